"""While there is no autopilot, the service says what it hears instead and what to look at."""

from __future__ import annotations

import random
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

from guidance.core import Guide
from guidance.records import Status
from sitl.lockstep import Channel
from tests.helpers import make_config, make_flight


def packet(system: int, component: int, message: Any) -> bytes:
    return bytes(message.pack(dialect.MAVLink(None, srcSystem=system, srcComponent=component)))


def heartbeat(system: int, component: int, autopilot: int = 12, *, kind: int | None = None) -> bytes:
    """Of a submarine or, from component 190, of a ground station, unless a `kind` is given."""
    if kind is None:
        kind, autopilot = (6, 8) if component == 190 else (12, autopilot)
    return packet(system, component, dialect.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 4, 3))


RADIO = packet(51, 68, dialect.MAVLink_radio_status_message(180, 170, 100, 40, 40, 0, 0))
SERIAL = 'link.connection="serial:///dev/ttyUSB0?baud=921600"'
TCP = 'link.connection="tcp://127.0.0.1:5760"'
#: A frame of an id that nobody knows: it cannot be checked.
UNKNOWN = b"\xfd\0\0\0\0\x09\x09\xff\xff\xff\0\0"
NOISE = random.Random(1).randbytes(20_000)


@pytest.mark.parametrize(
    ("connection", "heard", "words"),
    [
        ("", [], "no bytes yet: does the autopilot or a router send to this port"),
        (SERIAL, [], "no bytes yet: is it on, RX wired to TX, its port set to MAVLink"),
        ("", [b"U-Boot 2023.04\r\n"], "16 bytes and no MAVLink frame: another program sends to this port"),
        (SERIAL, [NOISE], "20000 bytes and no MAVLink frame: wrong baud rate?"),
        (SERIAL, [heartbeat(2, 1), NOISE], "heard: an autopilot (2/1), no heartbeat of 1/1"),
        (SERIAL, [packet(9, 9, dialect.MAVLink_timesync_message(1, 1)), NOISE], "wrong baud rate?"),
        ("", [UNKNOWN], "12 bytes and no MAVLink frame"),
        (TCP, [b"HTTP/1.1 400 Bad Request\r\n"], "what listens there does not speak MAVLink"),
        ("", [heartbeat(255, 190)], "heard: a ground station (255/190), no heartbeat of 1/1: is vehicle.sy"),
        ("", [heartbeat(2, 1)], "an autopilot (2/1), no heartbeat of 1/1: is it vehicle.system_id = 2, "),
        (SERIAL, [RADIO], "a telemetry radio (51/68), no heartbeat of 1/1: nothing comes through the radio"),
        (
            "",
            [heartbeat(1, 240, 8, kind=18)],
            "a telemetry radio (1/240), no heartbeat of 1/1: nothing",
        ),
        ("", [heartbeat(1, 154, 8, kind=26)], "heard: gimbal (1/154), no heartbeat of 1/1"),
        ("", [packet(1, 1, dialect.MAVLink_timesync_message(1, 1))], "packets of 1/1, but no heartbeat"),
        ("", [packet(9, 9, dialect.MAVLink_timesync_message(1, 1))], "no heartbeat of 1/1: does the router"),
    ],
)
def test_the_reason_names_what_is_heard(connection: str, heard: list[bytes], words: str) -> None:
    guide = Guide(make_config(*filter(None, [connection])))
    for i, data in enumerate(heard):
        guide.receive(data, i)
    guide.tick(10)
    status = next(record for record in guide.records() if isinstance(record, Status))
    assert status.state == "disconnected"
    assert words in status.reason


def test_a_baud_rate_that_is_changed_in_flight_is_named() -> None:
    flight = make_flight(SERIAL)
    flight.run(2.0)
    flight.to_guide = Channel(loss=1.0)
    for _ in range(60):
        flight.run(0.1)
        flight.inject(NOISE[:500])
    reason = flight.guide.engagement.reason
    assert "heartbeat of 1/1 stopped: " in reason
    assert "bytes since, and hardly a MAVLink frame: wrong baud rate?" in reason


def test_an_autopilot_that_falls_silent_is_named() -> None:
    flight = make_flight()
    flight.run(2.0)
    flight.to_guide = Channel(loss=1.0)
    flight.run(6.0)
    assert "heartbeat of 1/1 stopped" in flight.guide.engagement.reason


def test_a_crowd_of_strangers_costs_no_memory() -> None:
    guide = Guide(make_config())
    for system in range(2, 250):
        guide.receive(heartbeat(system, 1), system)
    assert len(guide.link.company.roles) <= 16
    assert guide.link.counters["other_system"] == 248
