"""Named campaigns of the rover and of the airplanes: their tasks, with much that is wrong at once."""

from __future__ import annotations

from typing import Any, Final, Literal

from sitl.campaign.vehicle_plan import VehiclePlan

FLIGHTS: Final = 400

#: What is wrong: answer and speed by 30 %, the slew by half, 0.1 s, wind.
_WRONG: Final[dict[str, Any]] = {
    "gain": (0.7, 1.3),
    "slew": (0.5, 1.5),
    "delay_s": (-0.1, 0.1),
    "wind_m_s": (0.0, 6.0),
    "off_deg": (0.0, 180.0),
}


def rover(flights: int = FLIGHTS, seed: int = 0) -> list[VehiclePlan]:
    """From up to 15 m off in any heading, the reference waiting."""
    tasks = {
        "rover, circle r 10 m at 2 m/s": ("trajectory.name=circle", "trajectory.speed_m_s=2"),
        "rover, lemniscate 20 x 10 m at 2 m/s": ("trajectory.name=lemniscate", "trajectory.speed_m_s=2"),
    }
    return [
        VehiclePlan(
            profile="ardupilot-rover",
            name=name,
            settings=(*settings, "ground.waits=true"),
            flights=flights,
            seed=seed,
            power=(0.7, 1.3),
            distance_m=(0.0, 15.0),
            **_WRONG,
        )
        for name, settings in tasks.items()
    ]


def airplane(flights: int = FLIGHTS, seed: int = 0) -> list[VehiclePlan]:
    """At 12 and at 20 m/s, from up to 150 m off on any course, the reference waiting.

    The thrust is at most a tenth off: with a fifth less, the slower one cannot fly at 12 m/s.
    """
    rows: tuple[tuple[Literal["px4-plane", "ardupilot-plane"], float], ...] = (
        ("px4-plane", 12.0),
        ("ardupilot-plane", 20.0),
    )
    tasks = {
        "circle r 100 m": ("trajectory.name=circle", "trajectory.radius_m=100"),
        "eight 400 x 200 +-10 m": (
            "trajectory.name=eight",
            "trajectory.length_m=400",
            "trajectory.width_m=200",
            "trajectory.rise_m=10",
        ),
    }
    return [
        VehiclePlan(
            profile=profile,
            name=f"{profile} at {speed:g} m/s, {name}",
            settings=(*settings, f"trajectory.speed_m_s={speed:g}", "airplane.waits=true"),
            flights=flights,
            seed=seed,
            duration_s=120.0,
            within_m=3.0,
            due_s=45.0,
            settling_s=8.0,
            power=(0.9, 1.1),
            distance_m=(0.0, 150.0),
            up_m=(-10.0, 10.0),
            **_WRONG,
        )
        for profile, speed in rows
        for name, settings in tasks.items()
    ]
