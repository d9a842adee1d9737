"""The link to one autopilot: who it is, what it says of itself, its clock, and what was lost on the way.

Only the autopilot component of the configured system is believed. Every other frame, and every frame that
is damaged, repeated, or overtaken by a newer word on the same subject, is counted under a name and otherwise
ignored.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Final, NamedTuple

from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.boot import BOOT_MS_MAX, BootClock, BootTime
from guidance.mavlink.clock import ClockFilter
from guidance.mavlink.codec import Frame, FrameReader
from guidance.mavlink.company import Company
from guidance.mavlink.messages import (
    DECODERS,
    MESSAGE_IDS,
    AutopilotVersion,
    Body,
    CommandAck,
    CurrentMode,
    GpsGlobalOrigin,
    Heartbeat,
    HomePosition,
    StateBody,
    Timesync,
    on_earth,
)
from guidance.mavlink.outbox import COMPONENT_ID, Outbox
from guidance.mavlink.sequence import Order, SequenceWatch
from guidance.mavlink.signing import Refusal, Signing
from guidance.mavlink.streams import Stream, Streams
from guidance.mavlink.twins import Twins

#: How many times its time-out a heartbeat may be old while other messages of the autopilot come.
HEARTBEATS_MISSED: Final = 3

_HEARTBEAT_PERIOD_NS: Final = 1_000_000_000
#: Often enough that 30 % of loss each way does not look like a dead uplink.
_TIMESYNC_PERIOD_NS: Final = 40_000_000
_HEARD_NS: Final = 500_000_000
_REQUEST_PERIOD_NS: Final = 1_000_000_000
_STREAM_PERIOD_NS: Final = 100_000_000
_QUESTIONS_KEPT: Final = 32
#: An intended mode that was not said again for so long may have changed (PX4 says it twice a second).
_INTENDED_OLD_NS: Final = 3_000_000_000
#: A clock that TIMESYNC finds set back by more than this belongs to an autopilot that rebooted.
_REBOOT_STEP_S: Final = 1.0

#: The command was neither carried out nor refused for good.
_NO_VERDICT: Final = (dialect.MAV_RESULT_TEMPORARILY_REJECTED, dialect.MAV_RESULT_IN_PROGRESS)
_UNKNOWN: Final = (dialect.MAV_RESULT_FAILED, dialect.MAV_RESULT_UNSUPPORTED)  # no such message (PX4: FAILED)
_ARMED: Final = dialect.MAV_MODE_FLAG_SAFETY_ARMED


class Received(NamedTuple):
    """A message of the autopilot, and the name of its stream."""

    name: str
    body: Body


class AutopilotLink:
    """Bookkeeping for one peer. Bytes in by `receive`, packets out by `outbox`; time is an argument.

    Without `signing` signatures are neither made nor looked at: signed packets are as good as unsigned ones.
    """

    def __init__(
        self,
        system: int,
        component: int,
        heartbeat_timeout_s: float,
        streams: Iterable[Stream],
        *,
        byte_stream: bool = False,
        signing: Signing | None = None,
    ) -> None:
        self.system = system
        self.component = component
        self.clock = ClockFilter()
        self.streams = Streams(streams)
        self.reader = FrameReader(stream=byte_stream)
        self.signing = signing
        self.signs = False  # whether the autopilot's newest packet carries a signature, good or not
        self.refusal: Refusal | None = None  # why its newest packet is not believed
        self.counters: Counter[str] = Counter()
        self.bytes_received = 0
        self.received = 0
        self.company = Company(system, COMPONENT_ID)
        self.twins = Twins()
        self.bytes_at_heartbeat = (0, 0)  # all of them, and those that were garbage
        self.reboots = 0
        self.heartbeat: Heartbeat | None = None
        self.custom_mode: int | None = None  # from the newest of HEARTBEAT and CURRENT_MODE
        self.intended_mode: int | None = None
        self.version: AutopilotVersion | None = None
        self.origin: GpsGlobalOrigin | None = None
        self.home: HomePosition | None = None
        self.outbox = Outbox(system, component, signing)
        self._heartbeat_timeout_ns = round(heartbeat_timeout_s * 1e9)
        self.heartbeat_ns = 0
        self._heard_ns = 0
        self.sequence = SequenceWatch()
        self._mode_number = self._heartbeat_number = -1
        self._boot = BootClock()
        self._recent: dict[int, Frame] = {}  # the last frame of each sequence number
        self._intended_ns = 0
        self._answered_ns: int | None = None
        self._questions: list[int] = []
        self._next_heartbeat_ns = 0
        self._next_timesync_ns = 0
        self._next_request_ns = 0
        self._next_stream_ns = 0

    # What is known -----------------------------------------------------------------------------------

    def connected(self, now_ns: int) -> bool:
        """Whether the autopilot's heartbeat is younger than its time-out.

        While its other messages come, heartbeats may have been lost on the way (at 30 % of loss three
        running are lost every 40 s): then it may be `HEARTBEATS_MISSED` times as old.
        """
        if self.heartbeat is None:
            return False
        heard = now_ns - self._heard_ns <= _HEARD_NS
        limit_ns = self._heartbeat_timeout_ns * (HEARTBEATS_MISSED if heard else 1)
        return now_ns - self.heartbeat_ns <= limit_ns

    @property
    def armed(self) -> bool | None:
        """None until the autopilot has said so."""
        return None if self.heartbeat is None else bool(self.heartbeat.base_mode & _ARMED)

    @property
    def vehicle_time_ms(self) -> int | None:
        """The newest `time_boot_ms`."""
        return self._boot.newest_ms

    def uplink_age_s(self, now_ns: int) -> float | None:
        """Since the newest packet of ours that the autopilot has proved to have got, by answering it."""
        return None if self._answered_ns is None else (now_ns - self._answered_ns) * 1e-9

    # Bytes in ----------------------------------------------------------------------------------------

    def receive(self, data: bytes, now_ns: int, forged: str = "") -> list[Received]:
        """The autopilot's messages in `data` that may be believed, in order.

        A replay, which has no key, says with `forged` what `signing.forged` was.
        """
        accepted: list[Received] = []
        self.bytes_received += len(data)
        frames = self.reader.feed(data)
        refused: dict[int, Refusal] = {}
        if self.signing is not None:
            refused = self.signing.refusals(frames, now_ns, forged)
            self.counters.update(refused.values())
        for number, frame in enumerate(frames):
            if not self._is_autopilot(frame, refused.get(number)) or number in refused:
                continue
            place = self.sequence.place(frame.sequence, now_ns)
            # An equal number alone proves nothing: a frame of an unknown id cannot be checked, may be forged.
            if place.order is Order.DUPLICATE:
                if self._recent.get(frame.sequence) == frame:
                    self.counters["duplicate"] += 1
                    continue
                self.twins.conflict(self.sequence.newest, now_ns)
            if place.order is not Order.NEW:
                self.counters["late"] += 1
            self._recent[frame.sequence] = frame
            if not frame.known:
                continue
            self.received += 1
            self._heard_ns = now_ns
            decode = DECODERS.get(frame.message_id)
            if decode is None:  # not read, but it had a sequence number all the same
                continue
            body = decode(frame.payload)
            if self._note(body, place.number, now_ns):
                accepted.append(Received(_NAMES[frame.message_id], body))
        return accepted

    def _is_autopilot(self, frame: Frame, refusal: Refusal | None) -> bool:
        if frame.system == self.system and frame.component == self.component:
            if frame.known:
                self.signs, self.refusal = bool(frame.signed), refusal
            return True
        self.counters["other_system" if frame.system != self.system else "other_component"] += 1
        if self.company.heard(frame, believed=refusal is None):
            self.counters["orders_of_others"] += 1
        return False

    def _note(self, body: Body, number: int, now_ns: int) -> bool:
        """Keep what the link itself needs; False for a message that must not be passed on.

        State carries its own time and TIMESYNC its question; only the mode needs the order of the frames.
        """
        if isinstance(body, StateBody):
            return self._boot_time(body.time_boot_ms, now_ns)
        if isinstance(body, Heartbeat):
            if body.autopilot == dialect.MAV_AUTOPILOT_INVALID:
                self.counters["not_an_autopilot"] += 1
                return False
            if number > self._heartbeat_number:
                self._heartbeat_number = number
                self.heartbeat = body
                self.heartbeat_ns = now_ns
                self.bytes_at_heartbeat = (self.bytes_received, self.reader.counters["garbage_bytes"])
            if self._overtaken(number):  # by a CURRENT_MODE: a sign of life all the same
                return False
            self.custom_mode = body.custom_mode
        elif isinstance(body, CurrentMode):
            if self._overtaken(number):
                return False
            self.custom_mode = body.custom_mode
            self.intended_mode = body.intended_custom_mode or None  # 0 is "not supplied"
            self._intended_ns = now_ns
        elif isinstance(body, Timesync):
            self._timesync(body, now_ns)
        elif isinstance(body, AutopilotVersion):
            self.version = body
        elif isinstance(body, GpsGlobalOrigin | HomePosition) and not on_earth(body.latitude, body.longitude):
            self.counters["origin:absurd" if isinstance(body, GpsGlobalOrigin) else "home:absurd"] += 1
            return False
        elif isinstance(body, GpsGlobalOrigin):
            self.origin = body
        elif isinstance(body, HomePosition):
            self.home = body
        elif isinstance(body, CommandAck):
            return self._acknowledged(body, now_ns)
        return True

    def _acknowledged(self, body: CommandAck, now_ns: int) -> bool:
        """An answer to a command; False if the command was another component's (0: not said, or to all)."""
        if body.target_system not in (0, self.system) or body.target_component not in (0, COMPONENT_ID):
            self.counters["ack_for_another"] += 1
            return False
        if body.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL and body.result not in _NO_VERDICT:
            self.streams.acknowledged(body.result == dialect.MAV_RESULT_ACCEPTED, body.result not in _UNKNOWN)
            self._next_stream_ns = now_ns
        return True

    def _overtaken(self, number: int) -> bool:
        """Whether a newer word on the mode has come already."""
        if number < self._mode_number:
            self.counters["overtaken_mode"] += 1
            return True
        self._mode_number = number
        return False

    def _boot_time(self, boot_ms: int, now_ns: int) -> bool:
        """Follow the autopilot's time since boot; False for a time that cannot be."""
        if boot_ms >= BOOT_MS_MAX:
            self.counters["not_time_since_boot"] += 1
            return False
        told = self._boot.take(boot_ms, self.clock, now_ns)
        if told is BootTime.REBOOT:
            self.clock.reset()
            self._rebooted()
            self._boot.newest_ms = boot_ms
        elif told is not BootTime.GOOD:
            self.counters[told.value] += 1
        return told in (BootTime.GOOD, BootTime.REBOOT)

    def _rebooted(self) -> None:
        """The autopilot's clock started again: nothing that it said before holds any more."""
        self.reboots += 1
        self._questions.clear()
        self._boot.reset()
        self.heartbeat = None
        self.custom_mode = None
        self.intended_mode = None
        self.origin = None
        self.home = None
        self.version = None
        self._next_request_ns = 0
        self.streams.reset()

    def _timesync(self, body: Timesync, now_ns: int) -> None:
        # The extension fields that name a target are not read: PX4 sends arbitrary bytes there (recorded).
        if body.tc1 == 0:
            self.outbox.send(dialect.MAVLink_timesync_message(now_ns, body.ts1))
        elif body.ts1 in self._questions:
            self._questions.remove(body.ts1)
            self._answered_ns = max(body.ts1, self._answered_ns or 0)
            restarts = self.clock.restarts
            if not self.clock.update(body.ts1, body.tc1, now_ns):
                self.counters["timesync_rejected"] += 1
            elif self.clock.restarts > restarts:
                self.counters["clock_set_anew"] += 1
                if self.clock.stepped_s < -_REBOOT_STEP_S:  # seen here first when no state is streamed
                    self._rebooted()
        else:
            self.counters["timesync_not_asked"] += 1

    # Packets out -------------------------------------------------------------------------------------

    def deadline(self) -> int:
        """When `tick` has something to do again, ns."""
        if self.heartbeat is None:
            return self._next_heartbeat_ns
        return min(
            self._next_heartbeat_ns, self._next_timesync_ns, self._next_request_ns, self._next_stream_ns
        )

    def tick(self, now_ns: int) -> None:
        """Queue what is due: our heartbeat, a TIMESYNC question, requests that were not answered."""
        if self.signing is not None:
            self.signing.advance(now_ns)
        if now_ns >= self._next_heartbeat_ns:
            self._next_heartbeat_ns = now_ns + _HEARTBEAT_PERIOD_NS
            self.outbox.heartbeat()
        if not self.connected(now_ns) or now_ns - self._intended_ns > _INTENDED_OLD_NS:
            self.intended_mode = None
        if self.heartbeat is None:
            return
        if now_ns >= self._next_timesync_ns:
            self._next_timesync_ns = now_ns + _TIMESYNC_PERIOD_NS
            self._questions = [*self._questions[1 - _QUESTIONS_KEPT :], now_ns]
            self.outbox.send(dialect.MAVLink_timesync_message(0, now_ns))
        if now_ns >= self._next_stream_ns:
            self._next_stream_ns = now_ns + _STREAM_PERIOD_NS
            request = self.streams.request(now_ns)
            if request is not None:
                message, rate_hz = request
                self.outbox.command(
                    dialect.MAV_CMD_SET_MESSAGE_INTERVAL, MESSAGE_IDS[message], round(1e6 / rate_hz)
                )
        if now_ns >= self._next_request_ns:
            self._next_request_ns = now_ns + _REQUEST_PERIOD_NS
            for name, known in self._one_shot():
                if not known:
                    self.outbox.command(dialect.MAV_CMD_REQUEST_MESSAGE, MESSAGE_IDS[name])

    def _one_shot(self) -> tuple[tuple[str, bool], ...]:
        """What must be asked for until it comes, so that origin and version are known."""
        return (
            ("AUTOPILOT_VERSION", self.version is not None),
            ("GPS_GLOBAL_ORIGIN", self.origin is not None),
            ("HOME_POSITION", self.home is not None),
        )


_NAMES: Final = {message_id: name for name, message_id in MESSAGE_IDS.items()}
