"""What a class of vehicles needs around the law: small functions with a memory, composed in one step a class.

The law takes a vehicle that does at once what it is told. Each function here makes up for one way in which
no vehicle does, and can be switched off by its parameters. All are functions on NamedTuples of floats and
booleans, without clock, exceptions or text, so that flight, replay and campaigns share them.
"""
