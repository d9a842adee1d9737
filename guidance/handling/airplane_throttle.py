"""Throttle for a wanted airspeed: what drag, climb and acceleration take, and a PI loop on airspeed.

    throttle = (c_2 V^2 + c_i n^2/V^2 + g sin(gamma) + a)/A + kp (V_w - V) + trim

A is the acceleration of full throttle. The trim, the loop's integral, learns what the rest has wrong; it rests
while the throttle is at an end (anti-windup).
"""

from __future__ import annotations

from math import sin
from typing import NamedTuple

from guidance.handling.airplane_bank import GRAVITY_M_S2
from guidance.limits import clamp


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


def throttle_for(
    parameters: Parameters,
    trim: float,
    wanted_m_s: float,
    airspeed_m_s: float,
    path_rad: float,
    load: float,
    acceleration_m_s2: float,
    frozen: bool,
    dt_s: float,
) -> Throttle:
    """The throttle for the airspeed `wanted_m_s` (> 0) on this path, at this load factor."""
    p = parameters
    needed = drag_m_s2(p, wanted_m_s, load) + GRAVITY_M_S2 * sin(path_rad) + acceleration_m_s2
    missing = wanted_m_s - airspeed_m_s
    wanted = needed / p.thrust_m_s2 + p.proportional_s_m * missing + trim
    throttle = clamp(wanted, p.lowest, p.highest)
    winding = (wanted > p.highest and missing > 0.0) or (wanted < p.lowest and missing < 0.0)
    if not frozen and not winding:
        trim = clamp(trim + p.integral_per_m * missing * dt_s, -p.trim_max, p.trim_max)
    return Throttle(throttle, throttle != wanted, trim)
