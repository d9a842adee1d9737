"""The manners of ArduPlane, as its sources and the recorded flight tell them."""

from __future__ import annotations

import math
from typing import Any, Final

import pytest

from sitl.plant import attitude_from_euler, euler_from_attitude
from sitl.vehicle import Firmware
from sitl.vehicle.controls import Attitude
from tests.vehicle_peer import Peer, airborne, height, stream_velocity

PLANE: Final = Firmware.ARDUPILOT_PLANE
ROLL_PITCH: Final = 0x84
"""Roll and pitch of q, and throttle: what the service sends."""
BANKED: Final = attitude_from_euler(0.4, -0.02, 0.0)


def in_guided(**options: Any) -> Peer:
    peer = airborne(PLANE, **options)
    assert peer.command(176, 1, 15) == [0]
    return peer


def asked(peer: Peer) -> Attitude:
    """What the body is told now."""
    pilot = peer.vehicle._pilot
    assert pilot.body is not None
    told = pilot.command(pilot.body)
    assert isinstance(told, Attitude)
    return told


@pytest.mark.parametrize(
    ("mask", "roll", "pitch", "throttle"),
    [
        (ROLL_PITCH, 0.4, -0.02, 0.5),
        (0x07, 0.4, -0.02, 0.5),  # all of q; its yaw goes to the rudder
        (0x00, 0.4, -0.02, 0.5),
        (0x86, 0.4, None, 0.5),
        (0x85, None, -0.02, 0.5),
        (0x87, None, None, 0.5),
        (ROLL_PITCH | 64, 0.4, -0.02, None),
    ],
)
def test_the_mask_says_which_axes_of_q_count(
    mask: int, roll: float | None, pitch: float | None, throttle: float | None
) -> None:
    peer = in_guided()
    peer.run(20.0)  # on its circle
    own = asked(peer)
    peer.setpoint(mask, q=BANKED, thrust=0.5)
    told = asked(peer)
    for said, is_, was in zip((roll, pitch, throttle), told, own, strict=True):
        assert is_ == pytest.approx(was if said is None else said, abs=0.02)


@pytest.mark.parametrize(("thrust", "throttle"), [(1.4, 1.0), (-0.5, 0.0), (0.3, 0.3)])
def test_throttle_is_clamped_and_angles_are_held_to_their_limits(thrust: float, throttle: float) -> None:
    peer = in_guided()
    peer.setpoint(ROLL_PITCH, q=attitude_from_euler(1.5, 0.9, 0.0), thrust=thrust)
    assert asked(peer) == pytest.approx((math.radians(65.0), math.radians(25.0), throttle), abs=1e-6)


def test_without_throttle_it_chases_the_altitude_at_which_guided_began() -> None:
    def throttle(pitch: float) -> float:
        peer = in_guided()
        peer.stream(3.0, ROLL_PITCH | 64, q=attitude_from_euler(0.0, pitch, 0.0))
        told = asked(peer)
        assert told.pitch_rad == pytest.approx(pitch, abs=1e-6)
        return told.throttle - 0.08 * (22.0 - peer.vehicle.truth().airspeed_m_s)

    assert throttle(-0.15) > throttle(-0.04) > throttle(0.1) + 0.02


def test_setpoints_act_in_guided_only() -> None:
    peer = airborne(PLANE)
    peer.stream(1.0, ROLL_PITCH, q=attitude_from_euler(-0.5, 0.0, 0.0), thrust=0.9)
    assert euler_from_attitude(peer.vehicle.truth().attitude_wxyz)[0] > -0.05
    assert peer.vehicle.mode == "LOITER"


def test_three_seconds_without_a_setpoint_and_it_circles_where_guided_began() -> None:
    peer = in_guided()
    peer.stream(5.0, ROLL_PITCH, q=attitude_from_euler(0.0, -0.03, 0.0), thrust=0.4)
    peer.run(2.9)
    assert asked(peer).throttle == pytest.approx(0.4)
    peer.run(0.2)
    assert asked(peer).throttle != pytest.approx(0.4)
    peer.run(60.0)
    assert peer.vehicle.mode == "GUIDED"
    north, east, _ = peer.vehicle.truth().position_ned_m
    assert math.hypot(north + 10.0, east + 30.0) == pytest.approx(80.0, abs=15.0)
    assert height(peer) == pytest.approx(60.0, abs=2.0)


