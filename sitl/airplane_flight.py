"""An airplane's flight without MAVLink: model, noise and `airplane_step`, interpreted or compiled.

The model steps at 4 ms, the guide at 50 Hz on a state that is `AGE_S` old. What is measured has the noise of
an estimator (`NOISES` independent normals a step):

- position: white, and a bias that wanders with a correlation time of 30 s;
- heading: a constant bias; roll, pitch, heading: white; velocity: white; airspeed: white, and none where the
  flight says that there is no such sensor.

Errors are those against the estimate: what was measured, and the reference at that instant.
"""

from __future__ import annotations

from math import atan2, cos, exp, pi, sin, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from guidance.handling import airplane
from guidance.handling.airplane import Demand, Evaluation, Measured, airplane_step
from guidance.se3 import Pose, Reference, Vec3, from_euler
from guidance.trajectory import circle, helix
from sitl.models import airplane as model
from sitl.models.gusts import NO_GUSTS, Turbulence, Wind, blowing, gusts_step

MODEL_STEP_S: Final = 0.004
GUIDE_STEP_S: Final = 0.02
#: From the instant of a measurement to the guide's step.
AGE_S: Final = 0.02

POSITION_M: Final = 0.05
BIAS_M: Final = 0.05
BIAS_CORRELATION_S: Final = 30.0
HEADING_BIAS_RAD: Final = 2.0 * pi / 180.0
ATTITUDE_RAD: Final = 0.3 * pi / 180.0
VELOCITY_M_S: Final = 0.05
AIRSPEED_M_S: Final = 0.3

#: Normals that a guide's step takes: gusts 3, position 3, its bias 3, attitude 3, velocity 3, airspeed 1.
NOISES: Final = 16
#: So many of them, the first, are the gusts'.
GUSTS: Final = 3

CIRCLE: Final = 0
HELIX: Final = 1
EIGHT: Final = 2

#: Columns of the record of a flight, one row a guide's step.
COLUMNS: Final = (
    "time_s",
    "error_m",
    "across_m",
    "along_m",
    "down_m",
    "airspeed_m_s",
    "asked_m_s",
    "load",
    "roll_rad",
    "bank_asked_rad",
    "throttle",
    "saturated",
    "stall_guard",
    "clock_rate",
    "effectiveness",
    "pitch_trim_rad",
    "throttle_trim",
    "wind_north_m_s",
    "wind_east_m_s",
    "height_m",
)


class Task(NamedTuple):
    """A path at constant speed: a circle or helix (`size_m` its radius, climbing at `climb_m_s`), or an
    eight, `size_m` long to the north and half as wide, that rises and falls by `climb_m_s` m at its ends."""

    kind: int
    size_m: float
    speed_m_s: float
    climb_m_s: float


class Start(NamedTuple):
    """Where the flight begins, m from the reference's start (to its right, up), and how much (rad) the course
    is off the reference's, to the right; the height of the reference's start."""

    right_m: float
    up_m: float
    off_rad: float
    height_m: float


class Seen(NamedTuple):
    """Position and velocity (NED), roll, pitch, heading and airspeed: the true ones, or those estimated."""

    position_ned_m: Vec3
    velocity_ned_m_s: Vec3
    roll_rad: float
    pitch_rad: float
    heading_rad: float
    airspeed_m_s: float


def phase_step(task: Task, phase: float, ds: float) -> float:
    """The phase `ds` s of the plan later: its time, or the angle that makes the eight's speed constant."""
    if task.kind != EIGHT:
        return phase + ds
    k1 = _eight_rate(task, phase)
    k2 = _eight_rate(task, phase + 0.5 * ds * k1)
    k3 = _eight_rate(task, phase + 0.5 * ds * k2)
    k4 = _eight_rate(task, phase + ds * k3)
    return phase + ds * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0


def _eight_rate(task: Task, p: float) -> float:
    half = 0.5 * task.size_m
    return task.speed_m_s / sqrt((half * cos(p)) ** 2 + (half * cos(2.0 * p)) ** 2)


