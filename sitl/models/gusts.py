"""Wind: a steady velocity and gusts about it, pure functions of normals that the caller draws.

MIL-F-8785C's low altitude model by Dryden: sigma and scale length level and vertical, 0.8 and 0.5 m/s and 200
and 50 m in 5 m/s of wind at 50 m of height. Its spectra across and up are of second order; here all three
are of first, as the one along is, with the same sigma and length.
"""

from __future__ import annotations

from math import exp, sqrt
from typing import Final, NamedTuple


class Wind(NamedTuple):
    """Velocity of the air over ground, NED, m/s."""

    north_m_s: float
    east_m_s: float
    down_m_s: float


CALM: Final = Wind(0.0, 0.0, 0.0)


class Gusts(NamedTuple):
    """Turbulence: the velocity that is added to a steady wind, NED, m/s."""

    north_m_s: float
    east_m_s: float
    down_m_s: float


class Turbulence(NamedTuple):
    """A steady wind, and sigma (m/s) and scale length (m) of its gusts."""

    wind: Wind
    level_m_s: float
    vertical_m_s: float
    level_length_m: float
    vertical_length_m: float


NO_GUSTS: Final = Gusts(0.0, 0.0, 0.0)


def gusts_step(
    turbulence: Turbulence,
    gusts: Gusts,
    airspeed_m_s: float,
    normals: tuple[float, float, float],
    dt_s: float,
) -> Gusts:
    """The gusts `dt_s` later, with three independent standard normals; exact for a constant airspeed."""
    a = exp(-airspeed_m_s * dt_s / turbulence.level_length_m)
    b = exp(-airspeed_m_s * dt_s / turbulence.vertical_length_m)
    level = turbulence.level_m_s * sqrt(1.0 - a * a)
    vertical = turbulence.vertical_m_s * sqrt(1.0 - b * b)
    return Gusts(
        a * gusts.north_m_s + level * normals[0],
        a * gusts.east_m_s + level * normals[1],
        b * gusts.down_m_s + vertical * normals[2],
    )


def blowing(turbulence: Turbulence, gusts: Gusts) -> Wind:
    """The wind with its gusts."""
    wind = turbulence.wind
    return Wind(
        wind.north_m_s + gusts.north_m_s, wind.east_m_s + gusts.east_m_s, wind.down_m_s + gusts.down_m_s
    )
