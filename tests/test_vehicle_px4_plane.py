"""The manners of PX4 as a fixed wing, as its sources and the recorded flight tell them."""

from __future__ import annotations

import math
from typing import Any, Final

import pytest

from sitl.plant import attitude_from_euler
from sitl.vehicle import Firmware
from sitl.vehicle.controls import Attitude, Control, RatesThrottle
from tests.vehicle_peer import ATTITUDE_THRUST, RATES, Peer, airborne, height, stream_velocity

PLANE: Final = Firmware.PX4_PLANE
BANKED: Final = attitude_from_euler(0.3, -0.05, 1.0)


def in_offboard(**options: Any) -> Peer:
    """Level flight in OFFBOARD."""
    peer = airborne(PLANE, **options)
    peer.setpoint(ATTITUDE_THRUST, thrust=0.8)
    assert peer.command(176, 1, 6) == [0, 0]
    return peer


def asked(peer: Peer) -> Control:
    """What the body is told now."""
    pilot = peer.vehicle._pilot
    assert pilot.body is not None
    return pilot.command(pilot.body)


@pytest.mark.parametrize(
    ("mask", "values", "parameters", "control"),
    [
        (ATTITUDE_THRUST, {"q": BANKED, "thrust": 0.7}, {}, Attitude(0.3, -0.05, 0.7)),
        # the receiver clamps nothing, the motor does
        (ATTITUDE_THRUST, {"q": BANKED, "thrust": 1.4}, {}, Attitude(0.3, -0.05, 1.0)),
        (ATTITUDE_THRUST, {"q": BANKED, "thrust": -0.4}, {}, Attitude(0.3, -0.05, 0.0)),
        (ATTITUDE_THRUST | 64, {"q": BANKED, "thrust": 0.7}, {}, Attitude(0.3, -0.05, 0.0)),
        (RATES, {"rates": (0.1, 0.2, 0.3), "thrust": 0.7}, {}, RatesThrottle((0.1, 0.2, 0.0), 0.7)),
        (RATES | 4, {"rates": (0.1, 0.2, 0.3), "thrust": 0.7}, {}, RatesThrottle((0.1, 0.2, 0.0), 0.7)),
        (
            RATES,
            {"rates": (0.1, 0.2, 0.3), "thrust": 0.7},
            {"FW_ACRO_YAW_EN": 1},
            RatesThrottle((0.1, 0.2, 0.3), 0.7),
        ),
        # a masked yaw rate is NaN, and with it all three torques are dropped
        (
            RATES | 4,
            {"rates": (0.1, 0.2, 0.3), "thrust": 0.7},
            {"FW_ACRO_YAW_EN": 1},
            RatesThrottle((0.0, 0.0, 0.0), 0.7),
        ),
    ],
)
def test_what_a_setpoint_becomes(
    mask: int, values: dict[str, Any], parameters: dict[str, float], control: Attitude | RatesThrottle
) -> None:
    peer = in_offboard(parameters=parameters)
    peer.setpoint(mask, **values)
    told = asked(peer)
    assert type(told) is type(control)
    flat = [*told[0], told[1]] if isinstance(told, RatesThrottle) else list(told)
    wanted = [*control[0], control[1]] if isinstance(control, RatesThrottle) else list(control)
    assert flat == pytest.approx(wanted, abs=1e-6)


def test_a_bank_turns_it() -> None:
    peer = in_offboard()
    peer.stream(2.0, ATTITUDE_THRUST, q=BANKED, thrust=0.9)
    north, east, _ = peer.vehicle.truth().velocity_ned_m_s
    assert 0.2 < math.atan2(east, north) < 1.5


def test_velocities_are_proof_of_life_and_turn_nothing() -> None:
    peer = in_offboard()
    stream_velocity(peer, 4.0, (0.0, 10.0, 0.0), 1.0)
    assert peer.vehicle.mode == "OFFBOARD"
    assert abs(peer.vehicle.truth().velocity_ned_m_s[1]) < 1.0
    assert height(peer) == pytest.approx(60.0, abs=2.0)


def test_take_off_climbs_to_mis_takeoff_alt_and_circles_there() -> None:
    peer = Peer(PLANE)
    assert peer.vehicle.truth().position_ned_m[2] == 0.0
    assert peer.command(176, 1, 4, 2) == [0, 0]
    assert peer.command(400, 1) == [0]
    peer.run(7.0)
    assert 8.0 < height(peer) < 32.0
    assert peer.last("EXTENDED_SYS_STATE").landed_state == 3
    peer.run(40.0)
    assert peer.vehicle.mode == "AUTO.LOITER"
    assert height(peer) == pytest.approx(60.0, abs=1.0)
    assert peer.last("CURRENT_MODE").intended_custom_mode == peer.last("CURRENT_MODE").custom_mode


