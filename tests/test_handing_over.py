"""Handing over, staying out, and leaving, with views made by hand: the pilot wins at once and for good."""

from __future__ import annotations

from typing import Any

import pytest

from guidance.engagement import ESTABLISHED_AFTER, RETRY_S
from guidance.leaving import LEAVE_S
from guidance.mavlink.profiles import Profile
from guidance.supervisor import Event, State
from guidance.takeover import UNDER_WAY_S
from guidance.view import silence_limit_s
from tests.engagement_bench import BOTH, PX4, ROVER, bench, mode, ways


@BOTH
@pytest.mark.parametrize("state", [State.STREAMING, State.SWITCHING, State.ARMING, State.TRACKING])
def test_a_mode_that_was_not_asked_for_hands_over_in_the_same_update(profile: Profile, state: State) -> None:
    it = bench(profile)
    it.reach(state)
    changes = it.see(custom_mode=mode(profile, "acro"))
    assert [change[1:] for change in changes] == [
        (State.HANDED_OVER, Event.MODE_LEFT, "the mode was changed to acro")
    ]
    assert it.command() is None


@BOTH
@pytest.mark.parametrize("state", [State.STREAMING, State.SWITCHING, State.ARMING, State.TRACKING])
def test_an_unasked_disarm_hands_over_in_the_same_update(profile: Profile, state: State) -> None:
    it = bench(profile, arm=True)
    it.reach(state)
    if state is not State.ARMING:
        it.see(armed=True)  # as somebody else may do in the middle of the sequence
    else:
        it.see(armed=True, blocked="not yet")
    assert it.state() is state
    assert it.see(armed=False)[0][1:] == (State.HANDED_OVER, Event.DISARMED, "the vehicle was disarmed")
    assert it.command() is None


@BOTH
def test_silence_hands_over_well_before_the_firmware_acts(profile: Profile) -> None:
    limit_s = silence_limit_s(profile)
    it = bench(profile)
    it.reach(State.TRACKING)
    assert it.see(1.0, silent_s=limit_s - 0.01) == []
    changes = it.see(silent_s=limit_s + 0.01, blocked="the attitude is 0.70 s old")
    assert ways(changes) == [(State.HANDED_OVER, Event.INTERRUPTED)]
    assert changes[0].reason == f"no setpoint for {limit_s + 0.01:.2f} s (the attitude is 0.70 s old)"


@BOTH
@pytest.mark.parametrize("state", [State.SWITCHING, State.ARMING, State.TRACKING])
def test_a_lost_link_hands_over_and_what_comes_back_in_control_is_withheld(
    profile: Profile, state: State
) -> None:
    it = bench(profile, "auto", arm=True)
    it.see()
    it.see(setpoints_sent=ESTABLISHED_AFTER)
    control = profile.control_mode.custom_mode
    if state is not State.SWITCHING:
        it.see(custom_mode=control)
    if state is State.TRACKING:
        it.see(armed=True)
    assert it.state() is state
    assert ways(it.see(connected=False)) == [
        (State.HANDED_OVER, Event.LOST),
        (State.DISCONNECTED, Event.LOST),
    ]
    it.see(connected=True, armed=True, custom_mode=control, intended_mode=control)
    assert it.state() is State.WITHHELD
    it.see(custom_mode=mode(profile, "acro"), intended_mode=mode(profile, "acro"))
    it.see(60.0, armed=False)
    assert it.state() is State.READY
    assert it.reason() == (
        "control was handed over, so no stream is offered: "
        "command engage, or switch to offboard before arming"
        if profile.needs_stream
        else "waiting for the pilot to switch to guided"
    )


@BOTH
def test_after_a_hand_over_auto_waits_for_a_command_even_on_the_ground(profile: Profile) -> None:
    control = profile.control_mode.custom_mode
    it = bench(profile, "auto", arm=True)
    it.reach_auto()
    it.see(connected=False)
    it.see(connected=True, intended_mode=control)  # found armed in control: withheld
    assert it.state() is State.WITHHELD
    it.see(armed=False)
    for _ in range(100):
        it.see(1.0)
        assert it.state() is State.READY
    assert it.engage() is None
    it.see()
    assert it.state() is State.STREAMING


@BOTH
def test_a_command_that_could_not_be_obeyed_in_time_does_not_bring_auto_back(profile: Profile) -> None:
    it = bench(profile, "auto", arm=True)
    it.reach_auto()
    acro = mode(profile, "acro")
    it.see(custom_mode=acro, intended_mode=acro, blocked="too far")
    assert it.engage() is None
    it.see()
    assert it.state() is State.CONNECTED
    it.see(60.0)
    it.see(blocked=None)
    assert it.state() is State.READY
    assert it.see(60.0) == []


