"""Holding, resuming and aborting, with views made by hand."""

from __future__ import annotations

from typing import Any

import pytest

from guidance.leaving import LEAVE_S, PAUSE_S
from guidance.mavlink.messages import CommandAck
from guidance.mavlink.profiles import Profile
from guidance.supervisor import Event, State
from guidance.takeover import UNDER_WAY_S
from guidance.view import Trip
from tests.engagement_bench import BOTH, PX4, ROVER, Bench, bench, mode, ways


def held(profile: Profile, engage: str = "pilot") -> Bench:
    """A bench whose flight is held."""
    it = bench(profile, engage, arm=True)
    it.reach_auto() if engage == "auto" else it.reach(State.TRACKING)
    assert it.it.hold(it.now_ns[0]) is None
    it.see()
    it.see(custom_mode=mode(profile, "hold"), intended_mode=mode(profile, "hold"))
    assert it.state() is State.HOLDING
    return it


@BOTH
def test_hold_commands_the_mode_until_it_is_seen_and_then_nothing_more(profile: Profile) -> None:
    it = bench(profile)
    it.reach(State.TRACKING)
    assert it.it.hold(it.now_ns[0]) is None
    assert ways(it.see()) == [(State.PAUSING, Event.HOLD)]
    assert [it.command(), it.command()] == [profile.mode("hold"), None]
    assert it.streams()
    it.see(0.2)
    assert it.command() == profile.mode("hold")
    assert it.it.hold(it.now_ns[0]) is None  # as asked already
    assert ways(it.see(custom_mode=mode(profile, "hold"))) == [(State.HOLDING, Event.HOLD_CONFIRMED)]
    assert not it.streams()
    for _ in range(100):
        assert it.see(1.0) == []
        assert it.command() is None
    assert it.reason() == f"{profile.mode_name(mode(profile, 'hold'))} is on: resume or abort"
    assert it.it.hold(it.now_ns[0]) is None


@BOTH
def test_a_hold_that_was_accepted_is_not_commanded_again_lest_it_overrules_the_pilot(
    profile: Profile,
) -> None:
    it = bench(profile)
    it.reach(State.TRACKING)
    it.it.hold(it.now_ns[0])
    it.see()
    assert it.command() == profile.mode("hold")
    it.it.answered(CommandAck(176, 0, 255, 191), it.now_ns[0])
    it.see(0.5)
    assert it.command() is None
    it.it.answered(CommandAck(176, 2, 255, 191), it.now_ns[0])  # PX4's second answer: denied after all
    assert it.command() == profile.mode("hold")


@BOTH
def test_a_hold_mode_that_is_never_seen_ends_in_silence(profile: Profile) -> None:
    it = bench(profile, "auto", arm=True)
    it.reach_auto()
    it.it.hold(it.now_ns[0])
    it.see()
    assert it.see(PAUSE_S - 0.001) == []
    assert it.streams()
    assert ways(it.see(0.001)) == [(State.ABORTED, Event.STEP_TIMEOUT)]
    assert it.reason() == f"{profile.mode_name(mode(profile, 'hold'))} not confirmed within 3 s"
    assert not it.streams()
    it.see(armed=False)
    it.see(60.0)
    it.see(60.0)
    assert it.state() is not State.STREAMING  # auto is spent


@BOTH
def test_a_shutdown_on_the_way_to_hold_leaves_for_the_exit_mode(profile: Profile) -> None:
    it = bench(profile)
    it.reach(State.TRACKING)
    it.it.hold(it.now_ns[0])
    it.see()
    it.it.shutdown()
    assert ways(it.see()) == [(State.LEAVING, Event.SHUTDOWN)]


@BOTH
def test_resume_goes_the_whole_way_again(profile: Profile) -> None:
    control = profile.control_mode
    it = held(profile)
    assert it.it.resume(it.now_ns[0]) is None
    assert ways(it.see()) == [(State.STREAMING, Event.RESUME)]
    assert it.it.resume(it.now_ns[0]) is None  # as asked already
    sent = it.views[0].setpoints_sent
    assert ways(it.see(setpoints_sent=sent + 10)) == [(State.SWITCHING, Event.STREAM_ESTABLISHED)]
    assert it.command() == control
    assert ways(it.see(custom_mode=control.custom_mode)) == [
        (State.ARMING, Event.MODE_CONFIRMED),
        (State.TRACKING, Event.IN_CONTROL),
    ]
    assert it.it.resume(it.now_ns[0]) is None


