"""What a handler of ground vehicles keeps between its steps, says of them, and lets nobody send."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

from msgspec.structs import replace as changed

from guidance.commands import Engage, Hold, Resume, Set
from guidance.config import Config
from guidance.flying import Flown
from guidance.records import Event, GroundHandling, Record, Reference, Setpoint
from guidance.replay import replay
from guidance.supervisor import State
from sitl.lockstep import SECOND, Lockstep
from sitl.logbook import LogBook
from sitl.scenarios.flight import configuration
from sitl.scenarios.rover import ON_A_CIRCLE, WAITS, vehicle
from sitl.scenarios.rover import task as task_of
from sitl.vehicle import Effect, Vehicle, VehicleOptions
from sitl.vehicle.estimator import USUAL
from tests.test_fitting import set_parameter

#: It starts 6 m outside, so that the reference has to wait.
TASK = task_of((*ON_A_CIRCLE, *WAITS), (16.0, 0.0, 0.5 * math.pi), 10.0)


def flight_of(config: Config) -> Lockstep:
    """Ready to engage."""
    options = VehicleOptions(**vehicle(16.0, 0.0, 0.5 * math.pi), noise=USUAL)
    flight = Lockstep(config, Vehicle(options, boot_ns=SECOND))
    assert flight.run(20.0, until=lambda: flight.guide.engagement.state is State.READY)
    return flight


def tracking() -> Lockstep:
    flight = flight_of(configuration(TASK))
    flight.guide.command(Engage(), flight.now_ns)
    assert flight.run(20.0, until=lambda: flight.guide.engagement.state is State.TRACKING)
    flight.run(3.0)
    return flight


T = TypeVar("T", bound=Record)


def of(flight: Lockstep, kind: type[T]) -> list[T]:
    return [record for record in flight.records if isinstance(record, kind)]


def flown(flight: Lockstep) -> Flown:
    estimate = flight.guide.steering.estimate(flight.now_ns)
    assert not isinstance(estimate, str)
    return flight.guide.tracker.solve(estimate).flown


def test_no_number_of_the_record_around_the_law_may_be_lost() -> None:
    found = flown(tracking())
    assert found.is_finite()
    assert isinstance(found.around, GroundHandling)
    for name in ("slip_rad", "clock_rate", "waited_s", "speed_correction_m_s"):
        assert not found._replace(around=changed(found.around, **{name: math.nan})).is_finite(), name


def test_the_records_of_one_setpoint_are_of_one_instant_and_one_clock() -> None:
    flight = tracking()
    start_ns = flight.guide.tracker.start_ns
    assert start_ns is not None
    references, arounds = of(flight, Reference), of(flight, GroundHandling)
    assert len(references) == len(arounds) > 100
    for reference, around in zip(references, arounds, strict=True):
        assert around.t_ns == reference.t_ns
        flight_s = (reference.t_ns - start_ns) * 1e-9
        assert math.isclose(flight_s - around.waited_s, reference.trajectory_s, abs_tol=1e-9)
    assert arounds[-1].waited_s > 0.5


def test_a_flight_that_is_held_goes_on_at_the_time_of_its_own_clock() -> None:
    flight = tracking()
    flight.guide.command(Hold(), flight.now_ns)
    assert flight.run(5.0, until=lambda: flight.guide.engagement.state is State.HOLDING)
    before = of(flight, Reference)[-1].trajectory_s
    flight.run(4.0)
    count = len(of(flight, Reference))
    flight.guide.command(Resume(), flight.now_ns)
    assert flight.run(5.0, until=lambda: flight.guide.engagement.state is State.TRACKING)
    flight.run(0.5)
    after = of(flight, Reference)[count].trajectory_s
    assert abs(after - before) < 0.2
    assert of(flight, GroundHandling)[count].waited_s == 0.0


def test_a_gain_that_is_set_in_flight_makes_no_jump() -> None:
    flight = tracking()
    before = of(flight, Setpoint)[-1]
    waited_s = flight.guide.tracker.handler.waited_s
    flight.guide.command(Set(key="law.rho3_per_s", value=2.5), flight.now_ns)
    flight.run(0.1)
    after = of(flight, Setpoint)[-1]
    assert flight.guide.tracker.handler.waited_s >= waited_s > 0.5
    assert abs(after.speed_m_s - before.speed_m_s) < 0.3
    assert abs(after.body_rates_frd_rad_s[2] - before.body_rates_frd_rad_s[2]) < 0.3


def test_an_estimator_that_jumps_moves_what_is_remembered_of_places() -> None:
    flight = tracking()
    flight.run(8.0)
    flight.vehicle.reset_estimator(flight.now_ns, (4.0, -3.0, 0.0))
    begun = len(of(flight, Setpoint)) - 1
    flight.run(1.0)
    assert [event for event in of(flight, Event) if event.code == "estimator_reset"]
    rates = [setpoint.body_rates_frd_rad_s[2] for setpoint in of(flight, Setpoint)[begun:]]
    assert max(abs(b - a) for a, b in pairwise(rates)) < 0.15


def test_a_flight_with_all_of_it_replays_to_the_bit(tmp_path: Path) -> None:
    flight = tracking()
    flight.guide.command(Set(key="law.k", value=0.9), flight.now_ns)
    set_parameter(flight, "WP_SPEED", 4.0)
    flight.run(2.0)
    flight.guide.command(Hold(), flight.now_ns)
    flight.run(2.0)
    flight.guide.command(Resume(), flight.now_ns)
    flight.run(3.0)
    with LogBook(configuration(TASK), tmp_path) as book:
        for record in flight.records:
            book.add(record)
    found = replay(book.path)
    assert found.difference is None
    assert found.identical
    assert found.tracked > 200


def test_a_vehicle_that_is_stuck_is_said_once() -> None:
    flight = tracking()
    flight.run(2.0)
    assert not [r for r in flight.records if isinstance(r, Event) and r.code == "stuck"]
    flight.vehicle.refit(flight.now_ns, effect=Effect(yaw=0.0, speed=0.0))
    flight.run(6.0)
    (event,) = [r for r in flight.records if isinstance(r, Event) and r.code == "stuck"]
    first = next(r for r in flight.records if isinstance(r, GroundHandling) and r.stuck)
    assert abs(event.t_ns - first.t_ns) < SECOND
