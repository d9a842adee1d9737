"""A fence: a polygon in the plane and a band of depth, in the vehicle's local frame (NED, m)."""

from __future__ import annotations

from math import hypot, inf, isfinite
from typing import NamedTuple

from guidance.se3 import Vec3

#: (north, east), m.
Corner = tuple[float, float]


class Fence(NamedTuple):
    """Where the vehicle may be. No `corners`: anywhere in the plane. `down_m` as in NED, positive down."""

    corners: tuple[Corner, ...] = ()
    down_min_m: float = -inf
    down_max_m: float = inf

    def outside_m(self, position_ned_m: Vec3) -> float:
        """How far a place is outside, 0 inside; what is not finite is outside (inf)."""
        north, east, down = position_ned_m
        if not (isfinite(north) and isfinite(east) and isfinite(down)):
            return inf
        vertical = max(self.down_min_m - down, down - self.down_max_m, 0.0)
        horizontal = outside_polygon_m(self.corners, north, east) if self.corners else 0.0
        return hypot(vertical, horizontal)


def outside_polygon_m(corners: tuple[Corner, ...], north: float, east: float) -> float:
    """The distance to the polygon (in either direction of rotation, convex or not), 0 inside or on it."""
    if _encloses(corners, north, east):
        return 0.0
    return min(_distance_m(corners[i - 1], corners[i], north, east) for i in range(len(corners)))


def crosses_itself(corners: tuple[Corner, ...]) -> bool:
    """Whether two edges that are no neighbours meet: then nobody can say what is inside."""
    count = len(corners)
    for i in range(count):
        for j in range(i + 1, count):
            if (j - i) % count in (1, count - 1):
                continue
            if _meet(corners[i - 1], corners[i], corners[j - 1], corners[j]):
                return True
    return False


def area_m2(corners: tuple[Corner, ...]) -> float:
    """The area inside (shoelace formula)."""
    twice = sum(
        corners[i - 1][0] * corners[i][1] - corners[i][0] * corners[i - 1][1] for i in range(len(corners))
    )
    return 0.5 * abs(twice)


def _encloses(corners: tuple[Corner, ...], north: float, east: float) -> bool:
    """Whether a ray to the north crosses the edges an odd number of times."""
    odd = False
    for i in range(len(corners)):
        (n0, e0), (n1, e1) = corners[i - 1], corners[i]
        if (e0 > east) != (e1 > east) and north < n0 + (n1 - n0) * (east - e0) / (e1 - e0):
            odd = not odd
    return odd


def _distance_m(a: Corner, b: Corner, north: float, east: float) -> float:
    dn, de = b[0] - a[0], b[1] - a[1]
    length2 = dn * dn + de * de
    along = ((north - a[0]) * dn + (east - a[1]) * de) / length2 if length2 > 0.0 else 0.0
    along = min(max(along, 0.0), 1.0)
    return hypot(north - a[0] - along * dn, east - a[1] - along * de)


def _meet(a: Corner, b: Corner, c: Corner, d: Corner) -> bool:
    def side(p: Corner, q: Corner, r: Corner) -> float:
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    apart = side(a, b, c) * side(a, b, d) > 0.0 or side(c, d, a) * side(c, d, b) > 0.0
    beside = any(max(a[k], b[k]) < min(c[k], d[k]) or max(c[k], d[k]) < min(a[k], b[k]) for k in range(2))
    return not apart and not beside
