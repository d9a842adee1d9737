"""Engaging, step by step, with views made by hand: each deadline, each named reason, each command."""

from __future__ import annotations

from typing import Any

import pytest

from guidance.engagement import ESTABLISHED_AFTER, RETRY_S, Change
from guidance.mavlink.profiles import Profile
from guidance.supervisor import Event, State
from tests.engagement_bench import BOTH, PX4, ROVER, bench, mode, ways


@BOTH
@pytest.mark.parametrize("unknown", [{"armed": None}, {"custom_mode": None}, {"connected": False}])
def test_nothing_begins_before_arming_and_mode_are_known(profile: Profile, unknown: dict[str, Any]) -> None:
    it = bench(profile, "auto", arm=True, **unknown)
    for _ in range(100):
        assert it.see() == []
    assert it.state() is State.DISCONNECTED
    assert str(it.engage()).startswith("engage refused: disconnected: ")


@BOTH
def test_the_whole_sequence_of_auto(profile: Profile) -> None:
    it = bench(profile, "auto", arm=True)
    control = profile.control_mode
    assert ways(it.see()) == [
        (State.CONNECTED, Event.FOUND),
        (State.READY, Event.CONDITIONS_MET),
        (State.STREAMING, Event.ENGAGE),
    ]
    assert it.see(setpoints_sent=ESTABLISHED_AFTER - 1) == []
    assert it.command() is None
    assert ways(it.see(setpoints_sent=ESTABLISHED_AFTER)) == [(State.SWITCHING, Event.STREAM_ESTABLISHED)]
    assert it.command() == control
    assert it.command() is None  # not again within a second
    it.see(0.95)
    assert it.command() is None
    it.see(0.05)
    assert it.command() == control
    assert ways(it.see(custom_mode=control.custom_mode)) == [(State.ARMING, Event.MODE_CONFIRMED)]
    assert it.command() is True
    assert it.command() is None
    assert it.see(0.5) == []
    assert ways(it.see(armed=True)) == [(State.TRACKING, Event.IN_CONTROL)]
    assert it.command() is None


@BOTH
def test_a_blocked_start_names_the_condition_and_goes_on_when_it_is_met(profile: Profile) -> None:
    it = bench(profile, "auto", blocked="no LOCAL_POSITION_NED: is the estimator ready?")
    it.see()
    assert (it.state(), it.reason()) == (State.CONNECTED, "no LOCAL_POSITION_NED: is the estimator ready?")
    it.see(blocked="12.0 m from the start")
    assert it.reason() == "12.0 m from the start"
    it.see(blocked=None)
    assert it.state() is State.STREAMING


def test_conditions_lost_while_ready_are_named() -> None:
    it = bench(PX4)
    it.reach(State.READY)
    assert it.see(blocked="the attitude is 0.30 s old") == [
        Change(State.READY, State.CONNECTED, Event.CONDITIONS_LOST, "the attitude is 0.30 s old")
    ]


@BOTH
def test_each_step_has_a_deadline_and_says_what_blocks_it(profile: Profile) -> None:
    name = profile.control_mode.name
    for state, seen, said in [
        (State.STREAMING, {}, "no stream of setpoints: none sent"),
        (State.STREAMING, {"blocked": "no attitude"}, "no stream of setpoints: no attitude"),
        (State.SWITCHING, {}, f"the autopilot does not enter {name}"),
        (State.SWITCHING, {"answer": "DENIED"}, f"the autopilot does not enter {name}; its answer: DENIED"),
        (State.ARMING, {"answer": "FAILED"}, "the autopilot does not arm; its answer: FAILED"),
        (State.ARMING, {"blocked": "too far"}, "too far"),
    ]:
        it = bench(profile, arm=True)
        it.reach(state)
        assert it.see(5.0, **seen) == [], state
        assert it.see(0.001) == [Change(state, State.ABORTED, Event.STEP_TIMEOUT, said)]
        assert it.command() is None


@BOTH
def test_without_arm_it_waits_for_the_pilot_and_never_commands_to_arm(profile: Profile) -> None:
    it = bench(profile)
    it.reach(State.ARMING)
    for _ in range(1000):
        assert it.see(1.0) == []
        assert it.command() is None
    assert it.reason() == "waiting for the pilot to arm"
    # The deadline runs from arming, not from when the wait began.
    assert it.see(armed=True, blocked="the attitude is 0.30 s old") == []
    assert it.see(4.9) == []
    assert ways(it.see(blocked=None)) == [(State.TRACKING, Event.IN_CONTROL)]


