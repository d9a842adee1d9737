"""The link, looked at as the service would, and moving nothing: bytes and time in, packets out.

It sends what the service sends before it engages (HEARTBEAT, TIMESYNC, SET_MESSAGE_INTERVAL and
REQUEST_MESSAGE) and PARAM_REQUEST_READ; never a setpoint, a mode or an arming command.
"""

from __future__ import annotations

from math import isfinite
from typing import Final

from pymavlink.dialects.v20 import all as dialect

from guidance.config import Config, parse_connection, profile_of
from guidance.estimate import Estimate, Estimator
from guidance.guarding import Guards
from guidance.intake import streams_at, take_state
from guidance.mavlink.air import AirBody
from guidance.mavlink.line import LineWatch
from guidance.mavlink.link import AutopilotLink, Received
from guidance.mavlink.messages import (
    MESSAGE_IDS,
    EkfStatusReport,
    EstimatorStatus,
    ParamValue,
    StateBody,
    StatusText,
    SysStatus,
)
from guidance.mavlink.parameters import ParameterReader, request_read
from guidance.mavlink.report import absence, link_record
from guidance.mavlink.requirements import Grade, judged, names_of, partners_of, values_of
from guidance.mavlink.signing import Signing
from guidance.mavlink.streams import SATISFIED, Stream
from guidance.readiness import young
from guidance.records import Link
from guidance.se3 import Vec3
from guidance.supervisor import State
from guidance.tracker import Tracker

#: Listened at least for so long: components speak once a second, and two autopilots of one id take 2 s.
LISTEN_NS: Final = 3_000_000_000
#: What is asked for and did not come within this time of the first heartbeat is not there.
PATIENCE_NS: Final = 4_000_000_000

_LOOK_NS: Final = 500_000_000
_ASK_NS: Final = 1_000_000_000
_TEXTS_MAX: Final = 3
_SERIOUS: Final = dialect.MAV_SEVERITY_WARNING


