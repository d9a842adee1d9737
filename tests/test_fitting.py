"""The service reads the autopilot's parameters at the start, uses them, and refuses what does not fit."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Final

import pytest
from pymavlink.dialects.v20 import all as mavlink

from guidance.commands import LoadTrajectory
from guidance.fitting import PATIENCE_NS, ROUND_NS
from guidance.mavlink.profiles import PROFILES
from guidance.records import Packet, Parameters, Setpoint
from guidance.replay import replay
from guidance.supervisor import State
from sitl.lockstep import Channel, Lockstep
from sitl.logbook import LogBook
from tests.helpers import (
    PERFECT,
    ROVER,
    events_of,
    fly_until,
    fly_until_tracking,
    make_config,
    make_flight,
    records_of,
    setpoints_since,
    state_of,
)
from tests.mavlink_peer import MS, SECOND, Sender

#: A rover that drives slowly enough for what its autopilot may say.
SLOW: Final = (
    *ROVER,
    "ground.enabled=true",
    "link.rate_hz=40",
    "law.rho2_per_s=3",
    "law.rho3_per_s=3",
    "limits.speed_min_m_s=0",
    'law.name="global"',
    'trajectory={name="circle", radius_m=10, speed_m_s=1}',
)
ASKED: Final = (20).to_bytes(3, "little")


def rover(*overrides: str, channel: Channel = PERFECT, **parameters: float) -> Lockstep:
    return make_flight(*SLOW, *overrides, parameters=parameters, to_guide=channel, to_vehicle=channel)


def refused(flight: Lockstep, seconds: float = 6.0) -> str:
    """Why it never gets ready."""
    flight.run(seconds)
    assert state_of(flight) is State.CONNECTED
    assert not flight.setpoint_times_ns
    return flight.guide.engagement.reason


def set_parameter(flight: Lockstep, name: str, value: float) -> None:
    """A ground station on another link sets it, and the autopilot tells all."""
    kind = mavlink.MAV_PARAM_TYPE_REAL32
    message = mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind)
    flight.vehicle.receive(Sender(255, 190).pack(message), flight.now_ns)


def questions(flight: Lockstep, since_ns: int = 0) -> list[tuple[int, str]]:
    parser = mavlink.MAVLink(None)
    found = []
    for record in records_of(flight, Packet, since_ns):
        if record.data[7:10] == ASKED:
            (message,) = parser.parse_buffer(record.data) or []
            found.append((record.t_ns, message.param_id))
    return found


def test_what_is_used_and_what_is_only_looked_at_is_told_once() -> None:
    flight = rover()
    fly_until_tracking(flight)
    flight.run(5.0)
    (record,) = records_of(flight, Parameters)
    assert record.values["WP_SPEED"] == 5.0
    assert record.values["ATC_ACCEL_MAX"] == 1.0
    assert "WP_SPEED" in record.used
    assert "FS_ACTION" in record.values.keys() - set(record.used)
    assert (record.absent, record.unmet) == ((), "")


def test_each_is_asked_for_once_spaced_the_needed_first_and_nothing_in_flight() -> None:
    flight = rover()
    fly_until_tracking(flight, 3.0)
    tracking_ns = flight.now_ns
    flight.run(10.0)
    asked = questions(flight)
    names = [name for _, name in asked]
    assert names[0] == "WP_SPEED"
    assert sorted(names) == sorted({*names})
    assert {row.parameter for row in PROFILES["ardupilot-rover"].requirements} <= {*names}
    rounds = sorted({t_ns for t_ns, _ in asked})
    assert all(b - a >= ROUND_NS for a, b in pairwise(rounds))
    assert max(names.count(name) for name in names) == 1
    assert not questions(flight, tracking_ns)


def test_the_rover_engages_as_fast_as_before() -> None:
    flight = rover()
    fly_until_tracking(flight, 2.5)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (0.0, "WP_SPEED = 0 m/s, which cannot be: 0.1 to 50 may: set WP_SPEED to what the vehicle can do: "),
        (400.0, "WP_SPEED = 400 m/s, which cannot be: 0.1 to 50 may: "),
        (
            0.5,
            'trajectory.name = "circle": speed: 1 m/s needed at t = 0 s (north 10 m, east 0 m), 0.5 m/s '
            "available (WP_SPEED 0.5): fly at most 0.5 m/s there",
        ),
    ],
)
def test_an_absurd_value_and_one_too_slow_for_the_flight_are_refused_with_numbers(
    value: float, said: str
) -> None:
    flight = rover(WP_SPEED=value)
    assert refused(flight).startswith(said)
    (event,) = events_of(flight, "parameters_unfit")
    assert event.startswith(said)


def test_a_missing_one_is_refused_by_name_and_asked_for_again_until_it_comes() -> None:
    flight = rover()
    mute = True

    def swallow(data: bytes, _: int) -> tuple[bytes, ...]:
        return () if mute and b"WP_SPEED" in data else (data,)

    flight.on_the_way = swallow
    assert refused(flight, 8.0).startswith("WP_SPEED = the autopilot has no such parameter: ")
    assert len(events_of(flight, "parameters_unfit")) == 1
    mute = False
    fly_until_tracking(flight, 2.0)


def test_one_that_no_flight_needs_delays_for_two_seconds_at_most() -> None:
    flight = rover()
    flight.on_the_way = lambda data, _: () if b"TURN_RADIUS" in data else (data,)
    assert flight.run(PATIENCE_NS / SECOND + 0.3, until=lambda: bool(flight.setpoint_times_ns))
    engaged_ns = flight.now_ns
    flight.run(2.0)
    assert not questions(flight, engaged_ns)
    (record,) = records_of(flight, Parameters)
    assert record.absent == ("TURN_RADIUS",)


def test_all_are_read_over_a_line_that_loses_a_fifth_each_way() -> None:
    flight = rover(channel=Channel(loss=0.2))
    fly_until_tracking(flight, 8.0)
    assert records_of(flight, Parameters)[-1].values["WP_SPEED"] == 5.0


@pytest.mark.parametrize(("wp_speed", "configured"), [(3.5, 5.0), (6.5, 5.0)])
def test_speeds_are_parts_of_the_autopilots_own_full_speed(wp_speed: float, configured: float) -> None:
    flight = rover(f"vehicle.speed_at_full_thrust_m_s={configured}", WP_SPEED=wp_speed)
    fly_until_tracking(flight)
    flight.run(16.0)
    last = records_of(flight, Setpoint)[-1]
    assert last.speed_m_s == pytest.approx(1.0, abs=0.1)
    assert last.thrust == pytest.approx(last.speed_m_s / wp_speed)
    (warning,) = events_of(flight, "parameter")
    assert warning.startswith(
        f"WP_SPEED = {wp_speed:g} m/s, needs 5 for vehicle.speed_at_full_thrust_m_s = 5: "
        f"set WP_SPEED to 5, or vehicle.speed_at_full_thrust_m_s = {wp_speed:g}: thrust 1 gives WP_SPEED"
    )


def test_the_tighter_limit_holds() -> None:
    flight = rover(ATC_STR_RAT_MAX=20.0)
    fly_until_tracking(flight)
    flight.run(5.0)
    rates = [abs(s.body_rates_frd_rad_s[2]) for s in records_of(flight, Setpoint)]
    assert max(rates) <= 0.3491


def test_before_a_flight_a_change_holds_at_once() -> None:
    flight = rover("supervisor.engage=pilot")
    fly_until(flight, State.READY)
    set_parameter(flight, "WP_SPEED", 0.0)
    flight.run(0.5)
    assert state_of(flight) is State.CONNECTED
    assert flight.guide.engagement.reason.startswith("WP_SPEED = 0 m/s, which cannot be")
    set_parameter(flight, "WP_SPEED", 4.0)
    fly_until(flight, State.READY, 1.0)
    assert events_of(flight, "parameter_changed") == ["WP_SPEED changed: it holds from here on"]
    assert records_of(flight, Parameters)[-1].values["WP_SPEED"] == 4.0


def test_in_flight_a_limit_waits_for_the_next_flight_and_is_told() -> None:
    flight = rover()
    fly_until_tracking(flight)
    flight.run(25.0)
    since_ns = flight.now_ns
    set_parameter(flight, "ATC_STR_RAT_MAX", 4.0)
    flight.run(3.0)
    assert state_of(flight) is State.TRACKING
    (told,) = events_of(flight, "parameter_changed")
    assert told.startswith("changed in flight: ATC_STR_RAT_MAX = 4 deg/s, needs at least 114.592 for ")
    assert told.endswith("(it holds from the next flight on)")
    turning = [s.body_rates_frd_rad_s[2] for s in records_of(flight, Setpoint, since_ns)]
    assert turning[-1] == pytest.approx(0.1, abs=0.02)  # 1 m/s on 10 m, and 0.07 rad/s is 4 deg/s
    assert max(b - a for a, b in pairwise(setpoints_since(flight, since_ns))) <= 40 * MS


def test_in_flight_the_speed_of_full_thrust_follows_so_that_the_vehicles_does_not_jump() -> None:
    flight = rover()
    fly_until_tracking(flight)
    flight.run(25.0)
    set_parameter(flight, "WP_SPEED", 2.5)
    flight.run(0.2)
    since_ns = flight.now_ns
    flight.run(3.0)
    assert all(
        s.thrust == pytest.approx(s.speed_m_s / 2.5) and s.speed_m_s == pytest.approx(1.0, abs=0.15)
        for s in records_of(flight, Setpoint, since_ns)
    )
    (told,) = events_of(flight, "parameter_changed")
    assert told.endswith("(speeds are asked for with it at once, limits follow after the flight)")


def test_in_flight_an_absurd_value_is_told_and_not_taken() -> None:
    flight = rover()
    fly_until_tracking(flight)
    flight.run(8.0)
    set_parameter(flight, "WP_SPEED", 400.0)
    flight.run(0.5)
    (told,) = events_of(flight, "parameter_changed")
    assert told.startswith("changed in flight: WP_SPEED = 400 m/s, which cannot be")
    last = records_of(flight, Setpoint)[-1]
    assert last.thrust == pytest.approx(last.speed_m_s / 5.0)


def test_after_a_reboot_they_are_read_anew() -> None:
    flight = rover()
    fly_until_tracking(flight)
    flight.run(2.0)
    since_ns = flight.now_ns
    flight.vehicle.reboot(flight.now_ns)
    flight.run(6.0)
    assert "WP_SPEED" in {name for _, name in questions(flight, since_ns)}
    assert records_of(flight, Parameters, since_ns)[-1].unmet == ""


def test_a_trajectory_that_is_loaded_is_held_against_them() -> None:
    flight = rover("supervisor.engage=pilot", WP_SPEED=2.0)
    fly_until(flight, State.READY)
    fast = LoadTrajectory(trajectory={"name": "circle", "radius_m": 10.0, "speed_m_s": 3.0})
    flight.guide.command(fast, flight.now_ns)
    flight.run(0.5)
    (refused,) = events_of(flight, "load_refused")
    assert "speed: 3 m/s needed at t = 0 s (north 10 m, east 0 m), 2 m/s available (WP_SPEED 2)" in refused
    assert state_of(flight) is State.READY, "what was loaded before flies"


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        (
            {"COM_OF_LOSS_T": 0.1},
            "COM_OF_LOSS_T = 0.1 s, which cannot be: 0.2 to 60 may: set COM_OF_LOSS_T to",
        ),
        ({"MAV_FWDEXTSP": 0.0}, "MAV_FWDEXTSP = 0, needs 1: set MAV_FWDEXTSP to 1: without it setpoints"),
    ],
)
def test_what_is_serious_on_px4_keeps_it_from_engaging(parameters: dict[str, float], said: str) -> None:
    assert refused(make_flight(parameters=parameters)).startswith(said)


@pytest.mark.parametrize("seconds", [0.5, 30.0])
def test_a_simulator_at_another_speed_is_flown(seconds: float) -> None:
    """PX4's `init.d-posix/rcS` sets COM_OF_LOSS_T to PX4_SIM_SPEED_FACTOR times 0.5 s (1.14, 1.15) or 1 s."""
    flight = make_flight(parameters={"COM_OF_LOSS_T": seconds})
    fly_until_tracking(flight)
    assert [text[:13] for text in events_of(flight, "parameter")] == ["COM_OF_LOSS_T"]


