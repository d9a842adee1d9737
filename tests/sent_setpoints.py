"""Setpoints as the autopilot gets them: SET_ATTITUDE_TARGET out of the bytes, held against the limits."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from guidance.config import Config
from guidance.records import Packet, Record


def float32(value: float) -> float:
    """The value after it was on the wire."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def sent_setpoint(packet: Packet) -> Any | None:
    """The packet's SET_ATTITUDE_TARGET, None if it holds something else."""
    (message,) = mavlink.MAVLink(None).parse_buffer(packet.data)
    return message if message.get_type() == "SET_ATTITUDE_TARGET" else None


def sent_setpoints(records: Iterable[Record]) -> list[tuple[Packet, Any]]:
    """All setpoints among the records, in order, each with the packet it came from."""
    packets = [record for record in records if isinstance(record, Packet)]
    found = ((packet, sent_setpoint(packet)) for packet in packets)
    return [(packet, message) for packet, message in found if message is not None]


def asked(message: Any) -> tuple[float, float, float, float]:
    """Body rates FRD in rad/s, and thrust."""
    return message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate, message.thrust


def ranges(config: Config) -> tuple[tuple[float, float], ...]:
    """Lowest and highest of what `asked` may give: body rates as configured, thrust by the speeds."""
    limits, full_m_s = config.limits, config.vehicle.speed_at_full_thrust_m_s
    rates = (limits.roll_rate_max_rad_s, limits.pitch_rate_max_rad_s, limits.yaw_rate_max_rad_s)
    thrusts = (float32(limits.speed_min_m_s / full_m_s), float32(limits.speed_max_m_s / full_m_s))
    return (*((-float32(rate), float32(rate)) for rate in rates), thrusts)


def within(message: Any, config: Config) -> bool:
    """Whether every number of a setpoint is finite and within the configured limits, neutral or not."""
    return all(
        low <= value <= high for value, (low, high) in zip(asked(message), ranges(config), strict=True)
    )
