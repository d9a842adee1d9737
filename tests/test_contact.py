"""After a silence nothing that was known before counts: the contact itself, and what follows from it."""

from __future__ import annotations

from typing import Final

import pytest

from guidance.mavlink.profiles import Profile
from guidance.supervisor import Event, State
from guidance.view import STOOD_S, Contact, silence_limit_s
from tests.engagement_bench import BOTH, PX4, Bench, S, bench, mode, ways

START_NS: Final = 100 * S
LOOK_NS: Final = S // 20


class Listener:
    """A contact, looked at every 0.05 s while a message a look comes, but for silences."""

    def __init__(self, profile: Profile) -> None:
        self.it = Contact(profile)
        self.now_ns = START_NS
        self.heard = 0
        self.heartbeat_ns = 0
        self.mode_ns: int | None = None

    def certain(self) -> bool:
        """A call, so that a type checker does not take it for constant."""
        return self.it.certain

    def listen(self, seconds: float, *, silent: bool = False, names: str = "") -> None:
        """Time passes; at its end the named messages come: h is HEARTBEAT, m is CURRENT_MODE."""
        for _ in range(round(seconds * S / LOOK_NS)):
            self.now_ns += LOOK_NS
            self.heard += not silent
            self.it.look(self.heard, self.heartbeat_ns, self.mode_ns, self.now_ns)
        if "h" in names:
            self.heartbeat_ns = self.now_ns
        if "m" in names:
            self.mode_ns = self.now_ns
        self.heard += len(names)
        self.it.look(self.heard, self.heartbeat_ns, self.mode_ns, self.now_ns)


@BOTH
def test_a_contact_is_certain_from_the_first_heartbeat_on_and_stays_so_while_it_is_heard(
    profile: Profile,
) -> None:
    it = Listener(profile)
    it.listen(10.0, silent=True)
    it.listen(0.05, silent=True, names="h")
    assert it.certain()
    it.listen(60.0)
    assert it.certain()
    assert it.it.unheard_s == 0.0


@BOTH
def test_after_a_silence_both_must_come_once_more_and_later_than_its_end(profile: Profile) -> None:
    limit_s = silence_limit_s(profile)
    it = Listener(profile)
    it.listen(1.0, names="hm")
    it.listen(limit_s, silent=True, names="hm")
    assert it.certain()  # short enough
    it.listen(limit_s + 0.05, silent=True, names="hm")  # what waited in a queue says nothing
    assert it.it.unheard_s > limit_s
    assert not it.certain()
    it.listen(1.0, names="m")
    assert not it.certain()
    it.listen(0.1, names="h")
    assert it.certain()


@BOTH
def test_where_no_current_mode_ever_came_the_heartbeat_is_enough(profile: Profile) -> None:
    it = Listener(profile)
    it.listen(1.0, names="h")
    it.listen(3.0, silent=True)
    assert not it.certain()
    it.listen(0.5, names="h")
    assert it.certain()


@BOTH
def test_a_process_that_was_stopped_heard_nothing_whatever_its_queue_holds(profile: Profile) -> None:
    it = Listener(profile)
    it.listen(1.0, names="hm")
    it.now_ns += 2 * S
    it.listen(0.0, names="hm")
    assert it.it.unheard_s == 2.0
    assert not it.certain()
    it.listen(0.05)
    assert it.it.unheard_s < 0.1
    assert not it.certain()


def streaming(it: Bench) -> bool:
    """Whether setpoints may flow; a call, so that a type checker does not take it for constant."""
    return it.it.streaming


ENGAGED: Final = [State.STREAMING, State.SWITCHING, State.ARMING, State.TRACKING]


@BOTH
@pytest.mark.parametrize("state", ENGAGED)
@pytest.mark.parametrize("what", ["silent_s", "unheard_s"])
def test_a_silence_in_any_step_hands_over(profile: Profile, state: State, what: str) -> None:
    limit_s = silence_limit_s(profile)
    it = bench(profile, armed=True)
    if state in (State.ARMING, State.TRACKING):
        it = bench(profile)
    it.reach(state)
    assert it.see(limit_s + 0.1, setpoints_sent=it.views[0].setpoints_sent + 1) == []
    assert it.see(**{what: limit_s - 0.01}) == []
    assert ways(it.see(**{what: limit_s + 0.01})) == [(State.HANDED_OVER, Event.INTERRUPTED)]
    assert not streaming(it)


