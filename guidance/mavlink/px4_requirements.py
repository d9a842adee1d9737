"""PX4's parameters that count, one table for each class of vehicle.

Sources: `commander_params.c`, `mavlink_params.c`, `fw_att_control` and `fw_lateral_longitudinal_control`
parameters, `mc_pos_control` (`multicopter_position_control_limits_params.c`), `rover_control` (PX4 1.16; a
rover of 1.15 and older has GND_*), `uuv_att_control_params.c`, each read in 1.14, 1.15, 1.16 and main of
2026-03. Of the rovers no recording was at hand.
"""

from __future__ import annotations

import math
from typing import Final

from guidance.mavlink.requirements import Requirement

_DEG: Final = math.radians(1.0)
_SPEED: Final = (0.1, 150.0)

#: Of COM_RC_IN_MODE: nobody steers by hand, and nothing is lost (`failsafe.cpp`, 1.14 to main of 2026-03).
_NO_STICKS: Final = 4
#: Of COM_RCL_EXCEPT: with bit 2.
_STICKS_IGNORED: Final = frozenset(bits for bits in range(32) if bits & 4)
_LINK_LOSS: Final = {1: "hold", 2: "return", 3: "land", 5: "terminate", 6: "disarm"}

PX4_OFFBOARD: Final = (
    Requirement(
        "COM_OF_LOSS_T",
        "it is how long the autopilot goes on with the last setpoint: shorter, a gap in the stream ends the "
        "flight before the service can; longer, a vehicle that nobody guides goes on as long",
        low=1.0,
        high=2.0,
        unit="s",
        serious=False,
        plausible=(0.2, 60.0),
    ),
    Requirement(
        "COM_OBL_RC_ACT",
        "that is what the autopilot does when the setpoints stop; is it meant?",
        meanings={
            0: "position mode",
            1: "altitude mode",
            2: "stabilized",
            3: "return",
            4: "land",
            5: "hold",
            6: "terminate",
            7: "disarm",
        },
        doubtful=frozenset({6, 7}),
    ),
    Requirement(
        "COM_RC_IN_MODE",
        "",
        meanings={
            0: "sticks by radio",
            1: "sticks by MAVLink",
            2: "sticks by radio or MAVLink",
            3: "sticks by the first that is heard",
            _NO_STICKS: "no sticks",
            **dict.fromkeys(range(5, 9), "sticks by radio or MAVLink, by priority"),
        },
        quiet=True,
    ),
    Requirement(
        "COM_RCL_EXCEPT",
        "when the transmitter is lost nobody can take over, and NAV_RCL_ACT does not act: if that is not "
        "meant, take 4 from it (bit 2); sticks that are not there at arming are not missed either way",
        meanings={
            **dict.fromkeys(range(32), "OFFBOARD ends when sticks are lost"),
            **dict.fromkeys(_STICKS_IGNORED, "OFFBOARD goes on when sticks are lost"),
        },
        doubtful=_STICKS_IGNORED,
        unless=("COM_RC_IN_MODE", _NO_STICKS),
        quiet=True,
    ),
    Requirement(
        "NAV_RCL_ACT",
        "that is what the autopilot does when sticks are lost; is it meant?",
        meanings={0: "nothing", **_LINK_LOSS},
        doubtful=frozenset({5, 6}),
        unless=("COM_RC_IN_MODE", _NO_STICKS),
        quiet=True,
    ),
    Requirement(
        "NAV_DLL_ACT",
        "with no ground station it does not arm, and losing one in flight ends OFFBOARD (since 1.17 unless "
        "COM_DLL_EXCEPT has bit 2): if that is not meant, set it to 0",
        meanings={0: "nothing without a ground station", **_LINK_LOSS},
        doubtful=frozenset(_LINK_LOSS),
        quiet=True,
    ),
    Requirement(
        "MAV_FWDEXTSP",
        "without it setpoints of a companion computer are not carried out",
        low=1.0,
        high=1.0,
    ),
)


def _limit(
    name: str, what: str, unit: str, plausible: tuple[float, float], *, older: tuple[str, ...] = ()
) -> Requirement:
    """One that the handling keeps to."""
    return Requirement(name, what, unit=unit, plausible=plausible, older=older, used=True)


def _required(name: str, what: str, unit: str, plausible: tuple[float, float]) -> Requirement:
    return _limit(name, what, unit, plausible)._replace(required=True)


def _told(name: str, what: str, unit: str, plausible: tuple[float, float]) -> Requirement:
    """One that the autopilot keeps to, and nothing here."""
    return _limit(name, what, unit, plausible)._replace(used=False)


