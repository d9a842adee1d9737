"""The MAVLink messages that the service reads, as typed NamedTuples, and how payload bytes become one.

Field names, units and meanings are those of the message definitions (`common.xml`, `development.xml`);
only the fields that the service uses are kept. Wire layout and CRC_EXTRA come from pymavlink's generated
dialect, so that no number is written twice.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import accumulate
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import all as dialect


class Heartbeat(NamedTuple):
    """HEARTBEAT (0)."""

    type: int
    autopilot: int
    base_mode: int
    custom_mode: int
    system_status: int


class Timesync(NamedTuple):
    """TIMESYNC (111): `tc1` is 0 in a question; `ts1` comes back as sent. Both ns."""

    tc1: int
    ts1: int


class Attitude(NamedTuple):
    """ATTITUDE (30): roll, pitch, yaw in rad, their body rates (FRD) in rad/s."""

    time_boot_ms: int
    roll: float
    pitch: float
    yaw: float
    rollspeed: float
    pitchspeed: float
    yawspeed: float


class AttitudeQuaternion(NamedTuple):
    """ATTITUDE_QUATERNION (31): q1..q4 = w, x, y, z, body (FRD) to NED; body rates in rad/s."""

    time_boot_ms: int
    q1: float
    q2: float
    q3: float
    q4: float
    rollspeed: float
    pitchspeed: float
    yawspeed: float


class LocalPositionNed(NamedTuple):
    """LOCAL_POSITION_NED (32): m and m/s from the estimator's origin."""

    time_boot_ms: int
    x: float
    y: float
    z: float
    vx: float
    vy: float
    vz: float


class GpsGlobalOrigin(NamedTuple):
    """GPS_GLOBAL_ORIGIN (49): the origin of LOCAL_POSITION_NED; 1e-7 deg, altitude in mm."""

    latitude: int
    longitude: int
    altitude: int


class HomePosition(NamedTuple):
    """HOME_POSITION (242): 1e-7 deg, altitude in mm. ArduPilot leaves x, y, z zero, so they are not read."""

    latitude: int
    longitude: int
    altitude: int


class CommandAck(NamedTuple):
    """COMMAND_ACK (77)."""

    command: int
    result: int
    target_system: int
    target_component: int


class AutopilotVersion(NamedTuple):
    """AUTOPILOT_VERSION (148)."""

    flight_sw_version: int
    uid: int


class StatusText(NamedTuple):
    """STATUSTEXT (253)."""

    severity: int
    text: bytes


class NamedValueFloat(NamedTuple):
    """NAMED_VALUE_FLOAT (251): what a script on the autopilot wants to say."""

    name: bytes
    value: float


class CurrentMode(NamedTuple):
    """CURRENT_MODE (436, dialect `development`): the mode, and the one that the operator intends."""

    custom_mode: int
    intended_custom_mode: int


Body = (
    Heartbeat
    | Timesync
    | Attitude
    | AttitudeQuaternion
    | LocalPositionNed
    | GpsGlobalOrigin
    | HomePosition
    | CommandAck
    | AutopilotVersion
    | StatusText
    | NamedValueFloat
    | CurrentMode
)

_READ: Final[dict[str, type[Body]]] = {
    "HEARTBEAT": Heartbeat,
    "TIMESYNC": Timesync,
    "ATTITUDE": Attitude,
    "ATTITUDE_QUATERNION": AttitudeQuaternion,
    "LOCAL_POSITION_NED": LocalPositionNed,
    "GPS_GLOBAL_ORIGIN": GpsGlobalOrigin,
    "HOME_POSITION": HomePosition,
    "COMMAND_ACK": CommandAck,
    "AUTOPILOT_VERSION": AutopilotVersion,
    "STATUSTEXT": StatusText,
    "NAMED_VALUE_FLOAT": NamedValueFloat,
    "CURRENT_MODE": CurrentMode,
}

#: Name and id of each message that is read.
MESSAGE_IDS: Final[dict[str, int]] = {
    message.msgname: message_id
    for message_id, message in dialect.mavlink_map.items()
    if message.msgname in _READ
}


def _decoder(message: Any, make: Callable[..., Body], fields: tuple[str, ...]) -> Callable[[bytes], Body]:
    """A function from a payload, trailing zeros possibly cut off (MAVLink 2), to the typed message."""
    starts = [0, *accumulate(message.lengths)]  # an array takes several places in what `struct` returns
    positions = [starts[message.ordered_fieldnames.index(name)] for name in fields]
    unpack = message.unpacker.unpack
    size = message.unpacker.size

    def decode(payload: bytes) -> Body:
        values = unpack(payload[:size].ljust(size, b"\0"))
        return make(*[values[i] for i in positions])

    return decode


#: Message id -> decoder of its payload.
DECODERS: Final[dict[int, Callable[[bytes], Body]]] = {
    message_id: _decoder(dialect.mavlink_map[message_id], _READ[name], _READ[name]._fields)
    for name, message_id in MESSAGE_IDS.items()
}

#: Message id -> CRC_EXTRA, for every message of the dialect.
CRC_EXTRA: Final[dict[int, int]] = {
    message_id: message.crc_extra for message_id, message in dialect.mavlink_map.items()
}
