"""The MAVLink messages that the service reads, as typed NamedTuples, and how payload bytes become one.

Field names, units and meanings are those of the message definitions (`common.xml`, `development.xml`);
only the fields that the service uses are kept. Wire layout and CRC_EXTRA come from pymavlink's generated
dialect, so that no number is written twice.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from struct import Struct, calcsize
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.air import VfrHud, Wind, WindCov

#: 1e-7 deg.
LATITUDE_MAX: Final = 900_000_000
LONGITUDE_MAX: Final = 1_800_000_000


def on_earth(latitude: int, longitude: int) -> bool:
    """Whether there is such a place (1e-7 deg) and somebody put it there: 0/0 is what was never set."""
    at_all = abs(latitude) <= LATITUDE_MAX and abs(longitude) <= LONGITUDE_MAX
    return at_all and not latitude == longitude == 0


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

    @property
    def since_boot_ns(self) -> int:
        """`time_boot_ms` in ns."""
        return self.time_boot_ms * 1_000_000


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

    @property
    def since_boot_ns(self) -> int:
        """`time_boot_ms` in ns."""
        return self.time_boot_ms * 1_000_000


class LocalPositionNed(NamedTuple):
    """LOCAL_POSITION_NED (32): m and m/s from the estimator's origin."""

    time_boot_ms: int
    x: float
    y: float
    z: float
    vx: float
    vy: float
    vz: float

    @property
    def since_boot_ns(self) -> int:
        """`time_boot_ms` in ns."""
        return self.time_boot_ms * 1_000_000


class GlobalPositionInt(NamedTuple):
    """GLOBAL_POSITION_INT (33): 1e-7 deg, altitude AMSL in mm, velocity in NED in cm/s."""

    time_boot_ms: int
    lat: int
    lon: int
    alt: int
    vx: int
    vy: int
    vz: int

    @property
    def since_boot_ns(self) -> int:
        """`time_boot_ms` in ns."""
        return self.time_boot_ms * 1_000_000


class Odometry(NamedTuple):
    """ODOMETRY (331): pose in `frame_id`, twist in `child_frame_id`, both of one instant; m, m/s, rad/s.

    q1..q4 = w, x, y, z, body (FRD) to `frame_id`. `reset_counter` changes with every reset of the estimator.
    """

    time_usec: int
    x: float
    y: float
    z: float
    q1: float
    q2: float
    q3: float
    q4: float
    vx: float
    vy: float
    vz: float
    rollspeed: float
    pitchspeed: float
    yawspeed: float
    frame_id: int
    child_frame_id: int
    reset_counter: int
    estimator_type: int
    quality: int

    @property
    def time_boot_ms(self) -> int:
        """Time since boot in ms, if `time_usec` is that and not Unix time: the message allows both."""
        return self.time_usec // 1000

    @property
    def since_boot_ns(self) -> int:
        """The same in ns."""
        return self.time_usec * 1000


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


class SysStatus(NamedTuple):
    """SYS_STATUS (1): bits of MAV_SYS_STATUS_SENSOR; `battery_remaining` in %, -1 if not known."""

    onboard_control_sensors_present: int
    onboard_control_sensors_enabled: int
    onboard_control_sensors_health: int
    battery_remaining: int


class BatteryStatus(NamedTuple):
    """BATTERY_STATUS (147): `battery_remaining` in %, -1 if not known; a MAV_BATTERY_CHARGE_STATE."""

    id: int
    battery_remaining: int
    charge_state: int


class EstimatorStatus(NamedTuple):
    """ESTIMATOR_STATUS (230) of PX4: bits of ESTIMATOR_STATUS_FLAGS."""

    flags: int


class EkfStatusReport(NamedTuple):
    """EKF_STATUS_REPORT (193) of ArduPilot: bits of EKF_STATUS_FLAGS, the lower ten as in the other."""

    flags: int


class ExtendedSysState(NamedTuple):
    """EXTENDED_SYS_STATE (245): a MAV_LANDED_STATE."""

    landed_state: int


class ParamValue(NamedTuple):
    """PARAM_VALUE (22): `param_value` is its four bytes, which need not be those of a float."""

    param_value: bytes
    param_id: bytes
    param_type: int


class NamedValueFloat(NamedTuple):
    """NAMED_VALUE_FLOAT (251): what a script on the autopilot wants to say."""

    name: bytes
    value: float


class CurrentMode(NamedTuple):
    """CURRENT_MODE (436, dialect `development`): the mode, and the one that the operator intends."""

    custom_mode: int
    intended_custom_mode: int


