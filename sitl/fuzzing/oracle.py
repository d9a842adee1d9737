"""What must hold of everything that a guide sends and records, whatever came in."""

from __future__ import annotations

import hashlib
import math
import struct
from typing import Any, Final

import msgspec
from pymavlink.dialects.v20 import all as dialect

from guidance.core import Guide
from guidance.handling.rover_px4 import STANDING_M_S
from guidance.mavlink.profiles import Handling
from guidance.records import TOPICS, Answer, Packet, Record
from guidance.supervisor import SETPOINTS, Setpoints
from sitl.fuzzing.sizes import longest

#: No container of a guide may be longer, whatever came in; a datagram or a log line is not kept.
CONTAINER_MAX: Final = 1200

_DECODERS: Final = {kind: msgspec.json.Decoder(kind) for kind in TOPICS}
_SIGNED: Final = 0x01


class Broken(Exception):  # noqa: N818
    """Something that must hold does not; the text says what."""


class Oracle:
    """Given each record of a guide in order; raises `Broken`.

    `questions` are the newest TIMESYNC questions (their `ts1`) of the guide, which a stranger may answer.
    """

    def __init__(self, guide: Guide, key: bytes | None = None) -> None:
        self.guide = guide
        self.questions: list[int] = []
        self._key = key
        self._digest = hashlib.sha256()
        self._encode = msgspec.json.Encoder().encode
        self._mav = dialect.MAVLink(None)
        self._follow()

    def _follow(self) -> None:
        """The limits as they are now: an order may have set another."""
        config = self.guide.config
        limits, full_m_s = config.limits, config.vehicle.speed_at_full_thrust_m_s
        self._full_m_s = full_m_s
        self._throttle = self.guide.profile.handling is Handling.AIRPLANE
        rates = (limits.roll_rate_max_rad_s, limits.pitch_rate_max_rad_s, limits.yaw_rate_max_rad_s)
        speeds = (limits.speed_min_m_s / full_m_s, limits.speed_max_m_s / full_m_s)
        self._ranges = [(-_float32(rate), _float32(rate)) for rate in rates]
        if self._throttle:
            speeds = (0.0, 1.0)
        self._ranges.append((_float32(speeds[0]), _float32(speeds[1])))

    def take(self, record: Record) -> None:
        """The next record."""
        line = self._encode(record)
        self._digest.update(line)
        if _DECODERS[type(record)].decode(line) != record:
            raise Broken(f"a record cannot be read back: {line.decode()}")
        if isinstance(record, Packet):
            self._packet(record.data)
        elif isinstance(record, Answer):
            self._follow()

    def finish(self) -> bytes:
        """At the end: memory; the digest of all that was recorded."""
        found = longest(self.guide, "guide")
        # The timestamps of a second's signed packets are kept: only who has the key can send more of them.
        if found.length > CONTAINER_MAX and not found.path.endswith("._seen"):
            raise Broken(f"{found.path} has grown to {found.length}")
        return self._digest.digest()

    def _packet(self, data: bytes) -> None:
        try:
            messages: list[Any] = self._mav.parse_buffer(data) or []
        except dialect.MAVError as error:
            raise Broken(f"pymavlink cannot read a packet of ours: {error}: {data.hex()}") from None
        if len(messages) != 1 or messages[0].get_type() in ("BAD_DATA", "UNKNOWN"):
            raise Broken(f"a packet of ours is {len(messages)} messages to pymavlink: {data.hex()}")
        if self._key is not None:
            good = hashlib.sha256(self._key + data[:-6]).digest()[:6] == data[-6:]
            if not (data[2] & _SIGNED and good):
                raise Broken(f"a packet of ours is not signed by our key: {data.hex()}")
        message = messages[0]
        kind = message.get_type()
        if kind == "SET_ATTITUDE_TARGET":
            rates = message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate
            self._setpoint(*rates, message.thrust)
        elif kind == "SET_POSITION_TARGET_LOCAL_NED":
            speed_m_s = math.hypot(message.vx, message.vy, message.vz)
            self._setpoint(0.0, 0.0, message.yaw_rate, speed_m_s / self._full_m_s)
        elif kind == "TIMESYNC" and message.tc1 == 0:
            self.questions = [*self.questions[-3:], message.ts1]
        elif kind == "COMMAND_LONG":
            self._command(message)

    def _setpoint(self, *values: float) -> None:
        """Body rates and thrust, or what stands for it."""
        engagement = self.guide.engagement
        kind = SETPOINTS[engagement.state]
        if kind is Setpoints.NONE or not engagement.streaming:
            raise Broken(f"a setpoint was sent in {engagement.state}, where nothing may be")
        if kind is Setpoints.NEUTRAL:  # asks for nothing, even of a vehicle that is never to be slow
            # an airplane keeps its throttle, and PX4's rovers stand by a bearing and next to no speed
            stands = abs(values[3]) * self._full_m_s <= STANDING_M_S + 1e-6
            if values[:3] != (0.0, 0.0, 0.0) or not (stands or self._throttle):
                raise Broken(f"a setpoint in {engagement.state} is not neutral: {values}")
            return
        for value, (low, high) in zip(values, self._ranges, strict=True):
            if not low <= value <= high:  # nor is what is not a number
                raise Broken(f"a setpoint is outside {low:g} to {high:g}: {values}")

    def _command(self, message: Any) -> None:
        config = self.guide.config
        numbers = [getattr(message, f"param{n}") for n in range(1, 8)]
        if any(math.isinf(number) for number in numbers):
            raise Broken(f"a command has a parameter that is not finite: {message}")
        arming = message.command == dialect.MAV_CMD_COMPONENT_ARM_DISARM and message.param1 != 0.0
        if arming and not config.supervisor.arm:
            raise Broken("an arming command was sent, and supervisor.arm is false")


def _float32(value: float) -> float:
    return float(struct.unpack("<f", struct.pack("<f", value))[0])
