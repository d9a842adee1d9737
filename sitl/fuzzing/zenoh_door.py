"""Zenoh's door: what strangers publish on our keys, read by all that listens to vehicles."""

from __future__ import annotations

import hashlib
import io
from contextlib import closing
from functools import cache
from typing import Any, Final

import msgspec
from rich.console import Console

from guidance.fleet import Fleet
from guidance.records import LOG_ONLY, SCHEMA_VERSION, TOPICS, Record, Session
from guidance.telemetry.arrivals import VEHICLE, VEHICLES_MAX, Heard, Ignored, Presence, read
from guidance.telemetry.foxglove_view import View
from guidance.telemetry.queue import Sample
from guidance.telemetry.schema import encoding_schema
from guidance.watch_view import Connection, ignored_line, line, screen
from sitl.fuzzing.corpus import flight_records
from sitl.fuzzing.dice import Dice
from sitl.fuzzing.oracle import Broken
from sitl.fuzzing.sizes import longest

#: No container behind this door may be longer, whatever was published: 500 setpoints of a vehicle are kept.
CONTAINER_MAX: Final = 550
#: What was ignored is counted by vehicle and kind; strangers can think of more than anybody reads.
KINDS_MAX: Final = 60
_NAMES: Final = ("demo", "uuv-1", "a" * 64)
_PUBLISHED: Final = tuple(topic for topic in TOPICS.values() if topic not in LOG_ONLY)
_LAST_NS: Final = (1 << 63) - 1


@cache
def published() -> dict[str, list[bytes]]:
    """Payloads of each topic, of a flight."""
    encode = msgspec.json.Encoder().encode
    found: dict[str, list[bytes]] = {topic: [] for topic in _PUBLISHED}
    for record in flight_records():
        topic = TOPICS[type(record)]
        if topic in found and len(found[topic]) < 40:
            found[topic].append(encode(record))
    return found


class ZenohDoor:
    """One sample or token after the other into the fleet, its views and Foxglove's; `newest` shows it."""

    inputs = 1500
    scene = "strangers on our keys"

    def __init__(self, dice: Dice) -> None:
        self.newest = ""
        self._dice = dice
        self._now_ns = dice.choice((0, 1, 10**12, 2**62))
        self._fleet = Fleet()
        self._views: dict[str, View] = {}
        self._digest = hashlib.sha256()
        self._encode = msgspec.json.Encoder().encode

    def feed(self) -> None:
        """One input."""
        dice, fleet = self._dice, self._fleet
        self._now_ns += dice.choice((0, 1000, 10**7, 10**8, 10**9, 10**10))
        name = self._name()
        if dice.chance(0.05):
            here = dice.chance(0.5)
            self.newest = f"the token of {name!r}, {'here' if here else 'gone'}"
            if VEHICLE.fullmatch(name):  # the subscriber takes no others
                fleet.take([Presence(self._now_ns, name, here)])
        else:
            topic = dice.choice(_PUBLISHED) if dice.chance(0.95) else dice.text().replace("/", "") or "x"
            payload, encoding = self._payload(topic), self._encoding(topic)
            self.newest = f"under guidance/{name}/{topic} as {encoding!r}: {payload!r}"
            came = read(self._now_ns, f"guidance/{name}/{topic}", encoding, payload, dice.chance(0.2))
            fleet.take([came])
            self._digest.update(repr(came).encode("utf-8", "backslashreplace"))
            if isinstance(came, Heard):
                self._view(came.vehicle, came.record)
            elif not isinstance(came, Ignored):
                raise Broken(f"a payload is {came!r}")
        if dice.chance(0.02):
            self._look()

    def finish(self) -> bytes:
        """The screen once more, and memory."""
        self.newest = "the end: the screen, then what is kept"
        self._look()
        kept = {"fleet": self._fleet, "views": self._views}
        found = longest(kept, inside_records=False)
        if found.length > CONTAINER_MAX:
            raise Broken(f"{found.path} has grown to {found.length}")
        if len(self._fleet.ignored) > KINDS_MAX:
            raise Broken(f"{len(self._fleet.ignored)} kinds of what was ignored are kept")
        return self._digest.digest()

    def _name(self) -> str:
        dice = self._dice
        kind = dice.random()
        if kind < 0.5:
            return dice.choice(_NAMES)
        if kind < 0.9:
            return f"v{dice.randrange(10_000)}"
        return dice.text().replace("/", "") or "x"

    def _encoding(self, topic: str) -> str:
        dice = self._dice
        known = topic if topic in _PUBLISHED else dice.choice(_PUBLISHED)
        right = f"application/json;{encoding_schema(known)}"
        kind = dice.random()
        if kind < 0.8:
            return right
        if kind < 0.9:
            return right.rpartition("/")[0] + f"/{dice.choice((0, 2, 7, 999999, 1000000, SCHEMA_VERSION))}"
        return dice.mutated(right.encode()).decode("utf-8", "replace") if kind < 0.95 else dice.text()

    def _payload(self, topic: str) -> bytes:
        dice = self._dice
        real = dice.choice(published().get(topic) or [b"{}"])
        kind = dice.random()
        if kind < 0.25:
            return real
        if kind < 0.35:
            return dice.mutated(real)
        if kind < 0.4:
            return dice.json()
        if kind < 0.42:
            return real + b" " * (1 << 18)
        if kind < 0.45:  # a field that is not known may hold anything
            return real[:-1] + b',"new":' + dice.json() + b"}"
        value: Any = msgspec.json.decode(real)
        for _ in range(dice.choice((1, 1, 2, 6))):
            value = dice.changed(value)
        made: bytes = self._encode(value)
        if kind > 0.9 and b":" in made:  # JSON that no encoder would write
            fields = made.split(b":")
            fields[dice.randrange(1, len(fields))] = dice.json() + dice.choice((b"", b"}", b',"x"'))
            made = b":".join(fields)
        return made

    def _view(self, vehicle: str, record: Record) -> None:
        if isinstance(record, Session) and (vehicle in self._views or len(self._views) < 5):
            self._views[vehicle] = View(record.unix_offset_ns, vehicle)
        view = self._views.get(vehicle)
        if view is not None:
            for made in view.of(Sample(TOPICS[type(record)], record.t_ns, self._encode(record))):
                self._digest.update(made.payload)

    def _look(self) -> None:
        fleet, dice = self._fleet, self._dice
        seen = fleet.look(self._now_ns)
        if len(seen) > VEHICLES_MAX:
            raise Broken(f"{len(seen)} vehicles are kept")
        told = [line(vehicle) for vehicle in seen]
        told.append(ignored_line(fleet.ignored))
        for text in told:
            if any(ord(mark) < 32 or 127 <= ord(mark) < 160 for mark in text):
                raise Broken(f"a line that steers a terminal: {text!r}")
            self._digest.update(text.encode())
        for vehicle in seen:
            self._encode(vehicle)
        if not dice.chance(0.3):
            return
        width, height = dice.choice(((80, 24), (160, 40), (40, 8)))
        drawn = io.StringIO()
        with closing(drawn):
            console = Console(file=drawn, width=width, height=height, force_terminal=False, highlight=False)
            connection = Connection("", 1, ("tcp/127.0.0.1:7447",))
            offset_ns = 1_700_000_000_000_000_000
            console.print(
                screen(
                    seen,
                    fleet.notes,
                    fleet.ignored,
                    connection,
                    width=width,
                    height=height,
                    unix_offset_ns=offset_ns,
                )
            )
            if len(drawn.getvalue().splitlines()) > height:
                raise Broken("the screen is higher than the terminal")
