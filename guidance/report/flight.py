"""A run of logs as one flight: its columns, what was told of it, and the stretches that tracked."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from guidance.config import Config, ConfigError, from_json, profile_of
from guidance.geodesy import Geodetic
from guidance.geofence import Fence
from guidance.guard_limits import fence_of
from guidance.mavlink.profiles import Handling
from guidance.records import (
    NOT_A_RECORD,
    TOPICS,
    AirplaneHandling,
    Event,
    GroundHandling,
    Input,
    Int64,
    Link,
    Lost,
    Parameters,
    Record,
    Reference,
    Session,
    Setpoint,
    State,
    Status,
    Timing,
    TrackingError,
    VelocityHandling,
)
from guidance.replay import ReplayError, session_of
from guidance.report.columns import Columns, Floats, Gathering, Times, known
from guidance.report.earth import Origin
from guidance.supervisor import SETPOINTS, Setpoints
from guidance.telemetry.log import LogDamaged, Passed
from guidance.telemetry.log_parts import PartMissing, read_run

R = TypeVar("R", bound=Record)

#: The trajectory's time going back by this much is another flight.
_BACK_S: Final = 0.5
_LAW: Final = frozenset(state.value for state, sends in SETPOINTS.items() if sends is Setpoints.LAW)


class ReportError(Exception):
    """The log is none that can be reported on; the text says why."""


class NoFlightError(Exception):
    """The log is whole, and nothing was tracked in it; the text says how far it came."""


class Span(NamedTuple):
    """The supervisor was in `state` from `start_ns` until `end_ns`, for that reason."""

    state: str
    reason: str
    start_ns: int
    end_ns: int


class LinkColumns(NamedTuple):
    """The link, twice a second: round trip in s (NaN where unknown), bytes/s each way."""

    t_ns: Floats
    round_trip_s: Floats
    received_bytes_per_s: Floats
    sent_bytes_per_s: Floats


class Flight(NamedTuple):
    """All that a report needs of one run. `incomplete` says in words where and why the log ends early.

    `stretches` are the half-open ranges of rows of `columns` in which one trajectory was tracked, from its
    start to its end. `origin` is that of the local frame when they began (deg, deg, m AMSL), looked for if
    the fence is on earth. `zero_ns` is the first of them: plots count from there.
    """

    path: Path
    session: Session
    config: Config
    handling: Handling
    origin: Geodetic | None
    columns: Columns
    stretches: tuple[tuple[int, int], ...]
    zero_ns: int
    spans: tuple[Span, ...]
    events: tuple[Event, ...]
    links: LinkColumns
    last_link: Link | None
    timing: Timing | None
    parameters: Parameters | None
    dropped: int
    incomplete: str

    def seconds(self, t_ns: Floats | Times) -> Floats:
        """Instants of the companion's clock as s since tracking began."""
        return (np.asarray(t_ns, dtype=np.float64) - self.zero_ns) * 1e-9

    @property
    def fence(self) -> Fence | None:
        """The fence, if it is known in the frame of the plots."""
        guards = self.config.guards
        corners = guards.fence_ned_m
        if guards.fence_deg:
            if self.origin is None:
                return None
            project, origin = profile_of(self.config).project, self.origin
            corners = tuple(project((*at, origin[2]), origin)[:2] for at in guards.fence_deg)
        fence = fence_of(guards, corners)
        return None if fence == Fence() else fence


def read_flight(path: Path, passed: Passed | None = None) -> Flight:
    """The run that the log at `path` is a part of. Raw traffic is passed over, not decoded.

    Raises:
        NotALog: no MCAP file.
        ReportError: not a log of this service, one of another schema, or without its beginning.
        NoFlightError: nothing was tracked.
    """
    try:
        return _read(path, passed)
    except PartMissing as error:
        raise ReportError(str(error)) from None
    except (ReplayError, LogDamaged) as error:
        raise ReportError(str(error)) from None


class _Instant(msgspec.Struct):
    t_ns: Int64


class _Told:
    """What is told beside the setpoints, gathered."""

    def __init__(self) -> None:
        self.spans: list[Span] = []
        self.events: list[Event] = []
        self.links: list[tuple[float, float, float, float]] = []
        self.last_link: Link | None = None
        self.timing: Timing | None = None
        self.parameters: Parameters | None = None
        self.dropped = 0

    def status(self, record: Status) -> None:
        if self.spans and (self.spans[-1].state, self.spans[-1].start_ns) == (record.state, record.since_ns):
            self.spans[-1] = self.spans[-1]._replace(end_ns=record.t_ns, reason=record.reason)
            return
        if self.spans:
            self.spans[-1] = self.spans[-1]._replace(end_ns=max(record.since_ns, self.spans[-1].start_ns))
        self.spans.append(Span(record.state, record.reason, record.since_ns, record.t_ns))

    def link(self, record: Link) -> None:
        round_trip = float("nan") if record.round_trip_s is None else record.round_trip_s
        self.links.append((record.t_ns, round_trip, record.received_bytes_per_s, record.sent_bytes_per_s))
        self.last_link = record

    def lost(self, record: Lost) -> None:
        self.dropped += record.count

    def last_timing(self, record: Timing) -> None:
        self.timing = record

    def last_parameters(self, record: Parameters) -> None:
        self.parameters = record


