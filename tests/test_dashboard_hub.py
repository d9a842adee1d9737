"""What pages are shown of a fleet, on virtual time: rows, words, what each is owed, what it may ask for."""

from __future__ import annotations

import json
from math import isnan
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from guidance.dashboard import orders
from guidance.dashboard.hub import EVENTS_MAX, RINGS_MAX
from guidance.dashboard.pages import ANSWERS_MAX, ROWS_MAX, Page
from guidance.dashboard.rows import ROW
from guidance.dashboard.said import NOTES_MAX, fleet_told, takes_orders, trajectories_told
from guidance.fleet import SILENT_NS
from guidance.records import Record
from guidance.telemetry.arrivals import Answered, History, Ignored, Presence, read
from guidance.trajectory import TRAJECTORIES, Circle
from tests.dashboard_rig import T0, TICK_NS, Flown, configured
from tests.fleet_rig import MS, UNIX_OFFSET_NS, S, error, event, link, session, state, status

NO_FENCE: dict[str, Any] = {"corners": [], "down_min_m": None, "down_max_m": None, "degrees": False}


def test_a_vehicle_that_is_heard_has_a_row_each_turn() -> None:
    flown = Flown()
    flown.fly(20)
    assert len(flown.rows()) == 20
    assert flown.hub.rows["uuv-1"] == flown.hub.ring("uuv-1")[-ROW.size :]
    assert [one["error"] for one in flown.rows()] == [0.5] * 20


def test_a_spike_between_two_turns_is_seen() -> None:
    flown = Flown()
    flown.fly(2)
    flown.turn(*flown.heard(*(error(flown.now_ns, metres) for metres in (0.1, 7.0, 0.2))))
    assert flown.rows()[-1]["error_peak"] == 7.0
    assert flown.rows()[-1]["error"] == pytest.approx(0.2)
    flown.fly(1)
    assert flown.rows()[-1]["error_peak"] == 0.5


def test_silence_ends_the_lines_with_the_first_turn_after_it_and_makes_one_row() -> None:
    flown = Flown()
    flown.fly(10)
    last_ns = flown.now_ns - TICK_NS
    while flown.hub.seen[0].contact == "live":
        flown.turn()
    assert flown.now_ns - last_ns < SILENT_NS + 2 * TICK_NS
    held = len(flown.rows())
    assert isnan(flown.rows()[-1]["north"])
    assert not isnan(flown.rows()[-2]["north"])
    for _ in range(10):
        flown.turn()
        assert flown.hub.rows == {}
    assert len(flown.rows()) == held
    flown.fly(1)
    assert not isnan(flown.rows()[-1]["north"])


def test_figures_are_shown_as_long_as_their_records_are_fresh_and_no_longer() -> None:
    flown = Flown()
    flown.fly(1)
    flown.turn(*flown.heard(replace(link(flown.now_ns), uplink_age_s=0.1)))
    for _ in range(40):
        flown.turn(*flown.heard(status(flown.now_ns)))
    ages = [not isnan(one["uplink_age"]) for one in flown.rows()]
    errors = [not isnan(one["error"]) for one in flown.rows()]
    assert sum(ages) == pytest.approx(30, abs=1)  # 1.5 s
    assert sum(errors) == pytest.approx(20, abs=1)  # 1 s


def test_who_appears_is_asked_for_its_last_minutes_and_they_go_before_the_rows() -> None:
    flown = Flown()
    flown.turn(Presence(flown.now_ns, "uuv-1", here=True), Presence(flown.now_ns, "uuv-2", here=False))
    assert flown.asked == ["uuv-1"]
    flown.fly(10)
    own = flown.hub.ring("uuv-1")
    start_ns = T0 - 50 * S
    kept: list[Record] = []
    for k in range(100):
        kept += [state(start_ns + k * 500 * MS), error(start_ns + k * 500 * MS, 2.0)]
    flown.turn(History(flown.now_ns, "uuv-1", tuple(kept)))
    assert flown.hub.renewed == {"uuv-1"}
    assert flown.hub.ring("uuv-1")[-len(own) - ROW.size : -ROW.size] == own
    rows = flown.rows()
    assert len(rows) == 100 + 11
    times = [one["t"] for one in rows]
    assert times == sorted(times)
    assert times[0] == start_ns / S
    assert {one["error"] for one in rows[:100]} == {2.0}
    flown.turn()
    assert flown.hub.renewed == set()
    count = len(flown.rows())
    flown.turn(History(flown.now_ns, "uuv-1", tuple(kept)))  # its token came a second time
    assert len(flown.rows()) == count + 1


