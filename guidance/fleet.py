"""What is known of every vehicle heard over zenoh: who is live, silent or gone, and what it does.

Takes arrivals with their instants and is looked at with the time as an argument. A figure is shown while it
is young; an old one is not known any more.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from enum import StrEnum
from typing import Final, NamedTuple, TypeVar

import msgspec
from msgspec.structs import replace

from guidance.records import Event, Level, Link, Record, Session, Setpoint, State, Status, TrackingError
from guidance.telemetry.arrivals import VEHICLES_MAX, Arrival, Heard, Ignored, Presence

#: `status` comes at 5 Hz. Who looks every 0.2 s or oftener sees within a second that a vehicle fell silent.
SILENT_NS: Final = 700_000_000
#: Records of every setpoint are shown while they are younger; those at 2 Hz have three periods.
_FRESH_NS: Final = 1_000_000_000
_LINK_FRESH_NS: Final = 1_500_000_000
#: The setpoint rate is taken over so long.
_RATE_WINDOW_NS: Final = 2_000_000_000
#: Two instants back within so long: two services under one name. One is a reboot.
_TWICE_NS: Final = 2_000_000_000

#: When what came in answer to a query was published: nobody knows.
_LONG_AGO_NS: Final = -(1 << 62)
#: Another schema version is named so long after its last record (the slowest comes once a second).
_VERSION_FRESH_NS: Final = 5_000_000_000

_MAX_NOTES: Final = 200
_MAX_KINDS: Final = 50
_MAX_SETPOINTS: Final = 500
_MAX_VERSIONS: Final = 5
#: Where kinds beyond the limit are counted.
_REST: Final = ("others", "further kinds")

R = TypeVar("R", bound=Record)


class Contact(StrEnum):
    """How a vehicle is heard."""

    LIVE = "live"
    SILENT = "silent"  # its service is there, or its end was not seen
    GONE = "gone"  # its service ended or left the network


class Source(msgspec.Struct, frozen=True):
    """A message that feeds the state: how often it comes, and how old it was at the newest state."""

    message: str
    rate_hz: float | None
    age_s: float


class Seen(msgspec.Struct, frozen=True, kw_only=True):
    """One vehicle at one look; None is what is not known, or not known any more.

    `quiet_s` is the time since anything came. `state`, `reason`, `armed`, `mode` and `cautions` of a vehicle
    that is not live are the last ones said. `versions` are other schema versions than ours in which it
    publishes, and `doubled` tells that two services publish under its name.
    """

    vehicle: str
    contact: Contact
    quiet_s: float = 0.0
    state: str | None = None
    reason: str | None = None
    armed: bool | None = None
    mode: str | None = None
    cautions: tuple[str, ...] = ()
    error_m: float | None = None
    setpoint_rate_hz: float | None = None
    attitude: Source | None = None
    position: Source | None = None
    round_trip_s: float | None = None
    lost: int | None = None
    heartbeat_age_s: float | None = None
    session_id: str | None = None
    versions: tuple[int, ...] = ()
    doubled: bool = False


class Note(NamedTuple):
    """Something that happened: an event of a vehicle, or what was noticed of it here.

    It happened at `at_ns` of the clock here, by which all vehicles' notes have one order, however wrong their
    own clocks are; None until the vehicle's instants are known by it. `number` counts the notes.
    """

    number: int
    vehicle: str
    level: Level
    text: str
    arrived_ns: int
    t_ns: int | None = None
    at_ns: int | None = None

    @property
    def when_ns(self) -> int:
        """When it happened, by the clock here, as far as that is known: else when it came."""
        return self.arrived_ns if self.at_ns is None else self.at_ns


class _Vehicle:
    """What came of one vehicle."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.contact: Contact | None = None  # at the last look or arrival
        self.heard_ns = 0
        self.here = False
        self.offset_ns: int | None = None  # from its instants to those of arrival
        self._left_ns: int | None = None
        self._newest: dict[type[Record], tuple[int, Record]] = {}
        self._versions: dict[int, int] = {}  # and when a record in it came last
        self._setpoints: deque[tuple[int, int]] = deque(maxlen=_MAX_SETPOINTS)
        self._went_back_ns: deque[int] = deque(maxlen=2)

    def leave(self, now_ns: int) -> None:
        """Its token was withdrawn; what comes back under its name may have another clock."""
        self.here, self._left_ns, self.contact = False, now_ns, Contact.GONE
        self.offset_ns = None

    def judge(self, now_ns: int) -> Contact:
        """How it is heard; what comes after the token was withdrawn proves that it is not gone."""
        if not self.here and self._left_ns is not None and self.heard_ns <= self._left_ns:
            return Contact.GONE
        return Contact.LIVE if now_ns - self.heard_ns < SILENT_NS else Contact.SILENT

    def take(self, heard: Heard) -> bool:
        """Keep a record; False if it is none that was not known."""
        kind, record = type(heard.record), heard.record
        held_ns, held = self._newest.get(kind, (_LONG_AGO_NS, None))
        if heard.answered:
            if held is not None and heard.arrived_ns - held_ns < _FRESH_NS:
                return False
        elif isinstance(record, Status):
            if isinstance(held, Status) and record.since_ns < held.since_ns:
                self._went_back_ns.append(heard.arrived_ns)
        elif isinstance(record, Setpoint):
            if self._setpoints and record.seq <= self._setpoints[-1][0]:
                self._setpoints.clear()  # another run
            self._setpoints.append((record.seq, record.t_ns))
        self._newest[kind] = (_LONG_AGO_NS if heard.answered else heard.arrived_ns, record)
        return held != record

    def take_version(self, version: int, now_ns: int) -> None:
        """It publishes in another version of the schema."""
        if version in self._versions or len(self._versions) < _MAX_VERSIONS:
            self._versions[version] = now_ns

    def last(self, kind: type[R]) -> R | None:
        """The newest record of a type, however old."""
        _, record = self._newest.get(kind, (_LONG_AGO_NS, None))
        return record if isinstance(record, kind) else None

    def fresh(self, kind: type[R], now_ns: int, within_ns: int = _FRESH_NS) -> R | None:
        """The newest record of a type, if it came lately."""
        arrived_ns, _ = self._newest.get(kind, (_LONG_AGO_NS, None))
        return self.last(kind) if now_ns - arrived_ns < within_ns else None

    def look(self, now_ns: int) -> Seen:
        """What is known of it now."""
        contact = self.contact = self.judge(now_ns)
        session, said = self.last(Session), self.last(Status)
        seen = Seen(
            vehicle=self.name,
            contact=contact,
            quiet_s=max(0.0, (now_ns - self.heard_ns) * 1e-9),
            session_id=None if session is None else session.session_id,
            versions=tuple(sorted(v for v, ns in self._versions.items() if now_ns - ns < _VERSION_FRESH_NS)),
            doubled=self.doubled(now_ns),
        )
        if said is not None and (contact is not Contact.LIVE or self.fresh(Status, now_ns)):
            seen = replace(
                seen,
                state=said.state,
                reason=said.reason,
                armed=said.armed,
                mode=said.mode,
                cautions=said.cautions,
            )
        return self._with_figures(seen, now_ns) if contact is Contact.LIVE else seen

    def _with_figures(self, seen: Seen, now_ns: int) -> Seen:
        error, link = self.fresh(TrackingError, now_ns), self.fresh(Link, now_ns, _LINK_FRESH_NS)
        seen = replace(
            seen,
            error_m=None if error is None else error.norm_m,
            setpoint_rate_hz=None if seen.doubled else self._setpoint_rate_hz(now_ns),
        )
        rates_hz: dict[str, float] = {}
        if link is not None:
            rates_hz = {stream.message: stream.rate_hz for stream in link.streams}
            seen = replace(
                seen,
                round_trip_s=link.round_trip_s,
                lost=link.lost,
                heartbeat_age_s=link.heartbeat_age_s,
            )
        state = self.fresh(State, now_ns)
        if state is None:
            return seen
        attitude, position = state.attitude_source, state.position_source
        return replace(
            seen,
            attitude=Source(attitude, rates_hz.get(attitude), state.attitude_age_s),
            position=Source(position, rates_hz.get(position), state.position_age_s),
        )

    def doubled(self, now_ns: int) -> bool:
        """The state was entered earlier than was said before, again and again."""
        back = self._went_back_ns
        return len(back) == 2 and back[1] - back[0] < _TWICE_NS and now_ns - back[1] < _TWICE_NS

    def _setpoint_rate_hz(self, now_ns: int) -> float | None:
        """By the sequence numbers: what the network loses on the way to here does not count."""
        if self.fresh(Setpoint, now_ns) is None or not self._setpoints:
            return None
        last_seq, last_ns = self._setpoints[-1]
        while last_ns - self._setpoints[0][1] > _RATE_WINDOW_NS:
            self._setpoints.popleft()
        first_seq, first_ns = self._setpoints[0]
        return (last_seq - first_seq) / ((last_ns - first_ns) * 1e-9) if last_ns > first_ns else None


