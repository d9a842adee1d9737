"""While there is no autopilot, the service says what it hears instead and what to look at."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

from guidance.core import Guide
from guidance.records import Status
from sitl.lockstep import Channel
from tests.helpers import make_config, make_flight


def packet(system: int, component: int, message: Any) -> bytes:
    return bytes(message.pack(dialect.MAVLink(None, srcSystem=system, srcComponent=component)))


def heartbeat(system: int, component: int, autopilot: int = 8) -> bytes:
    return packet(system, component, dialect.MAVLink_heartbeat_message(6, autopilot, 0, 0, 4, 3))


@pytest.mark.parametrize(
    ("heard", "words"),
    [
        ([], "no bytes yet"),
        ([b"U-Boot 2023.04\r\n"], "16 bytes, but no heartbeat of 1/1: is this a MAVLink port"),
        ([heartbeat(255, 190)], "heartbeats of 255/190, none of 1/1: is vehicle.system_id right"),
        ([heartbeat(2, 1, 12), heartbeat(1, 154)], "heartbeats of 1/154, 2/1, none of 1/1"),
        ([packet(1, 1, dialect.MAVLink_timesync_message(1, 1))], "packets of 1/1, but no heartbeat"),
    ],
)
def test_the_reason_names_what_is_heard(heard: list[bytes], words: str) -> None:
    guide = Guide(make_config())
    for i, data in enumerate(heard):
        guide.receive(data, i)
    guide.tick(10)
    status = next(record for record in guide.records() if isinstance(record, Status))
    assert status.state == "disconnected"
    assert words in status.reason


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
    assert len(guide.link.others) <= 16
    assert guide.link.counters["other_system"] == 248
