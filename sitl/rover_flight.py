"""A rover's or boat's drive without MAVLink: model, noise and `ground_step`, interpreted or compiled.

The model steps at 5 ms, so that the guide may step at 50, 40, 20 or 10 Hz, and the estimator draws anew at
50 Hz, with the noise of `sitl.vehicle.estimator`, level. What is measured is `AGE_S` old at the guide's step;
pose and reference are predicted to where the setpoint acts by the yaw rates that were sent, as
`guidance.prediction` does it.

Errors are those against the estimate: the position with its bias, which nobody on board can know, without the
white part, which is no motion; and the reference at that instant, on the clock that the guide set for it.
"""

from __future__ import annotations

from math import atan2, exp, hypot, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from guidance.handling import ground
from guidance.handling.ground import Measured, ground_step
from guidance.se3 import Pose, Reference, Twist, Vec3, compose, from_yaw, rotate, rotate_inverse, yaw_of
from guidance.se3 import exp as moved_by
from sitl.campaign.flight import reference_at
from sitl.models import rover as model
from sitl.models.gusts import NO_GUSTS, Turbulence, blowing, gusts_step
from sitl.vehicle.estimator import Noise

STEP_NS: Final = 5_000_000
STEP_S: Final = 0.005
#: From the instant of a measurement to the guide's step.
AGE_STEPS: Final = 4
AGE_S: Final = AGE_STEPS * STEP_S
#: The estimator draws anew every so many steps.
ESTIMATOR_STEPS: Final = 4

#: Normals that one estimate takes: position 2, its bias 2, heading 1, velocity 2, gusts 3.
NOISES: Final = 10
#: From here on they are the gusts'.
GUSTS: Final = 7
#: So many setpoints are remembered for the prediction: 1.3 s at 50 Hz.
REMEMBERED: Final = 64

#: Columns of the record of a flight, one row a guide's step.
COLUMNS: Final = (
    "time_s",
    "error_m",
    "north_m",
    "east_m",
    "heading_rad",
    "speed_m_s",
    "yaw_rate_asked_rad_s",
    "speed_asked_m_s",
    "saturated",
    "clock_rate",
    "slip_rad",
    "stuck",
)

Shape = tuple[float, float, float, float, float, float]


class Path(NamedTuple):
    """A trajectory as `sitl.campaign.flight.reference_at` takes it."""

    kind: int
    shape: Shape


class Guide(NamedTuple):
    """The handling, a setpoint every `steps` of the model (at least `AGE_STEPS`), each taken to act
    `ahead_ns` after it was computed."""

    ground: ground.Parameters
    steps: int
    ahead_ns: int


class Bias(NamedTuple):
    """How far the estimator is off for longer than one estimate: before it is bounded, m, north and east."""

    north_m: float
    east_m: float


def fly(
    body: model.Parameters,
    speed_part: float,
    guide: Guide,
    path: Path,
    state: model.State,
    turbulence: Turbulence,
    noise: Noise,
    heading_bias_rad: float,
    normals: NDArray[np.float64],
    record: NDArray[np.float64],
) -> None:
    """Fly as many guide's steps as `record` (steps, COLUMNS) has rows, and write them.

    The rover begins as `state` says, and makes of a speed that it is told `speed_part` times as much.
    `normals` (estimates, NOISES) has a row for every `ESTIMATOR_STEPS` of the model, and one more.
    """
    dt = guide.steps * STEP_S
    ahead_ns = AGE_STEPS * STEP_NS + guide.ahead_ns
    ahead_s = ahead_ns * 1e-9
    memory = ground.UNSTARTED
    gusts = NO_GUSTS
    half = 0.5 * noise.position_bias_m
    bias = Bias(half * normals[0, 2], half * normals[0, 3])
    drawn = 0
    sent_ns = np.zeros(REMEMBERED, np.int64)
    sent_rad_s = np.zeros(REMEMBERED)
    for n in range(record.shape[0]):
        step = n * guide.steps
        while drawn < step // ESTIMATOR_STEPS:
            drawn += 1
            bias = wandered(noise, bias, normals[drawn])
        z = normals[drawn]
        seen = sensed(noise, state, bounded(noise, bias), heading_bias_rad, z)
        true_north, true_east, true_heading = state.north_m, state.east_m, state.heading_rad
        speed, turning = state.speed_m_s, state.yaw_rate_rad_s

        # it drives on while the measurement is under way
        wind = blowing(turbulence, gusts)
        gusts = gusts_step(turbulence, gusts, airspeed(state, turbulence), (z[7], z[8], z[9]), dt)
        for _ in range(AGE_STEPS):
            state = model.step(body, state, wind.north_m_s, wind.east_m_s, STEP_S)

        planned_s = n * dt - memory.waiting.waited_s
        r = reference_at(path.kind, path.shape, planned_s)
        then = reference_at(path.kind, path.shape, planned_s - ahead_s * memory.waiting.rate)
        from_ns = step * STEP_NS
        pose, twist = predicted(sent_ns, sent_rad_s, n, seen.pose, seen.twist, from_ns, from_ns + ahead_ns)
        memory, demand, found = ground_step(
            guide.ground, memory, measured_of(pose, twist, turning, ahead_s), _level(r), dt
        )
        sent_ns[n % REMEMBERED] = from_ns + ahead_ns
        sent_rad_s[n % REMEMBERED] = found.law.controls.u3
        state = model.told(body, state, demand.yaw_rate_rad_s, speed_part * demand.speed_m_s)
        for _ in range(guide.steps - AGE_STEPS):
            state = model.step(body, state, wind.north_m_s, wind.east_m_s, STEP_S)

        off = bounded(noise, bias)
        row = record[n]
        row[0] = n * dt
        row[1] = hypot(true_north + off.north_m - then.position.x, true_east + off.east_m - then.position.y)
        row[2] = true_north
        row[3] = true_east
        row[4] = true_heading
        row[5] = speed
        row[6] = demand.yaw_rate_rad_s
        row[7] = demand.speed_m_s
        row[8] = 1.0 if found.law.saturated else 0.0
        row[9] = found.clock_rate
        row[10] = found.slip_rad
        row[11] = 1.0 if found.stuck else 0.0


