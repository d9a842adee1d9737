"""The path that is planned, as the dashboard draws it: which part of it, from where, and when it is told."""

from __future__ import annotations

import json
from collections.abc import Mapping
from math import hypot
from typing import Any

import pytest
from msgspec.structs import replace

from guidance.dashboard.hub import ASK_AGAIN_NS, ASKED_MAX
from guidance.dashboard.pages import Page
from guidance.dashboard.planned import POINTS, Planner, stretch
from guidance.geodesy import azimuthal_equidistant, equirectangular
from guidance.records import Reference, Status
from guidance.telemetry.arrivals import History, Presence
from guidance.trajectory import TRAJECTORIES, Circle, Helix, Line, Zigzag, sample
from tests.dashboard_rig import TICK_NS, Flown, configured
from tests.fleet_rig import link, state, status

EKF = (47.0, 8.0, 400.0)
CIRCLE = {"name": "circle", "radius_m": 5.0}


def told(keys: Mapping[str, Any], trajectory_s: float = 0.0) -> tuple[bool, list[tuple[float, ...]]]:
    said = json.loads(Planner().told("uuv-1", keys, trajectory_s))
    assert said["kind"] == "plan"
    flat = said["points"]
    return said["whole"], [tuple(flat[k : k + 3]) for k in range(0, len(flat), 3)]


def test_a_circle_is_drawn_once_around() -> None:
    whole, points = told(CIRCLE)
    assert whole
    assert len(points) == POINTS
    assert points[0] == points[-1]
    assert all(hypot(north, east) == pytest.approx(5.0, abs=1e-3) for north, east, _ in points)
    assert max(east for _, east, _ in points) == pytest.approx(5.0, abs=1e-3)


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_every_trajectory_is_drawn_along_its_own_places(name: str) -> None:
    kind = TRAJECTORIES[name]
    whole, from_s, to_s = stretch(kind(), 0.0)
    assert whole is (name in {"circle", "lemniscate", "eight"})
    drawn, points = told({"name": name})
    assert drawn is whole
    assert len(points) == POINTS
    for point, t_s in ((points[0], from_s), (points[-1], to_s)):
        assert point == pytest.approx(sample(kind(), t_s).position, abs=1e-3)


def test_what_never_comes_back_is_drawn_from_where_it_is_to_a_cycle_ahead_and_more() -> None:
    turn_s = Helix().cycle_s
    assert stretch(Helix(), 0.0) == (False, 0.0, 2 * turn_s)
    for trajectory_s in (10.0, 100.0, 1000.0):
        _, from_s, to_s = stretch(Helix(), trajectory_s)
        assert from_s <= trajectory_s <= to_s - turn_s
    assert stretch(Line(), 0.0) == (False, 0.0, 60.0)
    assert stretch(Zigzag(), 0.0) == (False, 0.0, 120.0)
    for odd in (float("nan"), float("inf"), -3.0, 1e300):
        assert stretch(Line(), odd) == (False, 0.0, 60.0)


def test_what_comes_to_rest_is_drawn_to_there() -> None:
    assert stretch(Line(stop_at_s=40.0), 0.0) == (True, 0.0, 40.0)
    assert stretch(Line(stop_at_s=1000.0), 0.0) == (False, 0.0, 60.0)
    assert stretch(Line(stop_at_s=1000.0), 990.0) == (False, 990.0, 1000.0)
    assert stretch(Line(stop_at_s=1000.0), 5000.0) == (False, 4980.0, 5040.0)
    assert stretch(Circle(stop_at_s=3.0), 0.0) == (True, 0.0, 3.0)
    assert stretch(Helix(down_m_s=0.0), 0.0)[0]


@pytest.mark.parametrize("keys", [{}, {"name": "spiral"}, {"name": "circle", "radius_m": "wide"}, {"x": 1}])
def test_a_trajectory_of_nobody_has_no_points(keys: dict[str, Any]) -> None:
    assert told(keys) == (True, [])


