"""The manners of ArduCopter, and of ArduRover as a boat, as sources and recordings tell them."""

from __future__ import annotations

import math
from typing import Any, Final

import pytest

from sitl.plant import attitude_from_euler, euler_from_attitude
from sitl.vehicle import Firmware
from sitl.vehicle.controls import RatesThrust, Velocity
from tests.vehicle_peer import (
    ATTITUDE_THRUST,
    YAW_RATE,
    Peer,
    airborne,
    height,
    rover_in_guided,
    stream_velocity,
    velocity_target,
)

COPTER: Final = Firmware.ARDUPILOT_COPTER


def in_guided(**options: Any) -> Peer:
    peer = airborne(COPTER, **options)
    assert peer.command(176, 1, 4) == [0]
    return peer


def asked(peer: Peer) -> Any:
    """What the body is told now."""
    pilot = peer.vehicle._pilot
    assert pilot.body is not None
    return pilot.command(pilot.body)


@pytest.mark.parametrize(
    ("target", "velocity", "yaw_rate"),
    [
        (velocity_target((1.0, -2.0, 0.5), 0.3), (1.0, -2.0, 0.5), 0.3),
        (velocity_target((30.0, 0.0, 0.0), 0.3), (10.0, 0.0, 0.0), 0.3),
        (velocity_target((1.0, 0.0, 0.0), 0.3, mask=0xDC7), (1.0, 0.0, 0.0), 0.0),
        (velocity_target((2.0, 0.0, 0.0), frame=8), (0.0, 2.0, 0.0), 0.0),
        (velocity_target(position=(-9.0, -30.0, -59.5), mask=0xDF8), (1.0, 0.0, 0.5), 0.0),
        (velocity_target(yaw=0.1, mask=0x9C7), (0.0, 0.0, 0.0), 0.45),
    ],
)
def test_what_a_velocity_becomes(target: Any, velocity: tuple[float, float, float], yaw_rate: float) -> None:
    peer = in_guided(initial_yaw_rad=0.5 * math.pi if target.coordinate_frame == 8 else 0.0)
    peer.send(target)
    told = asked(peer)
    assert isinstance(told, Velocity)
    assert told.velocity_ned_m_s == pytest.approx(velocity, abs=1e-6)
    assert told.yaw_rate_rad_s == pytest.approx(yaw_rate, abs=1e-6)


def test_it_answers_a_velocity_as_recorded() -> None:
    peer = in_guided()
    stream_velocity(peer, 3.0, (2.0, 0.0, 0.0))
    assert peer.vehicle.truth().velocity_ned_m_s[0] == pytest.approx(1.98, abs=0.1)


@pytest.mark.parametrize(("thrust", "climb"), [(0.5, 0.0), (1.0, 2.5), (0.0, -1.5), (0.75, 1.25), (7.0, 2.5)])
def test_thrust_is_a_climb_rate(thrust: float, climb: float) -> None:
    peer = in_guided()
    peer.stream(5.0, ATTITUDE_THRUST, q=attitude_from_euler(0.1, 0.0, 0.4), thrust=thrust)
    truth = peer.vehicle.truth()
    assert -truth.velocity_ned_m_s[2] == pytest.approx(climb, abs=0.15)
    assert euler_from_attitude(truth.attitude_wxyz) == pytest.approx((0.1, 0.0, 0.4), abs=0.03)


def test_with_guid_options_thrust_is_thrust() -> None:
    peer = in_guided(parameters={"GUID_OPTIONS": 8})
    peer.setpoint(0x80, rates=(0.1, 0.2, 0.3), thrust=0.7)
    told = asked(peer)
    assert isinstance(told, RatesThrust)
    assert (*told.body_rates_frd_rad_s, told.thrust) == pytest.approx((0.1, 0.2, 0.3, 0.7))


@pytest.mark.parametrize(("boosts", "thrust"), [(1, 0.4 / math.cos(0.3)), (0, 0.4)])
def test_leaning_it_gives_more_thrust_than_it_is_told(boosts: int, thrust: float) -> None:
    peer = in_guided(parameters={"GUID_OPTIONS": 8, "ATC_ANGLE_BOOST": boosts})
    peer.stream(3.0, ATTITUDE_THRUST, q=attitude_from_euler(0.3, 0.0, 0.0), thrust=0.4)
    told = asked(peer)
    assert isinstance(told, RatesThrust)
    assert told.thrust == pytest.approx(thrust, abs=0.002)


@pytest.mark.parametrize(
    ("mask", "q"),
    [
        (ATTITUDE_THRUST | 64, (1.0, 0.0, 0.0, 0.0)),
        (0x04, (1.0, 0.0, 0.0, 0.0)),  # two rates of three
        (ATTITUDE_THRUST, (1.01, 0.0, 0.0, 0.0)),
        (ATTITUDE_THRUST, (math.nan, 0.0, 0.0, 0.0)),
    ],
)
def test_what_is_dropped(mask: int, q: tuple[float, float, float, float]) -> None:
    peer = in_guided()
    peer.setpoint(mask, q=q, thrust=0.9)
    assert isinstance(asked(peer), Velocity)
    assert sum(peer.vehicle.ignored.values()) == 1