#: Both came with PX4 1.17 (2025-07), where they are 0.1 and 0.3 if nobody sets them; before, nothing was cut.
PX4_UUV: Final = (
    # Which of them stop its thrusters is a caution of its own (`guidance.cautions`).
    *(
        row._replace(doubtful=frozenset()) if row.parameter == "COM_OBL_RC_ACT" else row
        for row in PX4_OFFBOARD
    ),
    _told("UUV_THRUST_SAT", "thrust is cut off here", "", (0.001, 1.0))._replace(low=1.0, serious=False),
    _told("UUV_TORQUE_SAT", "torques are cut off here: it turns no harder", "", (0.001, 1.0)),
)

PX4_PLANE: Final = (
    *PX4_OFFBOARD,
    _required("FW_AIRSPD_MIN", "below it the autopilot takes the airplane to stall", "m/s", _SPEED),
    _required("FW_AIRSPD_TRIM", "its controllers are tuned at this airspeed", "m/s", _SPEED),
    _required("FW_AIRSPD_MAX", "above it the autopilot takes the airplane to break", "m/s", _SPEED),
    _told("FW_AIRSPD_STALL", "it is the airspeed at which it stalls", "m/s", (0.0, 150.0)),
    _limit("FW_R_LIM", "the bank is asked for up to this angle", "deg", (5.0, 80.0)),
    _limit("FW_R_RMAX", "the bank changes no faster", "deg/s", (1.0, 1000.0)),
    _limit("FW_PSP_OFF", "it is the pitch of level flight", "deg", (-90.0, 90.0)),
    _limit("FW_P_LIM_MIN", "the nose is asked to go down to this angle", "deg", (-80.0, -1.0)),
    _limit("FW_P_LIM_MAX", "the nose is asked to go up to this angle", "deg", (1.0, 80.0)),
    _limit("FW_THR_MIN", "throttle is asked for from here on", "", (0.0, 0.9)),
    _limit("FW_THR_TRIM", "throttle begins here, before it is learned", "", (0.01, 1.0)),
    _limit("FW_THR_MAX", "throttle is asked for up to here", "", (0.1, 1.0)),
    _limit(
        "FW_T_CLMB_MAX", "it is how fast the airplane climbs with all of its throttle", "m/s", (0.1, 100.0)
    ),
    _limit("FW_T_SINK_MAX", "it is how fast the airplane may sink", "m/s", (0.1, 100.0)),
    _told("FW_R_TC", "the bank follows with this time constant", "s", (0.05, 5.0)),
    _told("FW_P_TC", "the pitch follows with this time constant", "s", (0.05, 5.0)),
    Requirement(
        "FW_ACRO_YAW_EN",
        "",
        meanings={0: "a yaw rate is not obeyed: it turns by banking", 1: "a yaw rate is obeyed"},
    ),
    Requirement(
        "FW_USE_AIRSPD",
        "the autopilot guesses its airspeed, and so has the service to: keep away from the slowest",
        meanings={0: "no airspeed sensor", 1: "its airspeed sensor counts"},
        doubtful=frozenset({0}),
    ),
)

_VELOCITY_GAINS: Final = tuple(f"MPC_{axis}_VEL_{gain}_ACC" for axis in ("XY", "Z") for gain in "PID")

PX4_COPTER: Final = (
    *PX4_OFFBOARD,
    Requirement(
        "MPC_XY_VEL_MAX",
        "the vehicle flies slower than it is asked to",
        low="limits.speed_max_m_s",
        unit="m/s",
        serious=False,
        plausible=_SPEED,
        required=True,
        used=True,
    ),
    _required("MPC_Z_VEL_MAX_UP", "it climbs no faster", "m/s", _SPEED),
    _required("MPC_Z_VEL_MAX_DN", "it sinks no faster", "m/s", _SPEED),
    _limit("MPC_ACC_HOR", "the velocity changes no faster in flight by itself", "m/s^2", (0.1, 50.0)),
    _told("MPC_ACC_HOR_MAX", "the velocity changes no faster", "m/s^2", (0.1, 50.0)),
    _limit("MPC_ACC_UP_MAX", "the velocity changes no faster upwards", "m/s^2", (0.1, 50.0)),
    _limit("MPC_ACC_DOWN_MAX", "the velocity changes no faster downwards", "m/s^2", (0.1, 50.0)),
    _told("MPC_JERK_MAX", "the acceleration changes no faster", "m/s^3", (0.1, 500.0)),
    _limit("MPC_TILTMAX_AIR", "the velocity changes no faster than leaning so far does", "deg", (5.0, 89.0)),
    Requirement(
        "MC_YAWRATE_MAX",
        "the vehicle turns slower than it is asked to",
        low="limits.yaw_rate_max_rad_s",
        scale=_DEG,
        unit="deg/s",
        serious=False,
        plausible=(1.0, 2000.0),
        used=True,
    ),
    *(_limit(name, "with this gain it follows a velocity", "", (0.0, 20.0)) for name in _VELOCITY_GAINS),
    _limit("MPC_YAWRAUTO_MAX", "its heading turns no faster by itself", "deg/s", (1.0, 2000.0)),
)

