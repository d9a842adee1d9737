"""The velocity to ask for so that a velocity is flown: how an autopilot answers one, the other way round.

PX4's loop makes of the velocity that is missing an acceleration, u' = P q + I integral(q) - D v', with
q = asked - v; the air takes c v of it. What has to be asked for a velocity v that changes by a is therefore

    q + I/P integral(q) = ((1 + D) a + c v)/P

and that is a washout: x = ((1 + D) a + c v)/P without what has stood in it for longer than P/I, which the
autopilot's integral holds by then, steady wind among it. ArduPilot leads its velocity at a rate in proportion
to what is missing, q = a/rate, and its loops do the rest: the same with c = 0 and nothing washed out.

All but c is a parameter of the autopilot. c differs by airframe and is learned: with too little of it the
vehicle falls short along what is asked for in its name. What is short all the same, in gusts that the
autopilot is slow to hold against, is asked for on top in proportion.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from guidance.limits import clamp
from guidance.se3 import ZERO, Vec3

#: Below this (m/s) what is asked for against the air teaches less and less.
SLOWEST_M_S: Final = 0.7


class Axis(NamedTuple):
    """`lag_s` is (1 + D)/P or 1/rate, `drag_s` 1/P (0: c plays no part), `washout_s` P/I (0: none)."""

    lag_s: float
    drag_s: float
    washout_s: float


class Parameters(NamedTuple):
    """Of c: `per_s` is how fast it is learned (0: not at all), within [0, `drag_max_per_s`].

    `kp` (without unit) is of what is short, bounded to +-`bound_m_s` an axis.
    """

    level: Axis
    vertical: Axis
    per_s: float
    drag_max_per_s: float
    kp: float
    bound_m_s: float


class Memory(NamedTuple):
    """What is washed out by now (m/s), and c (1/s)."""

    stood_m_s: Vec3
    drag_per_s: float


def unstarted(drag_per_s: float) -> Memory:
    """Of a vehicle that stands."""
    return Memory(ZERO, drag_per_s)


def response_step(
    parameters: Parameters,
    memory: Memory,
    velocity: Vec3,
    acceleration: Vec3,
    short: Vec3,
    dt: float,
) -> tuple[Memory, Vec3]:
    """What to ask for so that `velocity` is flown and changes by `acceleration`; `dt` s (> 0) after the last.

    `short` is by how much the measured velocity was below the wanted one, or zero where that teaches nothing:
    while limits are active. World NED.
    """
    p = parameters
    c = memory.drag_per_s
    level, vertical = p.level, p.vertical
    x = Vec3(
        level.lag_s * acceleration.x + c * level.drag_s * velocity.x,
        level.lag_s * acceleration.y + c * level.drag_s * velocity.y,
        vertical.lag_s * acceleration.z + c * vertical.drag_s * velocity.z,
    )
    stood = memory.stood_m_s
    part, part_z = _part(level.washout_s, dt), _part(vertical.washout_s, dt)
    stood = Vec3(
        stood.x + part * (x.x - stood.x), stood.y + part * (x.y - stood.y), stood.z + part_z * (x.z - stood.z)
    )
    bound = p.bound_m_s
    asked = Vec3(
        velocity.x + x.x - stood.x + clamp(p.kp * short.x, -bound, bound),
        velocity.y + x.y - stood.y + clamp(p.kp * short.y, -bound, bound),
        velocity.z + x.z - stood.z + clamp(p.kp * short.z, -bound, bound),
    )
    if p.per_s > 0.0 and level.drag_s > 0.0:
        # what a unit of c asks for, but for what is washed out
        n, e = velocity.x, velocity.y
        scale = level.drag_s * (n * n + e * e + SLOWEST_M_S * SLOWEST_M_S)
        c = clamp(c + p.per_s * dt * (n * short.x + e * short.y) / scale, 0.0, p.drag_max_per_s)
    return Memory(stood, c), asked


def _part(washout_s: float, dt: float) -> float:
    return dt / (washout_s + dt) if washout_s > 0.0 else 0.0
