"""Messages by which others tell an autopilot where to go, or in which mode: noticed here, never obeyed."""

from __future__ import annotations

import re
from struct import calcsize
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.codec import Frame

#: Setpoints, sticks, modes and missions.
_MESSAGES: Final = (
    "SET_ATTITUDE_TARGET",
    "SET_POSITION_TARGET_LOCAL_NED",
    "SET_POSITION_TARGET_GLOBAL_INT",
    "SET_ACTUATOR_CONTROL_TARGET",
    "MANUAL_CONTROL",
    "RC_CHANNELS_OVERRIDE",
    "SET_MODE",
    "MISSION_COUNT",
    "MISSION_ITEM",
    "MISSION_ITEM_INT",
    "MISSION_CLEAR_ALL",
    "MISSION_SET_CURRENT",
    "MISSION_WRITE_PARTIAL_LIST",
    "COMMAND_LONG",
    "COMMAND_INT",
)
#: Of the two that carry commands.
_COMMANDS: Final = {
    getattr(dialect, name): name
    for name in (
        "MAV_CMD_DO_SET_MODE",
        "MAV_CMD_DO_REPOSITION",
        "MAV_CMD_DO_PAUSE_CONTINUE",
        "MAV_CMD_DO_CHANGE_SPEED",
        "MAV_CMD_DO_GUIDED_LIMITS",
        "MAV_CMD_DO_FLIGHTTERMINATION",
        "MAV_CMD_COMPONENT_ARM_DISARM",
        "MAV_CMD_MISSION_START",
        "MAV_CMD_NAV_LAND",
        "MAV_CMD_NAV_TAKEOFF",
        "MAV_CMD_NAV_RETURN_TO_LAUNCH",
    )
}


class _Layout(NamedTuple):
    """Where a message says for whom it is, and what it commands; None where it does not."""

    name: str
    size: int
    system_at: int
    component_at: int | None
    command_at: int | None


def _layout(message: Any) -> _Layout:
    places: dict[str, int] = {}
    at = 0
    for name, (count, code) in zip(
        message.ordered_fieldnames, re.findall(r"(\d*)([a-zA-Z])", message.unpacker.format), strict=True
    ):
        places[name] = at
        at += calcsize(f"<{count}{code}")
    system_at = places["target"] if "target" in places else places["target_system"]
    command_at = places["command"] if message.msgname.startswith("COMMAND_") else None
    return _Layout(message.msgname, at, system_at, places.get("target_component"), command_at)


_LAYOUTS: Final = {
    message_id: _layout(message)
    for message_id, message in dialect.mavlink_map.items()
    if message.msgname in _MESSAGES
}


def order_of(frame: Frame, system: int, component: int) -> str | None:
    """The name of what `frame` tells the autopilot of `system` to do; None if nothing.

    What is addressed to `component` of it, which is this service, is no order to the autopilot.
    """
    layout = _LAYOUTS.get(frame.message_id)
    if layout is None:
        return None
    payload = frame.payload.ljust(layout.size, b"\0")  # MAVLink 2 cuts trailing zeros off
    if payload[layout.system_at] not in (0, system):
        return None
    if layout.component_at is not None and payload[layout.component_at] == component:
        return None
    if layout.command_at is None:
        return layout.name
    return _COMMANDS.get(int.from_bytes(payload[layout.command_at : layout.command_at + 2], "little"))
