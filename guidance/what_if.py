"""What another configuration would have commanded: a log's inputs through a core that flies otherwise.

Both are asked at the same instants, with the same state of the vehicle. What it would have done with other
commands nobody knows: the path stays the flown one, so each difference is that of one decision and not of the
flight that would have followed from it. What a handling learns or waits for, it learns of the flown path.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable, Sequence
from math import isfinite, sqrt
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
from msgspec.structs import replace

from guidance.checking import override, problems
from guidance.commanded import channels_of
from guidance.config import Config, ConfigError, checked, from_json, load, profile_of, to_json
from guidance.core import Guide
from guidance.mavlink.signing import Signing
from guidance.records import NOT_A_RECORD, TOPICS, Input, Lost, Setpoint, Status
from guidance.replay import ReplayError, UntilDamage, lines_of, session_of
from guidance.telemetry.log import Passed

#: So many partings are told.
PARTINGS_MOST: Final = 20
_READ: Final = {TOPICS[kind]: kind for kind in (Input, Lost, Setpoint, Status)}


class Difference(NamedTuple):
    """Of one channel, over all instants at which both commanded: other minus flown. `largest_at_s` is after
    the first of these instants."""

    channel: str
    unit: str
    rms: float
    largest: float
    largest_at_s: float


class Parting(NamedTuple):
    """From here on they stand in different states, or in the same again: which, and why."""

    at_s: float
    flown: str
    other: str
    flown_reason: str
    other_reason: str


class Commands(NamedTuple):
    """One channel at each instant that is compared."""

    name: str
    unit: str
    flown: array[float]
    other: array[float]


class Comparison(NamedTuple):
    """The same inputs under two configurations.

    `t_ns` are the instants at which both sent a setpoint of the law; `only_*` counts those at which one did.
    `commands` are the channels that both send. `partings_more` there were beyond those that are told.
    `refused` says in words why the other never engaged, empty if it did; `stopped` why the comparison ended
    before the log.
    """

    flown: Config
    other: Config
    inputs: int
    flight_s: float
    t_ns: array[int]
    commands: tuple[Commands, ...]
    saturated_flown: int
    saturated_other: int
    only_flown: int
    only_other: int
    partings: tuple[Parting, ...]
    partings_more: int
    refused: str
    stopped: str

    @property
    def asked_otherwise(self) -> str:
        """In words, what is not compared because the two ask for different things; empty if they do not."""
        flown, other = profile_of(self.flown).asked, profile_of(self.other).asked
        if flown is other:
            return ""
        both = " and ".join(one.name for one in self.commands)
        compared = f"only {both} can be compared" if both else "no channel can be compared"
        return f"flown was asked for {flown}, the other asks for {other}: {compared}"

    @property
    def differences(self) -> tuple[Difference, ...]:
        """How far the commands are apart, channel by channel; none where nothing was compared."""
        return tuple(_difference(one, self.t_ns) for one in self.commands) if self.t_ns else ()

    def as_json(self) -> dict[str, Any]:
        """For `--json`: SI units, but for angles in degrees as `unit` says; None for what no number holds."""
        count = len(self.t_ns)
        return {
            "inputs": self.inputs,
            "flight_s": self.flight_s,
            "compared": count,
            "only_flown": self.only_flown,
            "only_other": self.only_other,
            "saturated_part_flown": self.saturated_flown / count if count else None,
            "saturated_part_other": self.saturated_other / count if count else None,
            "asked_otherwise": self.asked_otherwise,
            "differences": [_finite(one._asdict()) for one in self.differences],
            "partings": [one._asdict() for one in self.partings],
            "partings_more": self.partings_more,
            "refused": self.refused,
            "stopped": self.stopped,
        }


def other_configuration(logged: Config, file: Path | None, overrides: Sequence[str]) -> Config:
    """The configuration to compare with: that of a file, else the logged one, with overrides.

    What concerns the line is the log's: its connection decides how the bytes that came are read.

    Raises:
        ConfigError: as `config.load`.
    """
    if file is not None:
        other = load(file, overrides)
    else:
        data = _present(msgspec.json.decode(to_json(logged)))
        settings = {override(data, setting): setting for setting in overrides}
        wrong = [f"{one.key}{one.text}" for one in problems(data, Config)]
        if wrong:
            raise ConfigError("\n".join(f"--set {', '.join(settings.values())}: {one}" for one in wrong))
        other = checked(msgspec.convert(data, type=Config))
    link = replace(
        other.link,
        connection=logged.link.connection,
        signing_key_file=logged.link.signing_key_file,
        signing_link_id=logged.link.signing_link_id,
    )
    return checked(replace(other, link=link))


def compare(path: Path, choose: Callable[[Config], Config], passed: Passed | None = None) -> Comparison:
    """Feed the log's inputs to a core with another configuration, which `choose` makes of the logged one.

    Raises:
        NotALog: no MCAP file.
        ReplayError: not a log of ours, or of another schema, or of inputs that no service had.
        ConfigError: what was chosen is no configuration.
    """
    messages = lines_of(path, passed)
    session = session_of(path, messages)
    try:
        flown = from_json(session.config_json)
    except ConfigError as error:
        raise ReplayError(f"{path}: {error}; use guidance {session.guidance_version}") from None
    other = choose(flown)
    signing = Signing(None, other.link.signing_link_id) if other.link.signing_key_file else None
    guide = Guide(other, signing)
    sides = _Sides(flown, other)
    decode = {topic: msgspec.json.Decoder(kind).decode for topic, kind in _READ.items()}
    lines = UntilDamage(messages)
    inputs = first_ns = last_ns = 0
    stopped = ""
    for topic, payload in lines:
        if topic not in decode:
            continue
        try:
            record = decode[topic](payload)
        except NOT_A_RECORD as error:
            where = f"a record of topic {topic} behind {inputs} inputs"
            raise ReplayError(f"{path}: {where} cannot be read: {error}") from None
        if isinstance(record, Setpoint):
            sides.flown_setpoint = record
        elif isinstance(record, Status):
            sides.flown_status = record
        elif not isinstance(record, Input):  # the recorder lost some
            stopped = "the recorder had to drop records here; what entered the core after this is not known"
            break
        elif record.seq != inputs:
            stopped = f"input {inputs} is missing from the log, {record.seq} follows"
            break
        else:
            sides.next()
            first_ns, last_ns = (first_ns if inputs else record.t_ns), record.t_ns
            sides.now_ns = last_ns
            inputs += 1
            try:
                _fed(guide, record, sides)
            except (*NOT_A_RECORD, ValueError, OverflowError, struct.error) as error:
                raise ReplayError(f"{path}: no service had input {record.seq} like this: {error}") from error
    sides.next()
    return Comparison(
        flown=flown,
        other=other,
        inputs=inputs,
        flight_s=(last_ns - first_ns) * 1e-9,
        t_ns=sides.t_ns,
        commands=tuple(
            Commands(channel.name, channel.unit, *columns)
            for channel, *columns in zip(sides.channels, sides.flown, sides.other, strict=True)
        ),
        saturated_flown=sides.saturated_flown,
        saturated_other=sides.saturated_other,
        only_flown=sides.only_flown,
        only_other=sides.only_other,
        partings=tuple(sides.partings),
        partings_more=sides.partings_more,
        refused=sides.refused,
        stopped=stopped or lines.damage,
    )


class _Sides:
    """What both said at one input, and the columns of all that they said so far."""

    def __init__(self, flown: Config, other: Config) -> None:
        asked = channels_of(profile_of(other))
        self.channels = tuple(channel for channel in channels_of(profile_of(flown)) if channel in asked)
        self.flown = [array("d") for _ in self.channels]
        self.other = [array("d") for _ in self.channels]
        self.t_ns = array("q")
        self.now_ns = 0
        self.flown_setpoint: Setpoint | None = None
        self.other_setpoint: Setpoint | None = None
        self.flown_status: Status | None = None
        self.other_status: Status | None = None
        self.saturated_flown = self.saturated_other = self.only_flown = self.only_other = 0
        self.partings: list[Parting] = []
        self.partings_more = 0
        self._standing = ("", "")
        self._begun_ns: int | None = None

    @property
    def refused(self) -> str:
        """Why the other never commanded while the flown one did."""
        if self.t_ns or self.only_other or not self.only_flown:
            return ""
        if not self.partings:
            return "it stays silent; its events in a report of its own say why"
        first = self.partings[0]
        return f"{first.other}: {first.other_reason}" if first.other_reason else first.other

    def next(self) -> None:
        """All of one input was said: it is compared."""
        flown, other = _law(self.flown_setpoint), _law(self.other_setpoint)
        self.flown_setpoint = self.other_setpoint = None
        if flown is None and other is None:
            return
        if self._begun_ns is None:
            self._begun_ns = self.now_ns
        standing = (_state(self.flown_status), _state(self.other_status))
        if standing != self._standing:
            self._standing = standing
            if standing[0] != standing[1] or self.partings:
                self._part((self.now_ns - self._begun_ns) * 1e-9)
        if flown is None:
            self.only_other += 1
        elif other is None:
            self.only_flown += 1
        else:
            self.t_ns.append(self.now_ns)
            self.saturated_flown += flown.saturated
            self.saturated_other += other.saturated
            for channel, *columns in zip(self.channels, self.flown, self.other, strict=True):
                for column, setpoint in zip(columns, (flown, other), strict=True):
                    column.append(channel.of(setpoint))

    def _part(self, at_s: float) -> None:
        flown, other = self.flown_status, self.other_status
        if len(self.partings) == PARTINGS_MOST:
            self.partings_more += 1
            return
        why = ("" if status is None else status.reason for status in (flown, other))
        self.partings.append(Parting(at_s, _state(flown), _state(other), *why))


def _fed(guide: Guide, event: Input, sides: _Sides) -> None:
    """The input to the other core, and what it says to that."""
    guide.handle(event)
    guide.packets()
    for record in guide.records():
        if isinstance(record, Setpoint):
            sides.other_setpoint = record
        elif isinstance(record, Status):
            sides.other_status = record


def _state(status: Status | None) -> str:
    return "" if status is None else str(status.state)


def _law(setpoint: Setpoint | None) -> Setpoint | None:
    return None if setpoint is None or setpoint.neutral else setpoint


def _difference(one: Commands, t_ns: array[int]) -> Difference:
    apart = [b - a for a, b in zip(one.flown, one.other, strict=True)]
    worst = max(range(len(apart)), key=lambda i: abs(apart[i]))
    rms = sqrt(sum(d * d for d in apart) / len(apart))
    return Difference(one.name, one.unit, rms, abs(apart[worst]), (t_ns[worst] - t_ns[0]) * 1e-9)


def _finite(fields: dict[str, Any]) -> dict[str, Any]:
    return {
        name: None if isinstance(value, float) and not isfinite(value) else value
        for name, value in fields.items()
    }


def _present(data: Any) -> Any:
    """Without what is null: a key that is absent."""
    if isinstance(data, dict):
        return {key: _present(value) for key, value in data.items() if value is not None}
    return data
