"""A vehicle that is asked for all it has, or for any motion at all, and does not move.

A wheel in a ditch, a motor that is off, an autopilot that ignores the setpoint: the law goes on asking, and
nothing in its own numbers shows it. Seen is a vehicle that is told to drive, and neither moves nor turns, for
longer than it can take to start.
"""

from __future__ import annotations

from typing import Final, NamedTuple


class Parameters(NamedTuple):
    """Asked for at least `asked_m_s`, below `speed_m_s` and `yaw_rate_rad_s`, for `after_s`; 0 s: never."""

    asked_m_s: float
    speed_m_s: float
    yaw_rate_rad_s: float
    after_s: float


class Memory(NamedTuple):
    """Seconds it has been asked to drive and has not moved, and whether that is too long."""

    still_s: float
    stuck: bool


MOVING: Final = Memory(0.0, False)
#: A sample of noise that looks like motion takes back so many times what a still one adds.
DOUBT: Final = 3.0


def stuck_step(
    parameters: Parameters,
    memory: Memory,
    asked_m_s: float,
    measured_m_s: float,
    yaw_rate_rad_s: float,
    dt: float,
) -> Memory:
    """With what is asked for and what is seen; one noisy sample neither makes nor unmakes it."""
    p = parameters
    if p.after_s <= 0.0 or abs(asked_m_s) < p.asked_m_s:
        return MOVING
    moves = abs(measured_m_s) > p.speed_m_s or abs(yaw_rate_rad_s) > p.yaw_rate_rad_s
    still = memory.still_s - DOUBT * dt if moves else memory.still_s + dt
    # capped, so that motion ends it as soon after a minute as after the time it took
    still = max(0.0, min(still, p.after_s))
    return Memory(still, still >= p.after_s or (memory.stuck and still > 0.0))