def waiting(t_ns: int) -> Status:
    """Nothing is flown, so that there is no origin yet."""
    return replace(status(t_ns), origin_ned_m=None)


def reference(t_ns: int, trajectory_s: float) -> Reference:
    at = (0.0, 0.0, 0.0)
    return Reference(
        t_ns=t_ns,
        trajectory_s=trajectory_s,
        position_ned_m=at,
        velocity_ned_m_s=at,
        acceleration_ned_m_s2=at,
    )


def test_a_plan_is_the_same_object_until_another_is_flown_or_loaded() -> None:
    flown = Flown()
    flown.turn(*flown.heard(configured(trajectory={"name": "helix"}), waiting(flown.now_ns)))
    first = flown.hub.plan("uuv-1")
    flown.turn(*flown.heard(status(flown.now_ns), reference(flown.now_ns, 60.0)))
    assert flown.hub.plan("uuv-1") is first
    flown.turn(*flown.heard(reference(flown.now_ns, 70.0)))
    later = flown.hub.plan("uuv-1")
    assert later != first
    assert flown.hub.plan("uuv-1") is later
    flown.turn(*flown.heard(replace(status(flown.now_ns), trajectory_json=json.dumps(CIRCLE))))
    assert json.loads(flown.hub.plan("uuv-1"))["whole"]
    assert flown.hub.about("uuv-1", flown.now_ns)["trajectory"] == CIRCLE
    flown.turn(*flown.heard(replace(status(flown.now_ns), trajectory_json="[")))
    assert json.loads(flown.hub.plan("uuv-1"))["points"] == []
    flown.turn(*flown.heard(waiting(flown.now_ns)))
    assert flown.hub.plan("uuv-1") == first  # nothing is loaded any more, and nothing flown


def test_a_page_is_given_a_plan_once_and_anew_with_another_vehicle() -> None:
    page, plan = Page(), b'{"kind":"plan"}'
    page.see("uuv-1")
    page.take(lambda _: b"")
    for owed, given in ((plan, [plan.decode()]), (plan, []), (b"{}", ["{}"])):
        page.owe_plan(owed)
        assert page.take(lambda _: b"") == given
    page.owe_plan(plan)
    page.owe_plan(plan)
    assert page.take(lambda _: b"") == [plan.decode()]
    page.see("uuv-2")
    page.take(lambda _: b"")
    page.owe_plan(plan)
    assert page.take(lambda _: b"") == [plan.decode()]


def origin_of(flown: Flown) -> Any:
    return flown.hub.about("uuv-1", flown.now_ns)["origin"]


def test_the_origin_is_where_the_flight_has_it_or_would_have_it() -> None:
    flown = Flown()
    flown.turn(*flown.heard(waiting(flown.now_ns), state(flown.now_ns)))
    assert origin_of(flown) is None
    flown.turn(*flown.heard(configured(flight={"origin": "ekf"})))
    assert origin_of(flown) == (0.0, 0.0, 0.0)
    moved = replace(state(flown.now_ns), position_ned_m=(1.0, 2.0, 3.0))
    flown.turn(*flown.heard(configured(flight={"origin": "engage"}), moved))
    assert origin_of(flown) == (1.0, 2.0, 3.0)
    flown.turn(*flown.heard(configured(flight={"origin": "home"})))
    assert origin_of(flown) is None
    flown.turn(*flown.heard(replace(status(flown.now_ns), origin_ned_m=(7.0, 8.0, 9.0))))
    assert origin_of(flown) == (7.0, 8.0, 9.0)