def test_velocities_move_nothing() -> None:
    peer = in_guided()
    before = asked(peer)
    stream_velocity(peer, 0.1, (0.0, 10.0, 0.0))
    assert asked(peer) == pytest.approx(before, abs=0.1)
    assert sum(peer.vehicle.ignored.values()) == 5


def test_takeoff_mode_climbs_to_tkoff_alt_and_circles_in_that_mode() -> None:
    peer = Peer(PLANE)
    assert peer.command(176, 1, 13) == [0]
    assert peer.command(400, 1) == [0]
    peer.run(0.5)
    assert (peer.last("HEARTBEAT").base_mode, peer.last("HEARTBEAT").system_status) == (89, 3)
    peer.run(40.0)
    assert peer.vehicle.mode == "TAKEOFF"
    assert height(peer) == pytest.approx(60.0, abs=2.0)
    assert (peer.last("HEARTBEAT").base_mode, peer.last("HEARTBEAT").system_status) == (217, 4)


@pytest.mark.parametrize("wind", [(0.0, 0.0, 0.0), (5.0, 0.0, 0.0)])
def test_handed_over_to_loiter_it_circles_and_does_not_dive(wind: tuple[float, float, float]) -> None:
    peer = in_guided(wind_ned_m_s=wind)
    peer.stream(1.5, ROLL_PITCH, q=attitude_from_euler(-1.0, 0.2, 0.0), thrust=0.1)
    start = height(peer)
    assert peer.command(176, 1, 12) == [0]
    for _ in range(90):
        peer.run(1.0)
        assert height(peer) > start - 10.0
        assert peer.vehicle.truth().airspeed_m_s > 11.0


def test_return_circles_over_home() -> None:
    peer = airborne(PLANE, initial_position_ned_m=(-400.0, 300.0, -60.0))
    assert peer.command(20) == [0]
    peer.run(80.0)
    assert peer.vehicle.mode == "RTL"
    north, east, _ = peer.vehicle.truth().position_ned_m
    assert math.hypot(north, east) == pytest.approx(80.0, abs=15.0)
    assert height(peer) == pytest.approx(100.0, abs=2.0)


@pytest.mark.parametrize(
    ("command", "result", "mode"),
    [((176, 1, 99), 4, "LOITER"), ((176, 1, 10), 4, "LOITER"), ((22,), 4, "LOITER"), ((17,), 0, "LOITER")],
)
def test_commands(command: tuple[float, ...], result: int, mode: str) -> None:
    peer = airborne(PLANE)
    assert peer.command(int(command[0]), *command[1:]) == [result]
    assert peer.vehicle.mode == mode


def test_disarming_in_the_air_is_refused_unless_forced() -> None:
    peer = in_guided()
    assert peer.command(400, 0) == [4]
    assert peer.command(246, 1) == [4]
    assert peer.command(400, 0, 21196) == [0]
    assert not peer.vehicle.armed


def test_it_starts_initialising_and_does_not_arm_before_it_is_ready() -> None:
    peer = Peer(PLANE, estimator_ready_s=20.0)
    peer.run(1.1)
    assert (peer.last("HEARTBEAT").custom_mode, peer.last("HEARTBEAT").base_mode) == (16, 17)
    peer.run(1.0)
    assert (peer.last("HEARTBEAT").custom_mode, peer.last("HEARTBEAT").base_mode) == (0, 81)
    assert peer.command(400, 1) == [4]
    assert "Arm: AHRS: waiting for home" in peer.texts()


@pytest.mark.parametrize(("interval_us", "result"), [(20_000, 2), (25_000, 0)])
def test_fifty_hz_is_denied_and_forty_works(interval_us: int, result: int) -> None:
    assert Peer(PLANE).command(511, 31, interval_us) == [result]


def test_its_streams_have_no_quaternion_but_the_wind() -> None:
    peer = airborne(PLANE)
    heard = {m.get_type() for m in peer.run(3.0)}
    assert {"WIND", "VFR_HUD"} <= heard
    assert "ATTITUDE_QUATERNION" not in heard
    assert peer.last("HEARTBEAT").type == 1
    recorded = {"AIRSPEED_CRUISE": 22, "AIRSPEED_MIN": 10, "AIRSPEED_MAX": 30, "ROLL_LIMIT_DEG": 65}
    assert {name: peer.vehicle.parameter(name) for name in recorded} == recorded
