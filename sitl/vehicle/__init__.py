"""The built-in vehicle: a sans-IO MAVLink autopilot (PX4 or ArduPilot, of any class) around a body."""

from __future__ import annotations

from sitl.vehicle.controls import Effect
from sitl.vehicle.estimator import USUAL, Noise
from sitl.vehicle.options import Firmware, Origin, Truth, VehicleOptions
from sitl.vehicle.vehicle import Vehicle, fitting

__all__ = ["USUAL", "Effect", "Firmware", "Noise", "Origin", "Truth", "Vehicle", "VehicleOptions", "fitting"]
