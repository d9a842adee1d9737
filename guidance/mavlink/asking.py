"""What a ground station asks of this component: commands and parameters, as typed messages.

Fields and meanings are those of `common.xml`; only those that are used are kept. A command or a PARAM_SET
counts only if it names this component: what goes to all (component 0) is meant for the autopilot, such as
QGroundControl's own modes. Questions for parameters may go to all, as QGroundControl asks.
"""

from __future__ import annotations

import struct
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.codec import Frame


class CommandLong(NamedTuple):
    """COMMAND_LONG (76), its first two params; `confirmation` is above 0 in a transmission that repeats."""

    param1: float
    param2: float
    command: int
    confirmation: int


class CommandInt(NamedTuple):
    """COMMAND_INT (75): refused, as its params are those of places."""

    command: int


class ParamRequestList(NamedTuple):
    """PARAM_REQUEST_LIST (21)."""


class ParamRequestRead(NamedTuple):
    """PARAM_REQUEST_READ (20): by `number`, or by `name` if that is negative."""

    number: int
    name: str


class ParamSet(NamedTuple):
    """PARAM_SET (23); `value` is None for a type other than REAL32."""

    name: str
    value: float | None


Asked = CommandLong | CommandInt | ParamRequestList | ParamRequestRead | ParamSet

#: Layouts on the wire, trailing zeros of a payload cut off (MAVLink 2); where the target stands in each.
_COMMAND_LONG: Final = struct.Struct("<2f20xHBBB")
_COMMAND_INT: Final = struct.Struct("<28xHBB")
_REQUEST_LIST: Final = struct.Struct("<BB")
_REQUEST_READ: Final = struct.Struct("<hBB16s")
_SET: Final = struct.Struct("<fBB16sB")
_TARGETS: Final = {
    dialect.MAVLINK_MSG_ID_COMMAND_LONG: 30,
    dialect.MAVLINK_MSG_ID_COMMAND_INT: 30,
    dialect.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: 0,
    dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ: 2,
    dialect.MAVLINK_MSG_ID_PARAM_SET: 4,
}
_QUESTIONS: Final = (
    dialect.MAVLINK_MSG_ID_PARAM_REQUEST_LIST,
    dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
)


def asks(frame: Frame, system: int, component: int) -> bool:
    """Whether `frame` asks something of this component."""
    at = _TARGETS.get(frame.message_id)
    if at is None:
        return False
    asked_system, asked_component = frame.payload[at : at + 2].ljust(2, b"\0")
    if asked_system != system:
        return False
    return asked_component == component or (
        frame.message_id in _QUESTIONS and asked_component == dialect.MAV_COMP_ID_ALL
    )


def read(frame: Frame) -> Asked:
    """What is asked; of a frame that `asks`."""
    match frame.message_id:
        case dialect.MAVLINK_MSG_ID_COMMAND_LONG:
            param1, param2, command, _, _, confirmation = _fields(_COMMAND_LONG, frame)
            return CommandLong(param1, param2, command, confirmation)
        case dialect.MAVLINK_MSG_ID_COMMAND_INT:
            return CommandInt(_fields(_COMMAND_INT, frame)[0])
        case dialect.MAVLINK_MSG_ID_PARAM_REQUEST_LIST:
            return ParamRequestList()
        case dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ:
            index, _, _, name = _fields(_REQUEST_READ, frame)
            return ParamRequestRead(index, _name(name))
        case _:
            value, _, _, name, kind = _fields(_SET, frame)
            return ParamSet(_name(name), value if kind == dialect.MAV_PARAM_TYPE_REAL32 else None)


def once(frame: Frame) -> bytes:
    """What is the same in every transmission of one command: all but `confirmation`."""
    if frame.message_id == dialect.MAVLINK_MSG_ID_COMMAND_LONG:
        return frame.payload[: _COMMAND_LONG.size - 1].rstrip(b"\0")
    return frame.payload.rstrip(b"\0")


def _fields(layout: struct.Struct, frame: Frame) -> tuple[Any, ...]:
    return layout.unpack(frame.payload[: layout.size].ljust(layout.size, b"\0"))


def _name(param_id: bytes) -> str:
    return param_id.partition(b"\0")[0].decode("ascii", "replace")
