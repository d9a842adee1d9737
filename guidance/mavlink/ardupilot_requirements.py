"""ArduPilot's parameters that count, one table for each class of vehicle.

Sources: `Rover/Parameters.cpp`, `AR_AttitudeControl.cpp`, `AR_WPNav.cpp`, `ArduPlane/Parameters.cpp`,
`AP_TECS.cpp`, `ArduCopter/Parameters.cpp`, `AC_WPNav.cpp`, `GCS_MAVLink`. Older names are those of before
Plane 4.5 (cm/s, centidegrees) and Copter 4.7 (cm/s, centidegrees); PSC_JERK_NE is that of 4.7.0 alone.
"""

from __future__ import annotations

import math
from typing import Final

from guidance.mavlink.requirements import Requirement

_DEG: Final = math.radians(1.0)
_SPEED: Final = (0.1, 150.0)
_CENTI: Final = 0.01

_LOOP_RATE: Final = Requirement(
    "SCHED_LOOP_RATE",
    "messages are granted at no more than 0.8 times this rate, and asked for no faster",
    low="link.rate_hz",
    scale=0.8,
    unit="Hz",
    serious=False,
    plausible=(10.0, 10000.0),
    used=True,
)
_MAV_OPTIONS: Final = Requirement(
    "MAV_OPTIONS",
    "",
    # `accept_packet` of `GCS_Common.cpp` (4.4 to 4.7): the vehicle's own components are always heard.
    meanings={0: "every system id is heard", 1: "only MAV_GCS_SYSID and the vehicle's own id are heard"},
    older=("SYSID_ENFORCE",),
)


def _limit(
    name: str,
    what: str,
    unit: str,
    plausible: tuple[float, float],
    *,
    older: tuple[str, ...] = (),
    older_scale: float = 1.0,
    required: bool = False,
) -> Requirement:
    """One that the handling keeps to."""
    return Requirement(
        name,
        what,
        unit=unit,
        plausible=plausible,
        older=older,
        older_scale=older_scale,
        required=required,
        used=True,
    )


def _told(
    name: str,
    what: str,
    unit: str,
    plausible: tuple[float, float],
    *,
    older: tuple[str, ...] = (),
    older_scale: float = 1.0,
) -> Requirement:
    """One that the autopilot keeps to, and nothing here."""
    return _limit(name, what, unit, plausible, older=older, older_scale=older_scale)._replace(used=False)


ROVER_GUIDED: Final = (
    Requirement(
        "WP_SPEED",
        "thrust 1 gives WP_SPEED, and it is what speeds are made of; was another meant?",
        low="vehicle.speed_at_full_thrust_m_s",
        high="vehicle.speed_at_full_thrust_m_s",
        unit="m/s",
        serious=False,
        plausible=(0.1, 50.0),
        required=True,
        used=True,
    ),
    _LOOP_RATE,
    Requirement(
        "ATC_STR_RAT_MAX",
        "the vehicle turns slower than the law may ask",
        low="limits.yaw_rate_max_rad_s",
        scale=_DEG,
        unit="deg/s",
        zero_is_no_limit=True,
        serious=False,
        plausible=(1.0, 2000.0),
        used=True,
    ),
    Requirement(
        "ATC_STR_ACC_MAX",
        "the turn rate changes slower than the law takes it to",
        low="limits.yaw_acceleration_max_rad_s2",
        scale=_DEG,
        unit="deg/s^2",
        zero_is_no_limit=True,
        serious=False,
        plausible=(1.0, 20000.0),
        used=True,
    ),
    Requirement(
        "ATC_ACCEL_MAX",
        "the speed changes slower than the law takes it to",
        low="limits.acceleration_max_m_s2",
        unit="m/s^2",
        zero_is_no_limit=True,
        serious=False,
        plausible=(0.01, 100.0),
        used=True,
    ),
    Requirement(
        "ATC_DECEL_MAX",
        "the vehicle brakes slower than the law takes it to",
        low="limits.acceleration_max_m_s2",
        unit="m/s^2",
        zero_is_no_limit=True,
        serious=False,
        plausible=(0.01, 100.0),
        used=True,
    ),
    _limit("ATC_TURN_MAX_G", "it turns no tighter", "g", (0.01, 10.0)),
    _limit("TURN_RADIUS", "it turns on no smaller circle", "m", (0.0, 100.0)),
    Requirement("CRUISE_SPEED", "", unit="m/s"),
    Requirement(
        "FS_ACTION",
        "no failsafe of the autopilot's own would stop the vehicle; is it meant?",
        meanings={
            0: "nothing",
            1: "return",
            2: "hold",
            3: "smart return or return",
            4: "smart return or hold",
            5: "disarm",
            6: "loiter or hold",
        },
        doubtful=frozenset({0}),
    ),
    Requirement(
        "FS_EKF_ACTION",
        "it drives on when its estimator fails, and tells positions that are made up; is it meant?",
        meanings={0: "nothing", 1: "hold", 2: "only told"},
        doubtful=frozenset({0, 2}),
    ),
    Requirement(
        "FS_GCS_ENABLE",
        "",
        meanings={
            0: "a lost ground station is ignored",
            1: "a lost ground station is a failsafe",
            2: "a lost ground station is a failsafe, but in auto",
        },
    ),
    _MAV_OPTIONS,
)