def test_what_is_doubtful_is_warned_of_once_and_flown() -> None:
    flight = make_flight(parameters={"COM_RCL_EXCEPT": 4})
    fly_until_tracking(flight)
    flight.run(3.0)
    (warning,) = events_of(flight, "parameter")
    assert warning.startswith(
        "COM_RCL_EXCEPT = 4: OFFBOARD goes on when sticks are lost: when the transmitter is lost nobody can"
    )


def test_another_vehicles_parameters_are_not_asked_for() -> None:
    flight = make_flight(parameters={"MAV_TYPE": 2})
    flight.run(4.0)
    assert not questions(flight)


def test_a_flight_with_changes_replays_to_the_bit(tmp_path: Path) -> None:
    flight = rover()
    fly_until_tracking(flight)
    for name, value in (("WP_SPEED", 2.5), ("ATC_STR_RAT_MAX", 60.0)):
        set_parameter(flight, name, value)
        flight.run(2.0)
    with LogBook(make_config(*SLOW), tmp_path) as book:
        for record in flight.records:
            book.add(record)
    found = replay(book.path)
    assert (found.identical, found.difference) == (True, None)


def test_who_changes_one_over_and_over_fills_no_log() -> None:
    flight = rover()
    fly_until_tracking(flight)
    since_ns = flight.now_ns
    for number in range(200):
        set_parameter(flight, "ATC_ACCEL_MAX", float(1 + number % 2))
        flight.run(0.02)
    assert 3 <= len(events_of(flight, "parameter_changed", since_ns)) <= 9
