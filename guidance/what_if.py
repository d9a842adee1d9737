"""What another configuration would have commanded: a log's inputs through a core that flies otherwise.

Both are asked at the same instants, with the same state of the vehicle. What it would have done with other
commands nobody knows: the path stays the flown one, so each difference is that of one decision and not of the
flight that would have followed from it. What a handling learns or waits for, it learns of the flown path.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable, Sequence
from math import asin, atan2, degrees, sqrt
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
from msgspec.structs import replace

from guidance.checking import override, problems
from guidance.config import Config, ConfigError, checked, from_json, load, profile_of, to_json
from guidance.core import Guide
from guidance.mavlink.profiles import Asked, Handling
from guidance.mavlink.signing import Signing
from guidance.record import Wxyz
from guidance.records import NOT_A_RECORD, TOPICS, Input, Lost, Setpoint, Status
from guidance.replay import ReplayError, lines_of, session_of
from guidance.telemetry.log import Passed

#: So many partings are told.
PARTINGS_MOST: Final = 20


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
    refused: str
    stopped: str

    @property
    def differences(self) -> tuple[Difference, ...]:
        """How far the commands are apart, channel by channel; none where nothing was compared."""
        return tuple(_difference(one, self.t_ns) for one in self.commands) if self.t_ns else ()

    def as_json(self) -> dict[str, Any]:
        """For `--json`: SI units, but for angles in degrees as `unit` says."""
        count = len(self.t_ns)
        return {
            "inputs": self.inputs,
            "flight_s": self.flight_s,
            "compared": count,
            "only_flown": self.only_flown,
            "only_other": self.only_other,
            "saturated_part_flown": self.saturated_flown / count if count else None,
            "saturated_part_other": self.saturated_other / count if count else None,
            "differences": [one._asdict() for one in self.differences],
            "partings": [one._asdict() for one in self.partings],
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
    lines = lines_of(path, passed)
    session = session_of(path, lines)
    try:
        flown = from_json(session.config_json)
    except ConfigError as error:
        raise ReplayError(f"{path}: {error}; use guidance {session.guidance_version}") from None
    other = choose(flown)
    signing = Signing(None, other.link.signing_link_id) if other.link.signing_key_file else None
    guide = Guide(other, signing)
    sides = _Sides(flown, other)
    decode_input = msgspec.json.Decoder(Input).decode
    decode_setpoint = msgspec.json.Decoder(Setpoint).decode
    decode_status = msgspec.json.Decoder(Status).decode
    inputs = first_ns = last_ns = 0
    stopped = ""
    try:
        for topic, payload in lines:
            if topic == TOPICS[Input]:
                sides.next()
                event = decode_input(payload)
                if event.seq != inputs:
                    stopped = f"input {inputs} is missing from the log, {event.seq} follows"
                    break
                first_ns, last_ns = (first_ns if inputs else event.t_ns), event.t_ns
                sides.now_ns = last_ns
                inputs += 1
                guide.handle(event)
                guide.packets()
                for record in guide.records():
                    if isinstance(record, Setpoint):
                        sides.other_setpoint = record
                    elif isinstance(record, Status):
                        sides.other_status = record
            elif topic == TOPICS[Setpoint]:
                sides.flown_setpoint = decode_setpoint(payload)
            elif topic == TOPICS[Status]:
                sides.flown_status = decode_status(payload)
            elif topic == TOPICS[Lost]:
                stopped = (
                    "the recorder had to drop records here; what entered the core after this is not known"
                )
                break
            elif topic == "":
                stopped = payload.decode()
    except (*NOT_A_RECORD, ValueError, OverflowError, struct.error) as error:
        raise ReplayError(f"{path}: no service had input {inputs - 1} like this: {error}") from error
    sides.next()
    return Comparison(
        flown=flown,
        other=other,
        inputs=inputs,
        flight_s=(last_ns - first_ns) * 1e-9,
        t_ns=sides.t_ns,
        commands=tuple(
            Commands(name, unit, *columns)
            for (name, unit), *columns in zip(sides.channels, sides.flown, sides.other, strict=True)
        ),
        saturated_flown=sides.saturated_flown,
        saturated_other=sides.saturated_other,
        only_flown=sides.only_flown,
        only_other=sides.only_other,
        partings=tuple(sides.partings),
        refused=sides.refused,
        stopped=stopped,
    )


class _Sides:
    """What both said at one input, and the columns of all that they said so far."""

    def __init__(self, flown: Config, other: Config) -> None:
        self.channels, self._values = _channels(flown, other)
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
            for column, value in zip(self.flown, self._values(flown), strict=True):
                column.append(value)
            for column, value in zip(self.other, self._values(other), strict=True):
                column.append(value)

    def _part(self, at_s: float) -> None:
        flown, other = self.flown_status, self.other_status
        if len(self.partings) < PARTINGS_MOST:
            self.partings.append(
                Parting(
                    at_s,
                    _state(flown),
                    _state(other),
                    "" if flown is None else flown.reason,
                    "" if other is None else other.reason,
                )
            )


def _state(status: Status | None) -> str:
    return "" if status is None else str(status.state)


def _law(setpoint: Setpoint | None) -> Setpoint | None:
    return None if setpoint is None or setpoint.neutral else setpoint


Values = Callable[[Setpoint], tuple[float, ...]]


def _channels(flown: Config, other: Config) -> tuple[tuple[tuple[str, str], ...], Values]:
    """Names and units of what the profile sends, and their values in a setpoint."""
    profiles = (profile_of(flown), profile_of(other))
    rates = (("roll rate", "rad/s"), ("pitch rate", "rad/s"), ("yaw rate", "rad/s"))
    common = (("speed", "m/s"), ("thrust", ""))
    if any(profile.handling is Handling.AIRPLANE for profile in profiles):
        names = (("bank", "deg"), ("pitch", "deg"), *rates, *common)
        return names, lambda s: (
            *_bank_pitch(s.attitude_wxyz),
            *s.body_rates_frd_rad_s,
            s.speed_m_s,
            s.thrust,
        )
    if any(profile.asked is Asked.VELOCITY_YAW_RATE for profile in profiles):
        velocities: tuple[tuple[str, str], ...] = (
            ("velocity north", "m/s"),
            ("velocity east", "m/s"),
            ("velocity down", "m/s"),
            rates[2],
        )
        return velocities, lambda s: (*s.velocity_ned_m_s, s.body_rates_frd_rad_s[2])
    if all(profile.planar for profile in profiles):
        return (rates[2], *common), lambda s: (s.body_rates_frd_rad_s[2], s.speed_m_s, s.thrust)
    return (*rates, *common), lambda s: (*s.body_rates_frd_rad_s, s.speed_m_s, s.thrust)


def _bank_pitch(attitude_wxyz: Wxyz) -> tuple[float, float]:
    w, x, y, z = attitude_wxyz
    bank = atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return degrees(bank), degrees(asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x)))))


def _difference(one: Commands, t_ns: array[int]) -> Difference:
    apart = [b - a for a, b in zip(one.flown, one.other, strict=True)]
    worst = max(range(len(apart)), key=lambda i: abs(apart[i]))
    rms = sqrt(sum(d * d for d in apart) / len(apart))
    return Difference(one.name, one.unit, rms, abs(apart[worst]), (t_ns[worst] - t_ns[0]) * 1e-9)


def _present(data: Any) -> Any:
    """Without what is null: a key that is absent."""
    if isinstance(data, dict):
        return {key: _present(value) for key, value in data.items() if value is not None}
    return data