def _decoding(kind: type[R], take: Callable[[R], object]) -> tuple[str, Callable[[bytes], object]]:
    decode = msgspec.json.Decoder(kind).decode
    return TOPICS[kind], lambda payload: take(decode(payload))


def _read(path: Path, passed: Passed | None) -> Flight:
    lines = read_run(path, passed)
    incomplete = ""
    session = session_of(path, lines)
    try:
        config = from_json(session.config_json)
    except ConfigError as error:
        raise ReportError(f"{path}: {error}; use guidance {session.guidance_version}") from None
    gathering, told = Gathering(), _Told()
    origin = Origin(config) if config.guards.fence_deg else None
    newest_input = b""
    instant = msgspec.json.Decoder(_Instant).decode

    def setpoint(record: Setpoint) -> None:
        gathering.setpoint(record, instant(newest_input).t_ns if newest_input else record.t_ns)

    def handled(record: Record) -> None:
        gathering.handling(numbers(record))

    take = dict(
        (
            _decoding(State, gathering.state),
            _decoding(Reference, gathering.reference),
            _decoding(TrackingError, gathering.error),
            _decoding(Setpoint, setpoint),
            _decoding(GroundHandling, handled),
            _decoding(AirplaneHandling, handled),
            _decoding(VelocityHandling, handled),
            _decoding(Status, told.status),
            _decoding(Link, told.link),
            _decoding(Timing, told.last_timing),
            _decoding(Parameters, told.last_parameters),
            _decoding(Event, told.events.append),
            _decoding(Lost, told.lost),
        )
    )
    raw = TOPICS[Input]
    try:
        for topic, payload in lines:
            if topic == raw:
                newest_input = payload
                if origin is not None and not gathering.tracked:
                    origin.take(payload)
            elif topic in take:
                take[topic](payload)
    except LogDamaged as error:
        incomplete = str(error)
    except (*NOT_A_RECORD, OverflowError, ValueError, struct.error) as error:
        incomplete = f"{path}: a record of topic {topic} cannot be read ({error}); nothing after it was used"
    columns = gathering.columns()
    stretches = stretches_of(columns.trajectory_s, np.isfinite(columns.norm_m))
    if not stretches:
        raise NoFlightError(_nothing(path, told.spans, incomplete))
    links = np.array(told.links, dtype=np.float64).reshape(-1, 4)
    links[:, 1:] = known(links[:, 1:])
    return Flight(
        path=path,
        session=session,
        config=config,
        handling=profile_of(config).handling,
        origin=None if origin is None else origin.place,
        columns=columns,
        stretches=stretches,
        zero_ns=int(columns.sent_ns[stretches[0][0]]),
        spans=tuple(told.spans),
        events=tuple(told.events),
        links=LinkColumns(*links.T),
        last_link=told.last_link,
        timing=told.timing,
        parameters=told.parameters,
        dropped=told.dropped,
        incomplete=incomplete,
    )


def numbers(record: Record) -> dict[str, float]:
    """The fields of a record that are numbers, flags as 0 and 1; of a triple each, as NAME.0 to NAME.2."""
    found: dict[str, float] = {}
    for name in record.__struct_fields__:
        value = getattr(record, name)
        if name == "t_ns":
            continue
        if isinstance(value, tuple):
            for i, part in enumerate(value):
                found[f"{name}.{i}"] = part
        else:
            found[name] = value
    return found


def stretches_of(trajectory_s: Floats, tracked: NDArray[np.bool_]) -> tuple[tuple[int, int], ...]:
    """Half-open ranges of rows, from the first that tracked to the last before the trajectory began anew.

    A flight that is held and resumed is one: the trajectory's time goes on.
    """
    rows = np.flatnonzero(tracked)
    if not len(rows):
        return ()
    cuts = np.flatnonzero(np.diff(trajectory_s[rows]) < -_BACK_S) + 1
    return tuple((int(part[0]), int(part[-1]) + 1) for part in np.split(rows, cuts))


def law_streams(state: str) -> bool:
    """Whether setpoints of the law are sent in a state of that name."""
    return state in _LAW


def _nothing(path: Path, spans: list[Span], incomplete: str) -> str:
    text = f"{path}: no flight in it: nothing was tracked"
    if spans:
        text += f"; its last state was {spans[-1].state}" + (
            f" ({spans[-1].reason})" if spans[-1].reason else ""
        )
    return text + (f". It is incomplete, too: {incomplete}" if incomplete else "")
