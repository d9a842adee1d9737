"""What may become of the vehicle's messages on their way: changed, held, thinned, mixed with another's."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Final

from pymavlink.dialects.v20 import all as mavlink

from sitl.vehicle import Vehicle, VehicleOptions

#: A datagram of the vehicle's and the time; what goes on the line instead.
Stage = Callable[[bytes, int], Iterable[bytes]]
#: Changes a decoded message in place; False keeps it from going on.
Change = Callable[[Any], object]

ATTITUDE: Final = frozenset({"ATTITUDE", "ATTITUDE_QUATERNION", "ODOMETRY"})
POSITION: Final = frozenset({"LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "ODOMETRY"})
STATE: Final = ATTITUDE | POSITION

_ATTITUDE_FIELDS: Final = ("roll", "pitch", "yaw", "q1", "q2", "q3", "q4", "q")
_RATE_FIELDS: Final = ("rollspeed", "pitchspeed", "yawspeed")
_POSITION_FIELDS: Final = ("x", "y", "z", "lat", "lon", "alt", "relative_alt", "vx", "vy", "vz")


class Tampering:
    """A stage that changes the messages of some names and lets all others pass as they are.

    A change makes a frame with the sequence number of the one before and a checksum that holds.
    """

    def __init__(self, names: frozenset[str], change: Change) -> None:
        self._names = names
        self._change = change
        self._in, self._out = mavlink.MAVLink(None), mavlink.MAVLink(None)

    def __call__(self, data: bytes, now_ns: int) -> Iterator[bytes]:
        for message in self._in.parse_buffer(data) or []:
            if message.get_type() not in self._names:
                yield bytes(message.get_msgbuf())
            elif self._change(message) is not False:
                self._out.srcSystem, self._out.srcComponent = (
                    message.get_srcSystem(),
                    message.get_srcComponent(),
                )
                self._out.seq = message.get_seq()
                yield message.pack(self._out)


def frozen(names: frozenset[str], *, stamped: bool) -> Stage:
    """The values stand still; with `stamped` their times go on, without the whole message is repeated."""
    held: dict[str, dict[str, Any]] = {}

    def freeze(message: Any) -> None:
        fields = [*_ATTITUDE_FIELDS, *_RATE_FIELDS] if names == ATTITUDE else list(_POSITION_FIELDS)
        if not stamped:
            fields = message.get_fieldnames()
        kept = held.setdefault(message.get_type(), {})
        for field in fields:
            if hasattr(message, field):
                setattr(message, field, kept.setdefault(field, getattr(message, field)))

    return Tampering(names, freeze)


def quaternions(factor: Callable[[int], float]) -> Stage:
    """Each attitude's quaternion times `factor` of its number."""
    count = 0

    def scale(message: Any) -> None:
        nonlocal count
        count += 1
        by = factor(count)
        if message.get_type() == "ODOMETRY":
            message.q = [by * part for part in message.q]
        elif message.get_type() == "ATTITUDE_QUATERNION":
            for field in ("q1", "q2", "q3", "q4"):
                setattr(message, field, by * getattr(message, field))

    return Tampering(ATTITUDE, scale)


def not_a_number(names: frozenset[str]) -> Stage:
    """NaN in one field of the attitude or of the position (an integer position is the worst there is)."""

    def spoil(message: Any) -> None:
        for field in ("q1", "roll", "x"):
            if hasattr(message, field):
                setattr(message, field, math.nan)
        if message.get_type() == "GLOBAL_POSITION_INT":
            message.lat = 2**31 - 1

    return Tampering(names, spoil)


def moved(north_m: float, east_m: float) -> Stage:
    """The local position is elsewhere, and nobody counts a reset."""

    def move(message: Any) -> object:
        if message.get_type() == "GLOBAL_POSITION_INT":
            return False
        message.x += north_m
        message.y += east_m
        return None

    return Tampering(POSITION, move)


def later(seconds: float) -> Stage:
    """The autopilot's clock shows so much more in every message."""

    def shift(message: Any) -> None:
        if hasattr(message, "time_boot_ms"):
            message.time_boot_ms = max(0, message.time_boot_ms + round(1e3 * seconds))
        elif hasattr(message, "time_usec"):
            message.time_usec = max(0, message.time_usec + round(1e6 * seconds))
        elif message.tc1 != 0:
            message.tc1 = max(1, message.tc1 + round(1e9 * seconds))

    return Tampering(STATE | {"TIMESYNC"}, shift)


def thinned(names: frozenset[str], hz: float) -> Stage:
    """No more than so many a second of each."""
    period_ms = 1e3 / hz
    last_ms: dict[str, float] = {}

    def thin(message: Any) -> bool:
        kind = message.get_type()
        now_ms = message.time_usec * 1e-3 if kind == "ODOMETRY" else float(message.time_boot_ms)
        if now_ms < last_ms.get(kind, -math.inf) + period_ms - 1.0:
            return False
        last_ms[kind] = now_ms
        return True

    return Tampering(names, thin)


def with_another(options: VehicleOptions, now_ns: int) -> Stage:
    """Another autopilot speaks on the same line."""
    other = Vehicle(options, now_ns)

    def mix(data: bytes, now_ns: int) -> list[bytes]:
        return [data, *other.advance(now_ns)]

    return mix


def told(name: str, **values: float) -> Stage:
    """In every message of this name these fields have these values."""

    def put(message: Any) -> None:
        for field, value in values.items():
            setattr(message, field, value)

    return Tampering(frozenset({name}), put)


def parameters(value: float | None) -> Stage:
    """Every parameter that is no integer has this value; None: no answer comes."""

    def put(message: Any) -> object:
        if value is None:
            return False
        if message.param_type == mavlink.MAV_PARAM_TYPE_REAL32:
            message.param_value = value
        return None

    return Tampering(frozenset({"PARAM_VALUE"}), put)
