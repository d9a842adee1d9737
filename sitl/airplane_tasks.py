"""The airplane line of the table of figures: tasks, the guides that fly them, and what came of it."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, nan, radians
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from guidance.handling import (
    airplane,
    airplane_bank,
    airplane_envelope,
    airplane_pitch,
    airplane_throttle,
    airplane_wind,
    waiting,
)
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

WAITING: Final = waiting.Parameters(0.5, 1.15, 0.35, 0.5, 0.4)
PUNCTUAL: Final = waiting.OFF
WIND: Final = airplane_wind.Parameters(0.3, 0.05, 0.5, 15.0)


class Airplane(NamedTuple):
    """A model, and the guide that flies it; demands are taken to act `ahead_s` after they are computed."""

    body: model.Parameters
    guide: airplane.Parameters
    ahead_s: float


def airplane_12() -> Airplane:
    """Like PX4's SIH airplane at 12 m/s. The guide knows its body to 10 or 20 %, as one would by hand."""
    return Airplane(
        load_airplane("airplane_12"),
        airplane.Parameters(
            k_per_s=0.65,
            k_up_per_s=0.8,
            approach_m_s=13.0,
            approach_up_m_s=2.0,
            rho_per_s=1.8,
            roll_rate_rad_s=1.5,
            envelope=airplane_envelope.Parameters(10.0, 1.1, 14.0, radians(45.0), 1.5, 2.5, 3.0, -20.0, 0.5),
            bank=airplane_bank.Parameters(0.6, 1.3, 0.3, 1.0, 0.25),
            pitch=airplane_pitch.Parameters(-0.06, 5.0, 0.5, 0.3, 0.15, radians(-25), radians(25)),
            throttle=airplane_throttle.Parameters(12.5, 0.06, 300.0, 0.25, 0.06, 0.3, 0.0, 1.0),
            wind=WIND,
            waiting=PUNCTUAL,
        ),
        0.05,
    )


def airplane_20() -> Airplane:
    """Like ArduPlane's at 20 m/s."""
    return Airplane(
        load_airplane("airplane_20"),
        airplane.Parameters(
            k_per_s=0.7,
            k_up_per_s=0.8,
            approach_m_s=18.0,
            approach_up_m_s=3.0,
            rho_per_s=1.5,
            roll_rate_rad_s=1.5,
            envelope=airplane_envelope.Parameters(11.0, 2.5, 26.0, radians(64.0), 2.4, 4.0, 4.0, -20.0, 0.5),
            bank=airplane_bank.Parameters(0.6, 1.3, 0.3, 1.0, 0.25),
            pitch=airplane_pitch.Parameters(-0.06, 12.0, 0.25, 0.3, 0.15, radians(-18), radians(22)),
            throttle=airplane_throttle.Parameters(13.0, 0.0115, 120.0, 0.12, 0.05, 0.3, 0.0, 1.0),
            wind=WIND,
            waiting=PUNCTUAL,
        ),
        0.1,
    )


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
    steps = round(scenario.duration_s / GUIDE_STEP_S)
    dice = np.random.default_rng(seed)
    normals = dice.standard_normal((steps, NOISES))
    record = np.zeros((steps, len(COLUMNS)))
    gusts = 0.16 * scenario.wind_m_s
    from_rad = dice.uniform(0.0, 2.0 * np.pi)
    wind = Wind(scenario.wind_m_s * float(np.cos(from_rad)), scenario.wind_m_s * float(np.sin(from_rad)), 0.0)
    weather = Turbulence(wind if scenario.wind_m_s > 0.0 else CALM, gusts, 0.6 * gusts, 200.0, 50.0)
    guide = plane.guide._replace(waiting=WAITING) if scenario.waits else plane.guide
    compiled(
        plane.body,
        guide,
        airplane.UNTRIMMED,
        plane.ahead_s,
        scenario.task,
        scenario.start.height_m,
        started(plane.body, scenario.task, scenario.start, weather.wind),
        weather,
        scenario.wind_given,
        has_airspeed,
        float(dice.uniform(-HEADING_BIAS_RAD, HEADING_BIAS_RAD)),
        normals,
        record,
    )
    return record


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
