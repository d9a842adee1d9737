"""Step responses: what to ask of a vehicle, what its answers say of it, and what follows for its tuning.

`excitation` plans the steps and the room that they need, `identify` finds delay, slew, lag and gain in what
was measured, `propose` turns them into lines for the configuration, and `report` shows both. All are
functions without clock, link or files; nothing of it is on the control path, and no array library is needed.
"""
