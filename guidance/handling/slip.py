"""How far the course lies off the heading, from measured velocity.

The law turns b1 into the field as if the vehicle moved along b1. It does not: the estimator's heading is a
degree or two off, a boat drifts, a tyre slips. Left alone that is a constant error across the track, of
speed times angle over lambda k. The law is therefore given the course: the heading and the slip.

Slowly, because what is wanted is a constant and velocity is noisy; only when moving fast enough for a course
to exist; and within a bound: what is at it is a bad heading, which is not to be hidden but looked into.
"""

from __future__ import annotations

from math import atan2
from typing import Final, NamedTuple

from guidance.limits import clamp


class Parameters(NamedTuple):
    """A first-order filter with `time_constant_s` (> 0), at speeds over `speed_min_m_s` (> 0), within
    +-`bound_rad`; a bound of 0 switches it off."""

    time_constant_s: float
    speed_min_m_s: float
    bound_rad: float


class Memory(NamedTuple):
    """The slip, rad, positive when the course is to the right of the heading."""

    slip_rad: float


NONE: Final = Memory(0.0)


def slip_step(
    parameters: Parameters, memory: Memory, forward_m_s: float, right_m_s: float, dt: float
) -> Memory:
    """With the velocity over ground along the body's horizontal axes, `dt` s after the step before.

    Driving in reverse, the slip of the axis is the same line's: of (-v, -s) as of (v, s).
    """
    bound = parameters.bound_rad
    speed = abs(forward_m_s)
    # the course says nothing where the vehicle is slow, or slides more than it drives
    if bound <= 0.0 or speed < parameters.speed_min_m_s or speed < abs(right_m_s):
        return memory
    seen = atan2(right_m_s if forward_m_s > 0.0 else -right_m_s, speed)
    part = dt / (parameters.time_constant_s + dt)
    slip = memory.slip_rad + part * (seen - memory.slip_rad)
    return Memory(clamp(slip, -bound, bound))
