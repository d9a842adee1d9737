"""What makes the built-in vehicle and its line worse: actuators, currents, refusals, damage, restarts."""

from __future__ import annotations

import math

import pytest

from guidance.supervisor import State
from sitl.lockstep import Channel
from sitl.plant import PlantParameters
from sitl.vehicle import Effect
from tests.helpers import fly_until, make_flight, state_of
from tests.pilot import AUTO, BOTH, PILOT, PX4, tracking


@BOTH
def test_a_current_carries_the_vehicle_and_shows_in_its_velocity(firmware: tuple[str, ...]) -> None:
    flight = make_flight(*firmware, *PILOT)
    start = flight.truth().position_ned_m
    flight.vehicle.current(flight.now_ns, (0.5, -0.25, 0.0))
    flight.run(4.0)
    moved = [b - a for a, b in zip(start, flight.truth().position_ned_m, strict=True)]
    assert moved == pytest.approx([2.0, -1.0, 0.0])
    estimate = flight.guide._estimator.at(flight.now_ns + 100_000_000)
    assert estimate is not None
    # Ahead of what was told, by the velocity that was told.
    flight.run(0.1)
    assert math.dist(estimate.pose.position, flight.truth().position_ned_m) < 1e-3


def test_an_actuator_does_what_is_left_of_it() -> None:
    flight, _ = tracking(PX4)
    flight.vehicle.refit(flight.now_ns, effect=Effect(yaw=0.0, speed=0.5))
    before = flight.truth()
    flight.run(1.0)
    after = flight.truth()
    assert after.body_rates_frd_rad_s[2] == 0.0
    assert 0.0 < after.speed_m_s <= 2.5
    flight.vehicle.refit(flight.now_ns, effect=Effect(speed=0.0), plant=PlantParameters(0.1, 5.0))
    here = flight.truth().position_ned_m
    flight.run(1.0)
    assert flight.truth().position_ned_m == pytest.approx(here)
    assert max(map(abs, flight.truth().body_rates_frd_rad_s)) <= 0.1
    assert before.speed_m_s > 0.0


@BOTH
def test_a_rover_stays_planar_with_other_actuators(firmware: tuple[str, ...]) -> None:
    flight, _ = tracking(firmware)
    flight.vehicle.refit(flight.now_ns, plant=PlantParameters(5.0, 5.0))
    flight.run(2.0)
    if firmware is not PX4:
        assert flight.truth().position_ned_m[2] == pytest.approx(0.0)


@BOTH
def test_refusals_last_until_they_are_taken_back(firmware: tuple[str, ...]) -> None:
    flight = make_flight(*firmware, *AUTO, refuses_modes=True)
    fly_until(flight, State.SWITCHING)
    flight.run(1.0)
    assert state_of(flight) is State.SWITCHING
    assert "TEMPORARILY_REJECTED" in flight.guide._words.answer
    flight.vehicle.refuse(arming=True)
    fly_until(flight, State.ARMING, 1.5)
    flight.run(1.0)
    assert not flight.vehicle.armed
    flight.vehicle.refuse()
    fly_until(flight, State.TRACKING, 2.5)


@BOTH
def test_the_transmitter_chooses_a_mode_even_where_commands_are_refused(firmware: tuple[str, ...]) -> None:
    flight, _ = tracking(firmware)
    flight.vehicle.refuse(modes=True)
    hold = flight.guide.profile.mode("hold")
    assert hold is not None
    assert flight.vehicle.choose(flight.now_ns, hold.custom_mode)
    fly_until(flight, State.HANDED_OVER, 0.6)
    assert not flight.vehicle.choose(flight.now_ns, 99 << 24 | 4 << 16)


def test_damaged_datagrams_are_counted_and_never_believed() -> None:
    damaged = Channel(corruption=1.0)
    flight = make_flight(*AUTO, to_guide=damaged, to_vehicle=damaged)
    flight.run(3.0)
    assert flight.guide.link.received < 20  # a byte of what its checksum does not cover changes nothing
    assert flight.guide.link.reader.counters["bad_checksum"] > 100
    assert flight.vehicle.bad_packets > 1


def test_a_restarted_guide_knows_nothing() -> None:
    flight, _ = tracking(PX4)
    old = flight.guide
    flight.restart_guide()
    assert flight.guide is not old
    assert state_of(flight) is State.DISCONNECTED
    fly_until(flight, State.WITHHELD, 3.0)


def test_a_stage_decides_what_becomes_of_a_datagram() -> None:
    flight, _ = tracking(PX4)
    flight.on_the_way = lambda data, now_ns: ()
    heard = flight.guide.link.received
    flight.run(0.3)
    assert flight.guide.link.received == heard
    flight.on_the_way = lambda data, now_ns: (data, data)
    flight.run(0.3)
    assert flight.guide.link.counters["duplicate"] > 20
