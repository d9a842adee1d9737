"""A ground station commands this component and tunes it over MAVLink, as far as the configuration lets it."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink

from guidance.component import CUSTOM_MODES
from guidance.ground import REPEAT_NS, TEXT_NS, TEXTS_AT_ONCE
from guidance.mavlink.codec import PacketWriter, Payload
from guidance.mavlink.outbox import Outbox
from guidance.mavlink.signing import KEY_BYTES
from guidance.records import Answer, Link, Record
from guidance.replay import replay
from guidance.supervisor import State
from sitl.lockstep import Lockstep
from sitl.logbook import LogBook
from tests.ground_station import COMPONENT, MAY, PILOT, GroundStation, ready, texts_of, tracking
from tests.helpers import (
    events_of,
    fly_until,
    fly_until_tracking,
    make_config,
    make_flight,
    records_of,
    state_of,
)

CUSTOM = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
MODE, PAUSE = mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_CMD_DO_PAUSE_CONTINUE
ENGAGE, HOLD, ABORT = (float(CUSTOM_MODES[s]) for s in (State.TRACKING, State.HOLDING, State.READY))
OK, LATER, DENIED = (
    mavlink.MAV_RESULT_ACCEPTED,
    mavlink.MAV_RESULT_TEMPORARILY_REJECTED,
    mavlink.MAV_RESULT_DENIED,
)


def answers(flight: Lockstep) -> list[tuple[str, bool, bool]]:
    return [(a.order, a.accepted, a.repeated) for a in records_of(flight, Answer)]


# Commands --------------------------------------------------------------------------------------------


def test_a_flight_is_engaged_held_resumed_and_aborted_by_mavlink_alone() -> None:
    flight, ground = ready()
    assert ground.command(MODE, CUSTOM, ENGAGE) == [(MODE, OK)]
    fly_until_tracking(flight)
    flight.run(1.0)
    assert ground.command(PAUSE, 0.0) == [(PAUSE, OK)]
    fly_until(flight, State.HOLDING)
    assert ground.command(PAUSE, 1.0) == [(PAUSE, OK)]
    fly_until_tracking(flight)
    assert ground.command(MODE, CUSTOM, HOLD) == [(MODE, OK)]
    fly_until(flight, State.HOLDING)
    assert ground.command(MODE, CUSTOM, ENGAGE) == [(MODE, OK)]  # of what is held: resume
    fly_until_tracking(flight)
    assert ground.command(MODE, CUSTOM, ABORT) == [(MODE, OK)]
    fly_until(flight, State.ABORTED)
    assert [a.source for a in records_of(flight, Answer)] == ["mavlink 255/190"] * 6


def test_the_heartbeat_shows_the_state() -> None:
    flight, ground = ready()
    ground.hear()
    shown = []
    for state in (State.READY, State.TRACKING):
        if state is State.TRACKING:
            ground.command(MODE, CUSTOM, ENGAGE)
            fly_until_tracking(flight)
        flight.run(1.1)
        beat = ground.hear("HEARTBEAT")[-1]
        shown.append((beat.base_mode, beat.custom_mode, beat.system_status))
        assert (beat.type, beat.autopilot) == (18, 8)  # no autopilot, whatever it says of modes
    assert shown == [
        (CUSTOM, CUSTOM_MODES[State.READY], mavlink.MAV_STATE_STANDBY),
        (CUSTOM, CUSTOM_MODES[State.TRACKING], mavlink.MAV_STATE_ACTIVE),
    ]


def test_every_state_has_a_number_of_its_own() -> None:
    assert set(CUSTOM_MODES) == set(State)
    assert len(set(CUSTOM_MODES.values())) == len(State)


def test_what_is_refused_now_is_rejected_for_a_time_and_says_why() -> None:
    flight, ground = ready()
    ground.hear()
    assert ground.command(PAUSE, 0.0) == [(PAUSE, LATER)]
    ground = GroundStation(flight)
    ground.say(mavlink.MAVLink_command_long_message(1, COMPONENT, PAUSE, 0, 1, 0, 0, 0, 0, 0, 0))
    (text,) = texts_of(ground.hear())
    assert text.startswith("guidance: resume refused: ready")


@pytest.mark.parametrize(
    ("command", "params"),
    [
        (PAUSE, (0.5,)),
        (PAUSE, (float("nan"),)),
        (MODE, (0.0, ENGAGE)),
        (MODE, (float("nan"), ENGAGE)),
        (MODE, (float("inf"), ENGAGE)),
        (MODE, (CUSTOM, 99.0)),
        (MODE, (CUSTOM, float("nan"))),
    ],
)
def test_what_cannot_be_obeyed_ever_is_denied(command: int, params: tuple[float, ...]) -> None:
    flight, ground = ready()
    assert ground.command(command, *params) == [(command, DENIED)]
    assert answers(flight) == []


def test_other_commands_are_unsupported_and_a_command_int_wants_to_be_long() -> None:
    _, ground = ready()
    arm = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
    assert ground.command(arm, 1.0) == [(arm, mavlink.MAV_RESULT_UNSUPPORTED)]
    ground.say(mavlink.MAVLink_command_int_message(1, COMPONENT, 0, PAUSE, 0, 0, 0, 0, 0, 0, 0, 0, 0))
    assert [(a.command, a.result) for a in ground.acks()] == [(PAUSE, mavlink.MAV_RESULT_COMMAND_LONG_ONLY)]


def test_a_command_is_obeyed_once_however_often_it_is_transmitted() -> None:
    flight, ground = ready()
    packet = ground.pack(
        mavlink.MAVLink_command_long_message(1, COMPONENT, MODE, 0, CUSTOM, ENGAGE, 0, 0, 0, 0, 0)
    )
    ground.hear()
    for _ in range(3):
        flight.inject(packet)
    assert [a.result for a in ground.acks()] == [OK] * 3
    assert ground.command(MODE, CUSTOM, ENGAGE, confirmation=1) == [(MODE, OK)]
    assert answers(flight) == [("engage", True, False)] + [("engage", True, True)] * 3
    assert events_of(flight, "engage") == ["engage commanded (by mavlink 255/190)"]
    fly_until_tracking(flight)
    # Not confirmed anew but ordered anew: another order, of another packet.
    assert ground.command(MODE, CUSTOM, ENGAGE) == [(MODE, OK)]
    assert answers(flight)[-1] == ("engage", True, False)


def test_a_transmission_repeated_after_a_resume_is_answered_the_same() -> None:
    """DO_SET_MODE to `tracking` resumes what is held; by the time that it comes again it would engage."""
    flight, ground = tracking()
    ground.command(PAUSE, 0.0)
    fly_until(flight, State.HOLDING)
    assert ground.command(MODE, CUSTOM, ENGAGE) == [(MODE, OK)]
    fly_until(flight, State.STREAMING)
    assert ground.command(MODE, CUSTOM, ENGAGE, confirmation=1) == [(MODE, OK)]
    assert answers(flight)[-2:] == [("resume", True, False), ("resume", True, True)]


def test_a_flood_of_refused_commands_is_not_answered_by_a_flood_of_texts() -> None:
    """An answer may need five packets, on a line that must carry the setpoints."""
    flight, ground = ready()
    ground.hear()
    start_ns = flight.now_ns
    for _ in range(400):
        ground.say(mavlink.MAVLink_command_long_message(1, COMPONENT, PAUSE, 0, 0, 0, 0, 0, 0, 0, 0))
        flight.run(0.005)
    seconds = (flight.now_ns - start_ns) * 1e-9
    heard = ground.hear()
    assert sum(m.get_type() == "COMMAND_ACK" for m in heard) == 400  # each is answered all the same
    texts = texts_of(heard)
    assert set(texts) == {"guidance: hold refused: ready: not tracking"}
    assert 5 <= len(texts) <= TEXTS_AT_ONCE + seconds / (TEXT_NS * 1e-9) + 1
    assert flight.guide.link.company.counters["refusals_not_said"] == 400 - len(texts)


def test_a_first_transmission_that_was_lost_is_made_up_for() -> None:
    flight, ground = ready()
    assert ground.command(MODE, CUSTOM, ENGAGE, confirmation=2) == [(MODE, OK)]
    fly_until_tracking(flight)


def test_a_late_transmission_does_not_undo_what_was_ordered_since() -> None:
    flight, ground = ready()
    ground.command(MODE, CUSTOM, ENGAGE)
    fly_until_tracking(flight)
    ground.command(MODE, CUSTOM, ABORT)
    fly_until(flight, State.ABORTED)
    ground.hear()
    late = mavlink.MAVLink_command_long_message(1, COMPONENT, MODE, 1, CUSTOM, ENGAGE, 0, 0, 0, 0, 0)
    ground.say(late)
    heard = ground.hear()
    assert [m.result for m in heard if m.get_type() == "COMMAND_ACK"] == [LATER]
    assert texts_of(heard) == ["guidance: repeated, but another order came in between: send it anew"]
    flight.run(2.0)
    assert state_of(flight) is State.ABORTED
    flight.run(REPEAT_NS * 1e-9)
    ground.say(late)
    assert [a.result for a in ground.acks()] == [OK]


@pytest.mark.parametrize("length", [1, 50, 51, 99, 100, 199, 200, 500])
def test_a_long_reason_comes_in_parts_that_belong_together(length: int) -> None:
    outbox = Outbox(1, 1)
    said = "".join(chr(ord("a") + i % 26) for i in range(length))
    for _ in range(2):  # each with an id of its own
        outbox.long_text(mavlink.MAV_SEVERITY_WARNING, said)
    reader = mavlink.MAVLink(None)
    parts = [m for data in outbox.drain() for m in reader.parse_buffer(data) or []]
    assert texts_of(parts) == [said[:200]] * 2
    ended = [m for m in parts if len(m.text) < 50]  # how a receiver knows that no other follows
    assert len(ended) == (0 if length == 50 else 2)
    assert [m.chunk_seq for m in parts] == [*range(len(parts) // 2)] * 2


# Who may ---------------------------------------------------------------------------------------------


def test_nobody_may_unless_it_is_configured_and_then_only_to_this_component() -> None:
    for overrides, system, component in (
        ((), 255, COMPONENT),
        (("link.commands_from=[254]",), 255, COMPONENT),
        (MAY, 254, COMPONENT),
        (MAY, 255, 0),
        (MAY, 255, 1),
        (MAY, 255, 192),
    ):
        flight = make_flight("supervisor.engage=pilot", *overrides)
        fly_until(flight, State.READY)
        ground = GroundStation(flight, system)
        assert ground.command(MODE, CUSTOM, ENGAGE, component=component) == []
        ground.say(mavlink.MAVLink_param_set_message(1, component, b"LAW_K", 0.5, 9))
        if system != 255 or overrides != MAY:
            ground.say(mavlink.MAVLink_param_request_list_message(1, component))
        flight.run(2.0)
        assert ground.hear("PARAM_VALUE") == []
        assert records_of(flight, Answer) == []
        assert state_of(flight) is State.READY
        counted = records_of(flight, Link)[-1].counters.get("asks_not_heeded", 0)
        assert counted == (3 if component == COMPONENT else 0)


def test_on_a_signed_link_only_signed_orders_are_heeded(tmp_path: Path) -> None:
    key = bytes(range(KEY_BYTES))
    path = tmp_path / "key"
    path.write_bytes(key)
    flight = make_flight(*PILOT, f'link.signing_key_file="{path}"', signing_key=key)
    fly_until(flight, State.READY)
    for stranger in (GroundStation(flight), GroundStation(flight, key=bytes(KEY_BYTES))):
        assert stranger.command(MODE, CUSTOM, ENGAGE) == []
        stranger.set("LAW_K", 0.5)
    assert records_of(flight, Answer) == []
    friend = GroundStation(flight, key=key)
    assert friend.command(MODE, CUSTOM, ENGAGE) == [(MODE, OK)]
    fly_until_tracking(flight)


# All of it -------------------------------------------------------------------------------------------


def test_a_flight_that_was_commanded_replays_to_the_bit(tmp_path: Path) -> None:
    config = make_config(*PILOT)
    flight = make_flight(config=config)
    with LogBook(config, tmp_path) as book:

        def keep(record: Record) -> None:
            flight.records.append(record)
            book.add(record)

        flight.on_record = keep
        fly_until(flight, State.READY)
        ground = GroundStation(flight)
        ground.command(MODE, CUSTOM, ENGAGE)
        ground.say(mavlink.MAVLink_param_request_list_message(1, 0))
        fly_until_tracking(flight)
        ground.set("LAW_RHO2", 4.0)
        ground.set("LAW_RHO2", 4e9)
        flight.run(2.0)
        ground.command(PAUSE, 0.0)
        flight.run(2.0)
    found = replay(book.path)
    assert found.identical, found


FLYING = make_flight(*MAY)
#: Where each message says for whom it is.
TARGETS = {20: 2, 21: 0, 23: 4, 75: 30, 76: 30}


@given(st.sampled_from(list(TARGETS)), st.binary(max_size=40))
def test_no_payload_raises_anything(message_id: int, payload: bytes) -> None:
    target = TARGETS[message_id]
    whole = bytearray(payload.ljust(target + 3, b"\0"))
    whole[target : target + 2] = bytes([1, COMPONENT])
    FLYING.inject(PacketWriter(255, 190).pack(Payload(message_id, bytes(whole))))
    FLYING.run(0.02)
