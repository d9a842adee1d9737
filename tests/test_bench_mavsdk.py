"""MAVSDK's part in the latency bench is the service's job: the same setpoint of the same state."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

from guidance.core import Guide
from guidance.supervisor import State
from sitl.timing_autopilot import HEADINGS_RAD, POSITION_NED_M, SETTINGS, Conversation, attitude, yaw_rates
from tests.helpers import make_config

PERIOD_NS = 20_000_000


@pytest.fixture
def bench_mavsdk(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The module on stand-ins for MAVSDK, which is an extra, too large for the tests."""
    names = {
        "mavsdk": ("ComponentType", "Configuration", "Mavsdk"),
        "mavsdk.plugins": (),
        "mavsdk.plugins.offboard": ("Offboard",),
        "mavsdk.plugins.telemetry": ("Telemetry",),
    }
    for module, contents in names.items():
        monkeypatch.setitem(sys.modules, module, SimpleNamespace(**dict.fromkeys(contents)))
    sys.modules["mavsdk.plugins.offboard"].__dict__["AttitudeRate"] = lambda *fields: fields
    monkeypatch.delitem(sys.modules, "sitl.bench_mavsdk", raising=False)
    yield import_module("sitl.bench_mavsdk")
    sys.modules.pop("sitl.bench_mavsdk")


class Vehicle:
    """MAVSDK's Telemetry and Offboard in one: states by `fly`, setpoints in `sent`."""

    def __init__(self) -> None:
        self.sent: list[tuple[float, ...]] = []

    def subscribe_position_velocity_ned(self, take: Callable[[Any, Any], None]) -> None:
        self._position = take

    def subscribe_attitude_quaternion(self, take: Callable[[Any, Any], None]) -> None:
        self._attitude = take

    def set_attitude_rate(self, fields: tuple[float, ...]) -> None:
        self.sent.append(fields)

    def stand(self) -> None:
        n, e, d = POSITION_NED_M
        self._position(SimpleNamespace(position=SimpleNamespace(north_m=n, east_m=e, down_m=d)), None)

    def turn(self, heading_rad: float) -> None:
        w, x, y, z = attitude(heading_rad)
        self._attitude(SimpleNamespace(w=w, x=x, y=y, z=z), None)


def setpoints_of_the_service() -> list[tuple[float, ...]]:
    """Body rates (rad/s) and thrust that the service answers to each heading."""
    config = make_config(*SETTINGS)
    guide, autopilot = Guide(config), Conversation(yaw_rates(config), boot_ns=0)
    parser = dialect.MAVLink(None)
    found: dict[int, tuple[float, ...]] = {}

    def exchange(datagrams: list[bytes], now_ns: int) -> None:
        for datagram in datagrams:
            guide.receive(datagram, now_ns)
        guide.tick(now_ns)
        for packet in guide.packets():
            heading = autopilot.take(packet, now_ns)
            if heading is not None and guide.engagement.state is State.TRACKING:
                (told,) = parser.parse_buffer(packet)
                rates = (told.body_roll_rate, told.body_pitch_rate, told.body_yaw_rate)
                found[heading] = (*rates, told.thrust)

    for i in range(250):
        now_ns = 1_000_000_000 + i * PERIOD_NS
        autopilot.tick(now_ns)
        exchange(autopilot.drain(), now_ns)
        exchange(autopilot.drain(), now_ns)
        exchange([autopilot.state(i % len(HEADINGS_RAD), now_ns)], now_ns)
    return [found[heading] for heading in range(len(HEADINGS_RAD))]


def test_it_answers_each_state_as_the_service_does(bench_mavsdk: ModuleType) -> None:
    vehicle = Vehicle()
    bench_mavsdk.follow(make_config(*SETTINGS), vehicle, vehicle)
    vehicle.turn(0.0)
    assert vehicle.sent == []  # no position yet
    vehicle.stand()
    for heading_rad in HEADINGS_RAD:
        vehicle.turn(heading_rad)
    sent = [(*map(math.radians, fields[:3]), fields[3]) for fields in vehicle.sent]
    for ours, theirs in zip(setpoints_of_the_service(), sent, strict=True):
        assert theirs == pytest.approx(ours, abs=1e-4)
