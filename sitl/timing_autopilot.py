"""A timing autopilot: sends states at an even rate, and notes when each setpoint comes.

It is PX4 as far as a companion computer can tell: heartbeats, modes, arming, answers to TIMESYNC and to
commands, and LOCAL_POSITION_NED with ATTITUDE_QUATERNION in one datagram. The vehicle stands still, but its
heading goes round a few headings in turn. The law answers each with a yaw rate of its own, so that the yaw
rate of a setpoint tells which state it answers.
"""

from __future__ import annotations

import gc
import math
import select
import socket
import time
from collections.abc import Callable, Sequence
from struct import Struct
from typing import Any, Final

from pymavlink.dialects.v20 import all as dialect

from guidance.config import Config
from guidance.law import evaluate
from guidance.se3 import Pose, Quaternion, Vec3
from guidance.trajectory import sample
from sitl.stopwatch import Flight, Stamp, answer_times_ns

Address = tuple[str, int]

#: What the configuration must be for `yaw_rates` to be what is answered: the reference all but stands still.
SETTINGS: Final = ("trajectory.name=line", "trajectory.speed_m_s=0.001", "guards.effect_s=60")
#: Where the vehicle stands, from the start of the line; far enough that 1 mm/s makes no difference.
POSITION_NED_M: Final = Vec3(-20.0, 0.0, 0.0)
#: As many as periods that an answer may take: a later one would be taken for that to a newer state. So close
#: (4 deg from first to last) that none follows another as a reset of the autopilot's estimator would.
HEADINGS_RAD: Final = tuple(0.01 * (i - 3.5) for i in range(8))
#: Of the distance between two answers: a yaw rate that is farther from each answers no state (neutral ones).
_TOLERANCE: Final = 0.2
#: A PX4 that takes rates alone: 1.17.0, released.
_VERSION_ID: Final = dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
_VERSION: Final = dialect.MAVLink_autopilot_version_message(
    0, 0x011100FF, 0, 0, 0, bytes(8), bytes(8), bytes(8), 0, 0, 0
)
_HEARTBEAT_NS: Final = 1_000_000_000
_MODE_NS: Final = 100_000_000
_HOLD: Final = 4 << 16 | 3 << 24
_SETTLED_S: Final = 0.25
#: Payload of SET_ATTITUDE_TARGET: time, attitude, roll and pitch rate; yaw rate.
_YAW_RATE: Final = Struct("<28xf")
_HEADER_BYTES: Final = 10


def attitude(heading_rad: float) -> Quaternion:
    """Level, with this heading."""
    return Quaternion(math.cos(0.5 * heading_rad), 0.0, 0.0, math.sin(0.5 * heading_rad))


def yaw_rates(config: Config) -> list[float]:
    """What the law answers to each heading, rad/s."""
    gains, limits = config.law.gains(), config.limits.limits()
    reference = sample(config.trajectory, 0.0)
    return [
        evaluate(gains, limits, Pose(POSITION_NED_M, attitude(heading)), reference).controls.u3
        for heading in HEADINGS_RAD
    ]


def heading_of(yaw_rate_rad_s: float, answers_rad_s: Sequence[float]) -> int | None:
    """Which of the answers this is, None if it is none of them."""
    apart = [abs(answer - yaw_rate_rad_s) for answer in answers_rad_s]
    nearest = apart.index(min(apart))
    between = min(abs(a - answers_rad_s[nearest]) for i, a in enumerate(answers_rad_s) if i != nearest)
    return nearest if apart[nearest] <= _TOLERANCE * between else None


