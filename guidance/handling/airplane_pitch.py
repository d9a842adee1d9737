"""Pitch for a wanted climb: path angle, angle of attack, and a slow integral that learns the trim.

The nose stands above the path by the angle of attack that the load takes, alpha_zero + K n/V^2, of which a
bank shows cos(phi) (sin(gamma) = cos(alpha) sin(theta) - sin(alpha) cos(phi) cos(theta)). With
n cos(phi) g = a_ver the second part is the same at every bank:

    theta = gamma + alpha_zero cos(phi) + K a_ver/(g V^2) + lead + trim

`lead` counters the climb that is missing now, `trim` what is missing always: a wrong alpha_zero, an
autopilot that holds less pitch than it is told (PX4 held three quarters). Without it 2.3 m of height.
"""

from __future__ import annotations

from math import asin, cos
from typing import Final, NamedTuple

from guidance.handling.airplane_bank import GRAVITY_M_S2
from guidance.limits import clamp


#: No push-over takes the load below this.
LOAD_MIN: Final = 0.2


class Parameters(NamedTuple):
    """`alpha_zero_rad` and K of the body; `lead` (rad of pitch for a rad of path angle that is missing) and
    `trim_per_s` of the loop; the trim stays within +-`trim_max_rad`, the pitch within its limits."""

    alpha_zero_rad: float
    alpha_per_load_rad_m2_s2: float
    lead: float
    trim_per_s: float
    trim_max_rad: float
    lowest_rad: float
    highest_rad: float


class Pitch(NamedTuple):
    """Pitch, rad up, after its limits; whether one bit; and the trim for the next step, its memory."""

    pitch_rad: float
    saturated: bool
    trim_rad: float


def path_angle(climb_m_s: float, airspeed_m_s: float) -> float:
    """The angle (rad) above the horizontal at which an airspeed (> 0) climbs so."""
    return asin(clamp(climb_m_s / airspeed_m_s, -0.95, 0.95))


def pitch_for(
    parameters: Parameters,
    trim_rad: float,
    wanted_rad: float,
    path_rad: float,
    bank_rad: float,
    vertical_m_s2: float,
    airspeed_m_s: float,
    load_max: float,
    frozen: bool,
    dt_s: float,
) -> Pitch:
    """The pitch for the path angle `wanted_rad` when it is `path_rad`, at a load factor of `load_max` at most.

    The trim is learned unless `frozen`, and rests while the pitch is at its own limit.
    """
    p = parameters
    upright = cos(bank_rad)
    load = vertical_m_s2 / GRAVITY_M_S2
    per_load = p.alpha_per_load_rad_m2_s2 / (airspeed_m_s * airspeed_m_s)
    missing = wanted_rad - path_rad
    zero = p.alpha_zero_rad * upright + trim_rad
    wanted = wanted_rad + zero + per_load * load + p.lead * missing
    # the nose above the path makes the load, whatever path is wanted
    least = path_rad + zero + per_load * LOAD_MIN * upright
    most = path_rad + zero + per_load * load_max * upright
    loaded = clamp(wanted, least, most)
    pitch = clamp(loaded, p.lowest_rad, p.highest_rad)
    # a wrong trim moves the bounds of the load as well, so these must not keep it from being learned
    if not frozen and pitch == loaded:
        trim_rad = clamp(trim_rad + p.trim_per_s * missing * dt_s, -p.trim_max_rad, p.trim_max_rad)
    return Pitch(pitch, pitch != wanted, trim_rad)
