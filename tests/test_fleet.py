"""The fleet as watch sees it, on virtual time: live, silent, back, gone, doubled, and what is no record."""

from __future__ import annotations

import random

import msgspec
import pytest

from guidance.fleet import SILENT_NS, Contact, Source
from guidance.records import Level, Status
from tests.fleet_rig import MS, S, Sky, error, event, link, session, setpoint, state, status

LOOK_NS = 200 * MS  # between looks of `guidance watch`
TURN_NS = 50 * MS  # how late an arrival may be noted
T0 = 100 * S


def test_a_vehicle_that_tracks_is_seen_with_its_figures() -> None:
    sky = Sky()
    sky.say(T0, "uuv-1", session("aa"))
    sky.fly("uuv-1", T0, T0 + 3 * S)
    seen = sky.look(T0 + 3 * S, "uuv-1")
    assert seen.contact is Contact.LIVE
    assert (seen.state, seen.reason) == ("tracking", "offboard and armed, confirmed")
    assert (seen.mode, seen.armed, seen.session_id) == ("offboard", True, "aa")
    assert seen.error_m == 0.123
    assert seen.setpoint_rate_hz == pytest.approx(50.0)
    assert seen.attitude == Source("ATTITUDE_QUATERNION", 200.0, 0.012)
    assert seen.position == Source("LOCAL_POSITION_NED", 50.0, 0.034)
    assert (seen.round_trip_s, seen.lost, seen.heartbeat_age_s) == (0.0004, 7, 0.25)
    assert (seen.versions, seen.doubled) == ((), False)
    assert sky.fleet.ignored == {}
    assert sky.texts() == []


@pytest.mark.parametrize("seed", range(20))
def test_a_vehicle_that_falls_silent_looks_so_within_a_second_and_never_before(seed: int) -> None:
    """Whenever it ends, with arrivals noted up to a turn late and looks that are not in step."""
    dice = random.Random(seed)
    sky = Sky()
    end_ns = T0 + dice.randrange(2 * S, 4 * S)
    last_ns = 0
    looked_ns = T0 + dice.randrange(LOOK_NS)
    for t_ns in range(T0, T0 + 6 * S, 10 * MS):
        if t_ns < end_ns and (t_ns - T0) % (200 * MS) == 0:  # nothing but the status: a vehicle that waits
            sky.say(t_ns + dice.randrange(TURN_NS), "uuv-1", status(t_ns))
            last_ns = t_ns
        if t_ns >= looked_ns:
            looked_ns += LOOK_NS
            seen = sky.fleet.look(t_ns)
            silent = [s.contact for s in seen] == [Contact.SILENT]
            if silent:
                assert t_ns - last_ns >= SILENT_NS
            if t_ns - last_ns >= 0.98 * S:
                assert silent
    (text,) = sky.texts()
    assert text.startswith("uuv-1: silent: nothing came for 0.")


def test_what_a_silent_vehicle_said_last_is_kept_and_its_figures_are_not() -> None:
    sky = Sky()
    sky.fly("uuv-1", T0, T0 + 2 * S)
    sky.look(T0 + 2 * S, "uuv-1")
    for quiet_s in (0.8, 3.0):
        seen = sky.look(T0 + 2 * S + round(quiet_s * S), "uuv-1")
        assert seen.contact is Contact.SILENT
        assert seen.quiet_s == pytest.approx(quiet_s, abs=0.05)
        assert (seen.state, seen.mode, seen.armed) == ("tracking", "offboard", True)
        figures = (seen.error_m, seen.setpoint_rate_hz, seen.attitude, seen.position, seen.lost)
        assert figures == (None,) * 5
    sky.fly("uuv-1", T0 + 6 * S, T0 + 7 * S)
    assert sky.look(T0 + 7 * S, "uuv-1").contact is Contact.LIVE
    assert sky.texts()[1:] == ["uuv-1: heard again after 4.0 s"]


def test_each_figure_is_shown_only_while_it_is_young() -> None:
    """It still publishes its status, but no setpoint, state or link any more."""
    sky = Sky()
    sky.fly("uuv-1", T0, T0 + 2 * S)
    for t_ns in range(T0 + 2 * S, T0 + 4 * S, 200 * MS):
        sky.say(t_ns, "uuv-1", status(t_ns, state="handed-over", reason="the pilot"))
    seen = sky.look(T0 + 4 * S, "uuv-1")
    assert (seen.contact, seen.state) == (Contact.LIVE, "handed-over")
    assert (seen.error_m, seen.setpoint_rate_hz, seen.attitude, seen.round_trip_s) == (None,) * 4


def test_a_token_withdrawn_is_gone_at_once_and_a_record_after_it_is_not() -> None:
    sky = Sky()
    sky.token(T0, "uuv-1", here=True)
    sky.fly("uuv-1", T0, T0 + S)
    sky.say(T0 + S, "uuv-1", status(T0 + S, state="finished"))  # its last word, noted in the same turn
    sky.token(T0 + S, "uuv-1", here=False)
    assert sky.look(T0 + S, "uuv-1").contact is Contact.GONE
    assert sky.look(T0 + 9 * S, "uuv-1").contact is Contact.GONE
    assert sky.texts() == ["uuv-1: gone: its service ended or left the network"]
    sky.say(T0 + 10 * S, "uuv-1", status(T0 + 10 * S))
    assert sky.look(T0 + 10 * S, "uuv-1").contact is Contact.LIVE
    assert sky.look(T0 + 12 * S, "uuv-1").contact is Contact.SILENT
    assert sky.texts()[1] == "uuv-1: heard again after 9.0 s"


