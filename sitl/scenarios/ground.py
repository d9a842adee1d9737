"""A ground vehicle on one task, in virtual time: model, measurement noise, `guidance.handling`, figures.

No MAVLink: what is judged is the handling of the vehicle, not the link. The guide runs at its rate on noisy
measurements, predicts them by the setpoints under way to the instant at which its setpoint acts, and takes
the reference of that instant; the model runs in steps of `MODEL_STEP_S`.

The error is that against the estimate, as an operator sees it: the position with its slow bias, which nobody
on board can know, but without the white part, which is no motion.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from math import cos, exp, hypot, inf, radians, sin, sqrt
from random import Random
from typing import Final, NamedTuple

from guidance.handling import ground, rover_px4
from guidance.prediction import NOTHING_SENT, predict, sent
from guidance.se3 import Pose, Twist, Vec3, from_yaw
from guidance.trajectory import Trajectory, sample
from sitl.models import rover

MODEL_STEP_S: Final = 0.004
#: Below it for good, the vehicle has converged (m).
CONVERGED_M: Final = 0.3


class Noise(NamedTuple):
    """White parts at every measurement, and what changes slowly or not at all."""

    position_m: float = 0.05
    bias_m: float = 0.1
    bias_s: float = 30.0
    heading_bias_rad: float = radians(2.0)
    attitude_rad: float = radians(0.3)
    velocity_m_s: float = 0.05
    yaw_rate_rad_s: float = 0.005


NOISE: Final = Noise()
SILENT: Final = Noise(0.0, 0.0, 30.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Task:
    """One flight. `start` is north, east (m) and heading (rad), at rest; RMS and maximum count from
    `settled_s` on. `corners_s`: when the trajectory's corners are due, on its own clock.
    """

    trajectory: Trajectory
    start: tuple[float, float, float]
    duration_s: float
    settled_s: float
    corners_s: tuple[float, ...] = ()


@dataclass(frozen=True)
class Setting:
    """What a task is flown with.

    `known_delay_s` is what the guide predicts by, and of `extra_delay_s` too unless not `extra_is_known`;
    `thrust_part` is the speed that the vehicle makes of one that is asked for: its WP_SPEED over what the
    guide takes that to be. `steers_by`: the vehicle is PX4's and is told a velocity.
    """

    model: rover.Parameters
    handling: ground.Parameters
    known_delay_s: float
    noise: Noise = NOISE
    rate_hz: float = 50.0
    extra_delay_s: float = 0.0
    extra_is_known: bool = True
    thrust_part: float = 1.0
    predicts: bool = True
    wind_ne_m_s: tuple[float, float] = (0.0, 0.0)
    seed: int = 0
    steers_by: rover_px4.Autopilot | None = None


@dataclass(frozen=True)
class Figures:
    """s and m; inf where it did not happen. `converged_s` is before the first corner.

    `corner_m` is the largest error after a corner, `back_s` the time from a corner until the error is below
    `CONVERGED_M` for the rest of the leg. `truth_rms_m` is the RMS of the position without its bias, which
    nobody can hold to less than that. `reverse_m_s` is the fastest asked for backwards. `trace` has a row a
    step: t, error, north, east, speed, rate of the reference's clock.
    """

    converged_s: float
    rms_m: float
    max_m: float
    truth_rms_m: float
    corner_m: float
    back_s: float
    reverse_m_s: float
    saturated_part: float
    stuck: bool
    trace: tuple[tuple[float, ...], ...] = field(repr=False)


def fly(task: Task, setting: Setting) -> Figures:
    """The whole flight; deterministic, by its seed."""
    dice = Random(setting.seed)
    noise = setting.noise
    dt = 1.0 / setting.rate_hz
    substeps = max(1, round(dt / MODEL_STEP_S))
    model = setting.model._replace(delay_s=setting.model.delay_s + setting.extra_delay_s)
    ahead = setting.known_delay_s + (setting.extra_delay_s if setting.extra_is_known else 0.0)
    ahead = ahead if setting.predicts else 0.0
    state = rover.at_rest(*task.start)
    memory = ground.UNSTARTED
    history = NOTHING_SENT
    sign = 1.0 if dice.random() < 0.5 else -1.0
    drift = (dice.gauss(0.0, 0.5 * noise.bias_m), dice.gauss(0.0, 0.5 * noise.bias_m))
    keep = exp(-dt / noise.bias_s)
    clock: list[tuple[float, float]] = []
    samples: list[tuple[float, ...]] = []
    errors: list[tuple[float, float, float]] = []
    reverse = 0.0
    saturated = 0
    stuck = False
    for n in range(round(task.duration_s / dt)):
        t = n * dt
        drift = _wandered(drift, keep, noise.bias_m, dice)
        seen = (
            state.north_m + max(-noise.bias_m, min(noise.bias_m, drift[0])),
            state.east_m + max(-noise.bias_m, min(noise.bias_m, drift[1])),
        )

        position = Vec3(
            seen[0] + dice.gauss(0.0, noise.position_m), seen[1] + dice.gauss(0.0, noise.position_m), 0.0
        )
        heading = state.heading_rad + sign * noise.heading_bias_rad + dice.gauss(0.0, noise.attitude_rad)
        vn = state.velocity_north_m_s + dice.gauss(0.0, noise.velocity_m_s)
        ve = state.velocity_east_m_s + dice.gauss(0.0, noise.velocity_m_s)
        c, s = cos(heading), sin(heading)
        twist = Twist(
            Vec3(0.0, 0.0, state.yaw_rate_rad_s + dice.gauss(0.0, noise.yaw_rate_rad_s)),
            Vec3(c * vn + s * ve, c * ve - s * vn, 0.0),
        )
        pose = Pose(position, from_yaw(heading))
        now_ns, acts_ns = round(t * 1e9), round((t + ahead) * 1e9)
        led, led_twist = predict(history, pose, twist, now_ns, acts_ns)
        measured = ground.Measured(led, led_twist, twist.angular.z)

        planned_s = t + ahead - memory.waiting.waited_s
        planned = sample(task.trajectory, planned_s)
        memory, demand, around = ground.ground_step(setting.handling, memory, measured, planned, dt)
        history = sent(history, acts_ns, Vec3(0.0, 0.0, around.law.controls.u3))
        clock.append((t + ahead, planned_s))
        reverse = max(reverse, -demand.speed_m_s)
        saturated += around.law.saturated
        stuck = stuck or around.stuck

        on_s = trajectory_time(clock, t)
        at = sample(task.trajectory, on_s).position
        error = hypot(seen[0] - at.x, seen[1] - at.y)
        errors.append((error, hypot(state.north_m - at.x, state.east_m - at.y), on_s))
        samples.append((t, error, state.north_m, state.east_m, state.speed_m_s, around.clock_rate))

        yaw_rate, speed = demand.yaw_rate_rad_s, demand.speed_m_s * setting.thrust_part
        if setting.steers_by is not None:
            v = rover_px4.velocity_of(setting.steers_by, demand, heading)
            px4 = setting.steers_by
            yaw_rate, speed = rover.steered(px4.RO_YAW_P, radians(px4.RO_YAW_RATE_LIM), heading, v.x, v.y)
        state = rover.told(model, state, yaw_rate, speed)
        for _ in range(substeps):
            state = rover.step(model, state, *setting.wind_ne_m_s, dt / substeps)
    return _figures(task, dt, errors, reverse, saturated, stuck, tuple(samples))


def _wandered(drift: tuple[float, float], keep: float, bias_m: float, dice: Random) -> tuple[float, float]:
    """A step of two Gauss-Markov processes with half the bound as their deviation."""
    kick = 0.5 * bias_m * sqrt(1.0 - keep * keep)
    return keep * drift[0] + dice.gauss(0.0, kick), keep * drift[1] + dice.gauss(0.0, kick)


def trajectory_time(clock: list[tuple[float, float]], t: float) -> float:
    """What the reference's clock, as it was set at these instants, shows at `t` (s); before them, on time."""
    for at_s, planned_s in reversed(clock):
        if at_s <= t + 1e-9:
            return planned_s + (t - at_s)
    return t


