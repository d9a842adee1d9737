"""MAVLink: framing and messages, the clock and the link to one autopilot, and the autopilots' profiles.

Nothing here opens a socket or reads a clock.
"""