def test_a_late_answer_of_a_service_that_has_gone_does_not_bring_it_back() -> None:
    sky = Sky()
    sky.token(T0, "uuv-1", here=True)
    sky.token(T0 + S, "uuv-1", here=False)
    sky.say(T0 + S + 1, "uuv-1", status(T0), answered=True)
    assert sky.look(T0 + S + 2, "uuv-1").contact is Contact.GONE


def test_a_token_without_any_record_is_a_vehicle_that_falls_silent() -> None:
    sky = Sky()
    sky.token(T0, "uuv-1", here=True)
    assert sky.look(T0, "uuv-1").contact is Contact.LIVE
    seen = sky.look(T0 + S, "uuv-1")
    assert (seen.contact, seen.state) == (Contact.SILENT, None)


def test_answers_to_a_late_joiner_tell_what_was_said_but_are_no_young_figures() -> None:
    """An hour ago it tracked: its last error is still answered, and is no error of now."""
    sky = Sky()
    sky.token(T0, "uuv-1", here=True)
    old = (error(0, 1.0), setpoint(0, 5), state(0), link(0), event(3 * S, "engaged"), session("aa"))
    sky.say(T0, "uuv-1", *old, answered=True)
    assert sky.fleet.notes[0].when_ns == T0  # nobody knows yet
    sky.say(T0, "uuv-1", status(3600 * S, state="ready", reason="waiting for the pilot"))
    seen = sky.look(T0, "uuv-1")
    assert (seen.state, seen.session_id) == ("ready", "aa")
    assert (seen.error_m, seen.setpoint_rate_hz, seen.attitude, seen.lost) == (None,) * 4
    (note,) = sky.fleet.notes
    assert note.text == "engaged"
    assert note.when_ns == T0 - 3597 * S  # though the status came after it


def test_an_answer_never_replaces_what_is_newer_nor_tells_an_event_twice() -> None:
    sky = Sky()
    sky.token(T0, "uuv-1", here=True)
    sky.say(T0, "uuv-1", status(T0, state="tracking"), event(T0, "engaged"))
    sky.say(T0 + 1, "uuv-1", status(T0 - 1, state="ready"), event(T0, "engaged"), answered=True)
    assert sky.look(T0 + 2, "uuv-1").state == "tracking"
    sky.say(T0 + 5 * S, "uuv-1", event(T0, "engaged"), answered=True)  # asked again after a reconnect
    assert [text for text in sky.texts() if "engaged" in text] == ["uuv-1: engaged"]


def test_a_restart_is_a_new_run_and_not_a_second_service() -> None:
    """Also on a machine that booted in between: its clock goes back once."""
    sky = Sky()
    sky.say(T0, "uuv-1", session("a" * 32))
    sky.fly("uuv-1", T0, T0 + 2 * S)
    sky.token(T0 + 2 * S, "uuv-1", here=False)
    sky.token(T0 + 3 * S, "uuv-1", here=True)
    sky.say(T0 + 3 * S, "uuv-1", session("b" * 32))
    for k in range(10):
        sky.say(T0 + 3 * S + k * LOOK_NS, "uuv-1", status(k, since_ns=-5), setpoint(k * LOOK_NS, k))
    seen = sky.look(T0 + 5 * S, "uuv-1")
    assert (seen.doubled, seen.session_id) == (False, "b" * 32)
    assert seen.setpoint_rate_hz == pytest.approx(5.0)  # of the new run only
    assert sky.texts()[-1] == "uuv-1: a new run began: bbbbbbbb, guidance 0.1"