class Seen(NamedTuple):
    """What the estimator makes of the truth."""

    pose: Pose
    twist: Twist


def sensed(
    noise: Noise, state: model.State, bias: Bias, heading_bias_rad: float, z: NDArray[np.float64]
) -> Seen:
    """With this bias (bounded) and these normals; the yaw rate is the true one."""
    heading = from_yaw(state.heading_rad + heading_bias_rad + noise.attitude_rad * z[4])
    velocity = Vec3(
        state.velocity_north_m_s + noise.velocity_m_s * z[5],
        state.velocity_east_m_s + noise.velocity_m_s * z[6],
        0.0,
    )
    position = Vec3(
        state.north_m + bias.north_m + noise.position_m * z[0],
        state.east_m + bias.east_m + noise.position_m * z[1],
        0.0,
    )
    return Seen(
        Pose(position, heading),
        Twist(Vec3(0.0, 0.0, state.yaw_rate_rad_s), rotate_inverse(heading, velocity)),
    )


def wandered(noise: Noise, bias: Bias, z: NDArray[np.float64]) -> Bias:
    """The position's bias, one estimate later."""
    fade = exp(-ESTIMATOR_STEPS * STEP_S / noise.position_bias_s)
    drive = 0.5 * noise.position_bias_m * sqrt(1.0 - fade * fade)
    return Bias(fade * bias.north_m + drive * z[2], fade * bias.east_m + drive * z[3])


def bounded(noise: Noise, bias: Bias) -> Bias:
    """As it counts."""
    most = noise.position_bias_m
    return Bias(max(-most, min(most, bias.north_m)), max(-most, min(most, bias.east_m)))


def predicted(
    sent_ns: NDArray[np.int64],
    sent_rad_s: NDArray[np.float64],
    count: int,
    pose: Pose,
    twist: Twist,
    from_ns: int,
    to_ns: int,
) -> tuple[Pose, Twist]:
    """As `guidance.prediction.predict`, of the last of `count` setpoints: instants, rising, and yaw rates,
    those of setpoint i in place i modulo the length."""
    at_ns = from_ns
    for i in range(max(0, count - len(sent_ns)), count):
        instant_ns = sent_ns[i % len(sent_ns)]
        if from_ns < instant_ns < to_ns:
            pose = compose(pose, moved_by(twist, (instant_ns - at_ns) * 1e-9))
            twist = Twist(Vec3(0.0, 0.0, sent_rad_s[i % len(sent_ns)]), twist.linear)
            at_ns = instant_ns
    return compose(pose, moved_by(twist, (to_ns - at_ns) * 1e-9)), twist


def measured_of(pose: Pose, twist: Twist, seen_yaw_rate_rad_s: float, age_s: float) -> Measured:
    """What the guide is told of a prediction by `age_s`."""
    heading = from_yaw(yaw_of(pose.attitude))
    velocity = rotate(pose.attitude, twist.linear)
    return Measured(
        Pose(pose.position, heading),
        Twist(Vec3(0.0, 0.0, twist.angular.z), rotate_inverse(heading, velocity)),
        seen_yaw_rate_rad_s,
        age_s,
    )


def airspeed(state: model.State, turbulence: Turbulence) -> float:
    """Level, in the steady wind, m/s."""
    wind = turbulence.wind
    return hypot(state.velocity_north_m_s - wind.north_m_s, state.velocity_east_m_s - wind.east_m_s)


def beside(path: Path, right_m: float, ahead_m: float, off_rad: float) -> model.State:
    """At rest, so far from the reference's start (to its right, ahead of it), the heading so much to the
    right of its course."""
    r = reference_at(path.kind, path.shape, 0.0)
    speed = hypot(r.velocity.x, r.velocity.y)
    c, s = r.velocity.x / speed, r.velocity.y / speed
    return model.at_rest(
        r.position.x + ahead_m * c - right_m * s,
        r.position.y + ahead_m * s + right_m * c,
        atan2(s, c) + off_rad,
    )


def _level(r: Reference) -> Reference:
    """In the plane of the origin."""
    p, v, a = r.position, r.velocity, r.acceleration
    return Reference(Vec3(p.x, p.y, 0.0), Vec3(v.x, v.y, 0.0), Vec3(a.x, a.y, 0.0))
