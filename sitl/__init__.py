"""The built-in vehicle: a kinematic plant with the manners of a real MAVLink autopilot."""
