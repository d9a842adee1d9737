"""Vehicles that drive: a yaw rate and a forward speed, in the plane (rovers, boats).

One step, in order: the smoothed position, the clock of the reference, the slip, the law along the course with
a crawl as its least speed, a turn that its slew can stop (`alignment`) and, below the crawl, none tighter
than its wheels make, the speed that keeps the path where the turn saturates, and the loop on measured speed.
Pose and reference are those of the instant at which the setpoint acts.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from guidance import law
from guidance.handling import slip, smoothing, speed_loop, stuck, waiting
from guidance.handling.crawl import crawl_floor, rest_m_s
from guidance.handling.saturation import kept_curvature
from guidance.law import Evaluation, desired_field, guide_step
from guidance.limits import Controls, Limits, clamp
from guidance.se3 import (
    Pose,
    Reference,
    Twist,
    Vec3,
    body_axes,
    dot,
    from_yaw,
    norm,
    rotate,
    rotate_inverse,
    subtract,
    yaw_of,
)


class Parameters(NamedTuple):
    """`crawl_m_s` is of the law that only goes forward; 0 is for vehicles that turn at rest. The paper's law
    may reverse, as far as `law.limits.speed_min_m_s` lets it, and has no crawl.

    `yaw_gain` (> 0) is the yaw rate that the vehicle gives for one that is asked.
    """

    law: law.Parameters
    crawl_m_s: float
    lateral_acceleration_m_s2: float
    yaw_gain: float
    smoothing: smoothing.Parameters
    slip: slip.Parameters
    speed_loop: speed_loop.Parameters
    waiting: waiting.Parameters
    stuck: stuck.Parameters


class Memory(NamedTuple):
    """Of each function its own."""

    law: law.Memory
    smoothing: smoothing.Memory
    slip: slip.Memory
    speed_loop: speed_loop.Memory
    waiting: waiting.Memory
    stuck: stuck.Memory


class Measured(NamedTuple):
    """World NED; `twist` in body axes (FRD), its linear part the velocity over ground.

    Both are predicted by `age_s`, with the rates that were sent; `seen_yaw_rate_rad_s` is the one that was
    measured.
    """

    pose: Pose
    twist: Twist
    seen_yaw_rate_rad_s: float
    age_s: float = 0.0


class Demand(NamedTuple):
    """What to ask the autopilot for: yaw rate, rad/s to the right, and forward speed, m/s."""

    yaw_rate_rad_s: float
    speed_m_s: float


class Around(NamedTuple):
    """The law's evaluation, and what was found around it, for the record.

    `crawling`: the crawl, not the law, set the speed; `slowed`: it was lowered to keep the path.
    """

    law: Evaluation
    reference: Reference
    slip_rad: float
    clock_rate: float
    speed_correction_m_s: float
    crawling: bool
    slowed: bool
    stuck: bool


#: Before the first step.
UNSTARTED: Final = Memory(
    law.UNSTARTED, smoothing.UNSTARTED, slip.NONE, speed_loop.START, waiting.ON_TIME, stuck.MOVING
)


def ground_step(
    parameters: Parameters, memory: Memory, measured: Measured, reference: Reference, dt: float
) -> tuple[Memory, Demand, Around]:
    """`dt` s (> 0) after the step before, with the reference as planned at flight time - `waited_s`.

    Nothing raises, and all is finite, where `law.guide_step` promises that.
    """
    p = parameters
    twist = measured.twist
    velocity = rotate(measured.pose.attitude, twist.linear)
    smooth = smoothing.smoothing_step(p.smoothing, memory.smoothing, measured.pose.position, velocity, dt)
    position = smooth.position
    linear = rotate_inverse(measured.pose.attitude, subtract(velocity, smooth.error))
    forward, right = linear.x, linear.y
    planned = _level(reference, position.z)

    clock = waiting.waiting_step(p.waiting, memory.waiting, position, planned, dt)
    change = (clock.rate - memory.waiting.rate) / dt if dt > 0.0 else 0.0
    r = waiting.on_clock(planned, memory.waiting.rate, change)

    drift = slip.slip_step(p.slip, memory.slip, forward, right, dt)
    pose = Pose(position, from_yaw(yaw_of(measured.pose.attitude) + drift.slip_rad))

    limits = p.law.limits
    before = memory.law.controls.u4 if memory.law.started else forward
    field = desired_field(p.law.gains, position, r, p.law.error_function)
    floor = limits.speed_min_m_s
    if p.law.law == law.GLOBAL:
        along = dot(body_axes(pose.attitude)[0], field.Xr)
        radius = p.crawl_m_s / limits.yaw_rate_rad_s
        per_s = p.law.gains.k / p.law.gains.beta
        rest = rest_m_s(p.crawl_m_s, per_s, radius, norm(r.velocity), before)
        crawl = crawl_floor(p.crawl_m_s, rest, norm(field.Xr), along, before, limits.acceleration_m_s2, dt)
        floor = max(floor, crawl)
    level_twist = Twist(Vec3(0.0, 0.0, twist.angular.z), Vec3(forward, 0.0, 0.0))
    turn = limits.yaw_rate_rad_s
    moves = max(abs(before), abs(forward))
    if moves < p.crawl_m_s:
        turn *= moves / p.crawl_m_s
    stepped, found = guide_step(_within(p.law, floor, turn), memory.law, pose, level_twist, r, dt)

    u = found.controls
    speed = kept_curvature(
        u.u4, found.demanded.u3, limits.yaw_rate_rad_s, p.lateral_acceleration_m_s2, p.crawl_m_s
    )
    stepped = law.Memory(True, Controls(u.u1, u.u2, u.u3, speed))

    loop, asked = speed_loop.speed_step(
        p.speed_loop,
        memory.speed_loop,
        speed,
        forward,
        measured.age_s,
        limits.speed_min_m_s,
        limits.speed_max_m_s,
        dt,
    )
    still = stuck.stuck_step(p.stuck, memory.stuck, asked, forward, measured.seen_yaw_rate_rad_s, dt)
    yaw_rate = clamp(u.u3 / p.yaw_gain, -limits.yaw_rate_rad_s, limits.yaw_rate_rad_s)
    return (
        Memory(stepped, smooth, drift, loop, clock, still),
        Demand(yaw_rate, asked),
        Around(
            found,
            r,
            drift.slip_rad,
            memory.waiting.rate,
            asked - speed,
            found.demanded.u4 < floor,
            abs(speed) < abs(u.u4),
            still.stuck,
        ),
    )


def _level(reference: Reference, z: float) -> Reference:
    """The reference in the vehicle's plane, as `law.planar` has it."""
    r, v, a = reference
    return Reference(Vec3(r.x, r.y, z), Vec3(v.x, v.y, 0.0), Vec3(a.x, a.y, 0.0))


def _within(parameters: law.Parameters, floor_m_s: float, yaw_rate_rad_s: float) -> law.Parameters:
    """The law with this least speed, at most its greatest, and this highest yaw rate."""
    p = parameters
    s = p.limits
    return law.Parameters(
        p.law,
        p.allocation,
        p.gains,
        p.error_function,
        Limits(
            min(floor_m_s, s.speed_max_m_s),
            s.speed_max_m_s,
            s.roll_rate_rad_s,
            s.pitch_rate_rad_s,
            yaw_rate_rad_s,
            s.keep_direction,
            s.acceleration_m_s2,
            s.roll_acceleration_rad_s2,
            s.pitch_acceleration_rad_s2,
            s.yaw_acceleration_rad_s2,
        ),
    )
