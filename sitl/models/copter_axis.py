"""One axis of a copter's velocity control: what is in it, and how what it asks for is given."""

from __future__ import annotations

from typing import Final, NamedTuple

#: The way that a led velocity may be ahead of the vehicle, m.
GAP_MAX_M: Final = 2.0


class Loop(NamedTuple):
    """One axis of the autopilot: the led velocity (m/s) and its rate, how far it is ahead (m), the integral
    (m/s^2), the acceleration that is given (m/s^2, without drag) and its rate (m/s^3)."""

    led_m_s: float
    led_m_s2: float
    gap_m: float
    integral_m_s2: float
    given_m_s2: float
    given_m_s3: float


def held(acceleration_m_s2: float) -> Loop:
    """Led to rest, and this acceleration held by the integral."""
    return Loop(0.0, 0.0, 0.0, acceleration_m_s2, acceleration_m_s2, 0.0)


def ahead(loop: Loop, led_m_s: float, v: float, dt: float) -> float:
    """How far the led place is ahead (m) after `dt` s at this led speed and the vehicle's."""
    return max(-GAP_MAX_M, min(GAP_MAX_M, loop.gap_m + (led_m_s - v) * dt))


def answered(
    loop: Loop,
    led_m_s: float,
    led_m_s2: float,
    gap_m: float,
    learned_m_s2: float,
    asked_m_s2: float,
    frequency_rad_s: float,
    damping: float,
    dt: float,
) -> Loop:
    """`dt` s later: the acceleration that is asked for is given as a second-order lag does."""
    w = frequency_rad_s
    rate = (
        loop.given_m_s3 + (w * w * (asked_m_s2 - loop.given_m_s2) - 2.0 * damping * w * loop.given_m_s3) * dt
    )
    return Loop(
        led_m_s, led_m_s2, gap_m, loop.integral_m_s2 + learned_m_s2, loop.given_m_s2 + rate * dt, rate
    )
