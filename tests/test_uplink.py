"""Setpoints that do not arrive are no control: a dead uplink hands over, a bad one does not."""

from __future__ import annotations

import pytest

from guidance.supervisor import State
from sitl.lockstep import Channel
from tests.helpers import ROVER, fly_until_tracking, make_flight, setpoints_since, state_of
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