@pytest.mark.parametrize("attitude", [True, False])
def test_after_guid_timeout_it_stops_and_stays_in_guided(attitude: bool) -> None:
    peer = in_guided()
    if attitude:
        peer.stream(2.0, ATTITUDE_THRUST, q=attitude_from_euler(0.0, -0.1, 0.0), thrust=0.5)
    else:
        stream_velocity(peer, 2.0, (2.0, 0.0, 0.0))
    peer.run(2.9)
    moving = peer.vehicle.truth().velocity_ned_m_s[0]
    assert moving > 1.5
    peer.run(6.0)
    assert peer.vehicle.mode == "GUIDED"
    assert peer.vehicle.truth().velocity_ned_m_s == pytest.approx((0.0, 0.0, 0.0), abs=0.2)
    assert height(peer) == pytest.approx(60.0, abs=1.0)


def test_it_takes_off_by_command_only() -> None:
    peer = Peer(COPTER)
    assert peer.command(176, 1, 4) == [0]
    assert peer.command(22, 0, 0, 0, 0, 0, 0, 12) == [4], "not armed"
    assert peer.command(400, 1) == [0]
    stream_velocity(peer, 2.0, (0.0, 0.0, -1.0))
    assert height(peer) == 0.0
    assert peer.command(22, 0, 0, 0, 0, 0, 0, 12) == [0]
    peer.run(2.9)
    assert height(peer) == 0.0
    peer.run(6.3)  # 11.3 m were seen 9.2 s after the command
    assert height(peer) == pytest.approx(11.3, abs=1.0)
    assert peer.command(22, 0, 0, 0, 0, 0, 0, 12) == [4], "it flies"
    peer.run(5.0)
    assert height(peer) == pytest.approx(12.0, abs=0.3)


def test_armed_and_left_on_the_ground_it_disarms() -> None:
    peer = Peer(COPTER)
    assert peer.command(400, 1) == [0]
    peer.run(9.9)
    assert peer.vehicle.armed
    peer.run(0.3)
    assert not peer.vehicle.armed


@pytest.mark.parametrize("mode", [6, 9])
def test_return_and_land_come_down_and_disarm(mode: int) -> None:
    peer = airborne(COPTER, initial_position_ned_m=(3.0, 0.0, -4.0))
    assert peer.command(176, 1, mode) == [0]
    peer.run(45.0)
    assert not peer.vehicle.armed
    north, east, down = peer.vehicle.truth().position_ned_m
    assert (north, east, down) == pytest.approx((0.0 if mode == 6 else 3.0, 0.0, 0.0), abs=0.5)


def test_loiter_stops_and_stands() -> None:
    peer = in_guided()
    stream_velocity(peer, 3.0, (3.0, 0.0, 0.0))
    assert peer.command(176, 1, 5) == [0]
    peer.run(6.0)
    stands = peer.vehicle.truth().position_ned_m
    peer.run(5.0)
    assert peer.vehicle.truth().position_ned_m == pytest.approx(stands, abs=0.2)


def test_disarming_in_the_air_is_refused_unless_forced() -> None:
    peer = in_guided()
    assert peer.command(400, 0) == [4]
    assert peer.command(400, 0, 21196) == [0]
    assert not peer.vehicle.armed


def test_modes_and_rates() -> None:
    peer = Peer(COPTER)
    assert peer.command(176, 1, 99) == [4]
    assert "No such mode 99" in peer.texts()
    assert peer.command(176, 1, 6) == [0]
    assert peer.command(400, 1) == [4]
    assert "Arm: RTL mode not armable" in peer.texts()
    assert peer.command(511, 31, 20_000) == [0], "0.8 of SCHED_LOOP_RATE 400 allow 50 Hz"
    heard = [m.get_type() for m in peer.run(5.0)]
    assert heard.count("ATTITUDE_QUATERNION") == pytest.approx(250, abs=3)
    assert "ATTITUDE" not in heard, "all its stream rates are 0, as recorded"
    assert (peer.last("HEARTBEAT").type, peer.last("HEARTBEAT").base_mode) == (2, 89)


def test_a_boat_says_what_it_is_and_loiters_when_its_setpoints_stop() -> None:
    peer = rover_in_guided(model="boat", wind_ned_m_s=(0.0, 8.0, 0.0))
    peer.run(1.1)
    assert peer.last("HEARTBEAT").type == 11
    peer.stream(2.0, YAW_RATE, thrust=0.2)
    peer.run(3.1)
    at = peer.vehicle.truth().position_ned_m
    far = 0.0
    for _ in range(60):
        peer.run(1.0)
        far = max(far, math.dist(at, peer.vehicle.truth().position_ned_m))
    assert far < 8.0
    assert peer.vehicle.mode == "GUIDED"
