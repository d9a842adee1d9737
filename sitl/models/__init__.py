"""The bodies behind the built-in vehicle: pure functions of a state and a command, with parameters in files.

Each `NAME.toml` holds the values of one model's parameters; all are SI units. The text knows nothing of
`guidance`, so that a sign error here cannot cancel against the same error there.
"""