def test_two_services_under_one_name_are_named_and_only_while_both_publish() -> None:
    sky = Sky()
    for k in range(20):
        since_ns = 5 * S if k % 2 else 9 * S
        sky.say(T0 + k * LOOK_NS // 2, "uuv-1", status(T0, since_ns=since_ns))
    end_ns = T0 + 2 * S
    sky.say(end_ns, "uuv-1", setpoint(end_ns - 20 * MS, 1), setpoint(end_ns, 2))
    seen = sky.look(end_ns, "uuv-1")
    assert seen.doubled
    assert seen.setpoint_rate_hz is None, "it would be of both"
    assert len([text for text in sky.texts() if "two services publish under this name" in text]) == 1
    for k in range(20):
        sky.say(end_ns + k * LOOK_NS, "uuv-1", status(T0, since_ns=9 * S))
    sky.say(end_ns + 4 * S, "uuv-1", setpoint(end_ns + 4 * S, 3), setpoint(end_ns + 4 * S + 20 * MS, 4))
    seen = sky.look(end_ns + 4 * S, "uuv-1")
    assert not seen.doubled
    assert seen.setpoint_rate_hz is not None


def test_one_service_that_engages_quickly_is_not_two() -> None:
    sky = Sky()
    for k, name in enumerate(("ready", "streaming", "switching", "arming", "tracking")):
        now_ns = T0 + k * 100 * MS
        sky.say(now_ns, "uuv-1", status(now_ns, state=name, since_ns=now_ns))
        assert not sky.look(now_ns, "uuv-1").doubled


def test_records_of_another_schema_version_are_named_with_it() -> None:
    sky = Sky()
    for t_ns in (T0, T0 + 200 * MS):
        sky.payload(t_ns, "guidance/uuv-2/status", "application/json;guidance.Status/2")
    seen = sky.look(T0 + 300 * MS, "uuv-2")
    assert (seen.contact, seen.versions, seen.state) == (Contact.LIVE, (2,), None)
    assert sky.fleet.ignored == {("uuv-2", "schema version 2"): (2, "status: guidance.Status")}
    assert sky.look(T0 + 2 * S, "uuv-2").contact is Contact.SILENT
    sky.fly("uuv-2", T0 + 6 * S, T0 + 7 * S)  # it was updated
    seen = sky.look(T0 + 7 * S, "uuv-2")
    assert (seen.versions, seen.state) == ((), "tracking")


def test_garbage_is_counted_and_makes_no_vehicle() -> None:
    sky = Sky()
    sky.payload(T0, "guidance/uuv-1/status", "application/json;guidance.Status/1", b"{")
    sky.payload(T0, "guidance/uuv-1/status", "zenoh/bytes", msgspec.json.encode(status(0)))
    assert sky.fleet.look(T0) == []
    assert {what: count for (_, what), (count, _) in sky.fleet.ignored.items()} == {
        "garbage": 1,
        "no schema of ours": 1,
    }


def test_notes_carry_the_time_here_at_which_they_happened_and_their_level() -> None:
    sky = Sky()
    sky.say(T0, "uuv-1", event(7 * S, "early"), status(9 * S), event(8 * S, "late", Level.WARNING))
    early, late = sky.fleet.notes
    assert (early.when_ns, late.when_ns) == (T0 - 2 * S, T0 - S)
    assert (late.level, late.number) == (Level.WARNING, early.number + 1)
    sky.say(T0 + S, "uuv-1", event(11 * S, "ahead of its status"))
    assert sky.fleet.notes[-1].when_ns == T0 + S  # nothing comes before it happens


def test_an_answered_status_tells_the_time_until_one_is_published() -> None:
    sky = Sky()
    sky.say(T0, "uuv-1", event(7 * S, "x"), status(9 * S), answered=True)
    assert [note.when_ns for note in sky.fleet.notes] == [T0 - 2 * S]
    sky.say(T0 + 2 * S, "uuv-1", status(12 * S), event(12 * S, "y"))
    assert sky.fleet.notes[-1].when_ns == T0 + 2 * S


def test_who_comes_back_after_a_reboot_has_another_clock() -> None:
    sky = Sky()
    sky.token(T0, "uuv-1", here=True)
    sky.say(T0, "uuv-1", status(9000 * S))
    sky.token(T0 + S, "uuv-1", here=False)
    sky.token(T0 + 60 * S, "uuv-1", here=True)
    sky.fleet.recall("uuv-1", [event(5 * S, "booted")], T0 + 61 * S)
    sky.say(T0 + 61 * S, "uuv-1", status(8 * S))
    (booted,) = (note for note in sky.fleet.notes if note.text == "booted")
    assert booted.when_ns == T0 + 58 * S


def test_the_setpoint_rate_counts_what_was_sent_not_what_arrived() -> None:
    sky = Sky()
    for seq in range(0, 150, 3):  # the network loses two of three
        sky.say(T0, "uuv-1", setpoint(seq * 20 * MS, seq))
    assert sky.look(T0, "uuv-1").setpoint_rate_hz == pytest.approx(50.0)


def test_memory_has_a_limit_whoever_publishes() -> None:
    sky = Sky()
    for k in range(1000):
        sky.say(T0 + k, f"v{k}", event(k, "x"), *(setpoint(s, s) for s in range(3)))
        sky.payload(T0 + k, f"guidance/v{k}/status", f"application/json;guidance.Status/{k + 2}")
        sky.payload(T0 + k, "guidance/v999/status", f"application/json;guidance.Status/{k + 2}")
    seen = sky.fleet.look(T0 + 1000)
    assert len(seen) == 200
    assert {"v998", "v999"} <= {s.vehicle for s in seen}  # those unheard for longest gave way
    assert len(sky.fleet.notes) == 200
    assert len(sky.fleet.ignored) == 51
    assert sky.fleet.ignored["others", "further kinds"][0] > 1000
    assert len(sky.look(T0 + 1000, "v999").versions) <= 5


def test_the_newest_record_of_a_type_is_at_hand() -> None:
    sky = Sky()
    assert sky.fleet.newest("uuv-1", Status) is None
    sky.say(T0, "uuv-1", status(1), status(2))
    assert sky.fleet.newest("uuv-1", Status) == status(2)
