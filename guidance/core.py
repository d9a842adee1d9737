"""The guide: inputs and `now` in, packets and records out.

Service, lockstep and replay drive this one object. It opens nothing, reads no clock and has no randomness,
so that the same inputs give the same packets and records, to the bit. Every input is itself a record.

Receiving only updates what is known. Decisions and setpoints are made in `tick`, which the owner calls as
soon as `deadline()` has passed; a new attitude that is due for a setpoint moves the deadline to now. So a
burst of old datagrams is read to its end before a single setpoint is computed from the newest.
"""

from __future__ import annotations

from functools import partial
from typing import Final

import msgspec
from msgspec.structs import replace
from pymavlink.dialects.v20 import all as dialect

from guidance.cautions import Cautions, about_sticks, about_stopping
from guidance.commanding import command_of
from guidance.commands import Order, text_of
from guidance.component import shown
from guidance.condition import Condition
from guidance.config import Config, parse_connection, profile_of
from guidance.engagement import Change, Engagement
from guidance.estimate import Estimator
from guidance.fitting import Fitting
from guidance.ground import Ground
from guidance.guarding import Guards
from guidance.intake import streams_at, take_state
from guidance.leaving import LEAVING
from guidance.mavlink.line import LineWatch
from guidance.mavlink.link import AutopilotLink, Received
from guidance.mavlink.messages import (
    CommandAck,
    CurrentMode,
    GlobalPositionInt,
    GpsGlobalOrigin,
    Heartbeat,
    LocalPositionNed,
    NamedValueFloat,
    StateBody,
    StatusText,
)
from guidance.mavlink.report import link_record
from guidance.mavlink.signing import Signing, SigningClock
from guidance.orders import Orders, reported
from guidance.readiness import first_unmet
from guidance.records import Answer, Event, Input, InputKind, Level, Packet, Record
from guidance.reporting import News, setpoint_records, state_record, status_record
from guidance.requests import ENGAGING
from guidance.steering import Sent, Steering
from guidance.supervisor import GUARDED, SETPOINTS, Setpoints, State, status_text
from guidance.telling import Telling
from guidance.timing import LoopTiming
from guidance.tracker import Tracker
from guidance.view import seen
from guidance.words import SEVERITY, Words

_WATCH_NS: Final = 50_000_000
#: Where a flight that has begun stays begun.
_IN_FLIGHT: Final = ENGAGING | {State.TRACKING, State.PAUSING, State.HOLDING, State.ABORTING, State.LEAVING}
_LOUD: Final = frozenset({State.HANDED_OVER, State.ABORTED, State.WITHHELD})
_COMMANDS: Final = (dialect.MAV_CMD_DO_SET_MODE, dialect.MAV_CMD_COMPONENT_ARM_DISARM)


