"""The copter line of the table of figures: tasks, the guides that fly them, and what came of it."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, nan
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from guidance.handling import copter, velocity
from sitl.copter_flight import (
    CIRCLE,
    COLUMNS,
    EIGHT,
    GUIDE_STEP_S,
    HEADING_BIAS_RAD,
    HELIX,
    LEG,
    NOISES,
    Task,
    fly,
    planned,
)
from sitl.models import copter as model
from sitl.models.files import load_copter
from sitl.models.gusts import CALM, Turbulence, Wind


class Copter(NamedTuple):
    """A model, and the guide that flies it; demands are taken to act `ahead_s` after they are computed."""

    body: model.Parameters
    guide: velocity.Parameters
    ahead_s: float


def copter_px4(configured: copter.Configured = copter.UNBOUNDED) -> Copter:
    """PX4's quadrotor. `ahead_s`: the delay and the attitude's lags."""
    return Copter(load_copter("copter_px4"), copter.px4(copter.Px4(), configured), 0.09)


def copter_ardupilot(configured: copter.Configured = copter.UNBOUNDED) -> Copter:
    """ArduPilot's. `ahead_s`: the delay, and what its loops need after the led velocity and its jerk."""
    return Copter(load_copter("copter_ardupilot"), copter.ardupilot(copter.ArduPilot(), configured), 0.06)


class Scenario(NamedTuple):
    """A task in some wind, from `off_m` (NED) beside its start, at rest, and the limits of its figures.

    RMS and maximum count from `settled_s` on.
    """

    task: Task
    off_m: tuple[float, float, float]
    duration_s: float
    settled_s: float
    wind_m_s: float
    converged_s: float
    rms_m: float
    max_m: float


class Figures(NamedTuple):
    """`converged_s`: below `CONVERGED_M` for good from then on (inf: never)."""

    converged_s: float
    rms_m: float
    max_m: float
    nose_off_rad: float
    drag_per_s: float
    speed_at_end_m_s: float


#: Converged is below this for good.
CONVERGED_M: Final = 0.5
#: Of the end, what is averaged for the speed there.
END_S: Final = 2.0

TASKS: Final = {
    "circle r 10 m at 3 m/s": Scenario(
        Task(CIRCLE, 10.0, 3.0, 0.0), (-3.0, 0.0, 1.0), 60.0, 20.0, 0.0, 6.0, 0.15, 0.4
    ),
    "helix r 10 m at 3 m/s, 0.5 m/s up": Scenario(
        Task(HELIX, 10.0, 3.0, 0.5), (0.0, -3.0, 1.0), 60.0, 20.0, 0.0, 6.0, 0.15, 0.4
    ),
    "lemniscate 40 x 20 m at 3 m/s": Scenario(
        Task(EIGHT, 40.0, 3.0, 0.0), (-2.0, 2.0, 0.0), 80.0, 20.0, 0.0, 6.0, 0.15, 0.4
    ),
    "leg of 40 m at 4 m/s, stop and hold": Scenario(
        Task(LEG, 40.0, 4.0, 0.0), (0.0, 2.0, 0.0), 45.0, 25.0, 0.0, 16.0, 0.15, 0.4
    ),
}


def scenarios() -> dict[str, Scenario]:
    """The tasks in calm air and in 5 m/s of wind with gusts."""
    windy = {f"{name}, 5 m/s wind": row._replace(wind_m_s=5.0) for name, row in TASKS.items()}
    return {**TASKS, **windy}


def flown(
    copter_: Copter, scenario: Scenario, seed: int, compiled: Callable[..., Any] = fly
) -> NDArray[np.float64]:
    """The record of one flight, `COLUMNS` a step; `compiled` may be `fly` as machine code.

    The seed draws noise, gusts, where the wind blows to, the heading at the start and the bias of it.
    """
    steps = round(scenario.duration_s / GUIDE_STEP_S)
    dice = np.random.default_rng(seed)
    normals = dice.standard_normal((steps, NOISES))
    record = np.zeros((steps, len(COLUMNS)))
    gusts = 0.16 * scenario.wind_m_s
    to_rad = dice.uniform(0.0, 2.0 * np.pi)
    wind = Wind(scenario.wind_m_s * float(np.cos(to_rad)), scenario.wind_m_s * float(np.sin(to_rad)), 0.0)
    weather = Turbulence(wind if scenario.wind_m_s > 0.0 else CALM, gusts, 0.6 * gusts, 200.0, 50.0)
    begins = planned(scenario.task, 0.0).position
    off = scenario.off_m
    start = (begins.x + off[0], begins.y + off[1], begins.z + off[2])
    compiled(
        copter_.body,
        copter_.guide,
        copter_.ahead_s,
        scenario.task,
        model.hovering(copter_.body, start, float(dice.uniform(-np.pi, np.pi)), weather.wind),
        weather,
        float(dice.choice((-1.0, 1.0))) * HEADING_BIAS_RAD,
        normals,
        record,
    )
    return record


def figures(record: NDArray[np.float64], settled_s: float) -> Figures:
    """What came of a flight."""
    column = {name: record[:, i] for i, name in enumerate(COLUMNS)}
    error = column["error_m"]
    outside = np.flatnonzero(~(error < CONVERGED_M))
    first = int(outside[-1]) + 1 if outside.size else 0
    late = column["time_s"] >= settled_s
    if not late.any():
        return Figures(inf, nan, nan, nan, nan, nan)
    e = error[late]
    return Figures(
        inf if first == len(error) else first * GUIDE_STEP_S,
        float(np.sqrt(np.mean(e * e))),
        float(e.max()),
        float(np.abs(column["nose_off_rad"][late]).max()),
        float(column["drag_per_s"][-1]),
        float(column["speed_m_s"][-round(END_S / GUIDE_STEP_S) :].mean()),
    )
