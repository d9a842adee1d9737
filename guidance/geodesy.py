"""From latitude and longitude to the autopilot's local frame.

Autopilots project in different ways and onto different spheres, so the way is the profile's: at 1 km the two
differ by a metre in scale and by 0.1 m in shape.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from guidance.se3 import Vec3

#: `geo.h`, CONSTANTS_RADIUS_OF_EARTH.
PX4_RADIUS_M: Final = 6_371_000.0
#: `AP_Math/definitions.h`, RADIUS_OF_EARTH.
ARDUPILOT_RADIUS_M: Final = 6_378_100.0

#: (deg, deg, m AMSL).
Geodetic = tuple[float, float, float]
#: A point and the origin of the local frame to NED in m.
Projection = Callable[[Geodetic, Geodetic], Vec3]


def azimuthal_equidistant(point: Geodetic, origin: Geodetic) -> Vec3:
    """PX4: true distance and direction from the origin (`geo.cpp`, MapProjection::project)."""
    lat, lon = math.radians(point[0]), math.radians(point[1])
    lat0, lon0 = math.radians(origin[0]), math.radians(origin[1])
    along = math.sin(lat0) * math.sin(lat) + math.cos(lat0) * math.cos(lat) * math.cos(lon - lon0)
    angle = math.acos(min(max(along, -1.0), 1.0))
    stretch = angle / math.sin(angle) if 1e-9 < angle < math.pi - 1e-9 else 1.0
    north = math.cos(lat0) * math.sin(lat) - math.sin(lat0) * math.cos(lat) * math.cos(lon - lon0)
    east = math.cos(lat) * math.sin(lon - lon0)
    return Vec3(stretch * north * PX4_RADIUS_M, stretch * east * PX4_RADIUS_M, origin[2] - point[2])


def equirectangular(point: Geodetic, origin: Geodetic) -> Vec3:
    """ArduPilot: meridians as far apart as at the mean latitude (`Location.cpp`, get_distance_NE)."""
    turn_deg = math.remainder(point[1] - origin[1], 360.0)
    apart = max(math.cos(math.radians(0.5 * (point[0] + origin[0]))), 0.01)
    return Vec3(
        math.radians(point[0] - origin[0]) * ARDUPILOT_RADIUS_M,
        math.radians(turn_deg) * apart * ARDUPILOT_RADIUS_M,
        origin[2] - point[2],
    )
