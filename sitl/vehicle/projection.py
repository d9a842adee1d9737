"""A local position as latitude and longitude, each firmware in its own way and on its own sphere."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from sitl.plant import Triple
from sitl.vehicle.options import Origin

PX4_RADIUS_M: Final = 6_371_000.0
ARDUPILOT_RADIUS_M: Final = 6_378_100.0

#: What double precision may lack of a whole step.
_ROUNDING: Final = 1e-6

#: Origin and position (NED, m) to latitude and longitude (1e-7 deg) and altitude (m above mean sea level).
Projection = Callable[[Origin, Triple], tuple[int, int, float]]


def azimuthal_equidistant(origin: Origin, position_ned_m: Triple) -> tuple[int, int, float]:
    """Distances and directions from the origin are true: PX4, `geo.cpp`, MapProjection::reproject.

    `streams/GLOBAL_POSITION_INT.hpp` cuts off what is less than a step.
    """
    north, east, down = position_ned_m
    x, y = north / PX4_RADIUS_M, east / PX4_RADIUS_M
    c = math.hypot(x, y)
    latitude, longitude = math.radians(origin.latitude_deg), math.radians(origin.longitude_deg)
    if c > 0.0:
        sine = math.sin(c) / c
        cos_c, sin0, cos0 = math.cos(c), math.sin(latitude), math.cos(latitude)
        longitude += math.atan2(y * sine, cos0 * cos_c - x * sin0 * sine)
        latitude = math.asin(max(-1.0, min(1.0, cos_c * sin0 + x * sine * cos0)))
    return (
        int(math.degrees(latitude) * 1e7 + _ROUNDING),
        int(_wrapped_deg(math.degrees(longitude)) * 1e7 + _ROUNDING),
        origin.altitude_m - down,
    )


def equirectangular(origin: Origin, position_ned_m: Triple) -> tuple[int, int, float]:
    """By the mean latitude, towards the origin in whole steps: ArduPilot, `Location.cpp`, offset_latlng."""
    north, east, down = position_ned_m
    step_m = 1e-7 * math.radians(ARDUPILOT_RADIUS_M)
    rise = int(north / step_m)
    mean_deg = origin.latitude_deg + 0.5e-7 * rise
    turn = int(east / step_m / max(math.cos(math.radians(mean_deg)), 0.01))
    latitude = max(-90.0, min(90.0, round(origin.latitude_deg * 1e7) * 1e-7 + rise * 1e-7))
    longitude = _wrapped_deg((round(origin.longitude_deg * 1e7) + turn) * 1e-7)
    return round(latitude * 1e7), round(longitude * 1e7), origin.altitude_m - down


def _wrapped_deg(longitude_deg: float) -> float:
    return (longitude_deg + 180.0) % 360.0 - 180.0
