"""What a vehicle can do: its speeds, its rates, and how fast these can change."""

from __future__ import annotations

from math import inf, sqrt
from typing import Final, NamedTuple

#: So much of the rate of change that a limit allows is counted on to stop a turn; the rest is for delays.
SLEW_PART: Final = 0.7


class Controls(NamedTuple):
    """u of (1): roll, pitch and yaw rate in rad/s about the body axes (FRD), forward speed in m/s."""

    u1: float
    u2: float
    u3: float
    u4: float


class Limits(NamedTuple):
    """Rates are bounded by +-, all at least 0 and speed_min <= speed_max. Infinite values mean no limit.

    `speed_min_m_s` below zero allows reverse; above zero the vehicle is never asked for less. A rate that is
    limited to 0 has no actuator.

    With `keep_direction` rates that exceed a limit are all shortened by one factor, so that b1 turns in the
    direction that the law wants, only more slowly; without, each is clamped on its own, as in section 4.

    The last four bound the rate of change (> 0), and `keep_direction` says the same of the change.
    """

    speed_min_m_s: float
    speed_max_m_s: float
    roll_rate_rad_s: float
    pitch_rate_rad_s: float
    yaw_rate_rad_s: float
    keep_direction: bool = False
    acceleration_m_s2: float = inf
    roll_acceleration_rad_s2: float = inf
    pitch_acceleration_rad_s2: float = inf
    yaw_acceleration_rad_s2: float = inf


def clamp(value: float, lowest: float, highest: float) -> float:
    """The nearest value in [lowest, highest]."""
    if value < lowest:
        return lowest
    if value > highest:
        return highest
    return value


def stoppable(rate: float, angle: float, acceleration: float) -> float:
    """`rate` (>= 0, rad/s), or the highest from which a turn by `angle` (>= 0, rad) can be stopped in time.

    That is sqrt(2 a angle) for a rate that changes by at most a (rad/s^2), of which `SLEW_PART` is counted
    on. With more, a turn overshoots, and overshoots again on its way back.
    """
    if acceleration < inf:
        highest = sqrt(2.0 * SLEW_PART * acceleration * angle)
        if rate > highest:
            return highest
    return rate


def limited_speed(limits: Limits, u4: float, previous: float, dt: float) -> float:
    """The speed (m/s) nearest to u4 that can be asked for `dt` s after `previous` was.

    The range of speeds goes before the rate of change: a vehicle that is slower than `speed_min_m_s`, as when
    it starts, is asked for `speed_min_m_s` at once.
    """
    if limits.acceleration_m_s2 < inf:
        change = limits.acceleration_m_s2 * dt
        u4 = clamp(u4, previous - change, previous + change)
    return clamp(u4, limits.speed_min_m_s, limits.speed_max_m_s)


def limited_rates(
    limits: Limits, u1: float, u2: float, u3: float, previous: Controls, dt: float
) -> tuple[float, float, float]:
    """The rates (rad/s) that can be asked for `dt` s after `previous`, for these that are wanted.

    Where no limit bites these are the wanted ones, to the bit.
    """
    p = limits.roll_rate_rad_s
    q = limits.pitch_rate_rad_s
    r = limits.yaw_rate_rad_s
    if limits.keep_direction:
        part = 1.0
        if p > 0.0:
            part = _part(part, u1, p)
        if q > 0.0:
            part = _part(part, u2, q)
        if r > 0.0:
            part = _part(part, u3, r)
        u1 *= part
        u2 *= part
        u3 *= part
    u1 = clamp(u1, -p, p)
    u2 = clamp(u2, -q, q)
    u3 = clamp(u3, -r, r)

    a1 = limits.roll_acceleration_rad_s2
    a2 = limits.pitch_acceleration_rad_s2
    a3 = limits.yaw_acceleration_rad_s2
    if a1 == inf and a2 == inf and a3 == inf:
        return u1, u2, u3
    # From here both ends lie within the limits, and so does all between them.
    from1 = clamp(previous.u1, -p, p)
    from2 = clamp(previous.u2, -q, q)
    from3 = clamp(previous.u3, -r, r)
    a1 = a1 * dt if a1 < inf else inf
    a2 = a2 * dt if a2 < inf else inf
    a3 = a3 * dt if a3 < inf else inf
    if limits.keep_direction:
        c1, c2, c3 = u1 - from1, u2 - from2, u3 - from3
        part = _part(_part(_part(1.0, c1, a1), c2, a2), c3, a3)
        # Not with a part of 1: from + (u - from) is u but for rounding, and u unchanged means no limit.
        if part < 1.0:
            u1 = clamp(from1 + part * c1, -p, p)
            u2 = clamp(from2 + part * c2, -q, q)
            u3 = clamp(from3 + part * c3, -r, r)
    return (
        clamp(u1, from1 - a1, from1 + a1),
        clamp(u2, from2 - a2, from2 + a2),
        clamp(u3, from3 - a3, from3 + a3),
    )


def _part(part: float, value: float, limit: float) -> float:
    """`part`, or less, so that |part value| <= limit."""
    value = abs(value)
    if part * value > limit:
        return limit / value
    return part
