"""The fence as geometry: inside, outside, how far, and against a slow and simple oracle."""

from __future__ import annotations

import math
from typing import Final

import pytest
from hypothesis import given
from hypothesis import strategies as st

from guidance.geofence import Corner, Fence, area_m2, crosses_itself, outside_polygon_m
from guidance.guard_limits import leaves_after_s
from guidance.se3 import ZERO, Vec3
from guidance.trajectory import TRAJECTORIES

SQUARE: Final[tuple[Corner, ...]] = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0))
#: An L: the place at (8, 8) is between its arms, outside.
ELL: Final[tuple[Corner, ...]] = ((0.0, 0.0), (10.0, 0.0), (10.0, 5.0), (5.0, 5.0), (5.0, 10.0), (0.0, 10.0))
places = st.floats(-30.0, 30.0)


@pytest.mark.parametrize(
    ("corners", "north", "east", "outside_m"),
    [
        (SQUARE, 5.0, 5.0, 0.0),
        (SQUARE, 5.0, -2.0, 2.0),
        (SQUARE, 13.0, 14.0, 5.0),
        (SQUARE, 5.0, 10.0, 0.0),
        (ELL, 8.0, 8.0, 3.0),
        (ELL, 2.0, 8.0, 0.0),
        (ELL, 8.0, 2.0, 0.0),
    ],
)
def test_how_far_a_place_is_outside(
    corners: tuple[Corner, ...], north: float, east: float, outside_m: float
) -> None:
    for turned in (corners, corners[::-1], corners[2:] + corners[:2]):
        assert outside_polygon_m(turned, north, east) == pytest.approx(outside_m)


@given(st.lists(st.floats(0.5, 20.0), min_size=3, max_size=9), places, places)
def test_a_star_encloses_what_its_angles_say(radii: list[float], north: float, east: float) -> None:
    count = len(radii)
    angles = [math.tau * i / count for i in range(count)]
    star = tuple((r * math.cos(a), r * math.sin(a)) for r, a in zip(radii, angles, strict=True))
    assert not crosses_itself(star)
    outside_m = outside_polygon_m(star, north, east)
    # Of a star seen from the middle, the place lies in one of the triangles or outside.
    i = int(math.atan2(east, north) % math.tau / (math.tau / count)) % count
    (n0, e0), (n1, e1) = star[i], star[(i + 1) % count]
    beyond = (n1 - n0) * (east - e0) - (e1 - e0) * (north - n0)
    if abs(beyond) > 1e-6:
        assert (outside_m == 0.0) is (beyond > 0.0)


@given(places, places, places, places)
def test_the_distance_changes_no_faster_than_the_place(n0: float, e0: float, n1: float, e1: float) -> None:
    change_m = abs(outside_polygon_m(ELL, n0, e0) - outside_polygon_m(ELL, n1, e1))
    assert change_m <= math.hypot(n1 - n0, e1 - e0) + 1e-9


def test_the_band_of_depth_and_the_polygon_count_together() -> None:
    fence = Fence(SQUARE, -5.0, 2.0)
    assert fence.outside_m(Vec3(5.0, 5.0, 0.0)) == 0.0
    assert fence.outside_m(Vec3(5.0, 5.0, 3.0)) == 1.0
    assert fence.outside_m(Vec3(5.0, 5.0, -7.0)) == 2.0
    assert fence.outside_m(Vec3(5.0, 14.0, 5.0)) == 5.0
    assert Fence().outside_m(Vec3(1e9, -1e9, 1e9)) == 0.0


@pytest.mark.parametrize(
    "place", [Vec3(math.nan, 5.0, 0.0), Vec3(5.0, math.nan, 0.0), Vec3(5.0, 5.0, math.nan)]
)
def test_nowhere_is_outside(place: Vec3) -> None:
    assert Fence(SQUARE).outside_m(place) == math.inf


def test_what_is_no_area() -> None:
    assert area_m2(SQUARE) == 100.0
    assert area_m2(ELL) == 75.0
    assert area_m2(((0.0, 0.0), (1.0, 1.0), (2.0, 2.0))) == 0.0
    assert crosses_itself(((0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)))
    assert not crosses_itself(SQUARE)
    assert not crosses_itself(ELL)


def test_when_a_trajectory_leaves() -> None:
    line = TRAJECTORIES["line"](speed_m_s=1.0)
    fence = Fence(((-1.0, -1.0), (20.0, -1.0), (20.0, 1.0), (-1.0, 1.0)))
    assert leaves_after_s(fence, line, ZERO, 0.0, 19.0) is None
    assert leaves_after_s(fence, line, ZERO, 0.0, 60.0) == 20.25
    assert leaves_after_s(fence, line, ZERO, 15.0, 60.0) == 5.25
    assert leaves_after_s(fence, line, Vec3(0.0, 2.0, 0.0), 0.0, 60.0) == 0.0


@pytest.mark.parametrize("odd", [math.inf, -math.inf, math.nan])
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("fence", [Fence(SQUARE), Fence(SQUARE, 0.0, 5.0), Fence((), 0.0, 5.0)])
def test_a_place_that_is_not_finite_is_outside(fence: Fence, axis: int, odd: float) -> None:
    place = [1.0, 1.0, 1.0]
    place[axis] = odd
    assert fence.outside_m(Vec3(*place)) == math.inf