def planned(task: Task, phase: float, height_m: float) -> Reference:
    """The plan at this phase; its start is `height_m` above the origin."""
    if task.kind == CIRCLE:
        return circle(phase, task.size_m, task.speed_m_s, True, -height_m)
    if task.kind == HELIX:
        r = helix(phase, task.size_m, task.speed_m_s, -task.climb_m_s)
        return Reference(
            Vec3(r.position.x, r.position.y, r.position.z - height_m), r.velocity, r.acceleration
        )
    half = 0.5 * task.size_m
    up = task.climb_m_s
    rate = _eight_rate(task, phase)
    s, c, s2, c2 = sin(phase), cos(phase), sin(2.0 * phase), cos(2.0 * phase)
    # dr/dp and d^2r/dp^2; p'' from p' = V/|dr/dp| (level)
    change = half * half * (c * s + 2.0 * c2 * s2) / ((half * c) ** 2 + (half * c2) ** 2) * rate * rate
    return Reference(
        Vec3(half * s, 0.5 * half * s2, -height_m - up * s),
        Vec3(half * c * rate, half * c2 * rate, -up * c * rate),
        Vec3(
            -half * s * rate * rate + half * c * change,
            -2.0 * half * s2 * rate * rate + half * c2 * change,
            up * s * rate * rate - up * c * change,
        ),
    )


def started(body: model.Parameters, task: Task, start: Start, wind: Wind) -> model.State:
    """The airplane at its start, flying at the task's speed through the air."""
    r = planned(task, 0.0, start.height_m)
    course = atan2(r.velocity.y, r.velocity.x)
    return model.flying(
        body,
        r.position.x - sin(course) * start.right_m,
        r.position.y + cos(course) * start.right_m,
        r.position.z - start.up_m,
        course + start.off_rad,
        task.speed_m_s,
        wind,
    )


def fly(
    body: model.Parameters,
    guide: airplane.Parameters,
    trims: airplane.Trims,
    ahead_s: float,
    task: Task,
    height_m: float,
    state: model.State,
    turbulence: Turbulence,
    wind_given: bool,
    has_airspeed: bool,
    heading_bias_rad: float,
    normals: NDArray[np.float64],
    record: NDArray[np.float64],
) -> None:
    """Fly as many steps as `normals` (steps, NOISES) has, and write `record` (steps, COLUMNS).

    The airplane begins as `state` says; demands are taken to act `ahead_s` after the guide's step.
    """
    phase = phase_step(task, 0.0, ahead_s)
    wind = turbulence.wind
    gusts = NO_GUSTS
    memory = airplane.unstarted(trims)
    bias = Vec3(BIAS_M * normals[0, 6], BIAS_M * normals[0, 7], BIAS_M * normals[0, 8])
    steps = round(GUIDE_STEP_S / MODEL_STEP_S)
    for n in range(normals.shape[0]):
        z = normals[n]
        seen = sensed(
            Seen(
                Vec3(state.north_m, state.east_m, state.down_m),
                Vec3(state.velocity_north_m_s, state.velocity_east_m_s, state.velocity_down_m_s),
                state.roll_rad,
                state.pitch_rad,
                state.heading_rad,
                state.airspeed_m_s,
            ),
            bias,
            heading_bias_rad,
            z,
        )
        bias = wandered(bias, z)
        true_airspeed = state.airspeed_m_s

        # the vehicle flies on while the measurement is under way
        blows = blowing(turbulence, gusts)
        for _ in range(steps):
            state = model.step(body, state, blows, MODEL_STEP_S)
        gusts = gusts_step(turbulence, gusts, state.airspeed_m_s, (z[0], z[1], z[2]), GUIDE_STEP_S)

        ahead = AGE_S + ahead_s
        r = planned(task, phase, height_m)
        then = planned(task, phase_step(task, phase, -ahead * memory.waiting.rate), height_m)
        before = memory.waiting.waited_s
        measured = measured_of(seen, has_airspeed, wind_given, wind, ahead)
        memory, demand, found = airplane_step(guide, memory, measured, r, GUIDE_STEP_S)
        state = model.told(state, demand.roll_rad, demand.pitch_rad, demand.throttle)
        phase = phase_step(task, phase, GUIDE_STEP_S - (memory.waiting.waited_s - before))
        write(record[n], n * GUIDE_STEP_S, seen, then, true_airspeed, demand, found)


