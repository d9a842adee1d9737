"""Guidance of forward-driven vehicles on SE(3) over MAVLink.

The law is that of Tabuada & Lima, *Position tracking for underactuated rigid bodies on SE(3)*.
"""

__version__ = "0.1.0"
