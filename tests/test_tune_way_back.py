"""Ways back end where they should, never turn tighter than asked, and stay in the room that is announced."""

from __future__ import annotations

from math import cos, hypot, pi, remainder, sin

import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from guidance.geofence import Fence
from guidance.se3 import norm
from guidance.tune import room
from guidance.tune.excitation import TURNS, Box, Ground, ground_runs, path, space_needed
from guidance.tune.way_back import Path, Place, way_back, with_ways_back

METRES = st.floats(-200.0, 200.0)
PLACES = st.builds(Place, METRES, METRES, st.floats(-10.0, 10.0))
ROVER = Ground(2.0, 0.8, 5.0, 2.0, 0.95, 0.9)


@given(PLACES, PLACES, st.floats(0.5, 40.0), st.floats(0.0, 20.0))
def test_it_ends_at_the_place_with_its_heading(
    start: Place, end: Place, radius_m: float, straight_m: float
) -> None:
    way = way_back(start, end, radius_m, straight_m)
    arrived, _ = way.at(way.length_m)
    assert_allclose((arrived.north_m, arrived.east_m), (end.north_m, end.east_m), atol=1e-6)
    assert abs(remainder(arrived.heading_rad - end.heading_rad, 2.0 * pi)) < 1e-7
    assert (
        way.length_m
        < hypot(end.north_m - start.north_m, end.east_m - start.east_m)
        + 2.0 * straight_m
        + (4.0 * pi + 2.0) * radius_m
    )
    assert all(abs(piece.curvature_per_m) in (0.0, 1.0 / radius_m) for piece in way.pieces)
    assert way.pieces[-1] == (straight_m, 0.0)


def test_straight_ahead_it_is_straight() -> None:
    way = way_back(Place(0.0, 0.0, 0.0), Place(30.0, 0.0, 0.0), 5.0, 4.0)
    assert_allclose(way.length_m, 30.0)
    # and from where it already is, behind itself, all round
    assert way_back(Place(0.0, 0.0, 0.0), Place(0.0, 0.0, 0.0), 5.0, 0.0).length_m == 0.0


def test_the_reference_is_its_own_derivative() -> None:
    way, h = way_back(Place(3.0, -8.0, 2.0), Place(0.0, 0.0, 0.5), 3.0, 4.0), 1e-4
    for n in range(1, int(way.length_m / 1.5)):
        before, at, after = (way.reference(n + d, 1.5, -7.0) for d in (-h, 0.0, h))
        change = [(b - a) / (2.0 * h) for a, b in zip(before.position, after.position, strict=True)]
        assert_allclose(at.velocity, change, atol=1e-3)
        assert_allclose(norm(at.velocity), 1.5)
        assert at.position.z == -7.0
        if before.acceleration != (0.0, 0.0, 0.0) and norm(before.acceleration) == norm(after.acceleration):
            change = [(b - a) / (2.0 * h) for a, b in zip(before.velocity, after.velocity, strict=True)]
            assert_allclose(at.acceleration, change, atol=1e-3)


def test_after_its_end_it_goes_straight_on() -> None:
    way = Path(Place(0.0, 0.0, 0.5 * pi), ())
    place, curvature = way.at(3.0)
    assert_allclose(place, (0.0, 3.0, 0.5 * pi), atol=1e-12)
    assert curvature == 0.0


def test_the_room_holds_every_way_back() -> None:
    runs = ground_runs(ROVER)
    box = with_ways_back(space_needed(runs, 0.0), runs, 2.25, 3.0)
    for run in runs:
        for turns in TURNS:
            *_, (ahead, right, _, heading) = path(run, 0.0, turns)
            way = way_back(Place(ahead, right, heading), Place(0.0, 0.0, 0.0), 2.25, 3.0)
            for n in range(200):
                (north, east, _), _ = way.at(n * way.length_m / 199)
                assert -box.behind_m + 1.0 <= north <= box.ahead_m - 1.0
                assert -box.left_m <= east <= box.right_m


@pytest.mark.parametrize("heading", [0.0, 1.0, -2.5])
def test_room_is_held_against_the_fence_on_every_edge_and_level(heading: float) -> None:
    box, place = Box(20.0, 5.0, 10.0, 3.0, 4.0, 6.0), Place(100.0, -50.0, heading)

    def at(ahead: float, right: float) -> tuple[float, float]:
        c, s = cos(heading), sin(heading)
        return (100.0 + ahead * c - right * s, -50.0 + ahead * s + right * c)

    around = Fence(tuple(at(*corner) for corner in ((21.0, 11.0), (-6.0, 11.0), (-6.0, -4.0), (21.0, -4.0))))
    assert room.outside_m(around, box, place, 30.0) == 0.0
    assert_allclose(room.outside_m(around._replace(down_max_m=33.5), box, place, 30.0), 2.5)
    assert_allclose(room.outside_m(around._replace(down_min_m=29.0), box, place, 30.0), 3.0)
    # a notch between two corners that are both inside
    notched = ((21.0, 11.0), (8.0, 11.0), (7.0, -2.0), (6.0, 11.0), (-6.0, 11.0), (-6.0, -4.0), (21.0, -4.0))
    assert room.outside_m(Fence(tuple(at(*corner) for corner in notched)), box, place, 30.0) > 0.3


def test_the_words_for_room_can_be_pasted() -> None:
    box, place = Box(20.0, 5.0, 10.0, 3.0, 0.0, 0.0), Place(0.0, 0.0, 0.5 * pi)
    assert room.in_words(box) == "20 m ahead, 5 m behind, 10 m to the right and 3 m to the left"
    assert room.in_words(box._replace(up_m=4.0)).endswith("left, 4 m up and 0 m down")
    words = room.fence_in_words(box, place)
    assert words == "fence_ned_m = [[-12.0, 22.0], [-12.0, -7.0], [5.0, -7.0], [5.0, 22.0]]"
