"""The manners of PX4 as a multicopter and as a rover, as its sources and the recordings tell them."""

from __future__ import annotations

import math
from typing import Any, Final

import pytest

from sitl.plant import attitude_from_euler, euler_from_attitude
from sitl.vehicle import Firmware
from sitl.vehicle.controls import RatesThrust, Velocity
from tests.vehicle_peer import (
    ATTITUDE_THRUST,
    GCS_HEARTBEAT,
    RATES,
    Peer,
    airborne,
    height,
    stream_velocity,
    velocity_target,
)

COPTER: Final = Firmware.PX4_COPTER
NAN: Final = math.nan


def in_offboard(firmware: Firmware = COPTER, **options: Any) -> Peer:
    peer = (
        airborne(firmware, **options) if firmware.flies else Peer(firmware, initially_armed=True, **options)
    )
    peer.send(GCS_HEARTBEAT)
    peer.send(velocity_target())
    assert peer.command(176, 1, 6) == [0, 0]
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
        (velocity_target((30.0, 0.0, -9.0), 9.0), (12.0, 0.0, -3.0), math.radians(200.0)),
        (velocity_target((1.0, 0.0, 0.0), 0.3, mask=0xDC7), (1.0, 0.0, 0.0), 0.0),
        # position, at MPC_XY_P and MPC_Z_P, from (-10, -30, -60)
        (
            velocity_target(position=(-9.0, -30.0, -59.5), mask=0xDF8),
            (0.95, 0.0, 0.5),
            0.0,
        ),
        # to a yaw, at MC_YAW_P
        (velocity_target(yaw=0.5, mask=0x9C7), (0.0, 0.0, 0.0), 1.4),
        # forward in its own frame, to the east
        (velocity_target((2.0, 0.0, 0.0), frame=8), (0.0, 2.0, 0.0), 0.0),
        (velocity_target((NAN, 1.0, 0.0)), (0.0, 1.0, 0.0), 0.0),
    ],
)
def test_what_a_trajectory_setpoint_becomes(
    target: Any, velocity: tuple[float, float, float], yaw_rate: float
) -> None:
    peer = in_offboard(initial_yaw_rad=0.5 * math.pi if target.coordinate_frame == 8 else 0.0)
    peer.send(target)
    told = asked(peer)
    assert isinstance(told, Velocity)
    assert told.velocity_ned_m_s == pytest.approx(velocity, abs=1e-6)
    assert told.yaw_rate_rad_s == pytest.approx(yaw_rate, abs=1e-6)


def test_it_answers_a_velocity_as_recorded() -> None:
    peer = in_offboard()
    stream_velocity(peer, 3.0, (2.0, 0.0, 0.0))
    assert peer.vehicle.truth().velocity_ned_m_s[0] == pytest.approx(1.6, abs=0.25)
    stream_velocity(peer, 2.0, (0.0, 0.0, 0.0), 0.3)
    assert peer.vehicle.truth().body_rates_frd_rad_s[2] == pytest.approx(0.27, abs=0.05)


@pytest.mark.parametrize(
    ("mask", "values", "rates", "thrust"),
    [
        (RATES, {"rates": (0.1, 0.2, 0.3), "thrust": 0.6}, (0.1, 0.2, 0.3), 0.6),
        (RATES | 4, {"rates": (0.1, 0.2, 0.3), "thrust": 1.6}, (0.1, 0.2, 0.0), 1.0),
        (RATES | 64, {"rates": (0.1, 0.2, 0.3), "thrust": 0.6}, (0.1, 0.2, 0.3), 0.0),
        (
            ATTITUDE_THRUST,
            {"q": attitude_from_euler(0.02, 0.0, 0.0), "thrust": 0.5},
            (0.13, 0.0, 0.0),
            0.5,
        ),
    ],
)
def test_what_an_attitude_setpoint_becomes(
    mask: int, values: dict[str, Any], rates: tuple[float, float, float], thrust: float
) -> None:
    peer = in_offboard()
    peer.setpoint(mask, **values)
    told = asked(peer)
    assert isinstance(told, RatesThrust)
    assert told.body_rates_frd_rad_s == pytest.approx(rates, abs=1e-3)
    assert told.thrust == pytest.approx(thrust)


def test_an_attitude_is_reached() -> None:
    peer = in_offboard()
    peer.stream(3.0, ATTITUDE_THRUST, q=attitude_from_euler(0.1, -0.05, 0.6), thrust=0.5)
    attitude = euler_from_attitude(peer.vehicle.truth().attitude_wxyz)
    assert attitude == pytest.approx((0.1, -0.05, 0.6), abs=0.02)


