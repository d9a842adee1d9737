"""Throttle for a wanted airspeed: what drag, climb and acceleration take, and a PI loop on airspeed.

    throttle = (c_2 V^2 + c_i n^2/V^2 + g sin(gamma) + a)/A + kp (V_w - V) + trim

A is the acceleration of full throttle. The trim, the loop's integral, learns what the rest has wrong; it is
not wound up while the throttle is at an end.
"""

from __future__ import annotations

from math import sin, sqrt
from typing import Final, NamedTuple

from guidance.handling.airplane_bank import GRAVITY_M_S2
from guidance.limits import clamp

#: Drag is asked for at this speed (m/s) or more: towards rest the induced part has no bound.
SLOWEST_M_S: Final = 3.0


class Parameters(NamedTuple):
    """The body's A (> 0), c_2 and c_i; the loop's gains, throttle per m/s and per m; the bounds of the trim
    and of the throttle, `lowest` >= 0 so that an engine keeps running."""

    thrust_m_s2: float
    drag_per_m: float
    induced_m3_s4: float
    proportional_s_m: float
    integral_per_m: float
    trim_max: float
    lowest: float
    highest: float


class Throttle(NamedTuple):
    """Throttle, 0 to 1, after its limits; whether one bit; and the trim for the next step, its memory."""

    throttle: float
    saturated: bool
    trim: float


def drag_m_s2(parameters: Parameters, airspeed_m_s: float, load: float) -> float:
    """Deceleration by drag at this airspeed (> 0) and load factor."""
    v2 = airspeed_m_s * airspeed_m_s
    return parameters.drag_per_m * v2 + parameters.induced_m3_s4 * load * load / v2


def steepest_sine(parameters: Parameters, trim: float, airspeed_m_s: float, load: float) -> float:
    """Sine of the path angle that full throttle can hold at this airspeed; below 0 it cannot even fly level.

    The learned trim is taken as thrust that is needed for the same flight, and so is not there for a climb.
    """
    excess = parameters.thrust_m_s2 * (parameters.highest - trim) - drag_m_s2(parameters, airspeed_m_s, load)
    return clamp(excess / GRAVITY_M_S2, -0.5, 0.5)


def fastest_m_s(parameters: Parameters, trim: float, load: float, climb_m_s: float) -> float:
    """The airspeed that full throttle holds in this climb, at this load factor; 0 if none."""
    p = parameters
    spare = p.thrust_m_s2 * (p.highest - trim)
    # a climb takes g climb/V, at the V without it: drag = spare - g climb/V
    for _ in range(3):
        root = spare * spare - 4.0 * p.drag_per_m * p.induced_m3_s4 * load * load
        if root <= 0.0 or spare <= 0.0:
            return 0.0
        speed = sqrt((spare + sqrt(root)) / (2.0 * p.drag_per_m))
        spare = p.thrust_m_s2 * (p.highest - trim) - GRAVITY_M_S2 * climb_m_s / speed
    return speed


def throttle_for(
    parameters: Parameters,
    trim: float,
    missing_m_s: float,
    airspeed_m_s: float,
    path_rad: float,
    load: float,
    acceleration_m_s2: float,
    frozen: bool,
    dt_s: float,
) -> Throttle:
    """The throttle to fly `missing_m_s` faster than `airspeed_m_s` (> 0) on this path, at this load."""
    p = parameters
    needed = (
        drag_m_s2(p, max(airspeed_m_s + missing_m_s, SLOWEST_M_S), load)
        + GRAVITY_M_S2 * sin(path_rad)
        + acceleration_m_s2
    )
    wanted = needed / p.thrust_m_s2 + p.proportional_s_m * missing_m_s + trim
    throttle = clamp(wanted, p.lowest, p.highest)
    winding = (wanted > p.highest and missing_m_s > 0.0) or (wanted < p.lowest and missing_m_s < 0.0)
    if not frozen and not winding:
        trim = clamp(trim + p.integral_per_m * missing_m_s * dt_s, -p.trim_max, p.trim_max)
    return Throttle(throttle, throttle != wanted, trim)
