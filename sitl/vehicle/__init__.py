"""The built-in vehicle: a sans-IO MAVLink autopilot (PX4 UUV, ArduPilot rover) around the plant."""

from __future__ import annotations

from sitl.vehicle.options import Firmware, Origin, Truth, VehicleOptions
from sitl.vehicle.vehicle import Effect, Vehicle

__all__ = ["Effect", "Firmware", "Origin", "Truth", "Vehicle", "VehicleOptions"]