#: What says where the vehicle is, or how it lies, at a time since boot.
StateBody = Attitude | AttitudeQuaternion | LocalPositionNed | GlobalPositionInt | Odometry

Body = (
    Heartbeat
    | Timesync
    | Attitude
    | AttitudeQuaternion
    | LocalPositionNed
    | GlobalPositionInt
    | Odometry
    | GpsGlobalOrigin
    | HomePosition
    | CommandAck
    | AutopilotVersion
    | StatusText
    | SysStatus
    | BatteryStatus
    | EstimatorStatus
    | EkfStatusReport
    | ExtendedSysState
    | ParamValue
    | NamedValueFloat
    | CurrentMode
    | VfrHud
    | Wind
    | WindCov
)

_READ: Final[dict[str, type[Body]]] = {
    "HEARTBEAT": Heartbeat,
    "TIMESYNC": Timesync,
    "ATTITUDE": Attitude,
    "ATTITUDE_QUATERNION": AttitudeQuaternion,
    "LOCAL_POSITION_NED": LocalPositionNed,
    "GLOBAL_POSITION_INT": GlobalPositionInt,
    "ODOMETRY": Odometry,
    "GPS_GLOBAL_ORIGIN": GpsGlobalOrigin,
    "HOME_POSITION": HomePosition,
    "COMMAND_ACK": CommandAck,
    "AUTOPILOT_VERSION": AutopilotVersion,
    "STATUSTEXT": StatusText,
    "SYS_STATUS": SysStatus,
    "BATTERY_STATUS": BatteryStatus,
    "ESTIMATOR_STATUS": EstimatorStatus,
    "EKF_STATUS_REPORT": EkfStatusReport,
    "EXTENDED_SYS_STATE": ExtendedSysState,
    "PARAM_VALUE": ParamValue,
    "NAMED_VALUE_FLOAT": NamedValueFloat,
    "CURRENT_MODE": CurrentMode,
    "VFR_HUD": VfrHud,
    "WIND": Wind,
    "WIND_COV": WindCov,
}

#: Name and id of each message that is read.
MESSAGE_IDS: Final[dict[str, int]] = {
    message.msgname: message_id
    for message_id, message in dialect.mavlink_map.items()
    if message.msgname in _READ
}


def _decoder(message: Any, make: type[Body]) -> Callable[[bytes], Body]:
    """A function from a payload, trailing zeros possibly cut off (MAVLink 2), to the typed message.

    Only the fields of `make` are unpacked; an array `q` of four is its fields `q1` to `q4`.
    """
    layout = "<"
    found: list[str] = []
    places = re.findall(r"(\d*)([a-zA-Z])", message.unpacker.format)
    for name, (count, code) in zip(message.ordered_fieldnames, places, strict=True):
        array = bool(count) and code != "s"
        names = [f"{name}{n}" for n in range(1, int(count) + 1)] if array else [name]
        wanted = set(names) <= set(make._fields)
        layout += f"{count}{code}" if wanted else f"{calcsize('<' + count + code)}x"
        found += names if wanted else []
    size = calcsize(layout)
    unpack = Struct(layout).unpack_from
    build = make._make
    if tuple(found) == make._fields:
        return lambda payload: build(unpack(payload if len(payload) >= size else payload.ljust(size, b"\0")))
    positions = [found.index(name) for name in make._fields]

    def decode(payload: bytes) -> Body:
        values = unpack(payload.ljust(size, b"\0"))
        return build([values[i] for i in positions])

    return decode


_PARAM_VALUE: Final = Struct("<4s2x2x16sB")


def _param_value(payload: bytes) -> ParamValue:
    """Apart, as a float that passes through Python does not keep the bits of every integer."""
    size = _PARAM_VALUE.size
    return ParamValue(*_PARAM_VALUE.unpack(payload[:size].ljust(size, b"\0")))


#: Message id -> decoder of its payload.
DECODERS: Final[dict[int, Callable[[bytes], Body]]] = {
    message_id: _decoder(dialect.mavlink_map[message_id], _READ[name])
    for name, message_id in MESSAGE_IDS.items()
} | {MESSAGE_IDS["PARAM_VALUE"]: _param_value}

#: Message id -> CRC_EXTRA, for every message of the dialect.
CRC_EXTRA: Final[dict[int, int]] = {
    message_id: message.crc_extra for message_id, message in dialect.mavlink_map.items()
}