def _figures(
    task: Task,
    dt: float,
    errors: list[tuple[float, float, float]],
    reverse: float,
    saturated: int,
    stuck: bool,
    trace: tuple[tuple[float, ...], ...],
) -> Figures:
    first = round(task.settled_s / dt)
    late = [e for e, _, _ in errors[first:]]
    corner = back = 0.0
    for due, until in pairwise((*task.corners_s, inf)):
        leg = [(n * dt, e) for n, (e, _, on_s) in enumerate(errors) if due <= on_s < until]
        if leg:
            corner = max(corner, max(e for _, e in leg))
            back = max(back, _settled_s([e for _, e in leg], dt))
    return Figures(
        _settled_s([e for e, _, _ in errors[: _first_corner(task, errors)]], dt),
        sqrt(sum(e * e for e in late) / len(late)),
        max(late),
        sqrt(sum(e * e for _, e, _ in errors[first:]) / len(late)),
        corner,
        back,
        reverse,
        saturated / len(errors),
        stuck,
        trace,
    )


def _first_corner(task: Task, errors: list[tuple[float, float, float]]) -> int:
    if not task.corners_s:
        return len(errors)
    return sum(1 for _, _, on_s in errors if on_s < task.corners_s[0])


def _settled_s(errors: list[float], dt: float) -> float:
    """From the first of these until they stay below `CONVERGED_M`; inf if they do not."""
    outside = [n for n, e in enumerate(errors) if not e < CONVERGED_M]
    if not outside:
        return 0.0
    return inf if outside[-1] == len(errors) - 1 else (outside[-1] + 1) * dt
