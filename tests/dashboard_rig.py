"""A hub of the dashboard on virtual time, and what its vehicles say."""

from __future__ import annotations

import json
from typing import Any

from msgspec.structs import replace

from guidance.dashboard.hub import Hub
from guidance.dashboard.rows import COLUMNS, ROW
from guidance.records import TOPICS, Record
from guidance.telemetry.arrivals import Answered, Arrival, Heard
from tests.fleet_rig import MS, S, error, session, setpoint, state, status

TICK_NS = 50 * MS
T0 = 100 * S


class Flown:
    """A hub, and what its vehicles say."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.hub = Hub(self.asked.append)
        self.now_ns = T0

    def turn(self, *arrivals: Arrival) -> list[Answered]:
        self.now_ns += TICK_NS
        return self.hub.turn(arrivals, self.now_ns)

    def heard(self, *records: Record, vehicle: str = "uuv-1", answered: bool = False) -> list[Heard]:
        return [Heard(self.now_ns, vehicle, TOPICS[type(one)], one, answered) for one in records]

    def fly(self, turns: int, vehicle: str = "uuv-1") -> None:
        for _ in range(turns):
            t_ns = self.now_ns
            said = self.heard(
                state(t_ns), error(t_ns, 0.5), setpoint(t_ns, t_ns // MS), status(t_ns), vehicle=vehicle
            )
            self.turn(*said)

    def rows(self, vehicle: str = "uuv-1") -> list[dict[str, float]]:
        whole = self.hub.ring(vehicle)
        return [
            dict(zip(COLUMNS, ROW.unpack_from(whole, at), strict=True))
            for at in range(0, len(whole), ROW.size)
        ]


def configured(**tables: Any) -> Record:
    return replace(session("aa"), config_json=json.dumps(tables))
