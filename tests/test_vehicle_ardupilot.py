"""The manners of ArduRover, as its sources, measurements and recordings tell them."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sitl.plant import attitude_from_euler, euler_from_attitude
from sitl.vehicle import Firmware
from tests.vehicle_peer import SECOND, YAW_RATE, Peer, rover_in_guided

HEADING = 0x07
TIMEOUT = "target not received last 3secs, stopping"


def yaw(peer: Peer) -> float:
    return euler_from_attitude(peer.vehicle.truth().attitude_wxyz)[2]


@pytest.mark.parametrize(
    ("mask", "values", "yaw_rate", "speed"),
    [
        (YAW_RATE, {"rates": (0.0, 0.0, 0.3), "thrust": 0.4}, 0.3, 2.0),
        (YAW_RATE, {"rates": (0.0, 0.0, -0.3), "thrust": -0.3}, -0.3, -1.5),
        (YAW_RATE, {"rates": (9.0, 9.0, 0.1), "thrust": 1.4}, 0.1, 5.0),
        (YAW_RATE, {"rates": (0.0, 0.0, 0.1), "thrust": -1.4}, 0.1, -5.0),
        (YAW_RATE | 64, {"rates": (0.0, 0.0, 0.1), "thrust": 1.0}, 0.0, 0.0),
        (YAW_RATE, {"rates": (0.0, 0.0, math.nan), "thrust": 0.4}, 0.0, 0.0),
        # All rates unmasked and an attitude with another yaw: the yaw rate wins.
        (
            0x00,
            {"q": attitude_from_euler(0.0, 0.0, 1.0), "rates": (0.0, 0.0, -0.2), "thrust": 0.2},
            -0.2,
            1.0,
        ),
        (HEADING, {"q": attitude_from_euler(0.0, 0.0, 0.1), "thrust": 0.2}, 0.2, 1.0),
    ],
)
def test_what_a_setpoint_does(mask: int, values: dict[str, Any], yaw_rate: float, speed: float) -> None:
    peer = rover_in_guided()
    peer.setpoint(mask, **values)
    truth = peer.vehicle.truth()
    assert truth.body_rates_frd_rad_s == pytest.approx((0.0, 0.0, yaw_rate), abs=1e-6)
    assert truth.speed_m_s == pytest.approx(speed, abs=1e-6)


def test_speed_is_thrust_times_wp_speed() -> None:
    peer = rover_in_guided(parameters={"WP_SPEED": 2.0})
    peer.setpoint(YAW_RATE, thrust=0.5)
    assert peer.vehicle.truth().speed_m_s == pytest.approx(1.0)


def test_nan_thrust_stops_and_is_an_internal_error() -> None:
    peer = rover_in_guided()
    peer.setpoint(YAW_RATE, thrust=1.0)
    peer.setpoint(YAW_RATE, thrust=math.nan)
    assert peer.vehicle.truth().speed_m_s == 0.0
    assert any("Internal Error" in text for text in peer.texts())


def test_a_heading_is_reached_the_short_way_round() -> None:
    peer = rover_in_guided(initial_yaw_rad=3.0)
    peer.stream(6.0, HEADING, q=attitude_from_euler(0.0, 0.0, -3.0))
    assert yaw(peer) == pytest.approx(-3.0, abs=1e-3)


@pytest.mark.parametrize(
    ("mask", "vx", "vy", "yaw_rate", "speed", "turns"),
    [
        (0b110_111_000_111, 2.0, 0.0, 0.0, 2.0, 0.0),
        (0b010_111_000_111, 2.0, 0.0, 0.3, 2.0, 0.3),
        (0b010_111_000_111, -2.0, 0.0, 0.3, -2.0, 0.3),
        (0b010_111_111_111, 0.0, 0.0, 0.3, 0.0, 0.3),
        (0b110_000_000_111, 2.0, 0.0, 0.0, 0.0, 0.0),
    ],
)
def test_velocity_targets_move_it_unless_acceleration_is_asked_for(
    mask: int, vx: float, vy: float, yaw_rate: float, speed: float, turns: float
) -> None:
    peer = rover_in_guided()
    values = (0.0, 0.0, 0.0, vx, vy, 0.0, 0.0, 0.0, 0.0, 0.0, yaw_rate)
    peer.send(mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, mask, *values))
    truth = peer.vehicle.truth()
    assert truth.speed_m_s == pytest.approx(speed)
    assert truth.body_rates_frd_rad_s[2] == pytest.approx(turns)


def test_setpoints_act_in_guided_only() -> None:
    peer = rover_in_guided()
    peer.command(176, 1, 4)
    peer.stream(1.0, YAW_RATE, thrust=1.0)
    assert peer.vehicle.truth().position_ned_m == (-10.0, -30.0, 0.0)


def test_disarmed_it_does_not_move() -> None:
    peer = Peer(Firmware.ARDUPILOT_ROVER)
    peer.command(176, 1, 15)
    peer.stream(1.0, YAW_RATE, thrust=1.0)
    assert peer.vehicle.truth().position_ned_m == (-10.0, -30.0, 0.0)


def test_it_holds_the_last_setpoint_for_three_seconds_then_stops_and_stays_in_guided() -> None:
    peer = rover_in_guided()
    peer.setpoint(YAW_RATE, thrust=0.2)
    start_ns = peer.now_ns
    peer.run(2.99)
    assert peer.vehicle.truth().speed_m_s == pytest.approx(1.0)
    while TIMEOUT not in peer.texts():
        peer.run(0.001)
    assert 3.0 < (peer.now_ns - start_ns) / SECOND <= 3.03
    assert (peer.vehicle.truth().speed_m_s, peer.vehicle.mode) == (0.0, "GUIDED")
    peer.run(10.0)
    assert peer.texts().count(TIMEOUT) == 1
    peer.setpoint(YAW_RATE, thrust=0.2)
    assert peer.vehicle.truth().speed_m_s == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("params", "result", "mode", "text"),
    [
        ((1, 15), 0, "GUIDED", None),
        ((1, 4), 0, "HOLD", None),
        ((1, 11), 0, "RTL", None),
        ((1, 99), 4, "MANUAL", "No such mode 99"),
        ((1, 10), 4, "MANUAL", "No Mission. Can't set AUTO."),
        ((0, 15), 2, "MANUAL", None),
        ((1, math.nan), 2, "MANUAL", None),
    ],
)
def test_do_set_mode(params: tuple[float, float], result: int, mode: str, text: str | None) -> None:
    peer = Peer(Firmware.ARDUPILOT_ROVER)
    assert peer.command(176, *params) == [result]
    assert peer.vehicle.mode == mode
    assert peer.texts() == ([] if text is None else [text])


def test_set_mode_is_acknowledged_as_the_message_that_it_is() -> None:
    peer = Peer(Firmware.ARDUPILOT_ROVER)
    heard = peer.send(mavlink.MAVLink_set_mode_message(1, 1, 15))
    assert [(m.command, m.result) for m in heard if m.get_type() == "COMMAND_ACK"] == [(11, 0)]
    assert peer.vehicle.mode == "GUIDED"


def test_a_mode_change_shows_in_a_heartbeat_at_once_after_the_ack() -> None:
    peer = Peer(Firmware.ARDUPILOT_ROVER)
    peer.run(0.5)
    peer.command(176, 1, 15)
    assert [m.get_type() for m in peer.heard[-2:]] == ["COMMAND_ACK", "HEARTBEAT"]
    assert peer.heard[-1].custom_mode == 15


def test_arming_is_told_after_the_ack_and_shown_with_the_next_heartbeat() -> None:
    peer = Peer(Firmware.ARDUPILOT_ROVER)
    peer.run(0.5)
    peer.command(400, 1)
    assert [m.get_type() for m in peer.heard[-2:]] == ["COMMAND_ACK", "STATUSTEXT"]
    assert peer.last("HEARTBEAT").base_mode & 128 == 0
    peer.run(0.6)
    assert peer.last("HEARTBEAT").base_mode == 65 + 128
    assert peer.command(400, 0) == [0]
    assert peer.texts() == ["Throttle armed", "Throttle disarmed"]


@pytest.mark.parametrize(
    ("loop_rate", "interval_us", "result"),
    [(50, 20_000, 2), (50, 25_000, 0), (200, 20_000, 0), (50, -1, 0), (50, 0, 0), (50, 100, 2)],
)
def test_message_rates_above_eight_tenths_of_the_loop_rate_are_denied(
    loop_rate: int, interval_us: int, result: int
) -> None:
    peer = Peer(Firmware.ARDUPILOT_ROVER, parameters={"SCHED_LOOP_RATE": loop_rate})
    assert peer.command(511, 31, interval_us) == [result]


def test_attitude_quaternion_is_in_no_default_stream_and_comes_at_40_hz_when_asked() -> None:
    peer = Peer(Firmware.ARDUPILOT_ROVER)
    assert "ATTITUDE_QUATERNION" not in {m.get_type() for m in peer.run(3.0)}
    peer.command(511, 31, 25_000)
    heard = [m for m in peer.run(10.0) if m.get_type() == "ATTITUDE_QUATERNION"]
    assert len(heard) == pytest.approx(400, abs=2)


@pytest.mark.parametrize(("group", "name"), [(10, "ATTITUDE"), (6, "LOCAL_POSITION_NED"), (0, "VFR_HUD")])
def test_request_data_stream_sets_and_stops_a_group(group: int, name: str) -> None:
    peer = Peer(Firmware.ARDUPILOT_ROVER)
    peer.send(mavlink.MAVLink_request_data_stream_message(1, 1, group, 10, 1))
    assert len([m for m in peer.run(5.0) if m.get_type() == name]) == pytest.approx(50, abs=1)
    peer.send(mavlink.MAVLink_request_data_stream_message(1, 1, group, 10, 0))
    assert not [m for m in peer.run(3.0) if m.get_type() == name]


def test_reboot_fails_armed_and_is_obeyed_disarmed() -> None:
    peer = rover_in_guided()
    peer.run(2.0)
    assert peer.command(246, 1) == [4]
    peer.command(400, 0)
    assert peer.command(246, 1) == [0]
    assert (peer.vehicle.mode, peer.vehicle.truth().boot_ms) == ("MANUAL", 0.0)


def test_it_initialises_then_waits_for_its_estimator() -> None:
    peer = Peer(Firmware.ARDUPILOT_ROVER, estimator_ready_s=5.0)
    peer.run(0.1)
    assert (peer.last("HEARTBEAT").custom_mode, peer.last("HEARTBEAT").system_status) == (16, 2)
    assert peer.command(400, 1) == [4]
    assert peer.texts() == ["Arm: System not initialised"]
    early = peer.run(3.0)
    assert (peer.last("HEARTBEAT").custom_mode, peer.last("HEARTBEAT").system_status) == (0, 4)
    assert "LOCAL_POSITION_NED" not in {m.get_type() for m in early}
    assert peer.last("GLOBAL_POSITION_INT").lat == 0
    assert peer.command(400, 1) == [4]
    late = peer.run(4.0)
    assert "LOCAL_POSITION_NED" in {m.get_type() for m in late}
    assert peer.last("GLOBAL_POSITION_INT").lat != 0
    assert "AHRS: EKF3 active" in peer.texts()
    assert peer.command(400, 1) == [0]


def test_one_loop_fills_one_datagram() -> None:
    peer = Peer(Firmware.ARDUPILOT_ROVER)
    datagrams = peer.vehicle.advance(0)
    assert len(datagrams) == 1 or len(datagrams[0]) > 1000
    assert all(len(datagram) <= 1200 for datagram in datagrams)
