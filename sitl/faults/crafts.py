"""The seven profiles as they ship, each on the body of its own kind and on its way already.

The fault table flies the demo's configuration on an ideal vehicle, where a deviation of a centimetre shows.
These are the vehicles that are met outside: what an airplane or a copter does in a fault, no other shows.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from pathlib import Path
from typing import Any, Final, NamedTuple

from sitl.vehicle import Firmware
from sitl.vehicle.estimator import USUAL

#: Where the shipped configurations are, in a checkout.
DEPLOY: Final = Path(__file__).parents[2] / "deploy"
#: It flies when it is told to, around the autopilot's local origin.
_COMMON: Final = ("supervisor.arm=true", 'flight.origin="ekf"', "trajectory.name=circle")
#: From the start of the vehicle to the flight's, an airplane that circles flies on for so long, s.
_ENGAGED_S: Final = 0.7


class Craft(NamedTuple):
    """One profile: settings on top of what ships, `VehicleOptions`, and what is good.

    `good_m` is the error of good tracking with an estimator's noise, regained within `back_s` after a fault:
    1.1 m that were worked off of a jump of 5 m before it was taken back fall by 1/e in three times tau
    (`guidance.blending`).
    `floor_down_m` is the airplane's floor, `airspeed_min_m_s` its least airspeed; 0: none.
    """

    settings: tuple[str, ...]
    vehicle: Mapping[str, Any]
    good_m: float
    back_s: float
    airspeed_min_m_s: float = 0.0
    floor_down_m: float = 0.0


def _airplane(firmware: Firmware, model: str, mode: str, speed_m_s: float, least_m_s: float) -> Craft:
    floor_down_m = -40.0
    return Craft(
        (
            *_COMMON,
            f"trajectory.speed_m_s={speed_m_s}",
            "trajectory.radius_m=100",
            "trajectory.down_m=-60",
            f"airplane.floor_down_m={floor_down_m}",
        ),
        {
            "model": model,
            "initial_position_ned_m": (100.0, -_ENGAGED_S * speed_m_s, -60.0),
            "initial_yaw_rad": 0.5 * pi,
            "initial_speed_m_s": speed_m_s,
            "initial_mode": mode,
            "initially_armed": True,
            "noise": USUAL,
        },
        3.0,
        20.0,
        least_m_s,
        floor_down_m,
    )


def _copter(model: str, mode: str) -> Craft:
    return Craft(
        (*_COMMON, "trajectory.speed_m_s=3", "trajectory.radius_m=10", "trajectory.down_m=-20"),
        {
            "model": model,
            "initial_position_ned_m": (10.0, 0.0, -20.0),
            "initial_yaw_rad": 0.5 * pi,
            "initial_mode": mode,
            "initially_armed": True,
            "noise": USUAL,
        },
        0.6,
        16.0,
    )


def _rover(model: str) -> Craft:
    return Craft(
        (*_COMMON, "trajectory.speed_m_s=2", "trajectory.radius_m=10"),
        {
            "model": model,
            "initial_position_ned_m": (10.0, 0.0, 0.0),
            "initial_yaw_rad": 0.5 * pi,
            "initially_armed": True,
            "noise": USUAL,
        },
        0.6,
        12.0,
    )


CRAFTS: Final[dict[Firmware, Craft]] = {
    Firmware.PX4_UUV: Craft(
        ("supervisor.arm=true", 'flight.origin="ekf"', "trajectory.down_m=20"),
        {
            "model": "uuv",
            "initial_position_ned_m": (5.0, 0.0, 20.0),
            "initial_yaw_rad": 0.5 * pi,
            "initially_armed": True,
            "noise": USUAL,
        },
        0.8,
        15.0,
    ),
    Firmware.PX4_PLANE: _airplane(Firmware.PX4_PLANE, "airplane_12", "AUTO.LOITER", 12.0, 10.0),
    Firmware.PX4_COPTER: _copter("copter_px4", "AUTO.LOITER"),
    Firmware.PX4_ROVER: _rover("rover_px4"),
    Firmware.ARDUPILOT_ROVER: _rover("rover"),
    Firmware.ARDUPILOT_PLANE: _airplane(Firmware.ARDUPILOT_PLANE, "airplane_20", "LOITER", 20.0, 11.0),
    Firmware.ARDUPILOT_COPTER: _copter("copter_ardupilot", "LOITER"),
}