class Observation:
    """One look at one vehicle. `opened` must be called first; then `tick` whenever `deadline` has passed.

    `signing` is that of a configuration with a key, its clock set.
    """

    def __init__(self, config: Config, signing: Signing | None = None) -> None:
        vehicle, link = config.vehicle, config.link
        self.config = config
        self.profile = profile_of(config)
        self.connection = parse_connection(link.connection)
        self.link = AutopilotLink(
            vehicle.system_id,
            vehicle.component_id,
            link.heartbeat_timeout_s,
            self._streams_at(link.rate_hz),
            byte_stream=self.connection.byte_stream,
            signing=signing,
        )
        self.tracker = Tracker(config, self.profile)
        table = self.profile.requirements
        self.parameters = ParameterReader(
            names_of(table), bytewise=self.profile.parameters_bytewise, partners=partners_of(table)
        )
        self.health: SysStatus | None = None
        self.estimator_flags: int | None = None
        self.texts: dict[str, None] = {}  # what the autopilot complained of, in order, each once
        self.problems: dict[str, str] = {}  # of the line: words and code
        self.record: Link | None = None  # the newest look
        self.now_ns = 0
        self._line = LineWatch(self.connection, link.rate_hz, self._streams_at)
        self._estimator = Estimator(self.profile.project)
        self._reboots = 0
        self._opened_ns = 0
        self._heard_ns: int | None = None
        self._look_ns = 0
        self._ask_ns = 0

    def _streams_at(self, rate_hz: float) -> list[Stream]:
        return streams_at(rate_hz, self.config, self.profile, self.connection)

    # In ----------------------------------------------------------------------------------------------

    def opened(self, now_ns: int) -> None:
        """The line is open."""
        self.now_ns = self._opened_ns = self._look_ns = now_ns
        for event in self._line.opened(now_ns):
            self.problem(event.code, event.text)

    def problem(self, code: str, words: str) -> None:
        """Something is wrong with the line."""
        self.problems.setdefault(words, code)

    def receive(self, data: bytes, now_ns: int) -> None:
        """Bytes came."""
        self.now_ns = now_ns
        for received in self.link.receive(data, now_ns):
            self._take(received, now_ns)

    def _take(self, received: Received, now_ns: int) -> None:
        body = received.body
        if self.link.reboots != self._reboots:
            self._reboots = self.link.reboots
            self._estimator.reset()
            self.problem("reboot", "the autopilot rebooted, or two of one id speak in turn")
        if isinstance(body, StateBody):
            take_state(self.link, self._estimator, received.name, body, now_ns)
            return
        stream = self.link.streams.get(received.name)
        if stream is not None:
            stream.arrived(now_ns, valid=True)
        if isinstance(body, ParamValue):
            self.parameters.take(body)
        elif isinstance(body, SysStatus):
            self.health = body
        elif isinstance(body, AirBody) and all(map(isfinite, body)):
            self.tracker.handler.heard(body, now_ns)
        elif isinstance(body, EstimatorStatus | EkfStatusReport):
            self.estimator_flags = body.flags
        elif isinstance(body, StatusText) and body.severity <= _SERIOUS and len(self.texts) < _TEXTS_MAX:
            self.texts[body.text.rstrip(b"\t\0").decode("utf-8", "replace")] = None

    # Out ---------------------------------------------------------------------------------------------

    def deadline(self) -> int:
        """When `tick` is due, ns."""
        due = [self._look_ns, self.link.deadline()]
        if self.link.heartbeat is not None:
            due.append(self._ask_ns)
            if (parameters_ns := self.parameters.deadline(self.now_ns)) is not None:
                due.append(parameters_ns)
        return min(due)

    def tick(self, now_ns: int) -> list[bytes]:
        """Time passed; what to send."""
        self.now_ns = now_ns
        link = self.link
        link.tick(now_ns)
        if now_ns >= self._look_ns:
            self._look_ns = now_ns + _LOOK_NS
            self._look(now_ns)
        if link.heartbeat is not None:
            self._heard_ns = now_ns if self._heard_ns is None else self._heard_ns
            for name in self.parameters.due(now_ns):
                link.outbox.send(request_read(name, link.system, link.component))
            if now_ns >= self._ask_ns:
                self._ask_ns = now_ns + _ASK_NS
                for name in self._unheard():
                    request = dialect.MAV_CMD_REQUEST_MESSAGE
                    link.outbox.command(request, MESSAGE_IDS[name])
        return link.outbox.drain()

    def _unheard(self) -> list[str]:
        """What no stream may bring."""
        unheard = [] if self.health is not None else ["SYS_STATUS"]
        return unheard if self.estimator_flags is not None else [*unheard, self.profile.estimator]

    def _look(self, now_ns: int) -> None:
        self.record = self._line.measured(link_record(self.link, now_ns), self.link)
        for event in self._line.news(self.record, self.link):
            self.problem(event.code, event.text)

    # What is known -----------------------------------------------------------------------------------

    @property
    def absent_because(self) -> str:
        """Why there is no autopilot; empty if there is."""
        if self.link.connected(self.now_ns):
            return ""
        return absence(self.link, self.connection.scheme)

    def unfit(self) -> str | None:
        """Why the vehicle is not flown with the parameters that it has told, as far as they are the reason;
        what flies then knows them."""
        table, answers = self.profile.requirements, self.parameters.values
        if any(judged(row, answers, self.config).grade is Grade.BAD for row in table):
            return None
        return self.tracker.fit(values_of(table, answers))

    def guarded(self, estimate: Estimate) -> str | None:
        """What the guards forbid to engage for, with the trajectory begun from here."""
        guards = Guards(self.config, self.profile, self.link, self.tracker)
        if self.health is not None:
            guards.heard(self.health)
        guards.look(estimate, State.READY, self.now_ns)
        return guards.condition

    def estimate(self) -> Estimate | str:
        """The state, or why there is none to be used."""
        return young(self._estimator.at(self.now_ns), self.config.link, self.now_ns)

    def origin(self) -> Vec3 | str:
        """The trajectory's origin, or why it is not known."""
        estimate = self.estimate()
        if isinstance(estimate, str):
            return estimate
        return self.tracker.find_origin(estimate.pose.position, self.link.origin, self.link.home)

    def complete(self) -> bool:
        """Whether more listening would tell nothing new that matters."""
        link, now_ns = self.link, self.now_ns
        if self._heard_ns is None or now_ns - self._opened_ns < LISTEN_NS or not link.connected(now_ns):
            return False
        streams = link.streams.all()
        if not self.parameters.complete or not all(self._settled(s) for s in streams if s.insistent):
            return False
        if now_ns - self._heard_ns >= PATIENCE_NS:
            return True
        unheard = self._unheard() or link.version is None or isinstance(self.origin(), str)
        return not unheard and all(s.alive(now_ns) for s in streams if not s.insistent)

    def _settled(self, stream: Stream) -> bool:
        """Whether it comes as it was asked for, is not needed, or has another stand in."""
        if stream.rate_hz(self.now_ns) >= SATISFIED * stream.asked_hz:
            return True
        return not self.link.streams.needed(stream, self.now_ns) or self.stands_in(stream) is not None

    def stands_in(self, stream: Stream) -> Stream | None:
        """The lesser stream that comes in place of one that does not."""
        streams, now_ns = self.link.streams, self.now_ns
        if not stream.absent(now_ns):
            return None
        lesser = (s for s in streams.all() if s.instead_of == stream.message)
        return next((s for s in lesser if s.alive(now_ns) and not s.absent(now_ns)), None)