@BOTH
def test_resume_waits_for_a_condition_and_is_given_up(profile: Profile) -> None:
    it = held(profile)
    assert it.it.resume(it.now_ns[0]) is None
    assert it.see(blocked="12.0 m from where the flight was held") == []
    assert it.reason() == "12.0 m from where the flight was held"
    it.see(5.0)
    said = it.it.expired(it.now_ns[0])
    assert said == "resume given up after 5 s: 12.0 m from where the flight was held"
    assert it.see(blocked=None) == []
    assert it.state() is State.HOLDING


@BOTH
@pytest.mark.parametrize(
    "seen",
    [{"custom_mode": "acro"}, {"armed": False}, {"connected": False}],
    ids=["mode", "disarm", "lost"],
)
@pytest.mark.parametrize("state", [State.PAUSING, State.HOLDING, State.ABORTING, State.CANCELLING])
def test_the_pilot_wins_in_each_of_these_states_and_for_good(
    profile: Profile, state: State, seen: dict[str, Any]
) -> None:
    it = bench(profile, "auto", arm=True)
    if state is State.HOLDING:
        it = held(profile, "auto")
    elif state is State.CANCELLING:
        it.see()
        it.see(setpoints_sent=10, armed=True)
        assert it.it.abort(it.now_ns[0]) is None
    else:
        it.reach_auto()
        order = it.it.hold if state is State.PAUSING else it.it.abort
        assert order(it.now_ns[0]) is None
    it.see()
    assert it.state() is state
    changed = {k: mode(profile, v) if k == "custom_mode" else v for k, v in seen.items()}
    assert it.see(**changed)[0].after is State.HANDED_OVER
    it.see(connected=True, intended_mode=mode(profile, "acro"), custom_mode=mode(profile, "acro"))
    it.see(armed=False)
    for _ in range(100):
        it.see(1.0)
        assert it.state() in (State.HANDED_OVER, State.CONNECTED, State.READY)
    assert it.it.resume(it.now_ns[0]) is not None


def test_a_rovers_pilot_resumes_by_a_switch_and_px4s_hands_over() -> None:
    for profile, after in [(ROVER, State.TRACKING), (PX4, State.HANDED_OVER)]:
        it = held(profile)
        it.see(UNDER_WAY_S)
        it.see(custom_mode=profile.control_mode.custom_mode)
        assert it.state() is after


@BOTH
def test_abort_while_tracking_commands_the_exit_mode_and_auto_stays_out(profile: Profile) -> None:
    it = bench(profile, "auto", arm=True)
    it.reach_auto()
    assert it.it.abort(it.now_ns[0]) is None
    assert ways(it.see()) == [(State.ABORTING, Event.ABORT)]
    assert it.it.abort(it.now_ns[0]) is None
    assert it.command() == profile.mode("hold")
    hold = mode(profile, "hold")
    assert ways(it.see(custom_mode=hold, intended_mode=hold)) == [(State.ABORTED, Event.LEFT)]
    assert it.it.abort(it.now_ns[0]) is None
    it.see(armed=False)
    for _ in range(100):
        it.see(1.0)
        assert it.state() in (State.ABORTED, State.CONNECTED, State.READY)
    assert it.engage() is None
    it.see()
    assert it.state() is State.STREAMING


@BOTH
@pytest.mark.parametrize("state", [State.STREAMING, State.SWITCHING, State.ARMING])
def test_abort_while_engaging_backs_out(profile: Profile, state: State) -> None:
    it = bench(profile)
    it.reach(state)
    assert it.it.abort(it.now_ns[0]) is None
    assert ways(it.see()) == [(State.CANCELLING, Event.ABORT)]
    in_control = state is State.ARMING
    assert it.command() == (profile.mode("hold") if in_control else None)
    assert it.see(LEAVE_S - 0.001) == []
    assert ways(it.see(0.001)) == [(State.ABORTED, Event.LEFT)]
    assert it.reason() == (
        f"{profile.mode_name(mode(profile, 'hold'))} not confirmed within 1 s"
        if in_control
        else f"{profile.control_mode.name} is not on"
    )


@BOTH
def test_abort_before_engaging_takes_the_command_back(profile: Profile) -> None:
    for engage in ("pilot", "auto"):
        it = bench(profile, engage, blocked="too far")
        it.see()
        assert it.engage() is None
        assert it.it.abort(it.now_ns[0]) is None
        it.see(blocked=None)
        it.see(60.0)
        assert it.it.expired(it.now_ns[0]) is None
        assert it.state() is State.READY