class Guide:
    """The whole service without its shell. Raises ConfigError for a configuration no profile fits.

    `signing` must be given if the configuration names a key, and only then (ValueError).
    """

    def __init__(self, config: Config, signing: Signing | None = None) -> None:
        if (signing is not None) != bool(config.link.signing_key_file):
            raise ValueError("link.signing_key_file and `signing` go together")
        self.config = config
        self.profile = profile_of(config)
        self.connection = parse_connection(config.link.connection)
        wanted = partial(streams_at, config=config, profile=self.profile, connection=self.connection)
        self.link = AutopilotLink(
            config.vehicle.system_id,
            config.vehicle.component_id,
            config.link.heartbeat_timeout_s,
            wanted(config.link.rate_hz),
            byte_stream=self.connection.byte_stream,
            signing=signing,
        )
        self.engagement = Engagement(config.supervisor, self.profile)
        self.tracker = Tracker(config, self.profile)
        self.orders = Orders(config, self.engagement, self.tracker)
        self.ground = Ground(self.link, self.orders, self.engagement)
        self.timing = LoopTiming()
        self.dropped_records = 0  # told by the shell, for the record only; no decision depends on it,
        self.dropped_packets = 0  # nor on this
        self._line = LineWatch(self.connection, config.link.rate_hz, wanted)
        self._estimator = Estimator(self.profile.project)
        self.fitting = Fitting(config, self.profile, self.link, self.tracker)
        self.cautions = Cautions()
        self.condition = Condition()
        self.guards = Guards(config, self.profile, self.link, self.tracker)
        self.steering = Steering(
            config, self.connection, self.link, self.tracker, self._estimator, self.guards
        )
        self._news = News()
        self._told = Telling()
        self._packets: list[bytes] = []
        self._input_seq = 0
        self._started_ns: int | None = None
        self._watch_ns = 0
        self._reboots = 0
        self._words = Words()
        self._asked = self.profile.asked

    # Inputs ------------------------------------------------------------------------------------------

    def receive(self, data: bytes, now_ns: int) -> None:
        """Bytes came from the link."""
        self.handle(Input(t_ns=now_ns, seq=self._input_seq, kind=InputKind.DATAGRAM, data=data))

    def tick(self, now_ns: int) -> None:
        """Time passed; call when `deadline()` is reached, calling more often is harmless."""
        self.handle(Input(t_ns=now_ns, seq=self._input_seq, kind=InputKind.TICK))

    def command(self, order: Order, now_ns: int) -> None:
        """The operator orders."""
        self.handle(Input(t_ns=now_ns, seq=self._input_seq, kind=InputKind.COMMAND, text=text_of(order)))

    def note(self, kind: InputKind, text: str, now_ns: int) -> None:
        """The shell has something to say: the transport opened or failed, a sink has a problem."""
        self.handle(Input(t_ns=now_ns, seq=self._input_seq, kind=kind, text=text))

    def signing_clock(self, clock: SigningClock, now_ns: int) -> None:
        """It is at least so late, for signatures: first of all, and when the wall clock was set."""
        text = msgspec.json.encode(clock).decode()
        self.handle(Input(t_ns=now_ns, seq=self._input_seq, kind=InputKind.SIGNING_CLOCK, text=text))

    def recall(self, learned: str, now_ns: int) -> None:
        """What an earlier process `learned` of the vehicle; before a flight."""
        self.handle(Input(t_ns=now_ns, seq=self._input_seq, kind=InputKind.LEARNED, text=learned))

    def handle(self, event: Input) -> None:
        """The one way in; the others build its events."""
        self._told.catch_up()
        now_ns = event.t_ns
        self._input_seq = event.seq + 1
        self._told.add(event)
        if self._started_ns is None:
            self._started_ns = now_ns
        match event.kind:
            case InputKind.DATAGRAM:
                came = self.link.receive(event.data, now_ns, event.text)
                if self.link.signing is not None and self.link.signing.forged:
                    self._told.amend(replace(event, text=self.link.signing.forged))
                for received in came:
                    self._take(received, now_ns)
                for told in self.ground.take(now_ns):
                    self._answer(*told)
            case InputKind.TICK:
                self._tick(now_ns)
            case InputKind.COMMAND:
                self._answer(*self.orders.obey(event.text, now_ns))
            case InputKind.SIGNING_CLOCK:
                if self.link.signing is not None:
                    self.link.signing.set(msgspec.json.decode(event.text, type=SigningClock), now_ns)
            case InputKind.LEARNED:
                why = self.tracker.handler.recall(event.text)
                level, text = (
                    (Level.INFO, f"starts with what was learned before: {event.text}")
                    if why is None
                    else (Level.WARNING, f"what was learned before is not used: {why}")
                )
                self._told.event(level, "learned", text, now_ns)
            case InputKind.LINK_UP | InputKind.LINK_DOWN | InputKind.NOTE:
                level = Level.INFO if event.kind is InputKind.LINK_UP else Level.WARNING
                self._told.event(level, event.kind, event.text, now_ns)
                if event.kind is InputKind.LINK_UP:
                    self.link.reader.forget()
                    self._told.add(*self._line.opened(now_ns))
        if packets := self.link.outbox.drain():
            self._packets += packets
            self._told.later(partial(self._tell_packets, packets, event))

    # Outputs -----------------------------------------------------------------------------------------

    def packets(self) -> list[bytes]:
        """What to send, in order; empty after."""
        packets, self._packets = self._packets, []
        return packets

    def records(self) -> list[Record]:
        """What to publish and log, in order; empty after. Ask after sending: some are made only now."""
        return self._told.taken()

    def deadline(self) -> int:
        """When `tick` must be called next, ns; in the past if it is due now."""
        due_ns = min(self._watch_ns, self.link.deadline())
        return min(due_ns, self.steering.pace.due_ns) if self.engagement.streaming else due_ns

    @property
    def setpoints_sent(self) -> int:
        """How many, since the start."""
        return self.steering.setpoints_sent

    @property
    def learned(self) -> str | None:
        """What flights have taught of the vehicle, for the next process; None during one."""
        return self.tracker.handler.learned if self.tracker.start_ns is None else None

    @property
    def finished(self) -> bool:
        """Whether a shutdown is complete."""
        return self.engagement.state is State.FINISHED

    # Receiving ---------------------------------------------------------------------------------------

    def _take(self, received: Received, now_ns: int) -> None:
        body = received.body
        if self.link.reboots != self._reboots:
            self._reboots = self.link.reboots
            self._estimator.reset()
            self.guards.rebooted()
            self.fitting.rebooted()
            self.condition.rebooted()
            self._told.event(Level.ERROR, "reboot", "the autopilot rebooted", now_ns)
            self._watch_ns = now_ns
        if isinstance(body, StateBody):
            self._take_sample(received.name, body, now_ns)
            return
        stream = self.link.streams.get(received.name)
        if stream is not None:
            stream.arrived(now_ns, valid=True)
        self.guards.heard(body)
        self.fitting.heard(received, now_ns)
        self.condition.heard(body, now_ns)
        if isinstance(body, CommandAck) and body.command in _COMMANDS:
            self.engagement.answered(body, now_ns)
            self._words.acknowledged(body)
        elif isinstance(body, StatusText):
            self._told.tell(self._words.said(body, now_ns))
            self.link.counters["texts_not_shown"] = self._words.not_shown
        elif isinstance(body, NamedValueFloat):
            self._told.tell(reported(body, self.tracker, self.link.counters, now_ns))
        elif isinstance(body, Heartbeat | CurrentMode | GpsGlobalOrigin):
            self._watch_ns = now_ns  # look at once: the pilot may have switched, the frame may have moved

    def _take_sample(self, name: str, body: StateBody, now_ns: int) -> None:
        refused = take_state(self.link, self._estimator, name, body, now_ns, condition=self.condition)
        if refused is None and not isinstance(body, LocalPositionNed | GlobalPositionInt):
            self.steering.pace.attitude_came(now_ns)

    # Ticking -----------------------------------------------------------------------------------------

    def _tick(self, now_ns: int) -> None:
        self.link.tick(now_ns)
        if self._estimator.news:  # here, where all that waited has been read
            self._told.add(*self._news.events(self._estimator.news, now_ns))
            if self.guards.happened(self._estimator.news):
                self.tracker.estimator_reset(self.steering.estimate(now_ns))
                self._watch_ns = now_ns
            self._estimator.news.clear()
        if now_ns >= self._watch_ns:
            self._watch_ns = now_ns + _WATCH_NS
            self._supervise(now_ns)
        if self.engagement.streaming and now_ns >= self.steering.pace.due_ns:
            self._setpoint(now_ns)
            if self.guards.trip is not None:
                self._supervise(now_ns)
        self.ground.tick(now_ns)  # behind the setpoint
        self._told.later(partial(self._tell_periodic, now_ns))

    def _tell_packets(self, packets: list[bytes], event: Input) -> None:
        self._told.add(*(Packet(t_ns=event.t_ns, input_seq=event.seq, data=packet) for packet in packets))

    def _supervise(self, now_ns: int) -> None:
        moved = self._estimator.origin.look(self.link.origin, flying=self.tracker.origin_ned_m is not None)
        if moved is not None:
            self._told.event(Level.WARNING, "origin_moved", moved, now_ns)
        estimate = self.steering.basis(now_ns)
        flying = self.engagement.state in _IN_FLIGHT
        engaging = flying and self.engagement.state is not State.HOLDING
        self._told.add(*self.fitting.look(now_ns, flying=flying))
        unfit = self.fitting.unmet
        if not flying and unfit is None:
            answers = self.fitting.answers
            others = (
                *about_sticks(self.profile, answers, self.condition.health),
                *about_stopping(self.profile, answers, self.link.version),
            )
            for caution in self.cautions.look(self.tracker, self.link, estimate, now_ns, others):
                text = f"before you fly: {caution.text}"
                self._told.event(Level.WARNING, "caution", text, now_ns)
                self.link.outbox.long_text(SEVERITY[Level.WARNING], text)
        blocked = first_unmet(
            self.config,
            self.profile,
            self.link,
            self.tracker,
            self.condition,
            estimate,
            now_ns,
            engaging,
            unfit,
        )
        self.guards.look(estimate, self.engagement.state, now_ns)
        modes = self.link.streams.get("CURRENT_MODE")
        mode_ns = None if modes is None else modes.last_ns
        self.engagement.contact.look(
            self.link.received, self.link.heartbeat_ns, mode_ns, now_ns, self.link.custom_mode
        )
        view = seen(
            self.link,
            self.engagement.contact,
            self.connection.scheme,
            now_ns,
            blocked=blocked or self.guards.condition,
            setpoints_sent=self.setpoints_sent,
            sent_ns=self.steering.sent_ns,
            answer=self._words.answer,
            trip=self.guards.trip,
        )
        streamed = self.engagement.streaming
        for change in self.engagement.update(view, now_ns):
            self._changed(change, now_ns)
        if self.engagement.streaming and not streamed:  # none was due before: it is not late
            self.steering.pace.due_ns = max(self.steering.pace.due_ns, now_ns)
        expired = self.engagement.expired(now_ns)
        if expired is not None:
            self._told.event(Level.WARNING, "order_expired", expired, now_ns)
        wanted = self.engagement.due_command(view, now_ns)
        if wanted is not None:
            self.link.outbox.send(command_of(wanted, self.link.system, self.link.component))

    def _changed(self, change: Change, now_ns: int) -> None:
        if change.event in GUARDED and self.guards.trip is not None:
            self._told.event(Level.ERROR, f"guard_{self.guards.trip.guard}", change.reason, now_ns)
        loud = change.after in _LOUD
        level = Level.WARNING if loud else Level.NOTICE
        self._told.event(level, f"state_{change.after}", f"{change.after}: {change.reason}", now_ns)
        self.link.outbox.status_text(SEVERITY[level], status_text(change.after, change.event, change.reason))
        self.link.outbox.shown = shown(change.after)
        self._told.cadence.now("status")
        if change.after in ENGAGING | LEAVING:
            self._words.forget()
        if SETPOINTS[change.after] is Setpoints.NONE or SETPOINTS[change.before] is Setpoints.NONE:
            self.timing.paused()
            self.steering.pace.due_ns = now_ns
        if change.after is State.HOLDING:
            self.tracker.pause(self.steering.acts_ns(now_ns))
        elif change.after not in _IN_FLIGHT:
            self.tracker.stop()

    # Setpoints ---------------------------------------------------------------------------------------

    def _setpoint(self, now_ns: int) -> None:
        """Send one setpoint, or be silent and say why."""
        boot_ms = (now_ns - (self._started_ns or 0)) // 1_000_000
        law = SETPOINTS[self.engagement.state] is Setpoints.LAW
        sent = self.steering.send(now_ns, boot_ms, law=law)
        if isinstance(sent, str):
            self._told.silent(sent, now_ns)
            return
        self._told.silent("", now_ns)
        self._told.later(partial(self._tell_setpoint, sent, now_ns))

    def _tell_setpoint(self, sent: Sent, now_ns: int) -> None:
        gap_s = self.timing.sent(sent.due_ns, now_ns)
        if gap_s is not None:
            self._told.event(Level.WARNING, "setpoint_gap", f"{gap_s * 1e3:.0f} ms between setpoints", now_ns)
        self._told.cadence.told("state", now_ns)
        if sent.row.asked is not self._asked:
            self._asked = sent.row.asked
            text = f"setpoints ask for {self._asked} (type_mask {sent.row.type_mask:#04x})"
            self._told.event(Level.NOTICE, "setpoint_row", text, now_ns)
        made = setpoint_records(
            sent.estimate, sent.solution, sent.outgoing, sent.row.type_mask, self.setpoints_sent
        )
        self._told.add(*made)
        self._told.stuck(None if sent.solution is None else sent.solution.flown.around, now_ns)

    def _tell_periodic(self, now_ns: int) -> None:
        for name in self._told.cadence.due(now_ns):
            self._told.add(*self._periodic(name, now_ns))

    def _periodic(self, name: str, now_ns: int) -> list[Record]:
        if name == "state":
            estimate = self.steering.estimate(now_ns)
            return [] if isinstance(estimate, str) else [state_record(estimate)]
        if name == "status":
            standing, sent = self.cautions.standing, self.setpoints_sent
            return [status_record(self.engagement, self.link, self.tracker, standing, sent, now_ns)]
        if name == "link":
            record = self._line.measured(link_record(self.link, now_ns), self.link)
            return [record, *self._line.news(record, self.link)]
        return [self.timing.record(now_ns, self.dropped_records, self.dropped_packets)]

    def _answer(self, event: Event | None, answer: Answer) -> None:
        """An order was carried out or refused; what was set holds from here on."""
        self.config = self.orders.config
        self.guards.reconfigure(self.config)
        self.fitting.reconfigure(self.config)
        self._watch_ns = answer.t_ns
        self._told.tell(event)
        self._told.add(answer)
