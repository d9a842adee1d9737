"""Orders in flight: what is set holds, what is loaded is flown, and a log replays."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from guidance.commands import (
    Allocate,
    Engage,
    LoadTrajectory,
    Set,
    Shutdown,
)
from guidance.records import Answer, Link, Setpoint, Status, Timing
from guidance.replay import replay
from guidance.supervisor import State
from guidance.trajectory import Circle, Trajectory
from sitl.logbook import LogBook
from tests.helpers import (
    events_of,
    fly_until,
    fly_until_tracking,
    make_config,
    make_flight,
    records_of,
    state_of,
)

CIRCLE = LoadTrajectory(trajectory={"name": "circle", "radius_m": 4})


def test_what_is_set_holds_from_the_next_setpoint_on_and_is_told() -> None:
    flight = make_flight()
    fly_until_tracking(flight)
    flight.run(20.0)
    flight.guide.command(Set(source="zenoh ada", key="limits.speed_max_m_s", value=0.2), flight.now_ns)
    set_ns = flight.now_ns
    flight.run(1.0)
    after = [s for s in records_of(flight, Setpoint) if s.t_ns > set_ns]
    assert len(after) >= 49
    assert max(s.speed_m_s for s in after) <= 0.2
    assert events_of(flight, "set") == ["limits.speed_max_m_s: 5.0 -> 0.2 (by zenoh ada)"]
    assert flight.guide.config.limits.speed_max_m_s == 0.2
    assert state_of(flight) is State.TRACKING


def test_a_loaded_trajectory_is_flown_and_none_is_loaded_while_tracking() -> None:
    flight = make_flight("supervisor.engage=pilot")
    fly_until(flight, State.READY)
    flight.guide.command(CIRCLE, flight.now_ns)
    flight.guide.command(Engage(), flight.now_ns)
    fly_until_tracking(flight)
    flight.guide.command(LoadTrajectory(trajectory={"name": "line"}), flight.now_ns)
    flight.run(40.0)
    assert [a.accepted for a in records_of(flight, Answer)] == [True, True, False]
    assert flight.guide.config.trajectory == Circle(radius_m=4.0)
    x, y, _ = flight.truth().position_ned_m
    assert (x**2 + y**2) ** 0.5 == pytest.approx(4.0, abs=0.05)


def test_the_status_tells_a_trajectory_that_is_not_the_sessions() -> None:
    flight = make_flight("supervisor.engage=pilot")
    fly_until(flight, State.READY)
    flight.guide.command(CIRCLE, flight.now_ns)
    flight.run(1.0)
    first = LoadTrajectory(trajectory=msgspec.to_builtins(make_config().trajectory))
    flight.guide.command(Set(key="law.rho2_per_s", value=5), flight.now_ns)
    flight.run(1.0)
    told = [status.trajectory_json for status in records_of(flight, Status)]
    assert told[0] == ""
    assert msgspec.json.decode(told[-1], type=Trajectory) == Circle(radius_m=4.0)
    flight.guide.command(first, flight.now_ns)
    flight.run(1.0)
    assert records_of(flight, Status)[-1].trajectory_json == ""


def test_the_link_tells_where_the_local_frame_is() -> None:
    flight = make_flight()
    fly_until_tracking(flight)
    flight.run(2.0)
    at = flight.guide.link.origin
    assert at is not None
    assert records_of(flight, Link)[-1].origin_geodetic == pytest.approx(
        (at.latitude * 1e-7, at.longitude * 1e-7, at.altitude * 1e-3)
    )


def test_a_flight_with_orders_replays_to_the_bit(tmp_path: Path) -> None:
    config = make_config("supervisor.engage=pilot")
    flight = make_flight(config=config)
    with LogBook(config, tmp_path) as book:
        flight.on_record = book.add
        for wait_s, given in (
            (1.0, CIRCLE),
            (0.5, Set(id="1", key="law.rho2_per_s", value=5)),
            (0.1, Engage(id="2", source="SIGUSR1")),
            (0.0, Engage(id="2", source="SIGUSR1")),
            (3.0, Set(key="limits.yaw_rate_max_rad_s", value=1.5)),
            (0.0, Set(key="limits.yaw_rate_max_rad_s", value=1e9)),
            (0.0, Allocate(allocation="roll-yaw")),
            (1.0, LoadTrajectory(trajectory={"name": "line"})),
            (1.0, Shutdown()),
        ):
            flight.run(wait_s)
            flight.guide.command(given, flight.now_ns)
        flight.run(2.0)
    found = replay(book.path)
    assert found.identical, found
    assert found.tracked > 100


@pytest.mark.parametrize("profile", ["px4-uuv", "ardupilot-rover"])
def test_the_wait_for_an_order_is_no_lateness_of_the_loop(profile: str) -> None:
    flight = make_flight("supervisor.engage=pilot", f"vehicle.profile={profile}", "flight.origin=engage")
    fly_until(flight, State.READY)
    flight.run(6.0)
    flight.guide.command(Engage(), flight.now_ns)
    fly_until_tracking(flight)
    flight.run(2.0)
    assert records_of(flight, Timing)[-1].lateness_max_s < 0.02
