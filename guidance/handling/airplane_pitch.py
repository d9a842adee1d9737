"""Pitch for a wanted climb: path angle, angle of attack, the draft that is felt, and a slow integral.

The nose stands above the path by the angle of attack that the load takes, alpha_zero + K n/V^2, of which a
bank shows cos(phi) (sin(gamma) = cos(alpha) sin(theta) - sin(alpha) cos(phi) cos(theta)). With
n cos(phi) g = a_ver the second part is the same at every bank:

    theta = gamma + alpha_zero cos(phi) + K a_ver/(g V^2) + lead (gamma - measured gamma) + trim

`trim`, learned slowly, is what is missing always: an error of alpha_zero, an autopilot that holds less pitch
than it is told (PX4 held three quarters). Without it 2.3 m of height.

Near the stall the nose is kept within the angles of attack that the wing may have about the path that is
flown, whatever path is wanted: a pull-up on the way out of a dive would stall it again. Well above it is free
(`free_rad`): the path is measured over ground, and in air that sinks the nose must stand higher above it.
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
    free_rad: float,
    frozen: bool,
    dt_s: float,
) -> Pitch:
    """The pitch for the path angle `wanted_rad` when path and bank are these, with at most `free_rad` beyond the
    angles of attack of a load between `LOAD_MIN` and `load_max`.

    The trim is learned unless `frozen`, and not further into the pitch's own limits.
    """
    p = parameters
    upright = cos(bank_rad)
    per_load = p.alpha_per_load_rad_m2_s2 / (airspeed_m_s * airspeed_m_s)
    zero = p.alpha_zero_rad * upright + trim_rad
    missing = wanted_rad - path_rad
    wanted = wanted_rad + zero + per_load * vertical_m_s2 / GRAVITY_M_S2 + p.lead * missing
    least = path_rad + zero + per_load * LOAD_MIN * upright - free_rad
    most = path_rad + zero + per_load * load_max * upright + free_rad
    loaded = clamp(wanted, least, most)
    pitch = clamp(loaded, p.lowest_rad, p.highest_rad)
    # a wrong trim moves the bounds of the load as well, so these must not keep it from being learned
    winding = (loaded > p.highest_rad and missing > 0.0) or (loaded < p.lowest_rad and missing < 0.0)
    if not frozen and not winding:
        trim_rad = clamp(trim_rad + p.trim_per_s * missing * dt_s, -p.trim_max_rad, p.trim_max_rad)
    return Pitch(pitch, pitch != wanted, trim_rad)