@BOTH
def test_a_command_that_was_overtaken_by_the_pilots_switch_does_not_act_later(profile: Profile) -> None:
    it = bench(profile, armed=True)
    it.reach(State.READY)
    assert it.engage() is None
    it.see(custom_mode=profile.control_mode.custom_mode)
    assert it.state() is State.TRACKING
    it.see(custom_mode=mode(profile, "acro"), intended_mode=mode(profile, "acro"))
    for _ in range(20):
        it.see()
        assert it.state() is State.HANDED_OVER


@BOTH
def test_a_command_is_forgotten_when_its_time_is_over_or_the_link_was_lost(profile: Profile) -> None:
    it = bench(profile, blocked="too far")
    it.see()
    assert it.engage() is None
    it.see(5.1)
    it.see(blocked=None)
    assert it.state() is State.READY
    it.see(blocked="too far")
    assert it.engage() is None
    it.see(connected=False)
    it.see(connected=True, blocked=None)
    assert it.state() is State.READY


@BOTH
def test_found_armed_in_the_control_mode_it_is_silent_until_released_or_commanded(profile: Profile) -> None:
    control = profile.control_mode.custom_mode
    acro = mode(profile, "acro")
    ends: list[tuple[dict[str, Any] | None, Event]] = [
        ({"armed": False}, Event.RELEASED),
        ({"custom_mode": acro, "intended_mode": acro}, Event.RELEASED),
        (None, Event.COMMANDED),
    ]
    for changed, event in ends:
        it = bench(profile, armed=True, custom_mode=control, intended_mode=control)
        for _ in range(50):
            it.see(1.0)
            assert it.state() is State.WITHHELD
        assert it.reason().startswith(f"found armed in {profile.control_mode.name}: silent until the mode")
        if changed is None:
            assert it.engage() is None
        assert ways(it.see(**(changed or {})))[0] == (State.CONNECTED, event)


def test_px4_found_armed_is_left_alone_while_offboard_is_intended_or_not_excluded() -> None:
    offboard, position = PX4.control_mode.custom_mode, mode(PX4, "position")
    it = bench(PX4, "auto", armed=True, custom_mode=position, intended_mode=None)
    it.see()
    assert it.state() is State.WITHHELD
    assert it.reason() == "armed, and CURRENT_MODE does not say yet whether offboard is intended: silent"
    it.see(intended_mode=offboard)
    assert it.reason().startswith("found armed in offboard: silent")
    assert it.see(60.0) == []
    it.see(intended_mode=position)
    assert it.state() is State.READY  # and auto leaves the vehicle to whoever took it
    assert it.see(60.0) == []


@BOTH
def test_a_switch_that_nobody_saw_is_not_fresh(profile: Profile) -> None:
    it = bench(profile)
    it.reach(State.READY)
    it.see(connected=False)
    it.see(connected=True, custom_mode=profile.control_mode.custom_mode)
    assert it.state() is State.READY
    assert it.reason().startswith("already in")


def test_after_a_hand_over_the_rovers_pilot_may_switch_back_and_px4s_may_not() -> None:
    for profile, after in [(ROVER, State.TRACKING), (PX4, State.HANDED_OVER)]:
        it = bench(profile, armed=True)
        it.reach(State.TRACKING)
        it.see(custom_mode=mode(profile, "acro"))
        it.see(custom_mode=profile.control_mode.custom_mode)
        assert it.state() is after


def test_a_mode_command_that_acts_late_is_not_taken_for_the_pilots_switch() -> None:
    control = ROVER.control_mode.custom_mode
    for late, after in [(True, State.HANDED_OVER), (False, State.TRACKING)]:
        it = bench(ROVER, armed=True)
        it.reach(State.SWITCHING)
        assert ways(it.see(1.0, silent_s=1.0)) == [(State.HANDED_OVER, Event.INTERRUPTED)]
        it.see(UNDER_WAY_S - 0.1 if late else UNDER_WAY_S, silent_s=0.0)
        it.see(custom_mode=control)
        assert it.state() is after