PLANE_GUIDED: Final = (
    _limit(
        "AIRSPEED_MIN",
        "below it the airplane may stall",
        "m/s",
        _SPEED,
        older=("ARSPD_FBW_MIN",),
        required=True,
    ),
    _limit(
        "AIRSPEED_CRUISE",
        "its controllers are tuned at this airspeed",
        "m/s",
        _SPEED,
        older=("TRIM_ARSPD_CM",),
        older_scale=_CENTI,
        required=True,
    ),
    _limit(
        "AIRSPEED_MAX",
        "above it the airplane may break",
        "m/s",
        _SPEED,
        older=("ARSPD_FBW_MAX",),
        required=True,
    ),
    _told("AIRSPEED_STALL", "it is the airspeed at which it stalls (0: not known)", "m/s", (0.0, 150.0)),
    _limit(
        "ROLL_LIMIT_DEG",
        "the bank is asked for up to this angle",
        "deg",
        (5.0, 90.0),
        older=("LIM_ROLL_CD",),
        older_scale=_CENTI,
    ),
    _limit(
        "PTCH_LIM_MAX_DEG",
        "the nose is asked to go up to this angle",
        "deg",
        (1.0, 90.0),
        older=("LIM_PITCH_MAX",),
        older_scale=_CENTI,
    ),
    _limit(
        "PTCH_LIM_MIN_DEG",
        "the nose is asked to go down to this angle",
        "deg",
        (-90.0, -1.0),
        older=("LIM_PITCH_MIN",),
        older_scale=_CENTI,
    ),
    _limit("THR_MIN", "throttle is asked for from here on", "%", (-100.0, 90.0)),
    # At 1 % and less GUIDED takes no throttle from a setpoint (`mode_guided.cpp`, 4.4 to 4.7).
    _limit("TRIM_THROTTLE", "throttle begins here, before it is learned", "%", (2.0, 100.0)),
    _limit("THR_MAX", "throttle is asked for up to here", "%", (10.0, 100.0)),
    _limit("TECS_CLMB_MAX", "it is how fast it climbs with all of its throttle", "m/s", (0.1, 100.0)),
    _limit("TECS_SINK_MAX", "it is how fast it may sink", "m/s", (0.1, 100.0)),
    _limit("RLL2SRV_RMAX", "the bank changes no faster", "deg/s", (1.0, 1000.0))._replace(
        zero_is_no_limit=True
    ),
    _told("RLL2SRV_TCONST", "the bank follows with this time constant", "s", (0.05, 5.0)),
    _told("PTCH2SRV_TCONST", "the pitch follows with this time constant", "s", (0.05, 5.0)),
    _LOOP_RATE,
    Requirement(
        "FS_LONG_ACTN",
        "with the transmitter lost it flies on, and nobody can take over: if that is not meant, set it to 1",
        meanings={
            0: "goes on in auto and guided",
            1: "return",
            2: "glide",
            3: "parachute",
            4: "auto",
            5: "autoland",
        },
        doubtful=frozenset({0}),
    ),
    Requirement(
        "FS_GCS_ENABL",
        "",
        meanings={
            0: "a lost ground station is ignored",
            1: "a lost ground station is a failsafe",
            2: "a lost ground station is a failsafe, and a lost radio",
            3: "a lost ground station is a failsafe in auto only",
        },
    ),
    _MAV_OPTIONS,
)