class Fleet:
    """All vehicles, the latest notes, and counts of what was ignored; memory has a limit."""

    def __init__(self) -> None:
        #: What came that is no record of this version: vehicle and kind, with the count and the last detail.
        self.ignored: dict[tuple[str, str], tuple[int, str]] = {}
        self._vehicles: dict[str, _Vehicle] = {}
        self._notes: deque[Note] = deque(maxlen=_MAX_NOTES)
        self._noted = 0

    @property
    def notes(self) -> Sequence[Note]:
        """The latest notes, oldest first."""
        return self._notes

    def newest(self, vehicle: str, record: type[R]) -> R | None:
        """The newest record of a type, None if none came."""
        return self._vehicles[vehicle].last(record) if vehicle in self._vehicles else None

    def fresh(self, vehicle: str, record: type[R], now_ns: int, within_ns: int) -> R | None:
        """The same, if it came lately and was not an answer to a query."""
        return self._vehicles[vehicle].fresh(record, now_ns, within_ns) if vehicle in self._vehicles else None

    def take(self, arrivals: Iterable[Arrival]) -> None:
        """Take in what arrived, in order; answers to who asked are no news of a vehicle."""
        for arrival in arrivals:
            if isinstance(arrival, Heard):
                self._take_record(arrival)
            elif isinstance(arrival, Ignored):
                self._take_ignored(arrival)
            elif isinstance(arrival, Presence):
                self._take_presence(arrival)

    def recall(self, vehicle: str, events: Iterable[Event], now_ns: int) -> None:
        """Note events from before anybody listened, those that are not noted yet."""
        known = {(note.t_ns, note.text) for note in self._notes if note.vehicle == vehicle}
        for event in events:
            if (event.t_ns, event.text) not in known:
                self._note(self._vehicle(vehicle), event.level, event.text, now_ns, event.t_ns)

    def look(self, now_ns: int) -> list[Seen]:
        """Every vehicle now, by name; one that has fallen silent is noted."""
        seen = []
        for _, vehicle in sorted(self._vehicles.items()):
            before = vehicle.contact
            seen.append(vehicle.look(now_ns))
            if before is Contact.LIVE and vehicle.contact is Contact.SILENT:
                self._note(
                    vehicle, Level.WARNING, f"silent: nothing came for {seen[-1].quiet_s:.1f} s", now_ns
                )
        return seen

    def _take_record(self, heard: Heard) -> None:
        vehicle, record = self._vehicle(heard.vehicle), heard.record
        if vehicle.here or not heard.answered:
            self._hear(vehicle, heard.arrived_ns)
        session, was_doubled = vehicle.last(Session), vehicle.doubled(heard.arrived_ns)
        if not vehicle.take(heard):
            return
        if isinstance(record, Session):
            if session is not None and session.session_id != record.session_id:
                text = f"a new run began: {record.session_id[:8]}, guidance {record.guidance_version}"
                self._note(vehicle, Level.NOTICE, text, heard.arrived_ns)
        elif isinstance(record, Event):
            self._note(vehicle, record.level, record.text, heard.arrived_ns, record.t_ns)
        elif isinstance(record, Status):
            self._set_clock(vehicle, heard)
            if vehicle.doubled(heard.arrived_ns) and not was_doubled:
                text = "two services publish under this name: change vehicle.name of one"
                self._note(vehicle, Level.ERROR, text, heard.arrived_ns)

    def _take_ignored(self, ignored: Ignored) -> None:
        key = (ignored.vehicle, ignored.what)
        if key not in self.ignored and len(self.ignored) >= _MAX_KINDS:
            key = _REST
        count, _ = self.ignored.get(key, (0, ""))
        self.ignored[key] = (count + 1, ignored.detail)
        if ignored.version is not None:  # nothing to show of it, but it is there
            vehicle = self._vehicle(ignored.vehicle)
            self._hear(vehicle, ignored.arrived_ns)
            vehicle.take_version(ignored.version, ignored.arrived_ns)

    def _take_presence(self, presence: Presence) -> None:
        vehicle = self._vehicle(presence.vehicle)
        if presence.here:
            vehicle.here = True
            self._hear(vehicle, presence.arrived_ns)
        elif vehicle.contact is not Contact.GONE:
            vehicle.leave(presence.arrived_ns)
            text = "gone: its service ended or left the network"
            self._note(vehicle, Level.NOTICE, text, presence.arrived_ns)

    def _vehicle(self, name: str) -> _Vehicle:
        vehicle = self._vehicles.get(name)
        if vehicle is None:
            if len(self._vehicles) >= VEHICLES_MAX:
                quietest = min(self._vehicles.values(), key=lambda other: other.heard_ns)
                del self._vehicles[quietest.name]
            vehicle = self._vehicles[name] = _Vehicle(name)
        return vehicle

    def _hear(self, vehicle: _Vehicle, now_ns: int) -> None:
        if vehicle.contact in (Contact.SILENT, Contact.GONE):
            text = f"heard again after {(now_ns - vehicle.heard_ns) * 1e-9:.1f} s"
            self._note(vehicle, Level.NOTICE, text, now_ns)
        vehicle.heard_ns, vehicle.contact = now_ns, Contact.LIVE

    def _note(
        self, vehicle: _Vehicle, level: Level, text: str, arrived_ns: int, t_ns: int | None = None
    ) -> None:
        self._noted += 1
        note = Note(self._noted, vehicle.name, level, text, arrived_ns, t_ns)
        self._notes.append(_dated(note, vehicle.offset_ns))

    def _set_clock(self, vehicle: _Vehicle, heard: Heard) -> None:
        """The status, 5 times a second, says what time it is there; an answered one is hardly older."""
        first = vehicle.offset_ns is None
        if first or not heard.answered:
            vehicle.offset_ns = heard.arrived_ns - heard.record.t_ns
        if first:  # the answers to one query come in any order: an event may have come before
            for i, note in enumerate(self._notes):
                if note.vehicle == vehicle.name and note.at_ns is None:
                    self._notes[i] = _dated(note, vehicle.offset_ns)


def _dated(note: Note, offset_ns: int | None) -> Note:
    """What its vehicle told of happened before it came."""
    if offset_ns is None or note.t_ns is None:
        return note
    return note._replace(at_ns=min(note.t_ns + offset_ns, note.arrived_ns))
