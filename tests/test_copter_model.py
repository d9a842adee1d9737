"""The copter models against the step responses that were recorded of both autopilots, and as bodies."""

from __future__ import annotations

from functools import cache
from math import atan, cos, hypot, pi, radians, sin, tan
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from sitl.compiled import compiled
from sitl.models.copter import (
    GRAVITY_M_S2,
    IN_FLIGHT,
    Parameters,
    State,
    acting,
    hovering,
    roll_pitch_heading,
    step,
    thrust_of,
    told,
    told_rates,
)
from sitl.models.files import COPTERS, load_copter
from sitl.models.gusts import CALM, Wind

DT_S = 0.004
PERIOD = 5
MODELS = {name: load_copter(name) for name in COPTERS}

#: The flights that were recorded, from rest: s, and which of velocity NED and yaw rate was asked for (index).
PX4_STEPS = (4.5, 3.0), (3.0, 3.0), (2.0, 1.3)
ARDU_STEPS = (3.5, 2.5), (3.0, 3.0), (2.0, 1.3)
STEPS = (
    ("north +2", 0, 2.0),
    ("north -2", 0, -2.0),
    ("east +2", 1, 2.0),
    ("east -2", 1, -2.0),
    ("down -2", 2, -2.0),
    ("down +2", 2, 2.0),
    ("yaw +0.3", 3, 0.3),
    ("yaw -0.3", 3, -0.3),
    ("yaw +1", 3, 1.0),
    ("yaw -1", 3, -1.0),
)
#: What was seen: value at the end (mean of 0.4 s), s until 5, 50 and 90 % of the change, overshoot in %.
RECORDED = {
    "copter_ardupilot": {
        "north +2": (1.98, 0.32, 0.76, 1.36, 0.0),
        "north -2": (-2.03, 0.28, 0.74, 1.36, 0.0),
        "east +2": (2.00, 0.31, 0.75, 1.32, 0.0),
        "east -2": (-1.99, 0.29, 0.75, 1.35, 0.0),
        "down -2": (-2.05, 0.28, 1.14, 1.94, 1.0),
        "down +2": (2.02, 0.34, 1.18, 1.86, 2.0),
        "yaw +0.3": (0.30, 0.10, 0.24, 0.36, 23.0),
        "yaw -0.3": (-0.30, 0.13, 0.24, 0.36, 23.0),
        "yaw +1": (1.00, 0.16, 0.32, 0.46, 19.0),
        "yaw -1": (-1.00, 0.18, 0.32, 0.46, 18.0),
    },
    "copter_px4": {
        "north +2": (1.58, 0.18, 0.46, 1.32, 1.0),
        "north -2": (-1.60, 0.16, 0.50, 2.27, 1.0),
        "east +2": (1.55, 0.19, 0.46, 1.73, 4.0),
        "east -2": (-1.58, 0.20, 0.54, 1.90, 5.0),
        "down -2": (-1.90, 0.07, 0.22, 0.56, 1.0),
        "down +2": (1.48, 0.06, 0.22, 0.67, 4.0),
        "yaw +0.3": (0.28, 0.00, 0.32, 0.69, 15.0),
        "yaw -0.3": (-0.26, 0.00, 0.28, 0.58, 13.0),
        "yaw +1": (0.91, 0.12, 0.34, 0.73, 3.0),
        "yaw -1": (-0.90, 0.02, 0.34, 0.67, 6.0),
    },
}


def seen(state: State, what: int) -> float:
    return state.yaw_rate_rad_s if what == 3 else state.velocity_ned_m_s[what]


@cache
def answers(name: str) -> dict[str, NDArray[np.float64]]:
    """The recorded flight, flown by the model: the value that each step asks for, every `DT_S`."""
    parameters = MODELS[name]
    state = hovering(parameters, (0.0, 0.0, -30.0), radians(-2.0), CALM)
    times = PX4_STEPS if name == "copter_px4" else ARDU_STEPS
    found = {}
    for label, what, asked in STEPS:
        on_s, off_s = times[max(0, what - 1)]
        track = [seen(state, what)]
        for n in range(round((on_s + off_s) / DT_S)):
            if n % PERIOD == 0:
                values = [0.0] * 4
                values[what] = asked if n * DT_S < on_s - 1e-9 else 0.0
                state = told(parameters, state, (values[0], values[1], values[2]), values[3])
            state = step(parameters, state, CALM, DT_S)
            if n * DT_S < on_s - 1e-9:
                track.append(seen(state, what))
        found[label] = np.array(track)
    return found