def test_events_of_before_are_told_once_and_the_newest_of_them() -> None:
    flown = Flown()
    flown.turn(*flown.heard(event(5 * S, "old 5"), answered=True))
    events = tuple(event(k * S, f"old {k}") for k in range(EVENTS_MAX + 10))
    flown.turn(History(flown.now_ns, "uuv-1", events))
    texts = [note.text for note in flown.hub.fleet.notes]
    assert len(texts) == len(set(texts)) == EVENTS_MAX + 1
    assert f"old {EVENTS_MAX + 9}" in texts
    assert "old 9" not in texts
    flown.turn(History(flown.now_ns, "uuv-1", events))
    assert len(flown.hub.fleet.notes) == EVENTS_MAX + 1


def test_an_empty_history_and_one_of_nobody_known_change_nothing() -> None:
    flown = Flown()
    flown.turn(History(flown.now_ns, "uuv-9", ()))
    assert flown.hub.seen == []
    flown.turn(History(flown.now_ns, "uuv-9", (state(0),)))
    assert flown.hub.renewed == {"uuv-9"}


def test_memory_has_a_limit_whoever_calls_himself_what() -> None:
    flown = Flown()
    for number in range(RINGS_MAX + 5):
        flown.fly(1, f"v{number}")
    assert flown.hub.ring("v0") == b""
    assert flown.hub.ring(f"v{RINGS_MAX + 4}") != b""


def test_answers_are_handed_back() -> None:
    flown = Flown()
    answer = Answered(0, "uuv-1", "abort", "id", True, "")
    assert flown.turn(answer) == [answer]


def test_what_is_told_of_a_vehicle_is_its_state_link_and_fence() -> None:
    flown = Flown()
    corners = [[0.0, 0.0], [0.0, 9.0], [9.0, 9.0]]
    guards = {"fence_ned_m": corners, "fence_down_max_m": 5.0, "other": 1}
    flown.turn(
        *flown.heard(
            configured(guards=guards, zenoh={"commands": True}, trajectory={"name": "circle"}),
            replace(status(flown.now_ns), since_ns=flown.now_ns - 3 * S),
            link(flown.now_ns),
        )
    )
    said = flown.hub.about("uuv-1", flown.now_ns)
    assert said["commands"] is True
    assert said["fence"] == {
        "corners": [(0.0, 0.0), (0.0, 9.0), (9.0, 9.0)],
        "down_min_m": None,
        "down_max_m": 5.0,
        "degrees": False,
    }
    assert said["trajectory"] == {"name": "circle"}
    about: Any = said
    assert about["status"]["reason"] == "offboard and armed, confirmed"
    assert about["status"]["for_s"] == 3.0
    assert about["status"]["fresh"]
    assert [stream["good"] for stream in about["link"]["streams"]] == [True, True]
    for _ in range(40):
        flown.turn()
    later: Any = flown.hub.about("uuv-1", flown.now_ns)
    assert "link" not in later
    assert not later["status"]["fresh"]
    msgspec.json.encode(later)


@pytest.mark.parametrize(
    ("text", "commands"),
    [
        ("{}", False),
        ('{"zenoh":{"commands":true}}', True),
        ('{"zenoh":{"commands":"yes"}}', False),
        ('{"zenoh":{"commands":true},"guards":{"fence_ned_m":[["a"]]}}', False),
        ("not JSON", False),
        ("[" * 5000, False),
        ("\udcff", False),
    ],
)
def test_only_a_configuration_that_says_so_makes_buttons(text: str, commands: bool) -> None:
    flown = Flown()
    assert not takes_orders(flown.hub.fleet, flown.hub.watched, "uuv-1")
    flown.turn(*flown.heard(replace(session("aa"), config_json=text)))
    assert takes_orders(flown.hub.fleet, flown.hub.watched, "uuv-1") is commands
    assert flown.hub.about("uuv-1", flown.now_ns)["commands"] is commands


def test_another_session_is_read_anew() -> None:
    flown = Flown()
    flown.turn(*flown.heard(configured(zenoh={"commands": True})))
    assert takes_orders(flown.hub.fleet, flown.hub.watched, "uuv-1")
    flown.turn(*flown.heard(replace(session("bb"), config_json="{}")))
    assert not takes_orders(flown.hub.fleet, flown.hub.watched, "uuv-1")


@pytest.mark.parametrize(
    ("guards", "fence"),
    [
        ({}, None),
        (
            {"fence_deg": [[1.0, 2.0]] * 3},
            {"corners": [], "down_min_m": None, "down_max_m": None, "degrees": True},
        ),
        ({"fence_down_min_m": 0.0}, {"corners": [], "down_min_m": 0.0, "down_max_m": None, "degrees": False}),
    ],
)
def test_a_fence_that_cannot_be_drawn_is_told_nevertheless(guards: dict[str, Any], fence: Any) -> None:
    flown = Flown()
    flown.turn(*flown.heard(configured(guards=guards)))
    assert flown.hub.about("uuv-1", flown.now_ns)["fence"] == fence


