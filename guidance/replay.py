"""A log's inputs through the core again: the same packets and records must come out, to the bit.

The log says what entered (topic `input`), under which configuration (`session`) and what came out. Replay
feeds the inputs to a fresh core and compares all that it emits with the log, byte by byte of the JSON that
both are published as.

The key of a signed link is in no log. So the 6 bytes of each packet of ours that the key made are left out
of the comparison (not its link id and timestamp); and of what came, the log says whose signature was bad.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from msgspec.structs import replace

from guidance import config
from guidance.core import Guide
from guidance.mavlink.signing import Signing, without_hash
from guidance.records import NOT_A_RECORD, SCHEMA_VERSION, TOPICS, Input, Lost, Packet, Session, Timing
from guidance.telemetry.log import LogDamaged, Passed
from guidance.telemetry.log_parts import PartMissing, read_run

#: Written by the shell or the recorder, or counting what these did; the core decides nothing by them.
_NOT_COMPARED = frozenset({TOPICS[Session], TOPICS[Input], TOPICS[Lost], TOPICS[Timing]})


class ReplayError(Exception):
    """The log cannot be replayed; the text says why."""


class _Wrote(msgspec.Struct):
    """What every version's session record says."""

    schema_version: int
    guidance_version: str


class Difference(NamedTuple):
    """The first thing that came out otherwise: when (s after the first input), topic, field, both values."""

    time_s: float
    topic: str
    field: str
    logged: object
    replayed: object

    def __str__(self) -> str:
        where = f"{self.topic}.{self.field}" if self.field else self.topic
        return f"at {self.time_s:.6f} s {where}: logged {self.logged!r}, replayed {self.replayed!r}"


class Replay(NamedTuple):
    """What a replay found. `stopped` says in words why it ended before the log did, empty if it did not."""

    inputs: int
    compared: int
    setpoints: int
    tracked: int
    flight_s: float
    difference: Difference | None
    stopped: str

    @property
    def identical(self) -> bool:
        """Everything was compared, all of it is the same, and the flight did track."""
        return self.difference is None and not self.stopped and self.tracked > 0


def replay(path: Path, tolerance: float = 0.0, passed: Passed | None = None) -> Replay:
    """Feed the log's inputs to the core and compare; raises ReplayError, NotALog.

    Fractions in the records may differ by `tolerance`; all else, and every packet, is compared exactly.

    Of a run whose log went on in further files any one may be given: all are replayed, from the first on.
    """
    messages = lines_of(path, passed)
    settings = _configuration(path, messages)
    lines = UntilDamage(messages)
    signed = bool(settings.link.signing_key_file)
    guide = Guide(settings, Signing(None, settings.link.signing_link_id) if signed else None)
    encode = msgspec.json.Encoder().encode
    decode_input = msgspec.json.Decoder(Input).decode
    decode_packet = msgspec.json.Decoder(Packet).decode
    pending: list[tuple[str, bytes]] = []
    inputs = compared = setpoints = tracked = 0
    first_ns = last_ns = 0
    difference: Difference | None = None
    stopped = ""
    for topic, payload in lines:
        if topic == TOPICS[Lost]:
            stopped = "the recorder had to drop records here; what entered the core after this is not known"
        elif topic == TOPICS[Input]:
            if pending:
                difference = _missing(pending[0], (last_ns - first_ns) * 1e-9, logged=False)
                break
            try:
                event = decode_input(payload)
            except NOT_A_RECORD as error:
                raise ReplayError(f"{path}: input {inputs} cannot be read: {error}") from None
            if event.seq != inputs:
                stopped = f"input {inputs} is missing from the log, {event.seq} follows"
                break
            first_ns, last_ns = (first_ns if inputs else event.t_ns), event.t_ns
            inputs += 1
            try:
                guide.handle(event)
                made = guide.records()
            except (*NOT_A_RECORD, ValueError, OverflowError, struct.error) as error:
                raise ReplayError(f"{path}: no service had input {event.seq} like this: {error}") from error
            guide.packets()
            for record in made:
                if TOPICS[type(record)] not in _NOT_COMPARED:
                    pending.append((TOPICS[type(record)], encode(record)))
        elif topic not in _NOT_COMPARED:
            time_s = (last_ns - first_ns) * 1e-9
            if not pending:
                difference = _missing((topic, payload), time_s, logged=True)
                break
            expected = pending.pop(0)
            if signed and topic == TOPICS[Packet]:
                with suppress(*NOT_A_RECORD):  # then it differs as it is
                    payload = encode(_without_hash(decode_packet(payload)))
            if expected != (topic, payload) and not _within(tolerance, (topic, payload), expected):
                difference = _difference((topic, payload), expected, time_s)
                break
            compared += 1
            setpoints += topic == "setpoint"
            tracked += topic == "error"
        if stopped:
            break
    else:
        stopped = lines.damage or ("the log ends in the middle of an input's records" if pending else "")
    return Replay(inputs, compared, setpoints, tracked, (last_ns - first_ns) * 1e-9, difference, stopped)


