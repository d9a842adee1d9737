"""Back to where a run began, on a level path of arc, straight and arc, as Dubins has them.

A vehicle that only goes forward comes back to a place and a heading by turning one way or the other, going
straight, and turning again. Of the four such paths the shortest is taken; two circles the same way round
always give one.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import atan2, copysign, cos, hypot, pi, sin, sqrt
from typing import Final, NamedTuple

from guidance.se3 import Reference, Vec3
from guidance.tune.excitation import MARGIN_M, TURNS, Box, Run, path, with_place

#: A way back is looked at in pieces of this length, m.
LOOK_M: Final = 0.5


class Place(NamedTuple):
    """m and rad, NED; the heading is from north to the east."""

    north_m: float
    east_m: float
    heading_rad: float

    def ahead(self, length_m: float, curvature_per_m: float = 0.0) -> Place:
        """So far on, on an arc (to the right for a positive curvature)."""
        north, east, heading = self
        if curvature_per_m == 0.0:
            return Place(north + length_m * cos(heading), east + length_m * sin(heading), heading)
        end = heading + curvature_per_m * length_m
        return Place(
            north + (sin(end) - sin(heading)) / curvature_per_m,
            east - (cos(end) - cos(heading)) / curvature_per_m,
            end,
        )


class Piece(NamedTuple):
    """An arc, or a straight where the curvature is 0."""

    length_m: float
    curvature_per_m: float


class Path(NamedTuple):
    """Its pieces one after the other, from `start` on; it goes on straight after the last."""

    start: Place
    pieces: tuple[Piece, ...]

    @property
    def length_m(self) -> float:
        """Of all pieces."""
        return sum(piece.length_m for piece in self.pieces)

    def at(self, length_m: float) -> tuple[Place, float]:
        """The place so far along it, and the curvature there."""
        place = self.start
        for length, curvature in self.pieces:
            if length_m < length:
                return place.ahead(length_m, curvature), curvature
            place = place.ahead(length, curvature)
            length_m -= length
        return place.ahead(length_m), 0.0

    def reference(self, t_s: float, speed_m_s: float, down_m: float) -> Reference:
        """Along it at this speed, in the plane at `down_m`."""
        place, curvature = self.at(t_s * speed_m_s)
        c, s = cos(place.heading_rad), sin(place.heading_rad)
        turning = speed_m_s * speed_m_s * curvature
        return Reference(
            Vec3(place.north_m, place.east_m, down_m),
            Vec3(speed_m_s * c, speed_m_s * s, 0.0),
            Vec3(-turning * s, turning * c, 0.0),
        )


def way_back(start: Place, end: Place, radius_m: float, straight_m: float) -> Path:
    """The shortest from `start` to `end`, at which it arrives straight for the last `straight_m`."""
    before = end.ahead(-straight_m)
    found = [
        (*pieces, Piece(straight_m, 0.0))
        for first in (1.0, -1.0)
        for last in (1.0, -1.0)
        if (pieces := _pieces(start, before, radius_m, first, last))
    ]
    return Path(start, min(found, key=lambda pieces: sum(piece.length_m for piece in pieces)))


def with_ways_back(
    box: Box, runs: Iterable[Run], radius_m: float, straight_m: float, airspeed_m_s: float = 0.0
) -> Box:
    """The room with the ways back from where runs may end, `space_needed` as it coasts there."""
    start = Place(0.0, 0.0, 0.0)
    for run in runs:
        for turns in TURNS:
            *_, (ahead, right, _, heading) = path(run, airspeed_m_s, turns)
            way = way_back(Place(ahead, right, heading), start, radius_m, straight_m)
            for n in range(round(way.length_m / LOOK_M)):
                (north, east, _), _ = way.at(n * LOOK_M)
                box = with_place(box, north + copysign(MARGIN_M, north), east + copysign(MARGIN_M, east))
    return box


def _pieces(start: Place, end: Place, radius_m: float, first: float, last: float) -> tuple[Piece, ...]:
    """Turning to the right (1) or left (-1) first and last; none if the circles are too close."""
    (n0, e0), (n1, e1) = _centre(start, radius_m, first), _centre(end, radius_m, last)
    north, east = n1 - n0, e1 - e0
    apart = hypot(north, east)
    across = radius_m * (first - last)
    if apart < abs(across):
        return ()
    straight = sqrt(apart * apart - across * across)
    # the straight is the vector between the centres, turned by what it crosses over
    along_n, along_e = north * straight - east * across, east * straight + north * across
    heading = atan2(along_e, along_n) if apart > 0.0 else start.heading_rad
    turn, back = first * (heading - start.heading_rad), last * (end.heading_rad - heading)
    return (
        Piece(_once_round(turn) * radius_m, first / radius_m),
        Piece(straight, 0.0),
        Piece(_once_round(back) * radius_m, last / radius_m),
    )


def _once_round(angle_rad: float) -> float:
    """From 0 to 2 pi; what rounding leaves is no whole turn."""
    turned = angle_rad % (2.0 * pi)
    return 0.0 if turned > 2.0 * pi - 1e-9 else turned


def _centre(place: Place, radius_m: float, side: float) -> tuple[float, float]:
    north, east, heading = place
    return north - side * radius_m * sin(heading), east + side * radius_m * cos(heading)