def test_take_off_as_recorded() -> None:
    peer = Peer(COPTER)
    peer.send(GCS_HEARTBEAT)
    assert peer.command(176, 1, 4, 2) == [0, 0]
    assert peer.command(400, 1) == [0]
    peer.run(4.0)
    assert height(peer) == pytest.approx(0.0), "spooling up"
    peer.run(6.0)  # 8.5 m were seen 11 s after arming
    assert height(peer) == pytest.approx(7.5, abs=1.5)
    assert peer.last("EXTENDED_SYS_STATE").landed_state == 3
    peer.run(8.0)
    assert (peer.vehicle.mode, peer.last("EXTENDED_SYS_STATE").landed_state) == ("AUTO.LOITER", 2)
    assert height(peer) == pytest.approx(10.0, abs=0.3)
    assert "Using default takeoff altitude: 10.0 m\t" in peer.texts()


def test_without_a_stream_it_sinks_in_posctl_until_it_is_back() -> None:
    peer = in_offboard()
    stream_velocity(peer, 1.0, (1.0, 0.0, 0.0))
    peer.run(4.0)
    assert peer.vehicle.mode == "POSCTL"
    assert peer.vehicle.truth().velocity_ned_m_s == pytest.approx((0.0, 0.0, 0.5), abs=0.1)
    assert (peer.last("HEARTBEAT").base_mode, peer.last("CURRENT_MODE").standard_mode) == (209, 1)
    stream_velocity(peer, 0.2)
    assert peer.vehicle.mode == "OFFBOARD"


def test_hold_stops_and_stands() -> None:
    peer = in_offboard(wind_ned_m_s=(3.0, 0.0, 0.0))
    stream_velocity(peer, 3.0, (3.0, 0.0, 0.0))
    assert peer.command(176, 1, 4, 3) == [0, 0]
    peer.run(10.0)
    stands = peer.vehicle.truth().position_ned_m
    peer.run(10.0)
    assert peer.vehicle.truth().position_ned_m == pytest.approx(stands, abs=0.3)


def test_return_climbs_comes_home_lands_and_disarms() -> None:
    peer = airborne(COPTER, initial_position_ned_m=(20.0, 10.0, -8.0))
    assert peer.command(20) == [0]
    peer.run(12.0)
    assert height(peer) == pytest.approx(30.0, abs=1.0)
    peer.run(50.0)
    assert not peer.vehicle.armed
    assert peer.vehicle.truth().position_ned_m == pytest.approx((0.0, 0.0, 0.0), abs=0.5)


def test_disarming_in_the_air_is_refused_unless_forced_and_then_it_falls() -> None:
    peer = in_offboard()
    assert peer.command(400, 0) == [1]
    assert peer.command(400, 0, 21196) == [0]
    peer.run(1.0)
    assert peer.vehicle.truth().velocity_ned_m_s[2] > 4.0


def test_armed_and_left_on_the_ground_it_disarms() -> None:
    peer = Peer(COPTER)
    assert peer.command(400, 1) == [0]
    peer.run(9.9)
    assert peer.vehicle.armed
    peer.run(0.3)
    assert not peer.vehicle.armed


def test_a_setpoint_without_anything_to_follow_is_no_proof_of_life() -> None:
    peer = in_offboard()
    stream_velocity(peer, 1.5, mask=0xFFF)
    assert peer.vehicle.mode == "POSCTL"
    assert "SET_POSITION_TARGET_LOCAL_NED invalid\t" in peer.texts()


# --- rover ----------------------------------------------------------------------------------------------


def test_a_rover_stands_under_attitude_setpoints_that_keep_offboard_alive() -> None:
    peer = in_offboard(Firmware.PX4_ROVER)
    peer.stream(3.0, RATES, rates=(0.0, 0.0, 0.5), thrust=0.5)
    truth = peer.vehicle.truth()
    assert (truth.mode, truth.speed_m_s) == ("OFFBOARD", 0.0)
    assert peer.last("HEARTBEAT").type == 10


def test_a_rover_drives_where_the_velocity_points_and_faster_than_asked() -> None:
    peer = in_offboard(Firmware.PX4_ROVER)
    stream_velocity(peer, 6.0, (0.0, 1.5, 0.0), mask=0xDC7)
    truth = peer.vehicle.truth()
    assert truth.speed_m_s == pytest.approx(2.05, abs=0.15), "as measured"
    assert euler_from_attitude(truth.attitude_wxyz)[2] == pytest.approx(0.5 * math.pi, abs=0.05)
    peer.run(4.0)
    assert (peer.vehicle.mode, round(peer.vehicle.truth().speed_m_s, 2)) == ("POSCTL", 0.0)