class UntilDamage:
    """Messages of a log as far as it goes; `damage` then says where and why it ended early, if it did."""

    def __init__(self, messages: Iterator[tuple[str, bytes]]) -> None:
        self._messages = messages
        self.damage = ""

    def __iter__(self) -> Iterator[tuple[str, bytes]]:
        try:
            yield from self._messages
        except LogDamaged as error:
            self.damage = str(error)


def lines_of(path: Path, passed: Passed | None = None) -> Iterator[tuple[str, bytes]]:
    """The run's messages, see `read_run`; ReplayError if its beginning is not there or damaged."""
    try:
        return read_run(path, passed)
    except (PartMissing, LogDamaged) as error:
        raise ReplayError(str(error)) from None


def session_of(path: Path, lines: Iterator[tuple[str, bytes]]) -> Session:
    """The run's first record; ReplayError if it is none, or of another schema."""
    try:
        topic, payload = next(lines, ("", b""))
        if topic != TOPICS[Session]:
            raise ReplayError(f"{path}: does not begin with a session record; is it a log of this service?")
        wrote = msgspec.json.decode(payload, type=_Wrote)
        if wrote.schema_version != SCHEMA_VERSION:
            raise ReplayError(
                f"{path}: its records have schema version {wrote.schema_version}, not {SCHEMA_VERSION}: "
                f"use guidance {wrote.guidance_version}, which wrote it"
            )
        return msgspec.json.decode(payload, type=Session)
    except LogDamaged as error:
        raise ReplayError(str(error)) from None
    except NOT_A_RECORD as error:
        raise ReplayError(f"{path}: its session record cannot be used: {error}") from None


def _configuration(path: Path, lines: Iterator[tuple[str, bytes]]) -> config.Config:
    try:
        return config.from_json(session_of(path, lines).config_json)
    except config.ConfigError as error:
        raise ReplayError(f"{path}: its session record cannot be used: {error}") from None


def _without_hash(packet: Packet) -> Packet:
    return replace(packet, data=without_hash(packet.data))


def _within(tolerance: float, logged: tuple[str, bytes], replayed: tuple[str, bytes]) -> bool:
    """Whether two records differ by no more than the tolerance, and in nothing that is not a fraction."""
    if tolerance == 0.0 or logged[0] != replayed[0]:
        return False
    try:
        return _near(tolerance, msgspec.json.decode(logged[1]), msgspec.json.decode(replayed[1]))
    except NOT_A_RECORD:
        return False


def _near(tolerance: float, one: Any, other: Any) -> bool:
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_near(tolerance, one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_near, [tolerance] * len(one), one, other))
    if isinstance(one, float) and isinstance(other, float):
        return abs(one - other) <= tolerance
    return type(one) is type(other) and bool(one == other)


def _missing(line: tuple[str, bytes], time_s: float, *, logged: bool) -> Difference:
    shown = line[1][:200].decode(errors="replace")
    return Difference(time_s, line[0], "", shown if logged else None, None if logged else shown)


def _difference(logged: tuple[str, bytes], replayed: tuple[str, bytes], time_s: float) -> Difference:
    if logged[0] != replayed[0]:
        return Difference(time_s, logged[0], "topic", logged[0], replayed[0])
    try:
        theirs = msgspec.json.decode(logged[1], type=dict[str, Any])
    except NOT_A_RECORD:
        theirs = {}
    ours: dict[str, Any] = msgspec.json.decode(replayed[1])
    for field in sorted(theirs.keys() | ours.keys()) if theirs else ():
        if theirs.get(field) != ours.get(field):
            return Difference(time_s, logged[0], field, theirs.get(field), ours.get(field))
    return Difference(time_s, logged[0], "", logged[1].decode(errors="replace"), replayed[1].decode())
