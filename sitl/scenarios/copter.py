"""The tasks of copters, on both firmwares: hovering nearby at first, in calm air and in wind."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import pi
from pathlib import Path
from typing import Final

from sitl.scenarios.flight import DEPLOY, Task
from sitl.scenarios.table import AS_IT_IS, Limits, Row, Variation
from sitl.vehicle import Firmware

#: Of each profile: the model, and the firmware's mode that holds.
COPTERS: Final = {
    "px4-copter": ("copter_px4", "AUTO.LOITER"),
    "ardupilot-copter": ("copter_ardupilot", "LOITER"),
}
HEIGHT_M: Final = 20.0
SPEED_M_S: Final = 3.0
LEG_S: Final = 20.0
_HIGH: Final = f"trajectory.down_m={-HEIGHT_M}"
ON_A_CIRCLE: Final = ("trajectory.name=circle", "trajectory.radius_m=10", _HIGH)
ON_A_HELIX: Final = ("trajectory.name=helix", "trajectory.radius_m=10", "trajectory.down_m_s=-0.5", _HIGH)
ON_AN_EIGHT: Final = ("trajectory.name=lemniscate", "trajectory.length_m=40", "trajectory.width_m=20", _HIGH)
#: To the north, and there it stops.
ON_A_LEG: Final = ("trajectory.name=line", _HIGH, f"trajectory.stop_at_s={LEG_S}", "trajectory.stop_over_s=4")
WIND: Final = Variation(name="5 m/s wind", vehicle={"wind_ned_m_s": (3.0, -4.0, 0.0)})
VARIATIONS: Final = (AS_IT_IS, WIND)
#: Told body rates and thrust: what a row is called, the autopilot's own parameters, and then a hover thrust
#: that is told wrong by a fifth. To ArduPilot thrust is thrust, without bit 3 of GUID_OPTIONS a climb rate.
BY_RATES: Final[tuple[tuple[str, str, Mapping[str, float], Mapping[str, float] | None], ...]] = (
    ("px4-copter", "by rates and thrust", {}, {"MPC_THR_HOVER": 0.4}),
    ("ardupilot-copter", "by rates and thrust", {"GUID_OPTIONS": 8}, {"MOT_THST_HOVER": 0.29}),
    ("ardupilot-copter", "by rates and climb", {"GUID_OPTIONS": 0}, None),
)


def task(
    profile: str,
    settings: tuple[str, ...],
    start: tuple[float, float],
    duration_s: float,
    settling_s: float = 6.0,
) -> Task:
    """Of the shipped configuration, from a hover 2 m below the tasks' height, the nose to the south."""
    model, mode = COPTERS[profile]
    return Task(
        profile=profile,
        settings=(*settings, f"trajectory.speed_m_s={SPEED_M_S}"),
        vehicle={
            "firmware": Firmware(profile),
            "model": model,
            "initial_position_ned_m": (*start, 2.0 - HEIGHT_M),
            "initial_yaw_rad": pi,
            "initially_armed": True,
            "initial_mode": mode,
        },
        duration_s=duration_s,
        converged_m=0.5,
        settling_s=settling_s,
    )


def rows(directory: Path = DEPLOY) -> tuple[Row, ...]:
    """All of them."""
    good = Limits(converged_s=8.0, rms_m=0.15, max_m=0.4)
    by_velocity = tuple(
        Row(name=name, task=flown, limits=good, variations=VARIATIONS)
        for profile in COPTERS
        for name, flown in (
            ("circle r 10 m at 3 m/s", task(profile, ON_A_CIRCLE, (7.0, 0.0), 40.0)),
            ("helix r 10 m at 3 m/s, 0.5 m/s up", task(profile, ON_A_HELIX, (0.0, -3.0), 40.0)),
            ("lemniscate 40 x 20 m at 3 m/s", task(profile, ON_AN_EIGHT, (-2.0, 2.0), 55.0)),
            ("leg at 3 m/s, stop and hold", task(profile, ON_A_LEG, (0.0, 2.0), 40.0, LEG_S)),
        )
    )
    return (*by_velocity, *_by_rates(good))


def _by_rates(good: Limits) -> Iterator[Row]:
    for profile, means, own, wrong in BY_RATES:
        for name, flown in (
            ("circle r 10 m at 3 m/s", task(profile, ON_A_CIRCLE, (7.0, 0.0), 40.0)),
            ("helix r 10 m at 3 m/s, 0.5 m/s up", task(profile, ON_A_HELIX, (0.0, -3.0), 40.0)),
            ("leg at 3 m/s, stop and hold", task(profile, ON_A_LEG, (0.0, 2.0), 40.0, LEG_S)),
        ):
            asked = replace(
                flown,
                settings=(*flown.settings, "copter.output=rates"),
                vehicle={**flown.vehicle, "parameters": own},
            )
            variations: tuple[Variation, ...] = VARIATIONS
            if wrong is not None:
                other = Variation(name="hover thrust told wrong", vehicle={"parameters": {**own, **wrong}})
                variations = (*VARIATIONS, other)
            yield Row(name=f"{name}, {means}", task=asked, limits=good, variations=variations)
