"""The built-in vehicle's estimator: ODOMETRY, messages withheld or unknown, and resets of the estimate."""

from __future__ import annotations

import math

import pytest

from sitl.vehicle import Firmware
from tests.vehicle_peer import Peer

SET_MESSAGE_INTERVAL, ACCEPTED, DENIED, FAILED = 511, 0, 2, 4
ODOMETRY, LOCAL_POSITION_NED = 331, 32


def test_px4_sends_odometry_at_30_hz_as_recorded() -> None:
    peer = Peer()
    peer.run(1.0)
    heard = [message for message in peer.run(4.0) if message.get_type() == "ODOMETRY"]
    assert len(heard) == pytest.approx(120, abs=2)
    assert {(m.frame_id, m.child_frame_id, m.estimator_type, m.quality) for m in heard} == {(1, 1, 8, 0)}
    assert heard[-1].time_usec < 10 * 10**6, "since boot"


def test_ardupilot_knows_no_odometry() -> None:
    peer = Peer(Firmware.ARDUPILOT_ROVER)
    assert peer.command(SET_MESSAGE_INTERVAL, ODOMETRY, 50_000) == [DENIED]
    assert peer.command(SET_MESSAGE_INTERVAL, LOCAL_POSITION_NED, 50_000) == [ACCEPTED]
    assert "ODOMETRY" not in {message.get_type() for message in peer.run(2.0)}


def test_a_build_without_a_message_neither_sends_nor_promises_it() -> None:
    peer = Peer(without_messages=("ODOMETRY",))
    assert "ODOMETRY" not in {message.get_type() for message in peer.run(1.0)}
    assert peer.command(SET_MESSAGE_INTERVAL, ODOMETRY, 20_000) == [FAILED]
    with pytest.raises(ValueError, match="there is no message ODOMETER"):
        Peer(without_messages=("ODOMETER",))


def test_a_withheld_message_is_promised_and_not_sent_until_it_is_released() -> None:
    peer = Peer()
    peer.vehicle.withhold("ODOMETRY", "LOCAL_POSITION_NED")
    assert peer.command(SET_MESSAGE_INTERVAL, ODOMETRY, 20_000) == [ACCEPTED]
    names = {message.get_type() for message in peer.run(1.0)}
    assert not names & {"ODOMETRY", "LOCAL_POSITION_NED"}
    assert "ATTITUDE_QUATERNION" in names
    peer.vehicle.withhold()
    assert {"ODOMETRY", "LOCAL_POSITION_NED"} <= {message.get_type() for message in peer.run(1.0)}


def test_a_reset_moves_the_estimate_counts_and_leaves_the_truth_alone() -> None:
    peer = Peer(initial_yaw_rad=0.2, initially_armed=True)
    peer.run(1.0)
    before = peer.last("ODOMETRY")
    truth = peer.vehicle.truth()
    peer.vehicle.reset_estimator(peer.now_ns, (1.0, -2.0, 0.5), 0.3)
    peer.run(1.0)
    after = peer.last("ODOMETRY")
    assert (before.reset_counter, after.reset_counter) == (0, 1)
    moved = (after.x - before.x, after.y - before.y, after.z - before.z)
    assert moved == pytest.approx((1.0, -2.0, 0.5), abs=1e-5)
    assert peer.last("ATTITUDE").yaw == pytest.approx(0.5, abs=1e-6)
    assert 2.0 * math.atan2(after.q[3], after.q[0]) == pytest.approx(0.5, abs=1e-6)
    local = peer.last("LOCAL_POSITION_NED")
    assert (local.x, local.y, local.z) == pytest.approx((after.x, after.y, after.z))
    assert peer.vehicle.truth().position_ned_m == truth.position_ned_m
    peer.vehicle.reboot(peer.now_ns)
    peer.run(1.0)
    again = peer.last("ODOMETRY")
    assert again.reset_counter == 0
    assert (again.x, again.y, again.z) == pytest.approx(truth.position_ned_m, abs=1e-5)


def test_an_estimator_that_is_wrong_about_its_velocity_says_so_in_every_message() -> None:
    peer = Peer(initially_armed=True)
    peer.run(1.0)
    peer.vehicle.reset_estimator(peer.now_ns, faster_ned_m_s=(1.0, -2.0, 0.5))
    peer.run(1.0)
    local, odometry, absolute = map(peer.last, ("LOCAL_POSITION_NED", "ODOMETRY", "GLOBAL_POSITION_INT"))
    assert (local.vx, local.vy, local.vz) == pytest.approx((1.0, -2.0, 0.5))
    assert (odometry.vx, odometry.vy, odometry.vz) == pytest.approx((1.0, -2.0, 0.5))
    assert (absolute.vx, absolute.vy, absolute.vz) == (100, -200, 50)
    assert peer.vehicle.truth().speed_m_s == 0.0
