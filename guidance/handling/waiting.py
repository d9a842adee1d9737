"""A reference that waits: its clock runs slower while the vehicle is behind it, a little faster while ahead.

A vehicle that starts far off, or has been held up at a corner, chases a point that runs away; the law then
cuts across the plan. On a clock s(t) of its own the point is r(s), and what the law must know of it,

    r = r(s)    r' = s' dr/ds    r'' = s'^2 d^2r/ds^2 + s'' dr/ds

stays exact. s' follows the error along the track, e . r'/|r'|, between two bounds, and changes only slowly.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from guidance.limits import clamp
from guidance.se3 import Reference, Vec3, dot, norm
from guidance.trajectory import on_clock as on_clock  # how the law takes a reference on this clock


class Parameters(NamedTuple):
    """s' within [`slowest`, `fastest`], 0 < slowest <= 1 <= fastest, both 1 to switch it off.

    s' is 1 + `per_m` times the error along the track (m, positive ahead). It falls by at most `falls_per_s` a
    second and rises by at most `rises_per_s`, which times the speed is an acceleration that is asked for.
    """

    slowest: float
    fastest: float
    per_m: float
    falls_per_s: float
    rises_per_s: float


class Memory(NamedTuple):
    """s' now, and how far (s) the trajectory's clock is behind the flight's: trajectory time = flight time -
    `waited_s`, for the step that comes."""

    rate: float
    waited_s: float


ON_TIME: Final = Memory(1.0, 0.0)
OFF: Final = Parameters(1.0, 1.0, 0.0, 1.0, 1.0)


def waiting_step(
    parameters: Parameters, memory: Memory, position: Vec3, planned: Reference, dt: float
) -> Memory:
    """The clock of the next step, for a vehicle at `position` and the reference as planned (by s)."""
    p = parameters
    speed = norm(planned.velocity)
    wanted = 1.0
    if speed > 0.0:
        e = Vec3(
            position.x - planned.position.x, position.y - planned.position.y, position.z - planned.position.z
        )
        wanted += p.per_m * dot(e, planned.velocity) / speed
    lowest, highest = memory.rate - p.falls_per_s * dt, memory.rate + p.rises_per_s * dt
    rate = clamp(clamp(wanted, p.slowest, p.fastest), lowest, highest)
    return Memory(rate, memory.waited_s + (1.0 - rate) * dt)
