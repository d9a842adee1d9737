"""Holding, resuming and aborting in flight, with both firmwares."""

from __future__ import annotations

import pytest

from guidance.records import Reference, TrackingError
from guidance.supervisor import State
from sitl.lockstep import Lockstep
from tests.helpers import (
    PERFECT,
    ROVER,
    events_of,
    fly_until,
    fly_until_tracking,
    records_of,
    setpoints_since,
    state_of,
)
from tests.pilot import BOTH, DEAD, NAMES, Pilot, tracking


def order(flight: Lockstep, name: str) -> None:
    """An operator's order, which must be accepted."""
    assert getattr(flight.guide.engagement, name)(flight.now_ns) is None


@BOTH
def test_a_held_flight_stands_still_and_goes_on_where_it_was(firmware: tuple[str, ...]) -> None:
    flight, _ = tracking(firmware)
    flight.run(10.0)
    order(flight, "hold")
    fly_until(flight, State.HOLDING)
    held_ns, paused_s = flight.now_ns, flight.guide.tracker.paused_s
    last = records_of(flight, Reference)[-1]
    assert paused_s == pytest.approx(last.trajectory_s, abs=0.05)
    assert flight.vehicle.mode in NAMES["hold"]
    flight.run(20.0)
    assert state_of(flight) is State.HOLDING
    assert setpoints_since(flight, held_ns) == []
    order(flight, "resume")
    fly_until_tracking(flight)
    flight.run(0.1)
    first = records_of(flight, Reference, since_ns=held_ns + 1_000_000_000)[0]
    assert first.trajectory_s == pytest.approx(paused_s, abs=0.03)
    assert first.position_ned_m == pytest.approx(last.position_ned_m, abs=0.1)
    flight.run(10.0)
    errors = [error.norm_m for error in records_of(flight, TrackingError, since_ns=flight.now_ns - 10**9)]
    assert max(errors) < 0.1
    assert flight.guide.tracker.start_ns is not None


@BOTH
def test_abort_in_flight_ends_in_the_exit_mode_and_a_new_flight_begins_anew(
    firmware: tuple[str, ...],
) -> None:
    flight, _ = tracking(firmware, "supervisor.engage_max_error_m=100")
    order(flight, "abort")
    fly_until(flight, State.ABORTED)
    aborted_ns = flight.now_ns
    assert flight.vehicle.mode in NAMES["hold"]
    flight.run(20.0)
    assert setpoints_since(flight, aborted_ns) == []
    assert state_of(flight) is State.ABORTED
    assert "aborting: the operator aborts" in events_of(flight)
    order(flight, "engage")
    fly_until_tracking(flight)
    flight.run(0.1)
    assert records_of(flight, Reference, since_ns=aborted_ns + 10**9)[0].trajectory_s == pytest.approx(0.0)


@BOTH
def test_a_hold_over_a_dead_link_falls_silent_and_takes_nothing_back(firmware: tuple[str, ...]) -> None:
    flight, _ = tracking(firmware)
    order(flight, "hold")
    flight.to_guide = flight.to_vehicle = DEAD
    flight.run(5.0)
    assert state_of(flight) is not State.TRACKING
    resumed_ns = flight.now_ns
    flight.to_guide = flight.to_vehicle = flight.to_guide._replace(loss=0.0)
    flight.run(20.0)
    assert setpoints_since(flight, resumed_ns) == []
    assert state_of(flight) is not State.TRACKING


@BOTH
@pytest.mark.parametrize("name", ["hold", "abort"])
def test_a_pilot_who_takes_over_on_the_way_to_hold_is_obeyed_with_the_message(
    firmware: tuple[str, ...], name: str
) -> None:
    flight, pilot = tracking(firmware)
    flight.to_vehicle = DEAD  # the command never arrives
    order(flight, name)
    fly_until(flight, State.PAUSING if name == "hold" else State.ABORTING, 0.06)
    pilot.switch("acro")
    link = flight.guide.link
    before = link.custom_mode
    assert flight.run(0.9, until=lambda: link.custom_mode != before)
    shown_ns = flight.now_ns
    assert state_of(flight) is State.HANDED_OVER
    flight.to_vehicle = flight.to_vehicle._replace(loss=0.0)
    flight.run(20.0)
    assert setpoints_since(flight, shown_ns - 1) == []
    assert flight.vehicle.mode in NAMES["acro"]


@BOTH
def test_a_flight_that_is_aborted_while_held_is_not_continued(firmware: tuple[str, ...]) -> None:
    flight, _ = tracking(firmware, "supervisor.engage_max_error_m=100")
    order(flight, "hold")
    fly_until(flight, State.HOLDING)
    order(flight, "abort")
    fly_until(flight, State.ABORTED, 0.1)
    order(flight, "engage")
    engaged_ns = flight.now_ns
    fly_until_tracking(flight)
    flight.run(0.1)
    assert records_of(flight, Reference, since_ns=engaged_ns)[0].trajectory_s == pytest.approx(0.0)


def held_through(firmware: tuple[str, ...], *jumps_to_m: float) -> tuple[Lockstep, Pilot]:
    """A held flight whose estimator jumped meanwhile, to so far north of the truth each time."""
    flight, pilot = tracking(firmware, "supervisor.engage_max_error_m=1000")
    order(flight, "hold")
    fly_until(flight, State.HOLDING)
    for north_m in jumps_to_m:
        flight.vehicle.reset_estimator(flight.now_ns, (north_m, 0.0, 0.0), 0.0)
        flight.run(3.0)
    return flight, pilot


@BOTH
def test_a_flight_held_through_jumps_past_the_limit_does_not_go_on(firmware: tuple[str, ...]) -> None:
    flight, _ = held_through(firmware, 8.0, 16.0)  # each is within the limit, both are not
    order(flight, "resume")
    held_ns = flight.now_ns
    flight.run(10.0)
    assert state_of(flight) is State.HOLDING
    assert setpoints_since(flight, held_ns) == []
    assert "jump: estimator jumped by 16." in events_of(flight, "order_expired")[-1]
    order(flight, "abort")
    flight.run(1.0)
    order(flight, "engage")
    fly_until_tracking(flight)


def test_nor_by_the_pilots_switch() -> None:
    flight, pilot = held_through(ROVER, 50.0)
    pilot.switch("control")
    fly_until(flight, State.ARMING)
    fly_until(flight, State.ABORTED, 6.0)
    assert "jump: estimator jumped by 50.0 m" in flight.guide.engagement.reason


@BOTH
def test_a_flight_held_through_a_glitch_that_passed_goes_on(firmware: tuple[str, ...]) -> None:
    flight, _ = held_through(firmware, 50.0, 0.0)
    order(flight, "resume")
    fly_until_tracking(flight)


@BOTH
@pytest.mark.parametrize("name", ["hold", "abort"])
def test_a_mode_that_the_pilot_chose_while_the_link_was_silent_is_not_overruled(
    firmware: tuple[str, ...], name: str
) -> None:
    flight, pilot = tracking(firmware)
    flight.to_guide = flight.to_vehicle = DEAD
    flight.run(0.4)
    order(flight, name)
    flight.run(0.4)
    pilot.switch("acro")
    flight.run(0.2)
    flight.to_guide = flight.to_vehicle = PERFECT
    flight.run(20.0)
    assert flight.vehicle.mode in NAMES["acro"]
    assert state_of(flight) in (State.HANDED_OVER, State.ABORTED)
