"""The tasks of an ArduPilot rover. From `AWAY_M` off, the distance is straight away from the circle, the
farthest to go for a place at that distance but one behind it."""

from __future__ import annotations

from dataclasses import replace
from math import atan2, pi, sqrt
from pathlib import Path
from typing import Any, Final

from guidance import error_function
from guidance.law import Gains, desired_field
from guidance.se3 import Vec3
from guidance.trajectory import Circle, sample
from sitl.scenarios.flight import DEPLOY, Task, configuration
from sitl.scenarios.table import AS_IT_IS, Limits, Row, Variation
from sitl.vehicle import Firmware

PROFILE: Final = "ardupilot-rover"
CIRCLE: Final = Circle(radius_m=10.0, speed_m_s=2.0)
ON_A_CIRCLE: Final = ("trajectory.name=circle", "trajectory.radius_m=10", "trajectory.speed_m_s=2")
AWAY_M: Final = 15.0
LEG_M: Final = 20.0
ZIGZAG_M_S: Final = 1.4 / sqrt(2.0)
ON_A_ZIGZAG: Final = (
    "trajectory.name=zigzag",
    f"trajectory.leg_m={LEG_M}",
    f"trajectory.speed_m_s={ZIGZAG_M_S}",
)
CORNER_S: Final = LEG_M / ZIGZAG_M_S
WAITS: Final = ("ground.waits=true",)
_OUT_M: Final = CIRCLE.radius_m + AWAY_M


def vehicle(north_m: float, east_m: float, heading_rad: float, **more: Any) -> dict[str, Any]:
    """At rest there."""
    return {
        "firmware": Firmware.ARDUPILOT_ROVER,
        "model": "rover",
        "initial_position_ned_m": (north_m, east_m, 0.0),
        "initial_yaw_rad": heading_rad,
        **more,
    }


def task(
    settings: tuple[str, ...],
    start: tuple[float, float, float],
    duration_s: float,
    corners_s: tuple[float, ...] = (),
) -> Task:
    """Of the shipped configuration."""
    return Task(
        profile=PROFILE,
        settings=settings,
        vehicle=vehicle(*start),
        duration_s=duration_s,
        converged_m=0.3,
        settling_s=6.0,
        corners_s=corners_s,
    )


def _opposite_rad(north_m: float, east_m: float, directory: Path) -> float:
    """The heading exactly opposite to the field of the circle's first instant there."""
    law = configuration(task(ON_A_CIRCLE, (north_m, east_m, 0.0), 1.0), directory).law
    field = error_function.bounded(getattr(law.error_function, "approach_m_s", 1.0))
    gains = Gains(law.k, law.rho2_per_s, law.rho3_per_s, law.beta)
    Xr = desired_field(gains, Vec3(north_m, east_m, 0.0), sample(CIRCLE, 0.0), field).Xr
    return atan2(Xr.y, Xr.x) + pi


VARIATIONS: Final = (
    AS_IT_IS,
    Variation(name="30 % slower than asked", factor=1.5, speed_part=0.7),
    Variation(name="30 % faster than asked", factor=1.5, speed_part=1.3),
    Variation(name="80 ms more each way", factor=2.0, link_delay_s=0.08),
    Variation(name="10 Hz", factor=1.5, settings=("link.rate_hz=10",)),
)


def rows(directory: Path = DEPLOY) -> tuple[Row, ...]:
    """All of them; raises ConfigError."""
    found = (
        (
            "circle r 10 m at 2 m/s",
            task(ON_A_CIRCLE, (8.0, 0.0, 0.5 * pi), 40.0),
            Limits(converged_s=6.0, rms_m=0.03, max_m=0.06),
        ),
        (
            "lemniscate 20 x 10 m at 2 m/s",
            task(("trajectory.name=lemniscate", "trajectory.speed_m_s=2"), (0.0, 0.0, 0.25 * pi), 55.0),
            Limits(rms_m=0.05, max_m=0.12),
        ),
        (
            "zigzag, 90 degrees, 1.4 m/s",
            task(ON_A_ZIGZAG, (0.0, 0.0, 0.25 * pi), 55.0, (CORNER_S, 2.0 * CORNER_S)),
            Limits(corner_m=2.6, back_s=4.0),
        ),
        (
            "zigzag, the reference waits",
            task((*ON_A_ZIGZAG, *WAITS), (0.0, 0.0, 0.25 * pi), 55.0, (CORNER_S, 2.0 * CORNER_S)),
            Limits(corner_m=1.5, back_s=4.0),
        ),
        (
            "15 m off facing away",
            task((*ON_A_CIRCLE, *WAITS), (_OUT_M, 0.0, 0.0), 25.0),
            Limits(converged_s=9.0),
        ),
        (
            "15 m off, exactly opposite",
            task((*ON_A_CIRCLE, *WAITS), (_OUT_M, 0.0, _opposite_rad(_OUT_M, 0.0, directory)), 25.0),
            Limits(converged_s=13.0),
        ),
    )
    forward = ((name, flown, replace(limits, reverse_m_s=0.0)) for name, flown, limits in found)
    return tuple(
        Row(name=name, task=flown, limits=limits, variations=VARIATIONS) for name, flown, limits in forward
    )
