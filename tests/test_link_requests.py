"""The link asks and answers: TIMESYNC, requests until they are met, heartbeat and text, and its record."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.messages import MESSAGE_IDS
from guidance.mavlink.outbox import COMPONENT_ID
from guidance.mavlink.streams import Stream
from tests.mavlink_peer import SECOND, Peer, frame_by_hand

#: Of PX4 1.16.0.
VERSION = dialect.MAVLink_autopilot_version_message(
    0, 0x011000FF, 0, 0, 0, bytes(8), bytes(8), bytes(8), 0, 0, 0xABC
)


def names(messages: list[Any]) -> list[str]:
    return [message.get_type() for message in messages]


# TIMESYNC ------------------------------------------------------------------------------------------------


def test_a_timesync_question_is_answered_with_our_time() -> None:
    peer = Peer()
    peer.say(dialect.MAVLink_timesync_message(0, 987654321))
    (answer,) = peer.drained()
    assert (answer.get_type(), answer.tc1, answer.ts1) == ("TIMESYNC", peer.now, 987654321)
    assert (answer.get_srcSystem(), answer.get_srcComponent()) == (1, COMPONENT_ID)


def test_answers_that_were_not_asked_for_or_come_twice_are_ignored() -> None:
    peer = Peer()
    peer.heartbeat()
    (question,) = [m for m in peer.sent() if m.get_type() == "TIMESYNC"]
    assert (question.tc1, question.ts1) == (0, peer.now)
    peer.say(dialect.MAVLink_timesync_message(5 * SECOND, question.ts1 + 1), after_ms=1)
    assert (peer.link.clock.accepted, peer.counters) == (0, {"timesync_not_asked": 1})
    peer.say(dialect.MAVLink_timesync_message(5 * SECOND, question.ts1))
    assert peer.link.clock.accepted == 1
    assert peer.record().round_trip_s == pytest.approx(0.001)
    peer.say(dialect.MAVLink_timesync_message(9 * SECOND, question.ts1))
    assert peer.link.clock.accepted == 1
    assert peer.counters == {"timesync_not_asked": 2}


def test_what_px4_leaves_in_the_target_fields_of_timesync_does_not_matter() -> None:
    peer = Peer()
    peer.heartbeat()
    (question,) = [m for m in peer.sent() if m.get_type() == "TIMESYNC"]
    payload = (5 * SECOND).to_bytes(8, "little") + question.ts1.to_bytes(8, "little") + b"\x88\x35"
    peer.link.receive(frame_by_hand(111, payload, 34, sequence=1), peer.now)
    assert peer.link.clock.accepted == 1


def test_questions_that_nobody_answers_are_forgotten() -> None:
    peer = Peer()
    peer.heartbeat()
    for _ in range(500):
        peer.sent(wait_ms=100)
    assert len(peer.link._questions) <= 32


# Requests ------------------------------------------------------------------------------------------------


def requests_of(messages: list[Any]) -> list[int]:
    """The message ids of REQUEST_MESSAGE."""
    return [
        int(m.param1)
        for m in messages
        if m.get_type() == "COMMAND_LONG" and m.command == 512 and m.target_system == 1
    ]


def test_version_origin_and_home_are_asked_for_until_they_come() -> None:
    version, origin, home = (
        MESSAGE_IDS[n] for n in ("AUTOPILOT_VERSION", "GPS_GLOBAL_ORIGIN", "HOME_POSITION")
    )
    peer = Peer()
    assert requests_of(peer.sent()) == [], "nobody is there"
    peer.heartbeat()
    assert requests_of(peer.sent()) == [version, origin, home]
    assert requests_of(peer.sent(wait_ms=500)) == []
    assert requests_of(peer.sent(wait_ms=500)) == [version, origin, home]
    peer.say(dialect.MAVLink_gps_global_origin_message(473977418, 85455939, 488000))
    assert requests_of(peer.sent(wait_ms=1000)) == [version, home]
    peer.say(VERSION)
    peer.say(dialect.MAVLink_home_position_message(1, 2, 3, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0))
    assert requests_of(peer.sent(wait_ms=1000)) == []
    assert peer.link.origin == (473977418, 85455939, 488000)
    assert peer.link.home == (1, 2, 3)


def test_our_heartbeat_goes_out_every_second_whoever_listens() -> None:
    peer = Peer()
    beats = []
    for _ in range(40):
        beats += [m for m in peer.sent(wait_ms=100) if m.get_type() == "HEARTBEAT"]
    assert len(beats) == 4
    assert {(b.type, b.autopilot, b.get_srcSystem(), b.get_srcComponent()) for b in beats} == {
        (18, 8, 1, 191)
    }
    assert peer.link.deadline() <= peer.now + SECOND


def test_streams_are_asked_for_and_a_denial_is_heard() -> None:
    peer = Peer(Stream("ATTITUDE_QUATERNION", 50.0))

    def intervals(wait_ms: float = 100.0) -> list[float]:
        return [m.param2 for m in peer.sent(wait_ms) if m.get_type() == "COMMAND_LONG" and m.command == 511]

    def acknowledge(result: int, system: int = 1, component: int = 191) -> list[str]:
        return peer.say(dialect.MAVLink_command_ack_message(511, result, 0, 0, system, component))

    peer.heartbeat()
    assert intervals() == [20000.0]
    assert acknowledge(2, system=255, component=190) == []
    assert peer.counters == {"ack_for_another": 1}
    assert intervals() == []
    assert acknowledge(2) == ["COMMAND_ACK"]
    assert intervals() == [25000.0]
    assert acknowledge(1) == ["COMMAND_ACK"], "temporarily rejected: no reason to ask for less"
    assert intervals(2100.0) == [25000.0]
    assert acknowledge(0, 0, 0) == ["COMMAND_ACK"], "ArduPilot's older ones name no target"


# Out and telemetry ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "sent"),
    [
        ("guidance: ready", "guidance: ready"),
        ("x" * 70, "x" * 50),
        ("Höhe 3 µm → 4", "H?he 3 ?m ? 4"),
        ("a\x1b[31mred\x07", "a?[31mred?"),
        ("", ""),
    ],
)
def test_status_text_is_cut_to_fifty_bytes_and_plain(text: str, sent: str) -> None:
    peer = Peer()
    peer.link.outbox.status_text(4, text)
    (message,) = peer.drained()
    assert (message.get_type(), message.severity, message.text) == ("STATUSTEXT", 4, sent)


def test_the_record_says_who_is_heard_and_how_well() -> None:
    peer = Peer(Stream("ATTITUDE_QUATERNION", 50.0))
    empty = peer.record()
    assert (empty.connected, empty.heartbeat_age_s, empty.autopilot, empty.autopilot_uid) == (
        False,
        None,
        "",
        "",
    )
    assert (empty.round_trip_s, empty.clock_offset_ns, empty.clock_drift_ppm) == (None, None, None)
    peer.heartbeat()
    peer.say(VERSION)
    peer.answer_timesync(7 * SECOND)
    peer.now += SECOND // 2
    record = peer.record()
    assert (record.t_ns, record.connected, record.heartbeat_age_s) == (peer.now, True, 0.5)
    assert (record.autopilot, record.vehicle_type) == ("MAV_AUTOPILOT_PX4", "MAV_TYPE_SUBMARINE")
    assert (record.autopilot_version, record.autopilot_uid) == ("1.16.0", "0000000000000abc")
    assert (record.received, record.lost, record.reboots) == (3, 0, 0)
    assert record.clock_offset_ns == peer.now - SECOND // 2 - 7 * SECOND
    assert record.clock_drift_ppm == 0.0
    assert [stream.message for stream in record.streams] == ["ATTITUDE_QUATERNION"]
    peer.say(dialect.MAVLink_heartbeat_message(250, 200, 0, 0, 4, 3))
    assert (peer.record().autopilot, peer.record().vehicle_type) == ("200", "250"), "numbers without a name"


def test_nothing_is_said_twice() -> None:
    peer = Peer()
    assert names(peer.sent()) == ["HEARTBEAT"]
    assert names(peer.drained()) == []