COPTER_GUIDED: Final = (
    _limit(
        "WP_SPD",
        "it flies no faster",
        "m/s",
        _SPEED,
        older=("WPNAV_SPEED",),
        older_scale=_CENTI,
        required=True,
    )._replace(low="limits.speed_max_m_s", serious=False),
    _limit("WP_SPD_UP", "it climbs no faster", "m/s", _SPEED, older=("WPNAV_SPEED_UP",), older_scale=_CENTI),
    _limit("WP_SPD_DN", "it sinks no faster", "m/s", _SPEED, older=("WPNAV_SPEED_DN",), older_scale=_CENTI),
    _limit(
        "WP_ACC",
        "the velocity changes no faster",
        "m/s^2",
        (0.1, 50.0),
        older=("WPNAV_ACCEL",),
        older_scale=_CENTI,
    ),
    _limit(
        "WP_ACC_Z",
        "the velocity changes no faster up and down",
        "m/s^2",
        (0.1, 50.0),
        older=("WPNAV_ACCEL_Z",),
        older_scale=_CENTI,
    ),
    _limit(
        "ATC_ANGLE_MAX",
        "the velocity changes no faster than leaning so far does",
        "deg",
        (5.0, 89.0),
        older=("ANGLE_MAX",),
        older_scale=_CENTI,
    ),
    _limit(
        "PSC_D_JERK",
        "it changes no faster up and down",
        "m/s^3",
        (0.1, 500.0),
        older=("PSC_JERK_D", "PSC_JERK_Z"),
    ),
    _limit(
        "PSC_NE_JERK",
        "the acceleration changes no faster",
        "m/s^3",
        (0.1, 500.0),
        older=("PSC_JERK_NE", "PSC_JERK_XY"),
    ),
    Requirement(
        "ATC_RATE_Y_MAX",
        "the vehicle turns slower than it is asked to",
        low="limits.yaw_rate_max_rad_s",
        scale=_DEG,
        unit="deg/s",
        zero_is_no_limit=True,
        serious=False,
        plausible=(1.0, 2000.0),
        used=True,
    ),
    Requirement(
        "GUID_TIMEOUT",
        "it is how long the autopilot goes on with the last setpoint: shorter, a gap in the stream stops it "
        "before the service can; longer, a vehicle that nobody guides goes on as long",
        low=0.5,
        high=5.0,
        unit="s",
    ),
    Requirement(
        "GUID_OPTIONS",
        "bits 4 and 5 keep it from correcting position and velocity, bit 6 flies its own way there",
        high=15.0,
        serious=False,
    ),
    _LOOP_RATE,
    Requirement(
        "FS_GCS_ENABLE",
        "",
        meanings={
            0: "a lost ground station is ignored",
            1: "return",
            3: "smart return or return",
            4: "smart return or land",
            5: "land",
            6: "auto's landing or return",
            7: "brake or land",
        },
    ),
    Requirement(
        "FS_EKF_ACTION",
        "it flies on when its estimator fails, and tells positions that are made up; is it meant?",
        meanings={0: "only told", 1: "land", 2: "altitude hold", 3: "land, whatever the mode"},
        doubtful=frozenset({0}),
    ),
    _MAV_OPTIONS,
)

COPTER_GUIDED_RATES: Final = (
    *(
        row._replace(used=True) if row.parameter == "ATC_ANGLE_MAX" else row
        for row in COPTER_GUIDED
        if row.parameter != "GUID_OPTIONS"
    ),
    _limit(
        "GUID_OPTIONS",
        "its bit 3 says whether the thrust of a setpoint is thrust (set) or a climb rate (clear)",
        "",
        (0.0, 65535.0),
        required=True,
    ),
    _limit("MOT_THST_HOVER", "thrust begins here, before it is learned", "", (0.05, 0.95)),
    Requirement(
        "ATC_ANGLE_BOOST",
        "",
        meanings={0: "thrust is as it is told", 1: "it gives more thrust by itself where it leans"},
        used=True,
    ),
    _limit("ATC_RATE_R_MAX", "it rolls no faster", "deg/s", (1.0, 2000.0))._replace(zero_is_no_limit=True),
    _limit("ATC_RATE_P_MAX", "it pitches no faster", "deg/s", (1.0, 2000.0))._replace(zero_is_no_limit=True),
)