@pytest.mark.parametrize("wind", [(0.0, 0.0, 0.0), (4.0, -3.0, 0.0)])
def test_loiter_is_a_circle_of_nav_loiter_rad_at_the_height_where_it_began(
    wind: tuple[float, float, float],
) -> None:
    peer = airborne(PLANE, wind_ned_m_s=wind)
    peer.run(40.0)
    for _ in range(40):
        peer.run(1.0)
        north, east, down = peer.vehicle.truth().position_ned_m
        assert math.hypot(north + 10.0, east + 30.0) == pytest.approx(80.0, abs=12.0)
        assert -down == pytest.approx(60.0, abs=2.0)
        assert peer.vehicle.truth().airspeed_m_s > 10.0


def test_handed_over_from_a_steep_bank_and_slow_it_does_not_dive() -> None:
    peer = in_offboard()
    peer.stream(1.5, ATTITUDE_THRUST, q=attitude_from_euler(0.8, 0.3, 0.0), thrust=0.2)
    assert peer.command(176, 1, 4, 3) == [0, 0]
    lowest = min(height(peer) for _ in range(60) if peer.run(0.5) is not None)
    assert lowest > 40.0, "where it stalled, and what it takes to be out of that"
    assert peer.vehicle.truth().airspeed_m_s > 10.0


def test_return_circles_over_home_at_rtl_return_alt() -> None:
    peer = airborne(PLANE, initial_position_ned_m=(300.0, 200.0, -60.0))
    assert peer.command(20) == [0]
    peer.run(90.0)
    north, east, _ = peer.vehicle.truth().position_ned_m
    assert math.hypot(north, east) == pytest.approx(80.0, abs=8.0)
    assert height(peer) == pytest.approx(100.0, abs=2.0)


def test_land_glides_down_rolls_out_and_disarms() -> None:
    peer = airborne(PLANE, initial_position_ned_m=(0.0, 0.0, -15.0))
    assert peer.command(21) == [0]
    assert peer.command(400, 0) == [1]
    sink = 0.0
    while peer.vehicle.armed and peer.now_ns < 90e9:
        peer.run(0.1)
        if 0.0 < height(peer) < 0.5:
            sink = max(sink, peer.vehicle.truth().velocity_ned_m_s[2])
    assert not peer.vehicle.armed
    assert 0.0 < sink < 0.8
    assert peer.vehicle.truth().velocity_ned_m_s == pytest.approx((0.0, 0.0, 0.0), abs=0.05)


def test_after_the_loss_of_the_stream_it_flies_straight_on_in_posctl() -> None:
    peer = in_offboard()
    peer.stream(2.0, ATTITUDE_THRUST, thrust=0.8)
    peer.run(5.0)
    truth = peer.vehicle.truth()
    assert truth.mode == "POSCTL"
    assert (peer.last("HEARTBEAT").custom_mode, peer.last("HEARTBEAT").base_mode) == (196608, 209)
    assert peer.last("CURRENT_MODE").standard_mode == 3, "cruise, as recorded"
    assert height(peer) == pytest.approx(60.0, abs=4.0)
    assert abs(truth.velocity_ned_m_s[1]) < 1.0
    peer.stream(0.2, ATTITUDE_THRUST, thrust=0.8)
    assert peer.vehicle.mode == "OFFBOARD", "a stream that resumes takes control back"


def test_disarming_in_the_air_is_refused_unless_forced_and_then_it_falls() -> None:
    peer = in_offboard()
    assert peer.command(400, 0) == [1]
    assert "Disarming denied: not landed\t" in peer.texts()
    assert peer.command(400, 0, 21196) == [0]
    peer.run(4.0)
    assert height(peer) < 57.0


def test_it_is_a_fixed_wing_with_airspeed_wind_and_the_recorded_parameters() -> None:
    peer = airborne(PLANE)
    heard = {m.get_type() for m in peer.run(3.0)}
    assert {"WIND_COV", "VFR_HUD", "ATTITUDE_QUATERNION"} <= heard
    assert (peer.last("HEARTBEAT").type, peer.last("HEARTBEAT").base_mode) == (1, 157)
    recorded = {
        "FW_AIRSPD_TRIM": 15.0,
        "FW_AIRSPD_MIN": 10.0,
        "FW_AIRSPD_MAX": 20.0,
        "FW_R_LIM": 50.0,
        "FW_P_LIM_MIN": -30.0,
        "FW_P_LIM_MAX": 30.0,
        "FW_THR_MAX": 1.0,
        "FW_THR_TRIM": 0.6,
        "FW_ACRO_YAW_EN": 0.0,
        "COM_OF_LOSS_T": 1.0,
    }
    assert {name: pytest.approx(peer.vehicle.parameter(name)) for name in recorded} == recorded