PX4_COPTER_RATES: Final = (
    *(row._replace(used=True) if row.parameter == "MPC_TILTMAX_AIR" else row for row in PX4_COPTER),
    _required("MPC_THR_HOVER", "thrust begins here, before it is learned", "", (0.05, 0.95)),
    _limit("MPC_THR_MIN", "thrust is asked for from here on", "", (0.0, 0.9)),
    _limit("MPC_THR_MAX", "thrust is asked for up to here", "", (0.1, 1.0)),
    Requirement(
        "MPC_USE_HTE",
        "",
        meanings={
            0: "it hovers with MPC_THR_HOVER",
            1: "it finds its hover thrust by itself and does not tell; here it is learned anew",
        },
    ),
    _limit("MC_ROLLRATE_MAX", "it rolls no faster", "deg/s", (1.0, 2000.0)),
    _limit("MC_PITCHRATE_MAX", "it pitches no faster", "deg/s", (1.0, 2000.0)),
)
#: Of COM_OBL_RC_ACT. PX4's issue 18346 (open since 2021): a rover went on with the last setpoint.
_BY_HAND: Final = frozenset({0, 1, 2})

PX4_ROVER: Final = (
    *(
        row._replace(
            why="that is what the autopilot does when the setpoints stop; some versions of its rover drive "
            "on in a mode for sticks: set it to 5 (hold), if no other is meant",
            doubtful=row.doubtful | _BY_HAND,
        )
        if row.parameter == "COM_OBL_RC_ACT"
        else row
        for row in PX4_OFFBOARD
    ),
    Requirement(
        "RO_SPEED_LIM",
        "the vehicle drives slower than it is asked to",
        low="limits.speed_max_m_s",
        unit="m/s",
        serious=False,
        plausible=_SPEED,  # 0 or less (-1 is its default) is no limit but a rover that PX4 does not drive
        older=("GND_SPEED_MAX",),
        used=True,
    ),
    Requirement("RO_MAX_THR_SPEED", "", unit="m/s"),
    _told("RO_SPEED_P", "with this gain it follows a speed", "", (0.0, 100.0)),
    _limit("RO_YAW_P", "with this gain it turns to a bearing", "1/s", (0.01, 100.0)),
    _limit("RO_ACCEL_LIM", "it gains speed no faster", "m/s^2", (0.01, 100.0))._replace(
        zero_is_no_limit=True
    ),
    _told("RO_DECEL_LIM", "it loses speed no faster", "m/s^2", (0.01, 100.0))._replace(zero_is_no_limit=True),
    Requirement(
        "RO_YAW_RATE_LIM",
        "the vehicle turns slower than it is asked to",
        low="limits.yaw_rate_max_rad_s",
        scale=_DEG,
        unit="deg/s",
        serious=False,
        plausible=(1.0, 10000.0),  # 0, its default: PX4 does not steer
        used=True,
    ),
    _limit("RO_YAW_ACCEL_LIM", "its turn rate changes no faster", "deg/s^2", (1.0, 10000.0))._replace(
        zero_is_no_limit=True
    ),
    _limit("RA_WHEEL_BASE", "of it and the steering is the tightest turn", "m", (0.01, 50.0))._replace(
        zero_is_no_limit=True
    ),
    _limit("RA_MAX_STR_ANG", "of it and the wheel base is the tightest turn", "rad", (0.01, 1.5))._replace(
        zero_is_no_limit=True
    ),
    _limit("RD_WHEEL_TRACK", "it is set of a differential rover", "m", (0.01, 50.0))._replace(
        zero_is_no_limit=True
    ),
    _limit("RD_TRANS_DRV_TRN", "farther off its bearing it stops to turn", "rad", (0.001, 3.15))._replace(
        zero_is_no_limit=True
    ),
)