@pytest.mark.parametrize("ending", ["taken over", "aborted"])
def test_a_link_that_was_lost_meanwhile_makes_no_hand_over_in_flight_forgotten(ending: str) -> None:
    control, hold, acro = PX4.control_mode.custom_mode, mode(PX4, "hold"), mode(PX4, "acro")
    it = bench(PX4)
    it.reach(State.TRACKING)
    if ending == "aborted":
        assert it.it.abort(it.now_ns[0]) is None
        it.see()
        it.see(LEAVE_S)
        assert it.state() is State.ABORTED
    it.see(connected=False)
    it.see(connected=True, intended_mode=control)
    assert it.state() is State.WITHHELD
    it.see(custom_mode=hold, intended_mode=hold)
    for _ in range(3):
        it.see(RETRY_S)
        assert (it.state(), it.streams()) == (State.READY, False)
        assert it.reason().startswith("control was handed over, so no stream is offered")
    it.see(2.0, custom_mode=control)  # of somebody else's stream: this service has none
    assert it.state() is State.READY
    it.see(custom_mode=acro, intended_mode=acro)
    it.see(armed=False)
    assert (it.state(), it.streams()) == (State.READY, True)
    it.see(armed=True)
    assert it.streams()


def test_a_command_offers_a_stream_again_after_a_hand_over_and_a_lost_link() -> None:
    hold = mode(PX4, "hold")
    it = bench(PX4)
    it.reach(State.TRACKING)
    it.see(connected=False)
    it.see(connected=True, custom_mode=hold, intended_mode=hold)
    assert (it.state(), it.streams()) == (State.READY, False)
    assert it.engage() is None
    it.see()
    assert (it.state(), it.streams()) == (State.STREAMING, True)


@BOTH
def test_handed_over_and_put_down_is_a_new_start(profile: Profile) -> None:
    it = bench(profile)
    it.reach(State.TRACKING)
    it.see(custom_mode=mode(profile, "acro"), intended_mode=mode(profile, "acro"))
    it.see(custom_mode=mode(profile, "acro"))
    assert it.state() is State.HANDED_OVER
    it.see(armed=False)
    assert it.state() is State.HANDED_OVER  # for a while, so that nothing follows from the same glance
    it.see(RETRY_S)
    assert it.state() is State.READY


@BOTH
def test_shutdown_while_tracking_commands_the_exit_mode_until_it_is_seen(profile: Profile) -> None:
    hold = profile.mode("hold")
    it = bench(profile)
    it.reach(State.TRACKING)
    it.it.shutdown()
    assert ways(it.see()) == [(State.LEAVING, Event.SHUTDOWN)]
    assert [it.command(), it.command()] == [hold, None]
    it.see(0.2)
    assert it.command() == hold
    assert ways(it.see(custom_mode=mode(profile, "hold"))) == [(State.FINISHED, Event.LEFT)]
    assert it.command() is None


@BOTH
@pytest.mark.parametrize("state", [State.STREAMING, State.SWITCHING, State.ARMING, State.TRACKING])
def test_leaving_ends_after_one_second_whatever_the_vehicle_does(profile: Profile, state: State) -> None:
    it = bench(profile)
    it.reach(state)
    it.it.shutdown()
    after = State.LEAVING if state is State.TRACKING else State.BACKING_OUT
    assert ways(it.see()) == [(after, Event.SHUTDOWN)]
    assert it.see(LEAVE_S - 0.001, silent_s=100.0) == []
    assert ways(it.see(0.001)) == [(State.FINISHED, Event.LEFT)]


@BOTH
def test_backing_out_leaves_a_mode_that_somebody_else_chose_alone(profile: Profile) -> None:
    control, hold = profile.control_mode.custom_mode, profile.mode("hold")
    it = bench(profile, armed=True, custom_mode=mode(profile, "acro"))
    it.reach(State.SWITCHING)
    it.it.shutdown()
    it.see()
    assert it.state() is State.BACKING_OUT
    assert it.command() is None
    it.see(custom_mode=control)  # the command was still on its way
    assert it.command() == hold
    assert ways(it.see(custom_mode=mode(profile, "hold"))) == [(State.FINISHED, Event.LEFT)]


@BOTH
@pytest.mark.parametrize(
    "state", [State.DISCONNECTED, State.CONNECTED, State.WITHHELD, State.READY, State.HANDED_OVER]
)
def test_shutdown_out_of_control_is_immediate(profile: Profile, state: State) -> None:
    control = profile.control_mode.custom_mode
    it = bench(profile, connected=state is not State.DISCONNECTED)
    if state is State.CONNECTED:
        it.see(blocked="too far")
    elif state is State.WITHHELD:
        it.see(armed=True, custom_mode=control)
    elif state is State.READY:
        it.reach(state)
    elif state is State.HANDED_OVER:
        it.reach(State.TRACKING)
        it.see(custom_mode=mode(profile, "acro"))
    assert it.state() is state
    it.it.shutdown()
    assert ways(it.see()) == [(State.FINISHED, Event.SHUTDOWN)]
    assert it.see() == []
