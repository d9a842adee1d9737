"""An autopilot that moves the origin of its local frame: before a flight it is taken, in one handed over."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import all as dialect

from guidance.estimate import Estimator
from guidance.estimate.origin import LocalOrigin
from guidance.geodesy import azimuthal_equidistant
from guidance.mavlink.messages import GpsGlobalOrigin
from guidance.records import Status
from guidance.supervisor import State
from sitl.lockstep import Lockstep
from sitl.vehicle.options import Origin
from tests.helpers import (
    ROVER,
    events_of,
    fly_until_tracking,
    make_flight,
    records_of,
    setpoints_since,
    state_of,
)
from tests.test_flights import error_m

PLACE = Origin()
HERE = f"flight.origin=[{PLACE.latitude_deg},{PLACE.longitude_deg},{PLACE.altitude_m}]"
ON_GLOBAL = ("ODOMETRY", "LOCAL_POSITION_NED")
SAID = GpsGlobalOrigin(473977420, 85455940, 489000)
#: Steps of latitude a metre.
NORTH = math.degrees(1e7 / 6_371_000.0)


def north(metres: float) -> GpsGlobalOrigin:
    """The origin, so far to the north."""
    return SAID._replace(latitude=SAID.latitude + round(metres * NORTH))


AWAY = north(5.0)


def says(flight: Lockstep, origin: GpsGlobalOrigin) -> None:
    """The autopilot says where its local origin is."""
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    flight.inject(bytes(dialect.MAVLink_gps_global_origin_message(*origin).pack(mav)))


@pytest.mark.parametrize("without", [ON_GLOBAL, ()], ids=["global", "local"])
@pytest.mark.parametrize("firmware", [(HERE,), (*ROVER, "trajectory.name=circle"), ("flight.origin=home",)])
def test_an_origin_that_moves_in_flight_is_told_and_hands_over(
    firmware: tuple[str, ...], without: tuple[str, ...]
) -> None:
    flight = make_flight(*firmware, without_messages=without)
    fly_until_tracking(flight)
    flight.run(3.003)
    before_m, moved_ns = flight.truth().position_ned_m, flight.now_ns
    says(flight, north(100.0))
    flight.run(0.4)
    assert events_of(flight, "estimator_reset") == [], "our own projection does not jump while it flies"
    flight.run(0.6)
    (moved,) = events_of(flight, "origin_moved")
    assert moved.startswith("the autopilot's local origin moved by 100.")
    assert setpoints_since(flight, moved_ns) == []
    assert state_of(flight) is State.HANDED_OVER
    assert records_of(flight, Status)[-1].reason.endswith(f"({moved})")
    assert math.dist(flight.truth().position_ned_m, before_m) < 6.0


def test_what_moves_by_less_than_a_metre_does_not_move_a_flight_on_global_positions() -> None:
    flight = make_flight(HERE, without_messages=ON_GLOBAL)
    fly_until_tracking(flight)
    flight.run(20.0)
    says(flight, north(0.8))
    flight.run(5.0)
    assert state_of(flight) is State.TRACKING
    assert events_of(flight, "origin_moved") == []
    assert error_m(flight) < 0.05


def test_before_a_flight_it_is_the_new_origin_and_the_next_flight_is_from_there() -> None:
    flight = make_flight(
        "supervisor.engage=pilot", HERE, "supervisor.engage_max_error_m=50", without_messages=ON_GLOBAL
    )
    flight.run(3.0)
    assert state_of(flight) is State.READY
    says(flight, north(100.0))
    flight.run(1.0)
    assert state_of(flight) is State.READY
    assert events_of(flight, "origin_moved") == ["the autopilot's local origin moved by 100.0 m"]
    estimate = flight.guide._estimator.at(flight.now_ns)
    assert estimate is not None
    assert estimate.pose.position.x == pytest.approx(flight.truth().position_ned_m[0] - 100.0, abs=0.1)


def test_after_the_flight_the_new_origin_is_the_one_in_use() -> None:
    flight = make_flight(HERE, without_messages=ON_GLOBAL)
    fly_until_tracking(flight)
    says(flight, north(100.0))
    flight.run(3.0)
    assert flight.guide._estimator.origin.moved is None
    assert flight.guide._estimator.origin.held == north(100.0)


def test_small_moves_add_up_and_each_is_told_once() -> None:
    origin = LocalOrigin(azimuthal_equidistant)
    assert origin.look(None, flying=False) is None
    told = [origin.look(north(0.6 * step), flying=False) for step in (0, 1, 2, 2, 3)]
    assert told == [None, None, "the autopilot's local origin moved by 1.2 m", None, None]


def test_it_is_held_in_flight_until_that_ends() -> None:
    origin = LocalOrigin(azimuthal_equidistant)
    seen = []
    # The flight begins before the autopilot knows where it is.
    for said, flying in ((None, True), (SAID, True), (AWAY, True), (SAID, True), (AWAY, True), (AWAY, False)):
        origin.look(said, flying=flying)
        seen.append((origin.held, origin.moved))
    moved = "the autopilot's local origin moved by 5.0 m"
    assert seen == [(None, None), (SAID, None), (SAID, moved), (SAID, None), (SAID, moved), (AWAY, None)]


def test_a_reboot_releases_it() -> None:
    estimator = Estimator(azimuthal_equidistant)
    estimator.origin.look(SAID, flying=True)
    estimator.origin.look(north(5.0), flying=True)
    estimator.reset()
    assert estimator.origin.held is None
    assert estimator.origin.moved is None
    assert estimator.origin.look(north(9.0), flying=True) is None, "it is another origin, it has not moved"
