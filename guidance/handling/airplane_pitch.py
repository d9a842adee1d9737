"""Pitch for a wanted climb: path angle, angle of attack, the draft that is felt, and a slow integral.

The nose stands above the path by the angle of attack that the load takes, alpha_zero + K n/V^2, of which a
bank shows cos(phi) (sin(gamma) = cos(alpha) sin(theta) - sin(alpha) cos(phi) cos(theta)). With
n cos(phi) g = a_ver the second part is the same at every bank:

    theta = gamma + alpha_zero cos(phi) + K a_ver/(g V^2) + lead (gamma - measured gamma) + trim

`trim`, learned slowly, is what is missing always: an error of alpha_zero, an autopilot that holds less pitch
than it is told (PX4 held three quarters). Without it 2.3 m of height.

The path that is asked for is never further from the one that is flown than the wing can turn it within
`TURNED_S`, g (n - 1)/V a second: a sharper pull-up brakes, or stalls, on the way out of a dive again.
"""

from __future__ import annotations

from math import asin, cos
from typing import Final, NamedTuple

from guidance.handling.airplane_bank import GRAVITY_M_S2
from guidance.limits import clamp

#: No push-over takes the load below this.
LOAD_MIN: Final = 0.2
#: Time (s) in which the wing could turn the path into the one that is asked for.
TURNED_S: Final = 0.25


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
    upright_load: float,
    airspeed_m_s: float,
    load_max: float,
    pushed_rad: float,
    frozen: bool,
    dt_s: float,
) -> Pitch:
    """The pitch for the path angle `wanted_rad` when path and bank are these, at `load_max` g at most.

    `upright_load` is a_ver/g of the formula above; a stall guard holds the nose `pushed_rad` lower.
    The trim is learned unless `frozen`, and not further into the pitch's own limits.
    """
    p = parameters
    turned = TURNED_S * GRAVITY_M_S2 / airspeed_m_s
    missing = clamp(wanted_rad - path_rad, turned * (LOAD_MIN - 1.0), turned * (load_max - 1.0))
    v2 = airspeed_m_s * airspeed_m_s
    alpha = p.alpha_zero_rad * cos(bank_rad) + p.alpha_per_load_rad_m2_s2 * upright_load / v2
    wanted = path_rad + missing + alpha + p.lead * missing + trim_rad - pushed_rad
    pitch = clamp(wanted, p.lowest_rad, p.highest_rad)
    winding = (wanted > p.highest_rad and missing > 0.0) or (wanted < p.lowest_rad and missing < 0.0)
    if not frozen and not winding:
        trim_rad = clamp(trim_rad + p.trim_per_s * missing * dt_s, -p.trim_max_rad, p.trim_max_rad)
    return Pitch(pitch, pitch != wanted, trim_rad)
