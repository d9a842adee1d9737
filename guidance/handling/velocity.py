"""Vehicles that take a velocity and a yaw rate: multirotors.

For them the desired field Xr is the velocity to fly, wherever the nose points. One step, in order: the
smoothed position, the clock of the reference, the field and its rate of change, what limits leave of both,
the velocity to ask for so that this one is flown (`response`), and the heading: along the field by the law's
turn, with a rate and a slew, or held. A slow field has no direction: then the heading stays as it was. Pose
and reference are those of the instant at which the setpoint acts.
"""

from __future__ import annotations

from math import atan2, cos, hypot, sin
from typing import Final, NamedTuple

from guidance import law
from guidance.alignment import global_turn
from guidance.error_function import ErrorFunction, derivatives, times
from guidance.handling import response, smoothing, stuck, waiting
from guidance.law import Evaluation, field_of
from guidance.limits import Controls, Limits, clamp, limited_rates
from guidance.se3 import (
    ZERO,
    Pose,
    Reference,
    Twist,
    Vec3,
    add,
    body_axes,
    dot,
    from_yaw,
    norm,
    rotate,
    subtract,
    yaw_of,
)


class Parameters(NamedTuple):
    """`limits` are those of the level: its speed, acceleration, yaw rate and yaw acceleration are used.

    `follows`: the nose goes along the field where that is faster than `slow_m_s`; else the heading is held.
    `drag_per_s` is what `response` takes c to be at first.
    """

    gains: law.Gains
    error_function: ErrorFunction
    limits: Limits
    up_max_m_s: float
    down_max_m_s: float
    vertical_acceleration_m_s2: float
    follows: bool
    slow_m_s: float
    drag_per_s: float
    response: response.Parameters
    smoothing: smoothing.Parameters
    waiting: waiting.Parameters
    stuck: stuck.Parameters


class Memory(NamedTuple):
    """Velocity and yaw rate are what the step before wanted; `heading_rad` is the one that is sought."""

    started: bool
    wanted_ned_m_s: Vec3
    heading_rad: float
    yaw_rate_rad_s: float
    response: response.Memory
    smoothing: smoothing.Memory
    waiting: waiting.Memory
    stuck: stuck.Memory


class Measured(NamedTuple):
    """World NED; `twist` in body axes (FRD), its linear part the velocity over ground. Both are predicted;
    `seen_yaw_rate_rad_s` is as it was measured."""

    pose: Pose
    twist: Twist
    seen_yaw_rate_rad_s: float


class Demand(NamedTuple):
    """What to ask the autopilot for; the yaw rate is about down, positive to the right."""

    velocity_ned_m_s: Vec3
    yaw_rate_rad_s: float


class Around(NamedTuple):
    """The law's evaluation (its controls: yaw rate, and speed along the field), and what was found around it.

    `wanted_ned_m_s` is the field within the limits, `acceleration_ned_m_s2` its change, `drag_per_s` what was
    learned.
    """

    law: Evaluation
    reference: Reference
    wanted_ned_m_s: Vec3
    acceleration_ned_m_s2: Vec3
    clock_rate: float
    drag_per_s: float
    stuck: bool


#: Before the first step.
UNSTARTED: Final = Memory(
    False, ZERO, 0.0, 0.0, response.unstarted(0.0), smoothing.UNSTARTED, waiting.ON_TIME, stuck.MOVING
)


