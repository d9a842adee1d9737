"""The clock of a reference that waits for an airplane, which cannot stop, nor hasten against the wind.

`waiting` between two bounds that are the airplane's own: no quicker than it can follow, straight on or in the
turn; and in a tail wind that carries it faster than the plan even at its least airspeed, no slower than that,
unless it is behind anyway. From an airplane far off the reference hardly flies away: at half its speed, one
that is little faster than the plan takes 3 s longer from 150 m off. What the wind does is in the velocity
over ground, with the gusts.
"""

from __future__ import annotations

from math import sqrt
from typing import Final

from guidance.handling import waiting
from guidance.limits import clamp
from guidance.se3 import Reference, Vec3

#: An airplane that is further (m) behind is waited for in any wind.
HURRIED_M: Final = 15.0
#: Ahead of the reference, the clock may run so much quicker (of the plan) than it must, to catch up.
CAUGHT_UP: Final = 0.1
#: From an airplane that is further (m) off, the slowest clock is the slower the further it is.
FAR_M: Final = 30.0
#: So much of the greatest bank's acceleration is for the plan; the rest is for errors and gusts.
TURNED_PART: Final = 0.7


def clock_step(
    parameters: waiting.Parameters,
    memory: waiting.Memory,
    planned: Reference,
    x: Vec3,
    v: Vec3,
    slower_m_s: float,
    faster_m_s: float,
    lateral_m_s2: float,
    dt: float,
) -> waiting.Memory:
    """The clock of the step `dt` s from now, for an airplane at x with the velocity v over ground (NED).

    It can fly `slower_m_s` slower than it does and `faster_m_s` faster, and turn at `lateral_m_s2`.
    """
    p = parameters
    r_dot, r_ddot = planned.velocity, planned.acceleration
    speed = sqrt(r_dot.x * r_dot.x + r_dot.y * r_dot.y)
    if p.fastest > 1.0 and speed > 0.0:
        c, s = r_dot.x / speed, r_dot.y / speed
        along = v.x * c + v.y * s
        least = (along - slower_m_s) / speed
        most = (along + faster_m_s) / speed
        turn = abs(r_ddot.y * c - r_ddot.x * s)
        highest = max(p.fastest, least + CAUGHT_UP)
        # s'^2 of the lateral acceleration
        if highest * highest * turn > TURNED_PART * lateral_m_s2:
            highest = sqrt(TURNED_PART * lateral_m_s2 / turn)
        north, east = planned.position.x - x.x, planned.position.y - x.y
        patient = p.slowest * FAR_M / max(sqrt(north * north + east * east), FAR_M)
        behind = c * north + s * east
        hurry = clamp(1.0 - behind / HURRIED_M, 0.0, 1.0) * clamp(10.0 * (least - 1.0), 0.0, 1.0)
        slowest = min(patient + hurry * (least - patient), highest)
        p = waiting.Parameters(
            slowest, max(min(most, highest), slowest), p.per_m, p.falls_per_s, p.rises_per_s
        )
    return waiting.waiting_step(p, memory, x, planned, dt)
