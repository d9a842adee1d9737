"""Flights of the kinematic body (1) under `guide_step`, with actuators that may lag."""

from __future__ import annotations

import random
from collections.abc import Callable
from math import exp, sqrt
from typing import NamedTuple

from guidance import error_function, se3
from guidance.allocation import PITCH_YAW
from guidance.law import GLOBAL, REST, UNSTARTED, Evaluation, Gains, Limits, Parameters, guide_step
from guidance.limits import Controls
from guidance.se3 import Pose, Quaternion, Twist, Vec3
from guidance.trajectory import Trajectory, sample

#: A vehicle that only goes forward, at most 5 m/s, and turns by at most 5 rad/s about each axis.
FORWARD = Limits(0.0, 5.0, 5.0, 5.0, 5.0, keep_direction=True)
GLOBAL_LAW = Parameters(GLOBAL, PITCH_YAW, Gains(1.5, 10.0, 10.0, 1.0), error_function.PAPER, FORWARD)


class Moment(NamedTuple):
    """One step of a flight: |x - r| in m at t, and what the law said."""

    t: float
    error: float
    evaluation: Evaluation


def fly(
    parameters: Parameters,
    curve: Trajectory,
    pose: Pose,
    end_s: float,
    *,
    twist: Twist = REST,
    lag_s: float = 0.0,
    steps_per_s: int = 50,
    changed: Callable[[float, Parameters], Parameters] = lambda t, p: p,
) -> list[Moment]:
    """Each control acts for one step, behind a first-order lag if there is one."""
    dt = 1.0 / steps_per_s
    keep = exp(-dt / lag_s) if lag_s > 0.0 else 0.0
    memory = UNSTARTED
    flight = []
    for n in range(round(end_s * steps_per_s)):
        r = sample(curve, n * dt)
        memory, evaluation = guide_step(changed(n * dt, parameters), memory, pose, twist, r, dt)
        flight.append(Moment(n * dt, se3.norm(evaluation.e), evaluation))
        u = evaluation.controls
        end = _twist(u)
        if lag_s > 0.0:
            end = _mixed(keep, twist, end)
            mean = _mixed(0.5, twist, end)
        else:
            mean = end
        twist = end
        pose = se3.compose(pose, se3.exp(mean, dt))
        pose = Pose(pose.position, se3.normalized(pose.attitude))
    return flight


def _twist(u: Controls) -> Twist:
    return Twist(Vec3(u.u1, u.u2, u.u3), Vec3(u.u4, 0.0, 0.0))


def _mixed(part: float, a: Twist, b: Twist) -> Twist:
    def mix(v: Vec3, w: Vec3) -> Vec3:
        return se3.add(se3.scale(part, v), se3.scale(1.0 - part, w))

    return Twist(mix(a.angular, b.angular), mix(a.linear, b.linear))


def settled_s(flight: list[Moment], within_m: float = 0.01) -> float:
    """From when on the error stays within; the flight's end if it does not."""
    return max((m.t for m in flight if not m.error <= within_m), default=0.0)


def random_pose(dice: random.Random, centre: Vec3, radius_m: float) -> Pose:
    """Any attitude, and any place within a ball."""
    direction = _gauss(dice)
    r = radius_m * dice.random() ** (1.0 / 3.0) / se3.norm(direction)
    q = se3.normalized(Quaternion(*(dice.gauss(0.0, 1.0) for _ in range(4))))
    return Pose(se3.add(centre, se3.scale(r, direction)), q)


def random_twist(dice: random.Random) -> Twist:
    """Speed in [0, 5] m/s, rates within 5 rad/s."""
    rates = Vec3(*(dice.uniform(-5.0, 5.0) for _ in range(3)))
    return Twist(rates, Vec3(dice.uniform(0.0, 5.0), 0.0, 0.0))


def facing(direction: Vec3) -> Quaternion:
    """An attitude whose b1 has this direction."""
    d = se3.scale(1.0 / se3.norm(direction), direction)
    if d.x < -1.0 + 1e-12:
        return Quaternion(0.0, 0.0, 0.0, 1.0)
    w = sqrt(0.5 * (1.0 + d.x))
    return se3.normalized(Quaternion(w, 0.0, -0.5 * d.z / w, 0.5 * d.y / w))


def across(direction: Vec3, dice: random.Random) -> Vec3:
    """Some direction at a right angle."""
    return se3.cross(direction, _gauss(dice))


def _gauss(dice: random.Random) -> Vec3:
    return Vec3(dice.gauss(0.0, 1.0), dice.gauss(0.0, 1.0), dice.gauss(0.0, 1.0))