def test_it_does_not_arm_while_a_condition_is_not_met() -> None:
    it = bench(PX4, arm=True)
    it.reach(State.ARMING)
    it.see(blocked="too far")
    assert it.command() is None
    it.see(blocked=None)
    assert it.command() is True


def test_the_rover_needs_no_intended_mode() -> None:
    it = bench(ROVER, armed=True, intended_mode=None)
    it.see()
    assert it.state() is State.READY


def test_ready_offers_a_stream_only_where_it_cannot_take_control() -> None:
    offboard, hold = PX4.control_mode.custom_mode, mode(PX4, "hold")
    for profile, shown, intended, offered in [
        (PX4, hold, hold, True),
        (PX4, hold, None, False),
        (PX4, hold, offboard, False),
        (PX4, offboard, offboard, False),
        (ROVER, mode(ROVER, "hold"), None, False),
        (ROVER, ROVER.control_mode.custom_mode, None, False),
    ]:
        it = bench(profile, custom_mode=shown, intended_mode=intended)
        assert it.it.may_offer_stream(it.views[0]) is offered


@BOTH
def test_the_pilots_switch_engages_but_a_mode_that_stood_already_does_not(profile: Profile) -> None:
    control = profile.control_mode
    it = bench(profile, custom_mode=control.custom_mode, intended_mode=control.custom_mode)
    it.see()
    assert it.see(10.0) == []
    assert it.reason() == f"already in {control.name}: leave it and switch again, or command engage"
    it.see(custom_mode=mode(profile, "manual"), intended_mode=mode(profile, "manual"))
    assert it.reason() == f"waiting for the pilot to switch to {control.name}"
    assert ways(it.see(custom_mode=control.custom_mode)) == [(State.ARMING, Event.PILOT_SWITCHED)]


@BOTH
def test_a_refusal_is_tried_again_only_on_the_ground_and_not_at_once(profile: Profile) -> None:
    for engage, armed, again in [("auto", False, True), ("auto", True, False), ("pilot", False, True)]:
        it = bench(profile, engage, armed=armed)
        it.reach(State.SWITCHING) if engage == "pilot" or armed else it.see()
        it.see(setpoints_sent=ESTABLISHED_AFTER)
        assert ways(it.see(5.1)) == [(State.ABORTED, Event.STEP_TIMEOUT)]
        assert it.see(RETRY_S - 0.1) == []
        changes = it.see(0.2)
        assert (Event.RETRY in [change.event for change in changes]) is again
        assert (it.state() is State.STREAMING) is (engage == "auto" and again)


@BOTH
def test_an_operator_may_command_again_after_an_abort(profile: Profile) -> None:
    it = bench(profile, armed=True)
    it.reach(State.SWITCHING)
    it.see(5.1)
    assert it.state() is State.ABORTED
    assert it.engage() is None
    assert ways(it.see())[0] == (State.CONNECTED, Event.COMMANDED)
    assert it.state() is State.STREAMING


@BOTH
def test_the_engage_command_is_answered_in_every_state(profile: Profile) -> None:
    for state in (State.STREAMING, State.SWITCHING, State.ARMING, State.TRACKING):
        it = bench(profile)
        it.reach(state)
        assert it.engage() == f"engage ignored: already {state}"
    it = bench(profile)
    assert str(it.engage()).startswith("engage refused: disconnected: ")
    it.see()
    assert it.engage() is None
    it.it.shutdown()
    assert it.engage() == "engage refused: the service is shutting down"


@BOTH
def test_auto_leaves_alone_what_it_finds_in_use_even_once_that_is_put_down(profile: Profile) -> None:
    """A pilot may fly it, or have disarmed it, who took it from this very service before it was killed."""
    control, hold = profile.control_mode.custom_mode, mode(profile, "hold")
    in_mode = {"custom_mode": control, "intended_mode": control}
    for found, put_down in (
        ({"armed": True}, {"armed": False}),
        (in_mode, {"custom_mode": hold, "intended_mode": hold}),
    ):
        it = bench(profile, "auto", arm=True, **found)
        it.see()
        assert it.see(60.0) == []
        assert it.state() is State.READY
        it.see(**put_down)
        assert it.see(60.0) == []
        assert it.engage() is None
        it.see()
        assert it.state() is State.STREAMING
