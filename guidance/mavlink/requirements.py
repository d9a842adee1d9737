"""What the service needs of the autopilot's own parameters, as tables that a profile names.

A row says between what the value must lie, in numbers or as keys of the configuration, and what follows if it
does not. Rows without bounds only name what the value means: it is the operator's choice, to be known.

Sources: PX4 `commander_params.c`, `mavlink_params.c`; ArduPilot `Rover/Parameters.cpp`,
`AR_AttitudeControl.cpp`, `GCS_MAVLink`. Not all files were of one release: a meaning that a newer firmware
changed is to be corrected here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

#: A number, or the dotted key of the configuration that gives it.
Bound = float | str


class Requirement(NamedTuple):
    """One parameter. `scale` times its value is in the unit of the bounds; 0 may stand for no limit.

    `why` says what happens if it is out of bounds, or has one of the `doubtful` meanings. `serious` is false
    where the vehicle flies all the same. An `older` name is asked for as well.
    """

    parameter: str
    why: str
    low: Bound | None = None
    high: Bound | None = None
    scale: float = 1.0
    unit: str = ""
    zero_is_no_limit: bool = False
    serious: bool = True
    meanings: Mapping[int, str] = {}
    doubtful: frozenset[int] = frozenset()
    older: str = ""


PX4_OFFBOARD: Final = (
    Requirement(
        "COM_OF_LOSS_T",
        "it is how long the autopilot goes on with the last setpoint: shorter, a gap in the stream ends the "
        "flight before the service can; longer, a vehicle that nobody guides goes on as long",
        low=1.0,
        high=2.0,
        unit="s",
    ),
    Requirement(
        "COM_OBL_RC_ACT",
        "that is what the autopilot does when the setpoints stop; is it meant?",
        meanings={
            0: "position mode",
            1: "altitude mode",
            2: "manual",
            3: "return",
            4: "land",
            5: "hold",
            6: "terminate",
            7: "disarm",
        },
        doubtful=frozenset({6, 7}),
    ),
    Requirement(
        "MAV_FWDEXTSP",
        "without it setpoints of a companion computer are not carried out",
        low=1.0,
        high=1.0,
    ),
)

ROVER_GUIDED: Final = (
    Requirement(
        "WP_SPEED",
        "thrust 1 gives WP_SPEED: every speed would be wrong by that factor",
        low="vehicle.speed_at_full_thrust_m_s",
        high="vehicle.speed_at_full_thrust_m_s",
        unit="m/s",
    ),
    Requirement(
        "SCHED_LOOP_RATE",
        "messages are granted at no more than 0.8 times this rate",
        low="link.rate_hz",
        scale=0.8,
        unit="Hz",
        serious=False,
    ),
    Requirement(
        "ATC_STR_RAT_MAX",
        "the vehicle turns slower than the law may ask",
        low="limits.yaw_rate_max_rad_s",
        scale=math.radians(1.0),
        unit="deg/s",
        zero_is_no_limit=True,
        serious=False,
    ),
    Requirement(
        "ATC_STR_ACC_MAX",
        "the turn rate changes slower than the law takes it to",
        low="limits.yaw_acceleration_max_rad_s2",
        scale=math.radians(1.0),
        unit="deg/s^2",
        zero_is_no_limit=True,
        serious=False,
    ),
    Requirement(
        "ATC_ACCEL_MAX",
        "the speed changes slower than the law takes it to",
        low="limits.acceleration_max_m_s2",
        unit="m/s^2",
        zero_is_no_limit=True,
        serious=False,
    ),
    Requirement(
        "FS_ACTION",
        "no failsafe of the autopilot's own would stop the vehicle; is it meant?",
        meanings={
            0: "nothing",
            1: "return",
            2: "hold",
            3: "smart return or return",
            4: "smart return or hold",
        },
        doubtful=frozenset({0}),
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
    Requirement(
        "MAV_OPTIONS",
        "only the system ids of ground stations may be heard, and setpoints of this service not: clear bit 0",
        meanings={0: "heard from every system id", 1: "heard from MAV_GCS_SYSID only"},
        doubtful=frozenset({1}),
        older="SYSID_ENFORCE",
    ),
)