@BOTH
def test_abort_while_holding_leaves_the_vehicle_to_its_hold_mode(profile: Profile) -> None:
    it = held(profile)
    assert it.it.abort(it.now_ns[0]) is None
    assert ways(it.see()) == [(State.ABORTED, Event.ABORT)]
    assert it.command() is None


@BOTH
def test_what_cannot_be_obeyed_is_refused_with_the_reason(profile: Profile) -> None:
    it = bench(profile)
    assert it.it.hold(0) == "hold refused: disconnected: no heartbeat of the autopilot yet"
    it.see()
    assert it.it.hold(0) == "hold refused: ready: not tracking"
    assert it.it.resume(0) == "resume refused: ready: nothing is held"
    it = held(profile)
    assert it.engage() == "engage refused: holding: it has not ended: resume, or abort first"
    it.see(custom_mode=mode(profile, "acro"))
    assert it.it.abort(0) == "abort refused: handed-over: the service has no control"
    it.it.shutdown()
    assert it.it.resume(0) == "resume refused: the service is shutting down"


@BOTH
@pytest.mark.parametrize("state", [State.TRACKING, State.PAUSING])
@pytest.mark.parametrize("name", ["acro", None])
def test_a_guard_commands_its_mode_or_falls_silent(profile: Profile, state: State, name: str | None) -> None:
    it = bench(profile, "auto", arm=True)
    it.reach_auto()
    if state is State.PAUSING:
        it.it.hold(it.now_ns[0])
        it.see()
    wanted = None if name is None else profile.mode(name)
    changes = it.see(trip=Trip("speed", "too fast", wanted))
    event, after = (
        (Event.GUARD_SILENCES, State.ABORTED) if name is None else (Event.GUARD_TRIPPED, State.ABORTING)
    )
    assert ways(changes) == [(after, event)]
    assert changes[0].reason == "too fast"
    assert it.streams() is (name is not None)
    assert it.command() == wanted
    acro = mode(profile, "acro")
    it.see(custom_mode=acro, intended_mode=acro)
    assert it.state() is State.ABORTED
    it.see(armed=False, trip=None)
    for _ in range(100):
        it.see(1.0)
        assert it.state() in (State.ABORTED, State.CONNECTED, State.READY)


@BOTH
def test_the_pilots_act_comes_before_a_guard_and_an_order(profile: Profile) -> None:
    it = bench(profile)
    it.reach(State.TRACKING)
    it.it.abort(it.now_ns[0])
    it.see(custom_mode=mode(profile, "acro"), trip=Trip("speed", "too fast", profile.mode("hold")))
    assert it.state() is State.HANDED_OVER
    assert it.command() is None


# Orders against one that waits ------------------------------------------------------------------------


@BOTH
def test_a_hold_takes_back_a_resume_that_waits(profile: Profile) -> None:
    it = held(profile)
    it.see(blocked="no position")
    assert it.it.resume(it.now_ns[0]) is None
    it.see()
    assert it.it.hold(it.now_ns[0]) is None  # held already, and so it stays
    it.see(blocked=None)
    assert it.state() is State.HOLDING


@BOTH
@pytest.mark.parametrize("name", ["hold", "resume"])
def test_nothing_takes_back_an_abort_that_waits(profile: Profile, name: str) -> None:
    """Two orders in one read are both asked before anything follows from either."""
    it = held(profile) if name == "resume" else bench(profile)
    if name == "hold":
        it.reach(State.TRACKING)
    assert it.it.abort(it.now_ns[0]) is None
    refused = getattr(it.it, name)(it.now_ns[0])
    assert refused == f"{name} refused: {it.state()}: an abort was ordered"
    assert it.see()[-1].event is Event.ABORT


@BOTH
@pytest.mark.parametrize("state", [State.WITHHELD, State.HANDED_OVER, State.ABORTED])
def test_an_abort_takes_back_an_engage_that_waits(profile: Profile, state: State) -> None:
    it = bench(profile)
    it.see()
    it.it.state = state
    assert it.engage() is None
    assert it.it.abort(it.now_ns[0]) is None
    for _ in range(400):
        it.see()
        assert it.state() in (state, State.CONNECTED, State.READY)


@BOTH
def test_an_abort_where_engaging_failed_keeps_auto_from_trying_again(profile: Profile) -> None:
    it = bench(profile, "auto")
    it.see()
    it.see(after_s=6.0)
    assert it.state() is State.ABORTED, it.reason()  # no stream came about
    assert it.it.abort(it.now_ns[0]) is None
    for _ in range(400):
        it.see()
        assert it.state() in (State.ABORTED, State.CONNECTED, State.READY)
    assert it.engage() is None
    it.see()
    assert it.state() is State.STREAMING
