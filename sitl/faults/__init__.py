"""The fault harness: titled faults, flown, each with its safe outcome stated as data."""
