"""A copter's flight without MAVLink: model, noise and `velocity_step`, interpreted or compiled.

The model steps at 4 ms, the guide at 50 Hz; what it measures it predicts, by the measured twist, to the
instant at which its demand acts, `ahead_s` later, and takes the reference of that instant. What is measured
has the noise of an estimator (`NOISES` independent normals a step):

- position: white, and a bias within `BIAS_MAX_M` that wanders with a correlation time of 30 s;
- heading: a constant bias; roll, pitch, heading, velocity, yaw rate: white.

Errors are those against the estimate: the position with its bias, which nobody on board can know, without the
white part, which is no motion; and the reference at that instant.
"""

from __future__ import annotations

from math import exp, pi, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from guidance.handling import velocity
from guidance.handling.velocity import Measured, velocity_step
from guidance.se3 import (
    ZERO,
    Pose,
    Reference,
    Twist,
    Vec3,
    compose,
    from_euler,
    rotate_inverse,
)
from guidance.se3 import exp as moved_by
from guidance.trajectory import circle, helix, lemniscate, line
from sitl.models import copter as model
from sitl.models.attitude import roll_pitch_heading
from sitl.models.gusts import NO_GUSTS, Turbulence, blowing, gusts_step

MODEL_STEP_S: Final = 0.004
GUIDE_STEP_S: Final = 0.02

POSITION_M: Final = 0.05
BIAS_MAX_M: Final = 0.1
BIAS_CORRELATION_S: Final = 30.0
HEADING_BIAS_RAD: Final = 2.0 * pi / 180.0
ATTITUDE_RAD: Final = 0.3 * pi / 180.0
VELOCITY_M_S: Final = 0.05
YAW_RATE_RAD_S: Final = 0.005

#: Normals that a guide's step takes: gusts 3, position 3, its bias 3, attitude 3, velocity 3, yaw rate 1.
NOISES: Final = 16

CIRCLE: Final = 0
HELIX: Final = 1
EIGHT: Final = 2
LEG: Final = 3

#: Columns of the record of a flight, one row a guide's step.
COLUMNS: Final = (
    "time_s",
    "error_m",
    "north_m",
    "east_m",
    "down_m",
    "speed_m_s",
    "nose_off_rad",
    "yaw_rate_asked_rad_s",
    "clock_rate",
    "drag_per_s",
    "stuck",
)


class Task(NamedTuple):
    """A circle (`size_m` its radius), a helix that climbs at `climb_m_s`, an eight `size_m` long and half as
    wide, or a leg to the north, `size_m` long, with a stop and a hold at its end."""

    kind: int
    size_m: float
    speed_m_s: float
    climb_m_s: float


def planned(task: Task, t_s: float) -> Reference:
    """The plan at this time on its own clock."""
    if task.kind == CIRCLE:
        return circle(t_s, task.size_m, task.speed_m_s, True, 0.0)
    if task.kind == HELIX:
        return helix(t_s, task.size_m, task.speed_m_s, -task.climb_m_s)
    if task.kind == EIGHT:
        return lemniscate(t_s, task.size_m, 0.5 * task.size_m, task.speed_m_s, 0.0)
    if t_s < task.size_m / task.speed_m_s:
        return line(t_s, 0.0, 0.0, 0.0, 0.0, task.speed_m_s, 0.0)
    return Reference(Vec3(task.size_m, 0.0, 0.0), ZERO, ZERO)


def fly(
    body: model.Parameters,
    guide: velocity.Parameters,
    ahead_s: float,
    task: Task,
    state: model.State,
    turbulence: Turbulence,
    heading_bias_rad: float,
    normals: NDArray[np.float64],
    record: NDArray[np.float64],
) -> None:
    """Fly as many steps as `normals` (steps, NOISES) has, and write `record` (steps, COLUMNS).

    The copter begins as `state` says.
    """
    memory = velocity.UNSTARTED
    gusts = NO_GUSTS
    sigma = 0.5 * BIAS_MAX_M
    bias = Vec3(sigma * normals[0, 6], sigma * normals[0, 7], sigma * normals[0, 8])
    fade = exp(-GUIDE_STEP_S / BIAS_CORRELATION_S)
    kick = sigma * sqrt(1.0 - fade * fade)
    steps = round(GUIDE_STEP_S / MODEL_STEP_S)
    for n in range(normals.shape[0]):
        z = normals[n]
        t_s = n * GUIDE_STEP_S
        bias = Vec3(fade * bias.x + kick * z[6], fade * bias.y + kick * z[7], fade * bias.z + kick * z[8])
        north, east, down = state.position_ned_m
        seen = Vec3(
            north + max(-BIAS_MAX_M, min(BIAS_MAX_M, bias.x)),
            east + max(-BIAS_MAX_M, min(BIAS_MAX_M, bias.y)),
            down + max(-BIAS_MAX_M, min(BIAS_MAX_M, bias.z)),
        )
        roll, pitch, heading = roll_pitch_heading(state.attitude_wxyz)
        attitude = from_euler(
            roll + ATTITUDE_RAD * z[9],
            pitch + ATTITUDE_RAD * z[10],
            heading + heading_bias_rad + ATTITUDE_RAD * z[11],
        )
        flown = state.velocity_ned_m_s
        v = Vec3(
            flown[0] + VELOCITY_M_S * z[12], flown[1] + VELOCITY_M_S * z[13], flown[2] + VELOCITY_M_S * z[14]
        )
        yaw_rate = state.yaw_rate_rad_s + YAW_RATE_RAD_S * z[15]
        twist = Twist(Vec3(0.0, 0.0, yaw_rate), rotate_inverse(attitude, v))
        x = Vec3(seen.x + POSITION_M * z[3], seen.y + POSITION_M * z[4], seen.z + POSITION_M * z[5])
        led = compose(Pose(x, attitude), moved_by(twist, ahead_s))

        clock_s = t_s - memory.waiting.waited_s
        rate = memory.waiting.rate
        memory, demand, found = velocity_step(
            guide, memory, Measured(led, twist, yaw_rate), planned(task, clock_s + ahead_s), GUIDE_STEP_S
        )
        state = model.told(
            body,
            state,
            (demand.velocity_ned_m_s.x, demand.velocity_ned_m_s.y, demand.velocity_ned_m_s.z),
            demand.yaw_rate_rad_s,
        )

        at = planned(task, clock_s + ahead_s * (1.0 - rate)).position
        row = record[n]
        row[0] = t_s
        row[1] = sqrt((seen.x - at.x) ** 2 + (seen.y - at.y) ** 2 + (seen.z - at.z) ** 2)
        row[2] = north
        row[3] = east
        row[4] = down
        row[5] = sqrt(flown[0] ** 2 + flown[1] ** 2 + flown[2] ** 2)
        off = memory.heading_rad - heading
        row[6] = off - 2.0 * pi * round(off / (2.0 * pi))
        row[7] = demand.yaw_rate_rad_s
        row[8] = found.clock_rate
        row[9] = found.drag_per_s
        row[10] = 1.0 if found.stuck else 0.0

        blows = blowing(turbulence, gusts)
        for _ in range(steps):
            state = model.step(body, state, blows, MODEL_STEP_S)
        through = sqrt((flown[0] - blows.north_m_s) ** 2 + (flown[1] - blows.east_m_s) ** 2 + flown[2] ** 2)
        gusts = gusts_step(turbulence, gusts, through, (z[0], z[1], z[2]), GUIDE_STEP_S)
