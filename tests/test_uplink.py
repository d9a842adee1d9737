"""Setpoints that do not arrive are no control: a dead uplink hands over, a bad one does not."""

from __future__ import annotations

import pytest

from guidance.supervisor import State
from sitl.lockstep import Channel
from tests.helpers import ROVER, events_of, fly_until_tracking, make_flight, setpoints_since, state_of
from tests.pilot import AUTO, reason, tracking


@pytest.mark.parametrize("firmware", [(), ROVER])
def test_a_dead_uplink_hands_over_before_the_stream_could_resume(firmware: tuple[str, ...]) -> None:
    flight, _ = tracking(firmware)
    flight.to_vehicle = Channel(loss=1.0)
    flight.run(1.3)
    assert state_of(flight) is State.HANDED_OVER
    flight.run(2.2)
    flight.to_vehicle = Channel()
    back_ns = flight.now_ns
    flight.run(5.0)
    assert setpoints_since(flight, back_ns) == []


def test_the_reason_says_that_nothing_is_answered() -> None:
    flight, _ = tracking(ROVER)
    flight.to_vehicle = Channel(loss=1.0)
    flight.run(1.2)
    assert "answered nothing for 1.0" in reason(flight)


@pytest.mark.parametrize("firmware", [(), ROVER])
@pytest.mark.parametrize("seed", [1, 2])
def test_thirty_per_cent_of_loss_each_way_is_flown_through(firmware: tuple[str, ...], seed: int) -> None:
    lossy = Channel(loss=0.3)
    flight = make_flight(*firmware, *AUTO, to_guide=lossy, to_vehicle=lossy, seed=seed)
    fly_until_tracking(flight, 20.0)  # requests and answers are lost as well
    flight.run(42.0)
    assert state_of(flight) is State.TRACKING


#: All that a TCP connection's other end can still get after it stopped reading: 0.25 s at 50 Hz.
IN_FLIGHT = 13
TCP = 'link.connection="tcp://127.0.0.1:5760"'


@pytest.mark.parametrize("firmware", [(), ROVER])
def test_over_tcp_a_stall_is_silence_after_a_quarter_of_a_second_and_then_a_hand_over(
    firmware: tuple[str, ...],
) -> None:
    flight, _ = tracking(firmware, TCP)
    stalled_ns = flight.now_ns
    flight.to_vehicle = Channel(delay_s=4.0)  # nothing is lost: all of it is read, later
    flight.run(0.9)
    assert 10 <= len(setpoints_since(flight, stalled_ns)) <= IN_FLIGHT
    (said,) = events_of(flight, "silent", stalled_ns)
    assert "the other end has not answered for 0.2" in said
    assert said.endswith("not reading?")
    flight.run(0.2)
    assert state_of(flight) is State.HANDED_OVER
    flight.run(4.0)
    assert len(setpoints_since(flight, stalled_ns)) <= IN_FLIGHT


def test_over_tcp_a_short_stall_is_flown_through_with_what_is_fresh() -> None:
    flight, _ = tracking((), TCP)
    stalled_ns = flight.now_ns
    flight.to_vehicle = Channel(delay_s=0.5)
    flight.run(0.5)
    assert len(setpoints_since(flight, stalled_ns)) <= IN_FLIGHT
    flight.to_vehicle = Channel()
    read_ns = flight.now_ns
    flight.run(0.5)
    assert len(setpoints_since(flight, read_ns)) >= 20
    assert state_of(flight) is State.TRACKING


def test_over_udp_what_is_not_answered_may_be_lost_and_the_stream_goes_on() -> None:
    flight, _ = tracking(())
    lost_ns = flight.now_ns
    flight.to_vehicle = Channel(loss=1.0)
    flight.run(0.9)
    assert len(setpoints_since(flight, lost_ns)) >= 44
    flight.to_vehicle = Channel()
    flight.run(1.0)
    assert state_of(flight) is State.TRACKING
