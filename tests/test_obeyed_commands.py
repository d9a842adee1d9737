"""A command that the autopilot accepted is not sent again: what undid it since was the pilot."""

from __future__ import annotations

from typing import Any, Final

import pytest
from pymavlink.dialects.v20 import all as dialect

from guidance.commands import Engage
from guidance.engagement import ARMING_SHOWN_S
from guidance.mavlink.messages import CommandAck
from guidance.mavlink.profiles import Profile
from guidance.supervisor import Event, State
from tests.engagement_bench import BOTH, PX4, Bench, S, bench, mode, ways
from tests.helpers import ROVER, fly_until, make_flight, state_of
from tests.pilot import AUTO, PILOT, Pilot

SET_MODE: Final = dialect.MAV_CMD_DO_SET_MODE
ARM: Final = dialect.MAV_CMD_COMPONENT_ARM_DISARM
ACCEPTED: Final = dialect.MAV_RESULT_ACCEPTED
REFUSED: Final = dialect.MAV_RESULT_TEMPORARILY_REJECTED
FIRMWARE: Final = pytest.mark.parametrize("firmware", [(), ROVER], ids=["px4", "rover"])


def answer(it: Bench, command: int, result: int, target: tuple[int, int] = (1, 191)) -> None:
    """A COMMAND_ACK comes."""
    it.it.answered(CommandAck(command, result, *target), it.now_ns[0])


def commanded(it: Bench, seconds: float, **seen: Any) -> int:
    """How often something is commanded while time passes."""
    count = 0
    for _ in range(round(seconds / 0.05)):
        it.see(**seen)
        count += it.command() is not None
    return count


def begun(profile: Profile, state: State) -> Bench:
    """In a state whose command has just been sent."""
    it = bench(profile, arm=True)
    it.reach(state)
    assert it.command() is not None
    return it


STEPS: Final = pytest.mark.parametrize(
    ("state", "command"), [(State.SWITCHING, SET_MODE), (State.ARMING, ARM)], ids=["mode", "arm"]
)


@BOTH
@STEPS
@pytest.mark.parametrize("target", [(1, 191), (0, 0)], ids=["to us", "to all"])
def test_after_an_acceptance_it_is_not_repeated(
    profile: Profile, state: State, command: int, target: tuple[int, int]
) -> None:
    it = begun(profile, state)
    answer(it, command, ACCEPTED, target)
    assert commanded(it, 4.9) == 0
    assert it.state() is state


@BOTH
@STEPS
def test_without_an_acceptance_it_is_repeated(profile: Profile, state: State, command: int) -> None:
    it = begun(profile, state)
    answer(it, command, REFUSED)
    answer(it, SET_MODE if command == ARM else ARM, ACCEPTED)  # an answer to something else
    assert commanded(it, 4.9) == 4


def test_a_mode_that_is_refused_after_the_first_yes_is_asked_for_again_but_never_arming() -> None:
    it = begun(PX4, State.SWITCHING)
    answer(it, SET_MODE, ACCEPTED)
    answer(it, SET_MODE, REFUSED)
    assert commanded(it, 1.0) == 1
    answer(it, SET_MODE, ACCEPTED)
    answer(it, SET_MODE, REFUSED, (0, 0))  # perhaps somebody else's
    answer(it, SET_MODE, dialect.MAV_RESULT_IN_PROGRESS)
    assert commanded(it, 3.0) == 0
    it = begun(PX4, State.ARMING)
    answer(it, ARM, ACCEPTED)
    answer(it, ARM, REFUSED)
    assert commanded(it, 3.0) == 0


@BOTH
def test_an_accepted_mode_that_is_not_entered_aborts_and_says_so(profile: Profile) -> None:
    it = begun(profile, State.SWITCHING)
    answer(it, SET_MODE, ACCEPTED)
    changes = it.see(5.1)
    assert ways(changes) == [(State.ABORTED, Event.STEP_TIMEOUT)]
    name = profile.control_mode.name
    assert changes[0].reason == f"{name} was accepted but is not on: left again, or refused after all"


@BOTH
def test_an_answer_that_came_before_the_command_forbids_nothing(profile: Profile) -> None:
    it = bench(profile, arm=True)
    it.reach(State.SWITCHING)
    answer(it, SET_MODE, ACCEPTED)
    assert it.command() == profile.control_mode


@BOTH
def test_disarmed_in_a_heartbeat_sent_after_the_acceptance_hands_over(profile: Profile) -> None:
    it = begun(profile, State.ARMING)
    accepted_ns = it.now_ns[0]
    answer(it, ARM, ACCEPTED)
    shown_ns = accepted_ns + round(ARMING_SHOWN_S * S)
    assert it.see(1.0, heartbeat_ns=shown_ns - 1) == []  # may have been sent before
    changes = it.see(heartbeat_ns=shown_ns)
    assert ways(changes) == [(State.HANDED_OVER, Event.DISARMED)]
    assert commanded(it, 60.0) == 0
    assert it.state() is State.HANDED_OVER


def test_a_mode_that_was_intended_and_is_not_any_more_was_left() -> None:
    hold, offboard = mode(PX4, "hold"), PX4.control_mode.custom_mode
    it = begun(PX4, State.SWITCHING)
    assert it.see(intended_mode=offboard) == []
    assert it.see(intended_mode=None) == []  # nobody says
    assert ways(it.see(intended_mode=hold)) == [(State.HANDED_OVER, Event.MODE_LEFT)]
    assert it.reason() == "the mode was changed to manual"


@FIRMWARE
@pytest.mark.parametrize("after_s", [0.0, 0.02, 0.2, 0.5])
def test_a_pilot_who_disarms_at_once_is_not_overridden(firmware: tuple[str, ...], after_s: float) -> None:
    flight = make_flight(*firmware, *AUTO)
    fly_until(flight, State.ARMING)
    assert flight.run(5.0, until=lambda: flight.vehicle.armed)
    flight.run(after_s)
    Pilot(flight).arm(False)
    flight.run(20.0, until=lambda: flight.vehicle.armed)
    assert not flight.vehicle.armed
    assert state_of(flight) is State.HANDED_OVER


@pytest.mark.parametrize("after_s", [0.0, 0.02, 0.05])
@pytest.mark.parametrize("name", ["hold", "manual"])
def test_a_pilot_who_switches_back_at_once_is_not_overridden(after_s: float, name: str) -> None:
    flight = make_flight(*PILOT, initially_armed=True)
    fly_until(flight, State.READY)
    flight.guide.command(Engage(), flight.now_ns)
    fly_until(flight, State.SWITCHING)
    assert flight.run(5.0, until=lambda: flight.vehicle.mode == "OFFBOARD")
    flight.run(after_s)
    Pilot(flight).switch(name)
    assert not flight.run(20.0, until=lambda: flight.vehicle.mode == "OFFBOARD")
    assert state_of(flight) in (State.HANDED_OVER, State.ABORTED)