@pytest.mark.parametrize(
    ("profile", "project"), [("px4-copter", azimuthal_equidistant), ("ardupilot-rover", equirectangular)]
)
def test_degrees_are_drawn_as_the_autopilot_projects_them(profile: str, project: Any) -> None:
    flown = Flown()
    corners = [[47.001, 8.001], [47.001, 8.003], [47.003, 8.002]]
    tables = {
        "vehicle": {"profile": profile},
        "guards": {"fence_deg": corners, "fence_down_max_m": 5.0},
        "flight": {"origin": [47.002, 8.002, 410.0]},
    }
    flown.turn(*flown.heard(configured(**tables), link(flown.now_ns), waiting(flown.now_ns)))
    about: Any = flown.hub.about("uuv-1", flown.now_ns)
    assert (about["fence"]["corners"], about["fence"]["degrees"], about["origin"]) == ([], True, None)
    flown.turn(*flown.heard(replace(link(flown.now_ns), origin_geodetic=EKF)))
    about = flown.hub.about("uuv-1", flown.now_ns)
    assert about["fence"]["degrees"] is False
    assert about["fence"]["corners"] == [project((*corner, EKF[2]), EKF)[:2] for corner in corners]
    assert about["origin"] == project((47.002, 8.002, 410.0), EKF)
    tables["vehicle"] = {"profile": "balloon"}
    flown.turn(*flown.heard(configured(**tables)))
    about = flown.hub.about("uuv-1", flown.now_ns)
    assert (about["fence"]["degrees"], about["origin"]) == (True, None)


def test_who_shows_a_vehicle_without_a_past_asks_for_it_seldom_and_not_for_ever() -> None:
    flown = Flown()
    flown.hub.recall("uuv-1", flown.now_ns)
    assert flown.asked == []  # nobody of that name is heard
    flown.fly(2)
    flown.hub.recall("uuv-1", flown.now_ns)
    flown.hub.recall("uuv-1", flown.now_ns)
    assert flown.asked == ["uuv-1"]
    for _ in range(10):
        flown.now_ns += ASK_AGAIN_NS
        flown.hub.recall("uuv-1", flown.now_ns)
    assert flown.asked == ["uuv-1"] * ASKED_MAX


def test_a_token_that_comes_and_goes_asks_for_nothing_that_is_known() -> None:
    flown = Flown()
    flown.turn(Presence(flown.now_ns, "uuv-1", here=True), *flown.heard(state(flown.now_ns)))
    flown.turn(History(flown.now_ns, "uuv-1", (state(flown.now_ns - TICK_NS),)))
    for _ in range(5):  # a router that flaps
        flown.turn(Presence(flown.now_ns, "uuv-1", here=False), Presence(flown.now_ns, "uuv-1", here=True))
        flown.fly(20)
    assert flown.asked == ["uuv-1"]


def test_who_was_out_of_reach_is_asked_for_what_happened_meanwhile() -> None:
    flown = Flown()
    flown.turn(Presence(flown.now_ns, "uuv-1", here=True), *flown.heard(state(flown.now_ns)))
    flown.turn(History(flown.now_ns, "uuv-1", (state(flown.now_ns - TICK_NS),)))
    for _ in range(120):
        flown.turn()
    flown.hub.recall("uuv-1", flown.now_ns)
    assert flown.asked == ["uuv-1"]  # it would not answer
    flown.turn(Presence(flown.now_ns, "uuv-1", here=True))
    assert flown.asked == ["uuv-1"] * 2


def test_whose_token_was_seen_or_whose_past_has_come_is_not_asked_again_at_once() -> None:
    flown = Flown()
    flown.turn(Presence(flown.now_ns, "uuv-1", here=True), *flown.heard(state(flown.now_ns)))
    flown.hub.recall("uuv-1", flown.now_ns)
    assert flown.asked == ["uuv-1"]
    flown.turn(History(flown.now_ns, "uuv-1", ()))  # it was lost on the way
    flown.now_ns += ASK_AGAIN_NS - TICK_NS
    flown.hub.recall("uuv-1", flown.now_ns)
    assert flown.asked == ["uuv-1"] * 2
    flown.turn(History(flown.now_ns, "uuv-1", (state(flown.now_ns - TICK_NS),)))
    flown.now_ns += ASK_AGAIN_NS
    flown.hub.recall("uuv-1", flown.now_ns)
    assert flown.asked == ["uuv-1"] * 2
