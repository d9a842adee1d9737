"""The tasks of rovers, and ArduPilot's. From `AWAY_M` off, the distance is straight away from the circle, the
farthest to go for a place at that distance but one behind it."""

from __future__ import annotations

from dataclasses import replace
from math import atan2, pi, sqrt
from pathlib import Path
from typing import Any, Final, NamedTuple

from guidance import error_function
from guidance.law import Gains, desired_field
from guidance.se3 import Vec3
from guidance.trajectory import Circle, sample
from sitl.scenarios.flight import DEPLOY, Task, configuration
from sitl.scenarios.table import AS_IT_IS, Limits, Row, Variation
from sitl.vehicle import Firmware


class Rover(NamedTuple):
    """A profile, and the model behind its firmware."""

    profile: str
    model: str


ARDUPILOT: Final = Rover("ardupilot-rover", "rover")
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


def vehicle(
    north_m: float, east_m: float, heading_rad: float, rover: Rover = ARDUPILOT, **more: Any
) -> dict[str, Any]:
    """At rest there."""
    return {
        "firmware": Firmware(rover.profile),
        "model": rover.model,
        "initial_position_ned_m": (north_m, east_m, 0.0),
        "initial_yaw_rad": heading_rad,
        **more,
    }


def task(
    settings: tuple[str, ...],
    start: tuple[float, float, float],
    duration_s: float,
    corners_s: tuple[float, ...] = (),
    rover: Rover = ARDUPILOT,
) -> Task:
    """Of the shipped configuration."""
    return Task(
        profile=rover.profile,
        settings=settings,
        vehicle=vehicle(*start, rover),
        duration_s=duration_s,
        converged_m=0.3,
        settling_s=6.0,
        corners_s=corners_s,
    )


def _opposite_rad(north_m: float, east_m: float, directory: Path, rover: Rover) -> float:
    """The heading exactly opposite to the field of the circle's first instant there."""
    law = configuration(task(ON_A_CIRCLE, (north_m, east_m, 0.0), 1.0, (), rover), directory).law
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


def rows(directory: Path = DEPLOY, rover: Rover = ARDUPILOT) -> tuple[Row, ...]:
    """All of them; raises ConfigError."""
    opposite_rad = _opposite_rad(_OUT_M, 0.0, directory, rover)

    def one(
        settings: tuple[str, ...],
        start: tuple[float, float, float],
        duration_s: float,
        corners_s: tuple[float, ...] = (),
    ) -> Task:
        return task(settings, start, duration_s, corners_s, rover)

    found = (
        (
            "circle r 10 m at 2 m/s",
            one(ON_A_CIRCLE, (8.0, 0.0, 0.5 * pi), 40.0),
            Limits(converged_s=6.0, rms_m=0.03, max_m=0.06),
        ),
        (
            "lemniscate 20 x 10 m at 2 m/s",
            one(("trajectory.name=lemniscate", "trajectory.speed_m_s=2"), (0.0, 0.0, 0.25 * pi), 55.0),
            Limits(rms_m=0.05, max_m=0.12),
        ),
        (
            "zigzag, 90 degrees, 1.4 m/s",
            one(ON_A_ZIGZAG, (0.0, 0.0, 0.25 * pi), 55.0, (CORNER_S, 2.0 * CORNER_S)),
            Limits(corner_m=2.6, back_s=4.0),
        ),
        (
            "zigzag, the reference waits",
            one((*ON_A_ZIGZAG, *WAITS), (0.0, 0.0, 0.25 * pi), 55.0, (CORNER_S, 2.0 * CORNER_S)),
            Limits(corner_m=1.5, back_s=4.0),
        ),
        (
            "15 m off facing away",
            one((*ON_A_CIRCLE, *WAITS), (_OUT_M, 0.0, 0.0), 25.0),
            Limits(converged_s=9.0),
        ),
        (
            "15 m off, exactly opposite",
            one((*ON_A_CIRCLE, *WAITS), (_OUT_M, 0.0, opposite_rad), 25.0),
            Limits(converged_s=13.0),
        ),
    )
    forward = ((name, flown, replace(limits, reverse_m_s=0.0)) for name, flown, limits in found)
    return tuple(
        Row(name=name, task=flown, limits=limits, variations=VARIATIONS) for name, flown, limits in forward
    )