def sensed(true: Seen, bias_m: Vec3, heading_bias_rad: float, z: NDArray[np.float64]) -> Seen:
    """What the estimator makes of the truth."""
    x, v = true.position_ned_m, true.velocity_ned_m_s
    return Seen(
        Vec3(
            x.x + POSITION_M * z[3] + bias_m.x,
            x.y + POSITION_M * z[4] + bias_m.y,
            x.z + POSITION_M * z[5] + bias_m.z,
        ),
        Vec3(v.x + VELOCITY_M_S * z[12], v.y + VELOCITY_M_S * z[13], v.z + VELOCITY_M_S * z[14]),
        true.roll_rad + ATTITUDE_RAD * z[9],
        true.pitch_rad + ATTITUDE_RAD * z[10],
        true.heading_rad + heading_bias_rad + ATTITUDE_RAD * z[11],
        true.airspeed_m_s + AIRSPEED_M_S * z[15],
    )


def wandered(bias_m: Vec3, z: NDArray[np.float64]) -> Vec3:
    """The position's bias, a guide's step later."""
    fade = exp(-GUIDE_STEP_S / BIAS_CORRELATION_S)
    drive = BIAS_M * sqrt(1.0 - fade * fade)
    return Vec3(
        fade * bias_m.x + drive * z[6], fade * bias_m.y + drive * z[7], fade * bias_m.z + drive * z[8]
    )


def measured_of(seen: Seen, has_airspeed: bool, wind_given: bool, wind: Wind, ahead_s: float) -> Measured:
    """What the guide is told, `ahead_s` before its demand acts."""
    return Measured(
        Pose(seen.position_ned_m, from_euler(seen.roll_rad, seen.pitch_rad, seen.heading_rad)),
        seen.velocity_ned_m_s,
        seen.airspeed_m_s if has_airspeed else 0.0,
        wind_given,
        Vec3(wind.north_m_s, wind.east_m_s, wind.down_m_s),
        ahead_s,
    )


def write(
    row: NDArray[np.float64],
    time_s: float,
    seen: Seen,
    reference: Reference,
    airspeed_m_s: float,
    demand: Demand,
    found: Evaluation,
) -> None:
    """One row of the record: the reference of the instant that was seen, and the true airspeed then."""
    x, r, v = seen.position_ned_m, reference.position, reference.velocity
    e_n, e_e, e_d = x.x - r.x, x.y - r.y, x.z - r.z
    speed = sqrt(v.x * v.x + v.y * v.y)
    c, s = v.x / speed, v.y / speed
    row[0] = time_s
    row[1] = sqrt(e_n * e_n + e_e * e_e + e_d * e_d)
    row[2] = c * e_e - s * e_n
    row[3] = c * e_n + s * e_e
    row[4] = e_d
    row[5] = airspeed_m_s
    row[6] = found.asked_m_s
    row[7] = found.load
    row[8] = seen.roll_rad
    row[9] = demand.roll_rad
    row[10] = demand.throttle
    row[11] = 1.0 if found.bank_saturated else 0.0
    row[12] = 1.0 if found.stall_guard else 0.0
    row[13] = found.clock_rate
    row[14] = found.trims.effectiveness
    row[15] = found.trims.pitch_rad
    row[16] = found.trims.throttle
    row[17] = found.wind_ned_m_s.x
    row[18] = found.wind_ned_m_s.y
    row[19] = -x.z