@BOTH
def test_disarmed_while_streaming_a_silence_ends_nothing_until_somebody_has_armed(profile: Profile) -> None:
    it = bench(profile)
    it.reach(State.STREAMING)
    assert it.see(1.0, setpoints_sent=1) == []
    assert it.see(unheard_s=0.9, certain=False) == []
    assert not streaming(it)
    assert it.see(unheard_s=0.0) == []
    assert not streaming(it)
    assert it.see(certain=True) == []
    assert streaming(it)
    assert ways(it.see(armed=True)) == [(State.HANDED_OVER, Event.INTERRUPTED)]


@BOTH
@pytest.mark.parametrize("state", [State.SWITCHING, State.ARMING, State.TRACKING])
def test_a_silence_while_leaving_ends_the_stream_and_not_the_commands(profile: Profile, state: State) -> None:
    it = bench(profile)
    it.reach(state)
    it.see(custom_mode=profile.control_mode.custom_mode) if state is not State.SWITCHING else None
    it.it.shutdown()
    it.see()
    assert streaming(it)
    it.see(0.05, silent_s=100.0) if state is State.TRACKING else it.see(0.8, silent_s=0.8)
    it.see(0.8 if state is State.TRACKING else 0.05)
    assert not streaming(it)
    it.see(silent_s=0.0)
    assert not streaming(it)
    assert (it.command() is not None) is (state is not State.SWITCHING)


def test_ready_offers_no_stream_until_it_is_certain_again() -> None:
    it = bench(PX4)
    it.reach(State.READY)
    assert streaming(it)
    it.see(certain=False)
    assert not streaming(it)
    assert it.reason() == (
        "the autopilot was silent: waiting for HEARTBEAT and CURRENT_MODE, "
        "then switch to offboard or command engage"
    )
    it.see(certain=True)
    assert streaming(it)


@BOTH
def test_a_switch_across_a_silence_is_not_fresh(profile: Profile) -> None:
    control, hold = profile.control_mode.custom_mode, mode(profile, "hold")
    it = bench(profile)
    it.reach(State.READY)
    it.see(certain=False)
    it.see(custom_mode=control, intended_mode=control)
    it.see(certain=True)
    assert it.see(10.0) == []
    it.see(custom_mode=hold, intended_mode=hold)
    assert ways(it.see(custom_mode=control)) == [(State.ARMING, Event.PILOT_SWITCHED)]


@BOTH
def test_auto_does_not_take_what_somebody_may_have_control_of(profile: Profile) -> None:
    control, hold = profile.control_mode.custom_mode, mode(profile, "hold")
    it = bench(profile, "auto", blocked="too far")
    it.see()
    it.see(armed=True, custom_mode=control, intended_mode=control)
    it.see(blocked=None)
    assert it.see(60.0) == []
    it.see(custom_mode=hold, certain=False)
    assert it.see(60.0) == []
    if profile.needs_stream:
        it.see(intended_mode=None, certain=True)
        assert it.see(60.0) == []
    assert it.state() is State.READY
    it.see(intended_mode=hold, certain=True)
    assert it.state() is State.STREAMING


def settled(it: Contact, seconds: float, mode: int, start_ns: int) -> tuple[bool, int]:
    """Show this mode for so long, ten looks a second; whether it is settled with the first of them."""
    it.look(1, start_ns, None, start_ns, mode)
    first = it.settled
    for i in range(1, round(10 * seconds)):
        it.look(1, start_ns, None, start_ns + i * S // 10, mode)
    return first, start_ns + round(seconds * S)


def test_a_switch_from_a_mode_that_stood_is_settled_and_modes_in_turn_are_not() -> None:
    it, now_ns = Contact(PX4), START_NS
    for seconds, mode_shown, expected in (
        (0.3, 1, True),  # the first that is heard: it may have stood for long
        (0.5, 2, True),
        (0.5, 1, False),
        (0.5, 2, False),
        (STOOD_S + 0.2, 1, False),
        (0.5, 2, True),
    ):
        first, now_ns = settled(it, seconds, mode_shown, now_ns)
        assert first is expected, (seconds, mode_shown)