def test_the_fleet_is_told_with_notes_by_their_time_and_all_that_was_ignored() -> None:
    flown = Flown()
    flown.turn(*flown.heard(status(10 * S), event(9 * S, "later"), event(3 * S, "earlier")))
    garbage = read(flown.now_ns, "guidance/uuv-1/state", "application/json;guidance.State/1", b"\xff")
    other = read(flown.now_ns, "guidance/uuv-2/state", "application/json;guidance.State/7", b"{}")
    flown.turn(garbage, other, Ignored(flown.now_ns, "x" * 900, "no name of a vehicle"))
    said = json.loads(msgspec.json.encode(fleet_told(flown.hub.fleet, flown.hub.seen, "", 2, 0)))
    assert [note["text"] for note in said["notes"]] == ["earlier", "later"]
    assert said["notes"][0]["unix_s"] == T0 / S - 7
    assert [kind["what"] for kind in said["ignored"]] == [
        "garbage",
        "schema version 7",
        "no name of a vehicle",
    ]
    assert {seen["vehicle"]: seen["versions"] for seen in said["fleet"]} == {"uuv-1": [], "uuv-2": [7]}
    assert said["neighbours"] == 2


@pytest.mark.parametrize("clock_s", [-3600, 0, 3600], ids=["1 h behind", "right", "1 h ahead"])
@pytest.mark.parametrize("began_s", [UNIX_OFFSET_NS // S, 0], ids=["dated", "1970"])
def test_notes_have_one_order_whatever_a_vehicles_clock_says(clock_s: int, began_s: int) -> None:
    """A companion without a battery: its events are as new as they are, beside those noticed here."""
    flown = Flown()
    wrong = replace(session("aa"), unix_offset_ns=(began_s + clock_s) * S)
    flown.turn(*flown.heard(wrong, status(7 * S), event(6 * S, "first")))
    while flown.hub.seen[0].contact == "live":
        flown.turn()
    flown.turn(*flown.heard(status(9 * S), event(9 * S, "NEWEST of all")))
    said: Any = fleet_told(flown.hub.fleet, flown.hub.seen, "", 1, UNIX_OFFSET_NS)
    texts = [note["text"].partition(" ")[0] for note in said["notes"]]
    assert texts == ["first", "silent:", "heard", "NEWEST"]
    assert said["notes"][0]["unix_s"] == (T0 - S + UNIX_OFFSET_NS) / S
    assert said["notes"][-1]["unix_s"] == pytest.approx((flown.now_ns + UNIX_OFFSET_NS) / S, abs=0.06)


def test_a_strangers_instants_and_texts_are_cut_to_size() -> None:
    flown = Flown()
    flown.turn(*flown.heard(status((1 << 63) - 1), event(1 - (1 << 63), "x" * 100_000)))
    first: Any = fleet_told(flown.hub.fleet, flown.hub.seen, "", 0, 0)
    assert [note["unix_s"] for note in first["notes"]] == [0.0]
    flown.turn(*flown.heard(*(event(k, str(k)) for k in range(300))))
    said: Any = fleet_told(flown.hub.fleet, flown.hub.seen, "", 0, 0)
    assert len(said["notes"]) == NOTES_MAX
    assert len(msgspec.json.encode(said)) < 50_000


def test_every_trajectory_can_be_filled_in() -> None:
    told = {one["name"]: one["keys"] for one in trajectories_told()}
    assert set(told) == set(TRAJECTORIES)
    circle: Any = told["circle"]
    defaults = {key["key"]: key["default"] for key in circle}
    assert msgspec.convert({"name": "circle", **defaults}, Circle) == Circle()
    (radius,) = (key for key in circle if key["key"] == "radius_m")
    assert (radius["least"], radius["most"], radius["about"]) == (0.01, 1e5, "radius, m")
    assert [key["key"] for key in circle if key["yes_or_no"]] == ["clockwise"]


def ring(_: str) -> bytes:
    return b"RING"


def kinds(owed: list[str | bytes]) -> list[Any]:
    return [one if isinstance(one, bytes) else json.loads(one).get("kind") for one in owed]


def test_a_page_begins_with_all_that_is_kept_and_goes_on_with_each_row() -> None:
    page = Page()
    assert page.take(ring) == []
    page.see("uuv-1")
    page.owe_row(b"lost: it is in the ring")
    page.owe_about(b'{"kind":"about"}')
    page.owe_fleet(b'{"kind":"fleet","old":1}')
    page.owe_fleet(b'{"kind":"fleet"}')
    assert kinds(page.take(ring)) == ["fleet", "begin", b"RING", "about"]
    assert page.take(ring) == []
    page.owe_row(b"a")
    page.owe_row(b"b")
    assert page.take(ring) == [b"ab"]


def test_a_page_that_is_too_slow_begins_anew_and_owes_no_memory() -> None:
    page = Page()
    page.see("uuv-1")
    page.take(ring)
    for _ in range(100 * ROWS_MAX):
        page.owe_row(b"r")
        page.owe_fleet(b'{"kind":"fleet"}')
        page.owe_answer(b'{"kind":"answer"}')
    assert kinds(page.take(ring)) == ["answer"] * ANSWERS_MAX + ["fleet", "begin", b"RING"]
    for _ in range(ROWS_MAX):
        page.owe_row(b"r")
    assert page.take(ring) == [b"r" * ROWS_MAX]


def test_what_a_page_may_ask_is_read_and_anything_else_is_nothing() -> None:
    assert orders.read('{"ask":"see","vehicle":"a"}') == orders.See("a")
    order = orders.Order("a", "load", 3, 1.5, {"trajectory": {"name": "circle"}})
    assert orders.read(msgspec.json.encode(order)) == order
    for text in ("", "{}", "[" * 5000, '{"ask":"see"}', '{"ask":"see","vehicle":1}', '{"ask":"x"}', b"\xff"):
        assert orders.read(text) is None
    assert json.loads(orders.answer(order, None, "why")) == {
        "kind": "answer",
        "number": 3,
        "vehicle": "a",
        "verb": "load",
        "accepted": None,
        "reason": "why",
    }


def test_rows_of_hours_ago_do_not_stand_beside_those_of_now() -> None:
    flown = Flown()
    flown.fly(40)
    while flown.hub.seen[0].contact == "live":
        flown.turn()
    flown.now_ns += 290 * S
    flown.fly(1)
    assert len(flown.rows()) > 40, "the last five minutes are kept"
    while flown.hub.seen[0].contact == "live":
        flown.turn()
    flown.now_ns += 4098 * S  # the clock of the rows has gone round
    flown.fly(2)
    assert len(flown.rows()) == 2
    assert flown.hub.renewed == set()
    flown.turn()


def test_the_age_of_the_newest_row_is_known() -> None:
    flown = Flown()
    assert flown.hub.age_s("uuv-1") == 0.0
    flown.fly(3)
    assert flown.hub.age_s("uuv-1") == 0.0
    while flown.hub.seen[0].contact == "live":
        flown.turn()
    flown.now_ns += 100 * S
    flown.turn()
    assert flown.hub.age_s("uuv-1") == pytest.approx(100.0, abs=0.2)


def test_the_minutes_of_who_was_long_away_come_whatever_comes_first() -> None:
    flown = Flown()
    flown.fly(20)
    while flown.hub.seen[0].contact == "live":
        flown.turn()
    flown.now_ns += 400 * S
    start_ns = flown.now_ns - 50 * S
    flown.turn(History(flown.now_ns, "uuv-1", tuple(state(start_ns + k * S) for k in range(50))))
    flown.fly(2)
    assert 50 <= len(flown.rows()) <= 53
    assert min(one["t"] for one in flown.rows()) >= start_ns / S - 1.0


def test_every_gap_is_asked_about_however_many_there_were() -> None:
    flown = Flown()
    for _ in range(5):
        flown.fly(5)
        asked = len(flown.asked)
        for _ in range(3):
            flown.hub.recall("uuv-1", flown.now_ns)
        assert len(flown.asked) == asked + 1
        flown.turn(History(flown.now_ns, "uuv-1", (state(flown.now_ns - S),)))
        while flown.hub.seen[0].contact == "live":
            flown.turn()
        flown.now_ns += 20 * S
        flown.turn()


@pytest.mark.parametrize(
    ("profile", "output", "asked"),
    [
        ("px4-uuv", {}, "rates_speed"),
        ("ardupilot-rover", {}, "rates_speed"),
        ("px4-rover", {}, "level_velocity"),
        ("px4-copter", {}, "velocity"),
        ("px4-copter", {"copter": {"output": "rates"}}, "rates_throttle"),
        ("ardupilot-plane", {}, "attitude_throttle"),
        ("ardupilot-plane", {"airplane": {"output": "rates"}}, "rates_throttle"),
        ("of-another-make", {}, ""),
    ],
)
def test_a_page_is_told_what_the_vehicle_is_told(profile: str, output: dict[str, Any], asked: str) -> None:
    flown = Flown()
    flown.turn(*flown.heard(configured(vehicle={"profile": profile}, **output)))
    assert flown.hub.about("uuv-1", flown.now_ns)["asked"] == asked