class Conversation:
    """What the autopilot says, without a socket or a clock: bytes in by `take`, packets out by `drain`."""

    def __init__(self, answers_rad_s: Sequence[float], boot_ns: int) -> None:
        self._answers = answers_rad_s
        self._boot_ns = boot_ns
        self._out = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self._in = dialect.MAVLink(None)
        self._in.robust_parsing = True
        self._packets: list[bytes] = []
        self._mode, self._armed = _HOLD, False
        self._heartbeat_ns = self._mode_ns = boot_ns - _HEARTBEAT_NS
        self._heading_of: dict[bytes, int] = {}

    def forget(self) -> None:
        """The states sent so far are not echoed any more."""
        self._heading_of.clear()

    def state(self, heading: int, at_ns: int) -> bytes:
        """Position and attitude of that heading, measured at `at_ns`; no two are the same."""
        boot_ms = (at_ns - self._boot_ns) // 1_000_000
        q = attitude(HEADINGS_RAD[heading])
        datagram = self._pack(
            dialect.MAVLink_local_position_ned_message(boot_ms, *POSITION_NED_M, 0.0, 0.0, 0.0)
        ) + self._pack(dialect.MAVLink_attitude_quaternion_message(boot_ms, *q, 0.0, 0.0, 0.0))
        self._heading_of[datagram] = heading
        return datagram

    def take(self, data: bytes, now_ns: int) -> int | None:
        """A datagram came: the heading that it answers if it is a setpoint, or an echo of a state."""
        if int.from_bytes(data[7:10], "little") == dialect.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET:
            (yaw_rate_rad_s,) = _YAW_RATE.unpack_from(data, _HEADER_BYTES)
            return heading_of(yaw_rate_rad_s, self._answers)
        if data in self._heading_of:
            return self._heading_of[data]
        for message in self._in.parse_buffer(data) or ():
            self._answer(message, now_ns)
        return None

    def tick(self, now_ns: int) -> None:
        """Say what is due: HEARTBEAT and CURRENT_MODE."""
        if now_ns - self._heartbeat_ns >= _HEARTBEAT_NS:
            self._heartbeat_ns = now_ns
            base_mode = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            if self._armed:
                base_mode |= dialect.MAV_MODE_FLAG_SAFETY_ARMED
            kind, firmware = dialect.MAV_TYPE_SUBMARINE, dialect.MAV_AUTOPILOT_PX4
            state = dialect.MAV_STATE_ACTIVE
            self._say(dialect.MAVLink_heartbeat_message(kind, firmware, base_mode, self._mode, state, 3))
        if now_ns - self._mode_ns >= _MODE_NS:
            self._mode_ns = now_ns
            self._say(dialect.MAVLink_current_mode_message(0, self._mode, self._mode))

    def drain(self) -> list[bytes]:
        """The packets to send, in order."""
        packets, self._packets = self._packets, []
        return packets

    def _answer(self, message: Any, now_ns: int) -> None:
        if message.get_type() == "TIMESYNC" and message.tc1 == 0:
            self._say(dialect.MAVLink_timesync_message(now_ns - self._boot_ns, message.ts1))
        elif message.get_type() == "COMMAND_LONG":
            if message.command == dialect.MAV_CMD_DO_SET_MODE:
                self._mode = int(message.param2) << 16 | int(message.param3) << 24
                self._mode_ns -= _MODE_NS  # told at once
            elif message.command == dialect.MAV_CMD_COMPONENT_ARM_DISARM:
                self._armed = message.param1 == 1.0
                self._heartbeat_ns -= _HEARTBEAT_NS
            elif message.command == dialect.MAV_CMD_REQUEST_MESSAGE and message.param1 == _VERSION_ID:
                self._say(_VERSION)
            self._say(dialect.MAVLink_command_ack_message(message.command, dialect.MAV_RESULT_ACCEPTED))

    def _say(self, message: Any) -> None:
        self._packets.append(self._pack(message))

    def _pack(self, message: Any) -> bytes:
        packet = bytes(message.pack(self._out))
        self._out.seq = (self._out.seq + 1) % 256
        return packet


class TimingAutopilot:
    """The autopilot on a socket of its own, in this thread; `to` is who shall answer it."""

    def __init__(self, to: Address, answers_rad_s: Sequence[float]) -> None:
        self._to = to
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self._says = Conversation(answers_rad_s, time.monotonic_ns() - 1_000_000_000)
        self._came: list[Stamp] = []

    def __enter__(self) -> TimingAutopilot:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def fly(self, rate_hz: float, states: int) -> Flight:
        """Send so many states, and listen until one period after the last."""
        flown: list[bytes] = []
        sent: list[Stamp] = []
        late_ns: list[int] = []
        self._came = []
        self._says.forget()
        period_ns = round(1e9 / rate_hz)
        gc.collect()
        gc.disable()  # a pause of ours would be measured as theirs
        try:
            due_ns = time.monotonic_ns() + period_ns
            for i in range(states):
                heading = i % len(HEADINGS_RAD)
                state = self._says.state(heading, due_ns)
                self._listen(due_ns)
                now_ns = time.monotonic_ns()
                self._socket.sendto(state, self._to)
                flown.append(state)
                sent.append(Stamp(now_ns, heading))
                late_ns.append(now_ns - due_ns)
                due_ns += period_ns
                self._listen(now_ns + period_ns // 2)  # what else there is to say can wait for the answer
                self._says.tick(time.monotonic_ns())
                self._send()
            self._listen(due_ns)
        finally:
            gc.enable()
        return Flight(flown, sent, self._came, late_ns)

    def fly_until_answered(self, rate_hz: float, patience_s: float, alive: Callable[[], bool]) -> bool:
        """Wait until every state of a quarter of a second was answered; False if that never comes."""
        end_s = time.monotonic() + patience_s
        while time.monotonic() < end_s and alive():
            flight = self.fly(rate_hz, math.ceil(_SETTLED_S * rate_hz))
            if None not in answer_times_ns(flight.sent, flight.came):
                return True
        return False

    def _listen(self, until_ns: int) -> None:
        while (left_ns := until_ns - time.monotonic_ns()) > 0:
            if not select.select([self._socket], [], [], left_ns * 1e-9)[0]:
                return
            try:
                data = self._socket.recv(2048)
            except BlockingIOError:  # a damaged datagram, thrown away
                continue
            now_ns = time.monotonic_ns()
            heading = self._says.take(data, now_ns)
            if heading is not None:
                self._came.append(Stamp(now_ns, heading))
            self._send()

    def _send(self) -> None:
        for packet in self._says.drain():
            self._socket.sendto(packet, self._to)
