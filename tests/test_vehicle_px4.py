"""The manners of PX4 as a UUV, as its sources, measurements and recordings tell them."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sitl.plant import attitude_from_euler, euler_from_attitude
from tests.vehicle_peer import OFFBOARD, POSCTL, RATES, SECOND, Peer, px4_in_offboard

ATTITUDE = 0x07
"""Attitude and thrust, no rates."""
GCS = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3)


@pytest.mark.parametrize(
    ("mask", "values", "rates", "speed"),
    [
        (RATES, {"rates": (0.1, 0.2, 0.3), "thrust": 0.5}, (0.1, 0.2, 0.3), 2.5),
        (RATES, {"thrust": -0.4}, (0.0, 0.0, 0.0), -2.0),
        (RATES | 4, {"rates": (0.1, 0.2, 0.3), "thrust": 0.5}, (0.1, 0.2, 0.0), 2.5),
        (RATES | 64, {"rates": (0.1, 0.2, 0.3), "thrust": 0.5}, (0.1, 0.2, 0.3), 0.0),
        (RATES, {"rates": (9.0, -9.0, 0.0), "thrust": 1.4}, (5.0, -5.0, 0.0), 5.0),
        (RATES, {"rates": (0.1, math.nan, 0.3), "thrust": 0.2}, (0.1, 0.0, 0.3), 1.0),
        (RATES, {"rates": (0.1, 0.2, math.inf), "thrust": math.nan}, (0.1, 0.2, 0.0), 0.0),
        (ATTITUDE, {"q": (1.0, 0.0, 0.0, 0.0), "thrust": 0.2}, (0.0, 0.0, 0.0), 1.0),
        (ATTITUDE, {"q": (math.nan, 0.0, 0.0, 0.0), "thrust": 0.2}, (0.0, 0.0, 0.0), 0.0),
    ],
)
def test_what_a_setpoint_does(
    mask: int, values: dict[str, Any], rates: tuple[float, float, float], speed: float
) -> None:
    peer = px4_in_offboard()
    peer.setpoint(mask, **values)
    truth = peer.vehicle.truth()
    assert truth.body_rates_frd_rad_s == pytest.approx(rates, abs=1e-7)
    assert truth.speed_m_s == pytest.approx(speed, abs=1e-6)


def test_thrust_is_cut_off_where_its_parameter_says() -> None:
    peer = px4_in_offboard(parameters={"UUV_THRUST_SAT": 0.1})
    peer.setpoint(thrust=0.4)
    assert peer.vehicle.truth().speed_m_s == pytest.approx(0.5)


@pytest.mark.parametrize("mask", [RATES | 1, RATES | 2, RATES | 3])
def test_neither_attitude_nor_roll_and_pitch_rate_is_dropped_and_no_proof_of_life(mask: int) -> None:
    peer = px4_in_offboard()
    peer.stream(0.5, rates=(0.0, 0.0, 0.1), thrust=0.1)
    before = peer.vehicle.truth()
    peer.stream(1.5, mask, rates=(1.0, 1.0, 1.0), thrust=1.0)
    assert peer.vehicle.mode == "POSCTL"
    assert before.speed_m_s == pytest.approx(0.5)
    assert sum(peer.vehicle.ignored.values()) == 75


@pytest.mark.parametrize(
    ("system", "component", "moves"),
    [(1, 1, True), (0, 0, True), (1, 0, True), (0, 1, True), (2, 1, False), (1, 2, False)],
)
def test_setpoints_act_when_their_target_is_this_vehicle_or_everybody(
    system: int, component: int, moves: bool
) -> None:
    peer = px4_in_offboard()
    peer.setpoint(thrust=1.0, system=system, component=component)
    assert (peer.vehicle.truth().speed_m_s == 5.0) is moves


def test_an_attitude_setpoint_is_reached() -> None:
    peer = px4_in_offboard()
    peer.stream(5.0, ATTITUDE, q=attitude_from_euler(0.2, -0.3, 2.5), thrust=0.0)
    assert euler_from_attitude(peer.vehicle.truth().attitude_wxyz) == pytest.approx(
        (0.2, -0.3, 2.5), abs=1e-3
    )


def test_full_thrust_is_the_speed_of_the_options() -> None:
    peer = px4_in_offboard(speed_at_full_thrust_m_s=2.0)
    peer.setpoint(thrust=0.5)
    assert peer.vehicle.truth().speed_m_s == 1.0


def test_offboard_is_accepted_disarmed_without_a_stream_but_arming_then_is_not() -> None:
    peer = Peer()
    peer.send(GCS)
    assert peer.command(176, 1, 6) == [0, 0]
    assert peer.vehicle.mode == "OFFBOARD"
    assert peer.command(400, 1) == [1]
    assert peer.texts() == ["Arming denied: Resolve system health failures firs", "t\t"]
    peer.setpoint()
    assert peer.command(400, 1) == [0]
    assert peer.vehicle.armed


def test_offboard_armed_without_a_stream_is_refused_after_a_first_ack_that_says_yes() -> None:
    peer = Peer()
    assert peer.command(400, 1) == [0]
    assert peer.command(176, 1, 6) == [0, 1]
    assert peer.vehicle.mode == "AUTO.LOITER"


@pytest.mark.parametrize(("age_s", "results"), [(0.0, [0, 0]), (0.99, [0, 0]), (1.0, [0, 1]), (2.0, [0, 1])])
def test_one_setpoint_younger_than_com_of_loss_t_suffices(age_s: float, results: list[int]) -> None:
    peer = Peer()
    assert peer.command(400, 1) == [0]
    peer.setpoint()
    peer.run(age_s)
    assert peer.command(176, 1, 6) == results


def test_setpoints_before_offboard_are_proof_of_life_but_do_not_act_later() -> None:
    peer = Peer()
    peer.setpoint(thrust=1.0)
    peer.command(176, 1, 6)
    peer.command(400, 1)
    peer.run(0.1)
    assert peer.vehicle.truth().position_ned_m == (-10.0, -30.0, -5.0)


def test_the_loss_of_the_stream_leads_to_posctl_within_a_tenth_after_the_second() -> None:
    peer = px4_in_offboard()
    peer.stream(0.53, thrust=1.0)
    lost_ns = peer.now_ns - 20_000_000
    while peer.vehicle.mode == "OFFBOARD":
        peer.run(0.001)
    assert 1.0 <= (peer.now_ns - lost_ns) / SECOND <= 1.101
    stopped = peer.vehicle.truth()
    assert (stopped.mode, stopped.speed_m_s, stopped.armed) == ("POSCTL", 0.0, True)
    assert "Failsafe activated\t" in peer.texts()
    peer.run(1.0)
    shown, mode = peer.last("HEARTBEAT"), peer.last("CURRENT_MODE")
    assert (shown.custom_mode, shown.base_mode, shown.system_status) == (POSCTL, 209, 5)
    peer.run(1.0)
    mode = peer.last("CURRENT_MODE")
    assert (mode.custom_mode, mode.intended_custom_mode) == (POSCTL, OFFBOARD)


def test_a_stream_that_resumes_takes_control_back_within_a_tenth_and_unasked() -> None:
    peer = px4_in_offboard()
    peer.run(3.0)
    assert peer.vehicle.mode == "POSCTL"
    peer.stream(0.12, thrust=0.5)
    assert peer.vehicle.mode == "OFFBOARD"
    assert peer.vehicle.truth().speed_m_s == 2.5


def test_a_mode_commanded_during_the_failsafe_ends_the_intention() -> None:
    peer = px4_in_offboard()
    peer.run(3.0)
    assert peer.command(176, 1, 4, 3) == [0, 0]
    peer.stream(0.5, thrust=1.0)
    assert peer.vehicle.mode == "AUTO.LOITER"
    assert peer.vehicle.truth().position_ned_m == (-10.0, -30.0, -5.0)


@pytest.mark.parametrize(
    ("action", "mode"),
    [
        (0, "POSCTL"),
        (1, "ALTCTL"),
        (2, "STABILIZED"),
        (3, "AUTO.RTL"),
        (4, "AUTO.LAND"),
        (5, "AUTO.LOITER"),
        (6, "MANUAL"),
    ],
)
def test_com_obl_rc_act_names_the_failsafe(action: int, mode: str) -> None:
    peer = px4_in_offboard(parameters={"COM_OBL_RC_ACT": action})
    peer.run(1.2)
    assert peer.vehicle.mode == mode


@pytest.mark.parametrize(("hz", "holds"), [(2.0, True), (1.2, True), (0.7, False)])
def test_the_stream_needs_more_than_one_setpoint_a_second(hz: float, holds: bool) -> None:
    peer = px4_in_offboard()
    peer.stream(10.0, hz=hz)
    assert ("Failsafe activated\t" not in peer.texts()) is holds


def test_com_of_loss_t_is_obeyed_when_set_in_flight() -> None:
    peer = px4_in_offboard()
    peer.send(mavlink.MAVLink_param_set_message(1, 1, b"COM_OF_LOSS_T", 3.0, 9))
    peer.run(2.5)
    assert peer.vehicle.mode == "OFFBOARD"
    peer.run(0.7)
    assert peer.vehicle.mode == "POSCTL"


def test_position_setpoints_are_proof_of_life_and_the_vehicle_stands() -> None:
    peer = px4_in_offboard()
    target = mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, 0x5C7, *[0.0] * 3, 1.0, *[0.0] * 7
    )
    for _ in range(10):
        peer.send(target)
        peer.run(0.5)
    assert peer.vehicle.truth().mode == "OFFBOARD"
    assert peer.vehicle.truth().position_ned_m == (-10.0, -30.0, -5.0)


@pytest.mark.parametrize("mode", [(1, 3, 0), (1, 4, 3), (1, 1, 0)])
def test_other_modes_stand_still_whatever_is_streamed(mode: tuple[int, int, int]) -> None:
    peer = px4_in_offboard()
    peer.command(176, *mode)
    peer.stream(1.0, thrust=1.0, rates=(1.0, 1.0, 1.0))
    assert peer.vehicle.truth().position_ned_m == (-10.0, -30.0, -5.0)


def test_disarmed_it_does_not_move() -> None:
    peer = Peer()
    peer.setpoint()
    peer.command(176, 1, 6)
    peer.stream(1.0, thrust=1.0)
    assert peer.vehicle.truth().position_ned_m == (-10.0, -30.0, -5.0)


def test_disarming_is_refused_unless_forced_or_in_land() -> None:
    peer = px4_in_offboard()
    assert peer.command(400, 0) == [1]
    assert peer.texts()[-1] == "Disarming denied: not landed\t"
    assert peer.command(400, 0, 21196) == [0]
    assert not peer.vehicle.armed
    landing = px4_in_offboard()
    landing.command(176, 1, 4, 6)
    assert landing.command(400, 0) == [0]


def test_land_disarms_by_itself_after_com_disarm_land() -> None:
    peer = px4_in_offboard()
    peer.command(176, 1, 4, 6)
    peer.run(1.9)
    assert peer.vehicle.armed
    peer.run(0.4)
    assert not peer.vehicle.armed


def test_forced_arming_skips_the_checks() -> None:
    peer = Peer(estimator_ready_s=60.0)
    assert peer.command(400, 1) == [1]
    assert peer.command(400, 1, 21196) == [0]


def test_heartbeat_shows_a_mode_only_once_a_second_and_current_mode_as_asked() -> None:
    peer = Peer()
    peer.run(0.3)
    peer.command(511, 436, 50_000)
    peer.setpoint()
    heard = peer.run(0.1)
    peer.command(176, 1, 6)
    heard = peer.run(0.06)
    assert [m.custom_mode for m in heard if m.get_type() == "CURRENT_MODE"] == [OFFBOARD]
    assert not [m for m in heard if m.get_type() == "HEARTBEAT"]
    heard = peer.run(0.6)
    assert [m.custom_mode for m in heard if m.get_type() == "HEARTBEAT"] == [OFFBOARD]


def test_no_statustext_before_a_ground_station_was_heard() -> None:
    peer = Peer()
    peer.command(400, 1)
    peer.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
    peer.command(400, 0, 21196)
    assert peer.texts() == []
    peer.send(GCS, 255, 190)
    peer.command(400, 1)
    assert peer.texts() == ["Armed by external command\t"]


def test_attitude_target_goes_stale_in_rates_only_offboard() -> None:
    peer = px4_in_offboard()
    q = attitude_from_euler(0.0, 0.0, 1.0)
    peer.stream(0.2, ATTITUDE, q=q, thrust=0.3)
    peer.stream(0.3, RATES, rates=(0.1, 0.2, 0.3), thrust=0.7)
    shown = peer.last("ATTITUDE_TARGET")
    assert (shown.q, shown.thrust) == (pytest.approx(q), pytest.approx(0.3))
    assert (shown.body_roll_rate, shown.body_yaw_rate) == (pytest.approx(0.1), pytest.approx(0.3))


@pytest.mark.parametrize(
    ("params", "results", "mode"),
    [
        ((1, 3), [0, 0], "POSCTL"),
        ((1, 4, 5), [0, 0], "AUTO.RTL"),
        ((1, 4, 99), [0, 1], "AUTO.LOITER"),
        ((1, 99), [0, 0], "AUTO.LOITER"),
        ((0, 6), [0, 2], "AUTO.LOITER"),
        ((math.nan, 6), [0, 2], "AUTO.LOITER"),
    ],
)
def test_do_set_mode_answers_twice_and_only_the_second_answer_means_it(
    params: tuple[float, ...], results: list[int], mode: str
) -> None:
    peer = Peer()
    assert peer.command(176, *params) == results
    assert peer.vehicle.mode == mode


@pytest.mark.parametrize(
    ("command", "mode", "texts"),
    [
        (20, "AUTO.RTL", ["Returning to launch\t"]),
        (21, "AUTO.LAND", ["Landing at current position\t"]),
        (22, "AUTO.TAKEOFF", []),
    ],
)
def test_the_navigators_commands_change_the_mode_answer_once_and_end_offboard(
    command: int, mode: str, texts: list[str]
) -> None:
    peer = px4_in_offboard()
    peer.setpoint(thrust=1.0)
    before = len(peer.texts())
    assert peer.command(command) == [0]
    assert peer.vehicle.mode == mode
    assert peer.texts()[before:] == texts
    assert peer.vehicle.truth().speed_m_s == 0.0
    peer.setpoint(thrust=1.0)
    peer.run(2.0)
    assert peer.vehicle.mode == mode  # what is intended is no longer OFFBOARD


def test_set_mode_is_do_set_mode() -> None:
    peer = Peer()
    peer.send(mavlink.MAVLink_set_mode_message(1, 1, POSCTL))
    assert peer.vehicle.mode == "POSCTL"


def test_reboot_is_denied_armed_and_accepted_disarmed() -> None:
    peer = px4_in_offboard()
    peer.run(2.0)
    assert peer.command(246, 1) == [2]
    peer.command(400, 0, 21196)
    assert peer.command(246, 1) == [0]
    assert (peer.vehicle.mode, peer.vehicle.truth().boot_ms) == ("AUTO.LOITER", 0.0)


def test_before_the_estimator_is_ready_there_is_no_position_and_no_arming() -> None:
    peer = Peer(estimator_ready_s=5.0)
    peer.send(GCS)
    early = {m.get_type() for m in peer.run(4.9)}
    assert "ATTITUDE_QUATERNION" in early
    assert not early & {"LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "ODOMETRY", "HOME_POSITION"}
    assert peer.last("HEARTBEAT").system_status == 0
    assert peer.command(400, 1) == [1]
    late = {m.get_type() for m in peer.run(2.0)}
    assert {"LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "ODOMETRY", "HOME_POSITION"} <= late
    assert peer.last("HEARTBEAT").system_status == 3
    assert peer.command(400, 1) == [0]
