"""This service as a MAVLink component: the modes that it shows, those that may be commanded, its parameters.

HEARTBEAT's `custom_mode` is the supervisor's state as a number, which never changes once given. Parameter
names are made for QGroundControl, which groups them by what stands before the first underscore.
"""

from __future__ import annotations

import struct
from math import isfinite
from typing import Final

from pymavlink.dialects.v20 import all as dialect

from guidance.commands import Abort, Engage, Hold, Resume, Scalar
from guidance.mavlink.asking import CommandLong
from guidance.supervisor import State

#: What a COMMAND_LONG can order.
Manoeuvre = Engage | Hold | Resume | Abort

#: `custom_mode` of each state.
CUSTOM_MODES: Final[dict[State, int]] = {
    State.DISCONNECTED: 0,
    State.CONNECTED: 1,
    State.WITHHELD: 2,
    State.READY: 3,
    State.STREAMING: 4,
    State.SWITCHING: 5,
    State.ARMING: 6,
    State.TRACKING: 7,
    State.PAUSING: 8,
    State.HOLDING: 9,
    State.ABORTING: 10,
    State.CANCELLING: 11,
    State.BACKING_OUT: 12,
    State.LEAVING: 13,
    State.HANDED_OVER: 14,
    State.ABORTED: 15,
    State.FINISHED: 16,
}
#: MAV_STATE of the states; it is ACTIVE in the others, which have control or are taking or leaving it.
_STATUS: Final[dict[State, int]] = {
    State.DISCONNECTED: dialect.MAV_STATE_BOOT,
    State.CONNECTED: dialect.MAV_STATE_STANDBY,
    State.WITHHELD: dialect.MAV_STATE_STANDBY,
    State.READY: dialect.MAV_STATE_STANDBY,
    State.HANDED_OVER: dialect.MAV_STATE_STANDBY,
    State.ABORTED: dialect.MAV_STATE_CRITICAL,
    State.FINISHED: dialect.MAV_STATE_POWEROFF,
}
#: The modes that may be commanded by DO_SET_MODE: the state that is wanted.
_WANTED: Final[dict[float, type[Manoeuvre]]] = {
    CUSTOM_MODES[State.READY]: Abort,
    CUSTOM_MODES[State.TRACKING]: Engage,
    CUSTOM_MODES[State.HOLDING]: Hold,
}

#: Name of each parameter (16 characters at most) and the key that it is.
PARAMETERS: Final[dict[str, str]] = {
    "LAW_K": "law.k",
    "LAW_RHO2": "law.rho2_per_s",
    "LAW_RHO3": "law.rho3_per_s",
    "LAW_BETA": "law.beta",
    "LAW_APPR": "law.error_function.approach_m_s",
    "LAW_APPR_HORIZ": "law.error_function.horizontal_m_s",
    "LAW_APPR_VERT": "law.error_function.vertical_m_s",
    "LAW_KOFR_GAIN": "law.error_function.gain",
    "LAW_KOFR_WIDTH": "law.error_function.width_m",
    "LAW_KOFR_NORTH": "law.error_function.north_m",
    "LAW_KOFR_EAST": "law.error_function.east_m",
    "LAW_KOFR_DOWN": "law.error_function.down_m",
    "LIM_SPEED_MIN": "limits.speed_min_m_s",
    "LIM_SPEED_MAX": "limits.speed_max_m_s",
    "LIM_ROLL_RATE": "limits.roll_rate_max_rad_s",
    "LIM_PITCH_RATE": "limits.pitch_rate_max_rad_s",
    "LIM_YAW_RATE": "limits.yaw_rate_max_rad_s",
    "LIM_KEEP_DIR": "limits.keep_direction",
    "LIM_ACC": "limits.acceleration_max_m_s2",
    "LIM_ROLL_ACC": "limits.roll_acceleration_max_rad_s2",
    "LIM_PITCH_ACC": "limits.pitch_acceleration_max_rad_s2",
    "LIM_YAW_ACC": "limits.yaw_acceleration_max_rad_s2",
}
_ACCELERATIONS: Final = ("LIM_ACC", "LIM_ROLL_ACC", "LIM_PITCH_ACC", "LIM_YAW_ACC")
_REAL32: Final = struct.Struct("<f")


def shown(state: State) -> tuple[int, int]:
    """HEARTBEAT's custom_mode and system_status."""
    return CUSTOM_MODES[state], _STATUS.get(state, dialect.MAV_STATE_ACTIVE)


def order_of(command: CommandLong, state: State) -> type[Manoeuvre] | str | None:
    """What is ordered; why it cannot be ordered so; None for a command that this component does not know.

    DO_PAUSE_CONTINUE: 0 holds, 1 resumes. DO_SET_MODE: the custom mode of `tracking` engages, and resumes
    what is held; that of `holding` holds, and that of `ready` aborts.
    """
    if command.command == dialect.MAV_CMD_DO_PAUSE_CONTINUE:
        if command.param1 == 0.0:
            return Hold
        return Resume if command.param1 == 1.0 else "DO_PAUSE_CONTINUE: param1 must be 0 (hold) or 1 (resume)"
    if command.command != dialect.MAV_CMD_DO_SET_MODE:
        return None
    flags = command.param1
    if not (0.0 <= flags <= 255.0 and int(flags) & dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED):
        return "DO_SET_MODE: param1 must have MAV_MODE_FLAG_CUSTOM_MODE_ENABLED (1)"
    wanted = _WANTED.get(command.param2)
    if wanted is None:
        modes = ", ".join(f"{int(mode)} ({kind.__name__.lower()})" for mode, kind in _WANTED.items())
        return f"DO_SET_MODE: param2 must be one of {modes}"
    return Resume if wanted is Engage and state in (State.PAUSING, State.HOLDING) else wanted


def as_real32(value: Scalar) -> float:
    """A setting as a parameter: a switch is 0 or 1, a limit that is absent 0."""
    return 0.0 if value is None else float(value)


def from_real32(name: str, value: float) -> Scalar:
    """A parameter's value as a setting: the shortest number that is this REAL32."""
    if name in _ACCELERATIONS and value == 0.0:
        return None
    if name == "LIM_KEEP_DIR" and value in (0.0, 1.0):
        return value == 1.0
    if not isfinite(value):
        return value
    return next((short for n in (6, 7, 8) if _same(short := float(f"{value:.{n}g}"), value)), value)


def _same(short: float, value: float) -> bool:
    try:
        return bool(_REAL32.unpack(_REAL32.pack(short))[0] == value)
    except OverflowError:
        return False
