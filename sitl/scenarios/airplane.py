"""The tasks of airplanes: PX4's at 12 m/s and ArduPlane's at 20 m/s."""

from __future__ import annotations

from math import inf, pi, radians
from pathlib import Path
from typing import Any, Final, NamedTuple

from sitl.scenarios.flight import DEPLOY, Task
from sitl.scenarios.table import AS_IT_IS, Limits, Row, Variation
from sitl.vehicle import Firmware

HEIGHT_M: Final = 60.0
CONVERGED_M: Final = 3.0
#: From 3 m off to what stays takes so long.
SETTLING_S: Final = 8.0
#: The direction that a wind of 5 m/s blows to, and turbulence as of its strength.
WIND: Final = Variation(
    name="5 m/s wind and gusts", vehicle={"wind_ned_m_s": (-4.0, 3.0, 0.0), "gusts_m_s": 0.8}
)


class Airplane(NamedTuple):
    """A profile, the model behind it, and its speed; `least_m_s` is its minimum airspeed."""

    profile: str
    model: str
    speed_m_s: float
    least_m_s: float
    settings: tuple[str, ...] = ()


AIRPLANES: Final = (
    Airplane("px4-plane", "airplane_12", 12.0, 10.0),
    Airplane("ardupilot-plane", "airplane_20", 20.0, 11.0),
)


def task(
    plane: Airplane,
    settings: tuple[str, ...],
    start: tuple[float, float, float, float],
    duration_s: float,
) -> Task:
    """`start` is north, east, down and heading of an airplane in level flight that is left to hold."""
    north_m, east_m, down_m, heading_rad = start
    firmware = Firmware(plane.profile)
    vehicle: dict[str, Any] = {
        "firmware": firmware,
        "model": plane.model,
        "initial_position_ned_m": (north_m, east_m, down_m),
        "initial_yaw_rad": heading_rad,
        "initial_speed_m_s": plane.speed_m_s,
        "initial_mode": "LOITER" if firmware is Firmware.ARDUPILOT_PLANE else "AUTO.LOITER",
        "initially_armed": True,
    }
    return Task(
        profile=plane.profile,
        settings=(*plane.settings, *settings),
        vehicle=vehicle,
        duration_s=duration_s,
        converged_m=CONVERGED_M,
        settling_s=SETTLING_S,
    )


def on_a_circle(plane: Airplane, radius_m: float) -> tuple[str, ...]:
    """At the airplane's speed and the tasks' height."""
    return (
        "trajectory.name=circle",
        f"trajectory.radius_m={radius_m}",
        f"trajectory.speed_m_s={plane.speed_m_s}",
        f"trajectory.down_m={-HEIGHT_M}",
    )


def on_a_helix(plane: Airplane, radius_m: float) -> tuple[str, ...]:
    """1 m/s up."""
    return (
        "trajectory.name=helix",
        f"trajectory.radius_m={radius_m}",
        f"trajectory.speed_m_s={plane.speed_m_s}",
        "trajectory.down_m_s=-1",
        f"trajectory.down_m={-HEIGHT_M}",
    )


def on_an_eight(plane: Airplane, length_m: float) -> tuple[str, ...]:
    """Half as wide as long, +-10 m."""
    return (
        "trajectory.name=eight",
        f"trajectory.length_m={length_m}",
        f"trajectory.width_m={0.5 * length_m}",
        f"trajectory.speed_m_s={plane.speed_m_s}",
        "trajectory.rise_m=10",
        f"trajectory.down_m={-HEIGHT_M}",
    )


def near(north_m: float, east_m: float, heading_rad: float) -> tuple[float, float, float, float]:
    """20 m north of there, 5 m below, and 30 degrees off."""
    return north_m + 20.0, east_m, 5.0 - HEIGHT_M, heading_rad + radians(30.0)


def rows(directory: Path = DEPLOY) -> tuple[Row, ...]:
    """All of them."""
    found: list[Row] = []
    for plane in AIRPLANES:
        calm = Limits(
            converged_s=25.0, rms_m=0.5, max_m=1.5, saturated=0.01, airspeed_min_m_s=plane.least_m_s
        )
        windy = Limits(rms_m=1.0, saturated=inf, airspeed_min_m_s=plane.least_m_s)
        at = f"at {plane.speed_m_s:g} m/s"
        tasks = (
            (f"circle r 80 m {at}", on_a_circle(plane, 80.0), near(80.0, 0.0, 0.5 * pi)),
            (f"circle r 100 m {at}", on_a_circle(plane, 100.0), near(100.0, 0.0, 0.5 * pi)),
            (f"helix r 100 m, 1 m/s up, {at}", on_a_helix(plane, 100.0), near(0.0, 100.0, 0.0)),
            (f"eight 400 x 200 m, +-10 m, {at}", on_an_eight(plane, 400.0), near(0.0, 0.0, 0.25 * pi)),
        )
        for name, settings, start in tasks:
            found.append(
                Row(name=name, task=task(plane, settings, start, 100.0), limits=calm, variations=(AS_IT_IS,))
            )
            found.append(
                Row(
                    name=name,
                    task=task(plane, settings, start, 150.0),
                    limits=windy,
                    variations=(WIND,),
                )
            )
        away = task(plane, on_a_circle(plane, 100.0), (250.0, 0.0, -HEIGHT_M, 0.0), 60.0)
        found.append(Row(name=f"150 m off facing away, {at}", task=away, limits=Limits(converged_s=20.0)))
    return tuple(found)
