"""The link believes one autopilot, counts everything else, and finds losses and reboots."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.sequence import RESTART_AFTER
from tests.mavlink_peer import MS, OFFBOARD, SECOND, Peer, Sender, frame_by_hand

POSITION_MODE = 3 << 16
PX4_HEARTBEAT = (12, 12, 0x81, OFFBOARD, 4, 3)


# Who is believed -----------------------------------------------------------------------------------------


def test_other_systems_and_components_are_counted_and_never_believed() -> None:
    peer = Peer()
    beat = dialect.MAVLink_heartbeat_message(*PX4_HEARTBEAT)
    for system, component in ((255, 190), (2, 1), (1, 154), (1, 191)):
        assert peer.link.receive(Sender(system, component).pack(beat), peer.now) == []
    assert peer.counters == {"other_system": 2, "other_component": 2}
    assert peer.link.heartbeat is None
    assert not peer.link.connected(peer.now)
    assert (peer.link.armed, peer.link.custom_mode, peer.record().received) == (None, None, 0)
    assert peer.heartbeat() == ["HEARTBEAT"]
    assert peer.link.connected(peer.now)
    assert (peer.link.armed, peer.link.custom_mode) == (True, OFFBOARD)


def test_a_ground_station_that_calls_itself_the_autopilot_is_not_one() -> None:
    peer = Peer()
    assert peer.say(dialect.MAVLink_heartbeat_message(6, dialect.MAV_AUTOPILOT_INVALID, 0x81, 0, 4, 3)) == []
    assert peer.counters == {"not_an_autopilot": 1}
    assert not peer.link.connected(peer.now)
    assert peer.link.armed is None


def test_the_heartbeat_keeps_the_link_for_its_time_out() -> None:
    peer = Peer()
    peer.heartbeat()
    assert peer.link.connected(peer.now + 3 * SECOND)
    assert not peer.link.connected(peer.now + 3 * SECOND + 1)


def test_the_mode_is_the_newest_word_of_heartbeat_and_current_mode() -> None:
    peer = Peer()
    peer.heartbeat(POSITION_MODE)
    assert peer.say(dialect.MAVLink_current_mode_message(0, OFFBOARD, OFFBOARD)) == ["CURRENT_MODE"]
    assert (peer.link.custom_mode, peer.link.intended_mode) == (OFFBOARD, OFFBOARD)
    peer.heartbeat(POSITION_MODE, after_ms=50)
    assert (peer.link.custom_mode, peer.link.intended_mode) == (POSITION_MODE, OFFBOARD)


def test_a_mode_that_was_overtaken_on_the_way_is_not_believed() -> None:
    peer = Peer()
    peer.heartbeat(POSITION_MODE, sequence=10)
    peer.say(dialect.MAVLink_current_mode_message(0, OFFBOARD, OFFBOARD), sequence=12)
    assert peer.heartbeat(POSITION_MODE, after_ms=5, sequence=11) == []
    assert peer.link.custom_mode == OFFBOARD
    assert peer.counters == {"late": 1, "overtaken_mode": 1}


def test_a_heartbeat_whose_mode_was_overtaken_is_a_sign_of_life_all_the_same() -> None:
    """With 100 ms of jitter half of them are: counted as lost, 30 % of loss would end the link in minutes."""
    peer = Peer()
    peer.heartbeat(POSITION_MODE, sequence=10)
    peer.say(dialect.MAVLink_current_mode_message(0, OFFBOARD, OFFBOARD), after_ms=1000, sequence=12)
    peer.heartbeat(POSITION_MODE, after_ms=5, sequence=11)
    assert peer.link.heartbeat_ns == peer.now
    assert peer.link.connected(peer.now + 3 * SECOND)
    assert peer.link.custom_mode == OFFBOARD


def test_a_heartbeat_that_was_overtaken_by_the_next_says_nothing() -> None:
    peer = Peer()
    peer.heartbeat(OFFBOARD, sequence=11)
    heard_ns, heartbeat = peer.link.heartbeat_ns, peer.link.heartbeat
    peer.heartbeat(POSITION_MODE, after_ms=5, sequence=10)
    assert (peer.link.heartbeat_ns, peer.link.heartbeat) == (heard_ns, heartbeat)


def test_damaged_frames_are_counted_and_change_nothing() -> None:
    peer = Peer()
    packet = Sender().pack(dialect.MAVLink_heartbeat_message(*PX4_HEARTBEAT))
    for at in range(10, len(packet)):
        assert peer.link.receive(packet[:at] + bytes([packet[at] ^ 0x10]) + packet[at + 1 :], peer.now) == []
    assert peer.link.heartbeat is None
    assert peer.counters["bad_checksum"] == len(packet) - 10


# Losses and order ----------------------------------------------------------------------------------------


def test_losses_are_counted_by_sequence_number_and_across_its_wrap() -> None:
    peer = Peer()
    for sequence in (250, 251, 254, 255, 0, 1, 4, 5):
        assert peer.heartbeat(after_ms=10, sequence=sequence) == ["HEARTBEAT"]
    assert (peer.record().lost, peer.record().received) == (4, 8)
    assert not peer.counters


def test_messages_that_are_not_read_or_not_known_are_not_lost() -> None:
    peer = Peer()
    peer.heartbeat(sequence=7)
    peer.link.receive(frame_by_hand(0xABCDE, b"\1\2", 0, sequence=8), peer.now)
    assert peer.say(dialect.MAVLink_raw_pressure_message(0, 0, 0, 0, 0), sequence=9) == []
    peer.heartbeat(sequence=10)
    assert (peer.record().lost, peer.record().received) == (0, 3), "what cannot be checked proves no peer"
    assert peer.counters == {"unknown_message": 1}


def test_a_forged_frame_of_an_unknown_id_takes_no_true_frames_place() -> None:
    peer = Peer()
    peer.heartbeat(sequence=7)
    peer.link.receive(frame_by_hand(0xABCDE, b"\1\2", 0, sequence=8), peer.now)
    assert peer.attitude(1000, after_ms=5, sequence=8)
    assert peer.counters.get("duplicate", 0) == 0


def test_a_repeated_frame_is_dropped_and_counted() -> None:
    peer = Peer()
    for sequence in (5, 6):
        assert peer.attitude(1000 + sequence, after_ms=5, sequence=sequence)
    assert peer.attitude(1006, sequence=6) == []
    assert peer.attitude(1005, sequence=5) == []
    assert peer.attitude(1007, after_ms=5, sequence=7)
    assert peer.counters == {"duplicate": 2}
    assert peer.record().lost == 0


def test_a_late_frame_is_taken_and_no_longer_counted_as_lost() -> None:
    peer = Peer()
    peer.attitude(1000, sequence=254)
    peer.attitude(1020, after_ms=20, sequence=1)
    assert peer.record().lost == 2
    assert peer.attitude(1010, after_ms=1, sequence=255) == ["ATTITUDE_QUATERNION"]
    assert peer.record().lost == 1
    assert peer.attitude(1010, after_ms=1, sequence=255) == []
    assert peer.counters == {"late": 1, "duplicate": 1}
    assert peer.record().lost == 1


@pytest.mark.parametrize("after", [1, 100, 130, 200, 255, 0])
def test_after_an_outage_nothing_is_called_late(after: int) -> None:
    peer = Peer()
    peer.heartbeat(sequence=0)
    for n in range(5):
        assert peer.heartbeat(after_ms=5000 if n == 0 else 5, sequence=(after + n) % 256) == ["HEARTBEAT"]
    assert not peer.counters
    assert peer.record().lost == 0


def test_a_counter_that_starts_again_is_followed_without_an_outage() -> None:
    peer = Peer()
    for sequence in range(200):
        peer.attitude(1000 + sequence, after_ms=1, sequence=sequence)
    believed = [peer.attitude(1200 + n, after_ms=1, sequence=160 + n % 40) for n in range(RESTART_AFTER + 5)]
    assert believed[-5:] == [["ATTITUDE_QUATERNION"]] * 5
    assert peer.record().lost == 0


# Places --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", [(0, 0), (900_000_001, 1), (-900_000_001, 1), (1, 1_800_000_001)], ids=str)
def test_an_origin_or_home_that_is_nowhere_is_refused_and_counted(place: tuple[int, int]) -> None:
    peer = Peer()
    peer.heartbeat()
    peer.say(dialect.MAVLink_gps_global_origin_message(900_000_000, -1_800_000_000, 3))
    peer.say(dialect.MAVLink_home_position_message(0, 5, 6, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0))
    peer.say(dialect.MAVLink_gps_global_origin_message(*place, 0))
    peer.say(dialect.MAVLink_home_position_message(*place, 0, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0))
    assert peer.link.origin == (900_000_000, -1_800_000_000, 3)
    assert peer.link.home == (0, 5, 6)
    assert peer.counters == {"origin:absurd": 1, "home:absurd": 1}


# Reboots -------------------------------------------------------------------------------------------------


def flying(boot_ms: int = 60_000) -> Peer:
    """A peer that has said all that a link keeps."""
    peer = Peer()
    peer.heartbeat()
    peer.say(dialect.MAVLink_current_mode_message(0, OFFBOARD, OFFBOARD))
    peer.say(dialect.MAVLink_gps_global_origin_message(1, 2, 3))
    for n in range(20):
        peer.attitude(boot_ms + 20 * n, after_ms=20)
    return peer


def test_a_reboot_is_found_once_and_forgets_what_was_said_before() -> None:
    peer = flying()
    believed = [peer.attitude(500 + 20 * n, after_ms=3000 if n == 0 else 20) for n in range(30)]
    assert peer.link.reboots == 1
    assert believed[:3] == [[], [], []]
    assert believed[-15:] == [["ATTITUDE_QUATERNION"]] * 15
    assert peer.counters == {"time_backwards": believed.count([])}
    assert 3 <= believed.count([]) <= 12
    link = peer.link
    assert (link.heartbeat, link.custom_mode, link.intended_mode, link.origin, link.armed) == (None,) * 5
    assert not link.connected(peer.now)
    assert link.vehicle_time_ms == 500 + 20 * 29
    peer.heartbeat()
    assert link.connected(peer.now)


def test_one_late_message_is_no_reboot() -> None:
    peer = flying()
    newest = peer.link.vehicle_time_ms
    assert peer.attitude(5_000, after_ms=1) == []
    assert peer.link.vehicle_time_ms == newest
    assert (peer.link.reboots, peer.counters) == (0, {"time_backwards": 1})


def test_two_late_messages_a_while_apart_are_no_reboot() -> None:
    peer = flying()
    assert peer.attitude(5_000, after_ms=1) == []
    assert peer.attitude(5_001, after_ms=900) == []
    assert peer.attitude(61_500, after_ms=100) == ["ATTITUDE_QUATERNION"]
    assert peer.link.reboots == 0


def test_a_burst_of_late_messages_is_no_reboot() -> None:
    peer = flying()
    for n in range(50):
        assert peer.attitude(5_000 + n, after_ms=2) == []
    assert peer.link.reboots == 0
    assert peer.attitude(60_700, after_ms=2) == ["ATTITUDE_QUATERNION"]


def test_late_messages_among_new_ones_are_never_a_reboot() -> None:
    peer = flying()
    for n in range(200):
        assert peer.attitude(60_500 + 20 * n, after_ms=20)
        assert peer.attitude(20_000 + 20 * n, after_ms=1) == []
        assert peer.attitude(20_010 + 20 * n, after_ms=1) == []
    assert peer.link.reboots == 0
    assert peer.counters == {"time_backwards": 400}
    assert peer.link.armed


def test_a_reboot_shows_by_timesync_before_any_state_is_streamed() -> None:
    peer = flying()
    for n in range(10):
        peer.answer_timesync(61 * SECOND + n * 100 * MS)
        peer.now += 100 * MS
    assert peer.link.clock.synced(peer.now)
    peer.now += 3 * SECOND
    for n in range(6):
        peer.heartbeat()  # alive, with nothing streamed yet
        peer.answer_timesync(2 * SECOND + n * 100 * MS)
        peer.now += 100 * MS
    assert peer.link.reboots == 1
    assert peer.counters == {"timesync_rejected": 3, "clock_set_anew": 1}
    assert peer.link.clock.synced(peer.now)
    assert peer.attitude(2_600) == ["ATTITUDE_QUATERNION"], "and it is not found a second time"
    assert peer.link.reboots == 1


def test_an_absurd_time_is_refused_once_the_clock_is_known() -> None:
    peer = flying()
    for _ in range(5):
        peer.answer_timesync(peer.now - 40 * SECOND)
        peer.now += 100 * MS
    newest = (peer.now - 40 * SECOND) // MS
    assert peer.attitude(newest + 3_600_000) == []
    assert peer.counters == {"from_the_future": 1}
    assert peer.attitude(newest) == ["ATTITUDE_QUATERNION"]
    assert peer.link.reboots == 0


def test_the_intended_mode_is_unknown_when_not_supplied_old_or_of_a_lost_link() -> None:
    peer = Peer()
    peer.heartbeat()
    peer.say(dialect.MAVLink_current_mode_message(0, 6 << 16, 6 << 16))
    assert peer.link.intended_mode == 6 << 16
    seen: list[int | None] = []
    peer.say(dialect.MAVLink_current_mode_message(0, 3 << 16, 0))
    seen.append(peer.link.intended_mode)
    assert seen == [None], "0 is: not supplied"
    peer.say(dialect.MAVLink_current_mode_message(0, 6 << 16, 6 << 16))
    for _ in range(31):
        peer.heartbeat()
        peer.sent(wait_ms=100)
        seen.append(peer.link.intended_mode)
    assert seen[1:30] == [6 << 16] * 29
    assert seen[-1] is None, "not said again for 3 s"


def test_the_age_of_the_uplink_counts_from_the_newest_question_that_was_answered() -> None:
    peer = Peer()
    assert peer.record().uplink_age_s is None
    peer.heartbeat()
    asked_ns = next(m.ts1 for m in peer.sent() if m.get_type() == "TIMESYNC")
    peer.say(dialect.MAVLink_timesync_message(5_000_000, asked_ns), after_ms=10)
    age_s = peer.record().uplink_age_s
    assert age_s == pytest.approx((peer.now - asked_ns) * 1e-9)
    peer.sent(wait_ms=500)
    assert peer.record().uplink_age_s == pytest.approx((peer.now - asked_ns) * 1e-9)


def test_lost_heartbeats_are_forgiven_for_a_while_as_long_as_the_autopilot_is_heard() -> None:
    peer = Peer()
    peer.heartbeat()
    start = peer.now
    last_connected = start
    for n in range(120):
        peer.attitude(1000 + 100 * n, after_ms=100)
        if peer.link.connected(peer.now):
            last_connected = peer.now
    assert last_connected - start == pytest.approx(9e9, abs=0.11e9)
    silent = Peer()
    silent.heartbeat()
    assert silent.link.connected(silent.now + 3_000_000_000)
    assert not silent.link.connected(silent.now + 3_000_000_001)


@pytest.mark.parametrize("synced", [False, True])
def test_odometry_in_unix_time_is_refused_and_moves_no_boot_clock(synced: bool) -> None:
    """The message allows both; believed, all that follows would look old, and then like a reboot."""
    peer = Peer()
    peer.heartbeat()
    if synced:
        for n in range(5):
            peer.now += 100 * MS
            peer.answer_timesync((1000 + 100 * n) * MS)
    nan = [math.nan] * 21

    def odometry(time_usec: int) -> list[str]:
        message = dialect.MAVLink_odometry_message(
            time_usec, 1, 1, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0, 0, 0, 0, nan, nan, 0, 8, 0
        )
        return peer.say(message, after_ms=20)

    assert peer.attitude(1400, after_ms=1) == ["ATTITUDE_QUATERNION"]
    for n in range(20):
        assert odometry(1_700_000_000_000_000 + n * 20_000) == []
    assert peer.counters["not_time_since_boot"] == 20
    assert peer.link.vehicle_time_ms == 1400
    assert odometry(1_820_000) == ["ODOMETRY"]
    assert (peer.link.vehicle_time_ms, peer.link.reboots) == (1820, 0)