def velocity_step(
    parameters: Parameters, memory: Memory, measured: Measured, reference: Reference, dt: float
) -> tuple[Memory, Demand, Around]:
    """`dt` s (> 0) after the step before, with the reference as planned at flight time - `waited_s`.

    Nothing raises, and all is finite, where `law.guide_step` promises that.
    """
    p = parameters
    yaw = yaw_of(measured.pose.attitude)
    velocity = rotate(measured.pose.attitude, measured.twist.linear)
    if not memory.started:
        memory = _begun(p, yaw, velocity, measured.seen_yaw_rate_rad_s)
    smooth = smoothing.smoothing_step(p.smoothing, memory.smoothing, measured.pose.position, velocity, dt)
    position, velocity = smooth.position, subtract(velocity, smooth.error)

    clock = waiting.waiting_step(p.waiting, memory.waiting, position, reference, dt)
    r = waiting.on_clock(reference, memory.waiting.rate, (clock.rate - memory.waiting.rate) / dt)

    beta = p.gains.beta
    e = subtract(position, r.position)
    d = derivatives(p.error_function, p.gains.k, beta, e, r)
    Xr, a = field_of(1.0 / beta, d, r)
    wanted = _limited(p, Xr, memory.wanted_ned_m_s, dt)
    # Xr' with the velocity that is wanted, which is known better than the one that is flown
    Hv = times(d.hessian, wanted)
    change = Vec3(a.x - Hv.x / beta, a.y - Hv.y / beta, a.z - Hv.z / beta)
    acceleration = change
    short = subtract(memory.wanted_ned_m_s, velocity)
    bound = wanted != Xr
    if bound:
        was = memory.wanted_ned_m_s
        acceleration = Vec3((wanted.x - was.x) / dt, (wanted.y - was.y) / dt, (wanted.z - was.z) / dt)
        short = ZERO
    acceleration = _shortened(
        acceleration, p.limits.acceleration_m_s2, p.vertical_acceleration_m_s2, p.vertical_acceleration_m_s2
    )
    learned, asked = response.response_step(p.response, memory.response, wanted, acceleration, short, dt)
    asked = add(asked, smooth.error)  # the autopilot sees its velocity with that error
    asked = _shortened(asked, p.limits.speed_max_m_s, p.up_max_m_s, p.down_max_m_s)

    y, heading, turn, yaw_rate = _nose(p, memory, yaw, Xr, change, dt)
    speed = norm(wanted)
    controls = Controls(0.0, 0.0, yaw_rate, speed)
    demanded = Controls(0.0, 0.0, turn, norm(Xr))
    still = stuck.stuck_step(p.stuck, memory.stuck, speed, norm(velocity), measured.seen_yaw_rate_rad_s, dt)
    return (
        Memory(True, wanted, heading, yaw_rate, learned, smooth, clock, still),
        Demand(asked, yaw_rate),
        Around(
            Evaluation(
                controls,
                demanded,
                e,
                y.x,
                y.y,
                y.z,
                d.phi,
                0.5 * (y.y * y.y + y.z * y.z),
                bound or yaw_rate != turn,
                False,
            ),
            r,
            wanted,
            acceleration,
            memory.waiting.rate,
            learned.drag_per_s,
            still.stuck,
        ),
    )


def _begun(p: Parameters, yaw: float, velocity: Vec3, yaw_rate: float) -> Memory:
    """From what it does now."""
    return Memory(
        True,
        velocity,
        yaw,
        yaw_rate,
        response.unstarted(p.drag_per_s),
        smoothing.UNSTARTED,
        waiting.ON_TIME,
        stuck.MOVING,
    )


def _limited(p: Parameters, Xr: Vec3, before: Vec3, dt: float) -> Vec3:
    """The field within the speeds, as near as the accelerations let it be; where nothing bites, itself."""
    held = _shortened(Xr, p.limits.speed_max_m_s, p.up_max_m_s, p.down_max_m_s)
    step = subtract(held, before)
    most, most_z = p.limits.acceleration_m_s2 * dt, p.vertical_acceleration_m_s2 * dt
    kept = _shortened(step, most, most_z, most_z)
    if kept == step:
        return held
    return Vec3(before.x + kept.x, before.y + kept.y, before.z + kept.z)


def _shortened(v: Vec3, level: float, up: float, down: float) -> Vec3:
    """`v` with its level part at most `level` long, in its direction, and the vertical within [-up, down]."""
    length = hypot(v.x, v.y)
    part = level / length if length > level else 1.0
    return Vec3(part * v.x, part * v.y, clamp(v.z, -up, down))


def _nose(
    p: Parameters, memory: Memory, yaw: float, Xr: Vec3, change: Vec3, dt: float
) -> tuple[Vec3, float, float, float]:
    """The field in the axes of the heading, the heading sought, the turn to it, what limits leave of it."""
    b1, b2, b3 = body_axes(from_yaw(yaw))
    beta = p.gains.beta
    y = Vec3(beta * dot(b1, Xr), beta * dot(b2, Xr), beta * dot(b3, Xr))
    heading = memory.heading_rad
    towards, turning = Vec3(cos(heading), sin(heading), 0.0), ZERO
    if p.follows and hypot(Xr.x, Xr.y) > p.slow_m_s:
        heading = atan2(Xr.y, Xr.x)
        towards, turning = Vec3(Xr.x, Xr.y, 0.0), Vec3(change.x, change.y, 0.0)
    limits = p.limits
    turn = global_turn(
        p.gains,
        limits.yaw_acceleration_rad_s2,
        Vec3(beta * dot(b1, towards), beta * dot(b2, towards), 0.0),
        Vec3(beta * dot(b1, turning), beta * dot(b2, turning), 0.0),
    ).u3
    before = Controls(0.0, 0.0, memory.yaw_rate_rad_s, 0.0)
    return y, heading, turn, limited_rates(limits, 0.0, 0.0, turn, before, dt)[2]
