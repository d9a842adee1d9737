"""The airplane line of the table of figures: tasks, the guides that fly them, and what came of it."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, nan, radians
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from guidance.handling import airplane
from guidance.handling.airplane_defaults import Airframe, handling, patience
from sitl.airplane_flight import (
    CIRCLE,
    COLUMNS,
    EIGHT,
    GUIDE_STEP_S,
    HEADING_BIAS_RAD,
    HELIX,
    NOISES,
    Start,
    Task,
    fly,
    started,
)
from sitl.models import airplane as model
from sitl.models.files import load_airplane
from sitl.models.gusts import CALM, Turbulence, Wind

#: What a manual would say of PX4's SIH airplane, and of ArduPlane's.
AIRFRAME_12: Final = Airframe(
    airspeed_min_m_s=10.0,
    airspeed_cruise_m_s=12.0,
    airspeed_max_m_s=14.0,
    climb_max_m_s=2.5,
    sink_max_m_s=3.0,
    climb_full_m_s=3.0,
    throttle_cruise=0.8,
    bank_max_rad=radians(45.0),
    pitch_cruise_rad=radians(-1.5),
    pitch_lowest_rad=radians(-30.0),
    pitch_highest_rad=radians(25.0),
    roll_rate_rad_s=1.5,
    lag_s=0.16,
    floor_down_m=-20.0,
)
AIRFRAME_20: Final = Airframe(
    airspeed_min_m_s=11.0,
    airspeed_cruise_m_s=20.0,
    airspeed_max_m_s=26.0,
    climb_max_m_s=4.0,
    sink_max_m_s=4.0,
    climb_full_m_s=17.0,
    throttle_cruise=0.36,
    bank_max_rad=radians(64.0),
    pitch_cruise_rad=radians(-1.5),
    pitch_lowest_rad=radians(-18.0),
    pitch_highest_rad=radians(22.0),
    roll_rate_rad_s=1.5,
    lag_s=0.43,
    floor_down_m=-20.0,
)


class Airplane(NamedTuple):
    """A model, and the guide that flies it; demands are taken to act `ahead_s` after they are computed."""

    body: model.Parameters
    guide: airplane.Parameters
    ahead_s: float


def airplane_12() -> Airplane:
    """Like PX4's SIH airplane at 12 m/s."""
    return Airplane(load_airplane("airplane_12"), handling(AIRFRAME_12), 0.05)


def airplane_20() -> Airplane:
    """Like ArduPlane's at 20 m/s."""
    return Airplane(load_airplane("airplane_20"), handling(AIRFRAME_20), 0.1)


class Scenario(NamedTuple):
    """A task in some weather, and the limits of its figures (inf: none)."""

    task: Task
    start: Start
    duration_s: float
    waits: bool
    wind_m_s: float
    wind_given: bool
    converged_s: float
    rms_m: float
    max_m: float


class Figures(NamedTuple):
    """`converged_s`: below 3 m for good from then on (NaN: never). All others are from `SETTLING_S` after."""

    converged_s: float
    rms_m: float
    max_m: float
    airspeed_min_m_s: float
    saturated: float
    effectiveness: float


#: Converged is below this for good.
CONVERGED_M: Final = 3.0
#: From 3 m off to what stays takes so long.
SETTLING_S: Final = 8.0

NEAR: Final = Start(20.0, -5.0, radians(30.0), 60.0)
FAR: Final = Start(-150.0, 0.0, radians(-90.0), 60.0)


def scenarios(speed_m_s: float) -> dict[str, Scenario]:
    """The tasks at this speed."""
    circles = {f"circle {r} m": Task(CIRCLE, float(r), speed_m_s, 0.0) for r in (80, 100)}
    tasks = {
        **circles,
        "helix 100 m, 1 m/s up": Task(HELIX, 100.0, speed_m_s, 1.0),
        "lemniscate 400 x 200 m +-10 m": Task(EIGHT, 400.0, speed_m_s, 10.0),
    }
    table = {
        name: Scenario(task, NEAR, 120.0, False, 0.0, True, 25.0, 0.5, 1.5) for name, task in tasks.items()
    }
    table["150 m off, facing away"] = Scenario(
        circles["circle 100 m"], FAR, 60.0, True, 0.0, True, 20.0, 0.5, 1.5
    )
    for given in (True, False):
        for name, task in tasks.items():
            known = "given" if given else "estimated"
            table[f"{name}, 5 m/s wind {known}"] = Scenario(
                task, NEAR, 150.0, True, 5.0, given, 40.0, 1.0, inf
            )
    return table


def flown(
    plane: Airplane,
    scenario: Scenario,
    seed: int,
    compiled: Callable[..., Any] = fly,
    *,
    has_airspeed: bool = True,
) -> NDArray[np.float64]:
    """The record of one flight, `COLUMNS` a step; `compiled` may be `fly` as machine code.

    The seed draws noise, gusts, where the wind blows to and the bias of the heading.
    """
    dice = drawn(scenario, seed)
    record = np.zeros((dice.normals.shape[0], len(COLUMNS)))
    compiled(
        plane.body,
        patient(plane.guide, scenario),
        airplane.UNTRIMMED,
        plane.ahead_s,
        scenario.task,
        scenario.start.height_m,
        started(plane.body, scenario.task, scenario.start, dice.weather.wind),
        dice.weather,
        scenario.wind_given,
        has_airspeed,
        dice.heading_bias_rad,
        dice.normals,
        record,
    )
    return record


class Drawn(NamedTuple):
    """What a seed draws: noise (steps, NOISES), weather, and the bias of the heading."""

    normals: NDArray[np.float64]
    weather: Turbulence
    heading_bias_rad: float


def drawn(scenario: Scenario, seed: int) -> Drawn:
    """The dice of one flight; where the wind blows to is drawn too."""
    dice = np.random.default_rng(seed)
    normals = dice.standard_normal((round(scenario.duration_s / GUIDE_STEP_S), NOISES))
    gusts = 0.16 * scenario.wind_m_s
    to_rad = dice.uniform(0.0, 2.0 * np.pi)
    wind = Wind(scenario.wind_m_s * float(np.cos(to_rad)), scenario.wind_m_s * float(np.sin(to_rad)), 0.0)
    weather = Turbulence(wind if scenario.wind_m_s > 0.0 else CALM, gusts, 0.6 * gusts, 200.0, 50.0)
    return Drawn(normals, weather, float(dice.uniform(-HEADING_BIAS_RAD, HEADING_BIAS_RAD)))


def patient(guide: airplane.Parameters, scenario: Scenario) -> airplane.Parameters:
    """The guide with the clock of this scenario."""
    if not scenario.waits:
        return guide
    return guide._replace(waiting=patience(scenario.task.speed_m_s, guide.k_per_s))


def figures(record: NDArray[np.float64]) -> Figures:
    """What came of a flight."""
    column = {name: record[:, i] for i, name in enumerate(COLUMNS)}
    error, time_s = column["error_m"], column["time_s"]
    outside = np.flatnonzero(~(error < CONVERGED_M))
    first = int(outside[-1]) + 1 if outside.size else 0
    settled = time_s >= first * GUIDE_STEP_S + SETTLING_S
    if not settled.any():
        return Figures(nan, nan, nan, float(column["airspeed_m_s"].min()), nan, nan)
    e = error[settled]
    return Figures(
        first * GUIDE_STEP_S,
        float(np.sqrt(np.mean(e * e))),
        float(e.max()),
        float(column["airspeed_m_s"].min()),
        float(column["saturated"][settled].mean()),
        float(column["effectiveness"][-1]),
    )
