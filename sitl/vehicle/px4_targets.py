"""What PX4's receiver makes of a setpoint message (`mavlink_receiver.cpp`), whatever the vehicle."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

from sitl.plant import Triple, Wxyz

IGNORE_ROLL_RATE: Final = 1
IGNORE_PITCH_RATE: Final = 2
IGNORE_YAW_RATE: Final = 4
IGNORE_THROTTLE: Final = 64
IGNORE_ATTITUDE: Final = 128
#: Of SET_POSITION_TARGET_LOCAL_NED: the first of three bits of each vector, and the rest.
IGNORE_X: Final = 1
IGNORE_VX: Final = 1 << 3
IGNORE_AFX: Final = 1 << 6
IGNORE_YAW: Final = 1 << 10
IGNORE_TARGET_YAW_RATE: Final = 1 << 11
LOCAL_NED: Final = 1
BODY_NED: Final = 8


class AttitudeTarget(NamedTuple):
    """SET_ATTITUDE_TARGET, not clamped; an ignored throttle is 0, an ignored rate NaN.

    With an attitude, roll and pitch rate are 0 unless both are wanted too; without one all are wanted.
    """

    attitude_wxyz: Wxyz | None
    body_rates_frd_rad_s: Triple
    thrust: float


class TrajectoryTarget(NamedTuple):
    """SET_POSITION_TARGET_LOCAL_NED, in NED; what is ignored is NaN."""

    position_ned_m: Triple
    velocity_ned_m_s: Triple
    yaw_rad: float
    yaw_rate_rad_s: float


Target = AttitudeTarget | TrajectoryTarget


def attitude_target(message: Any) -> AttitudeTarget | None:
    """None: it says neither an attitude nor both the roll and the pitch rate, and is no proof of life."""
    mask = message.type_mask
    thrust = 0.0 if mask & IGNORE_THROTTLE else message.thrust
    yaw_rate = math.nan if mask & IGNORE_YAW_RATE else message.body_yaw_rate
    turns = not mask & (IGNORE_ROLL_RATE | IGNORE_PITCH_RATE)
    roll_rate, pitch_rate = (message.body_roll_rate, message.body_pitch_rate) if turns else (0.0, 0.0)
    if not mask & IGNORE_ATTITUDE:
        w, x, y, z = message.q
        return AttitudeTarget((w, x, y, z), (roll_rate, pitch_rate, yaw_rate), thrust)
    return AttitudeTarget(None, (roll_rate, pitch_rate, yaw_rate), thrust) if turns else None


def trajectory_target(message: Any, yaw_rad: float) -> TrajectoryTarget:
    """`yaw_rad` of the vehicle turns what is said in its own frame.

    Raises:
        ValueError: an unknown frame, or nothing but yaw is asked for; it is no proof of life.
    """
    mask, frame = message.type_mask, message.coordinate_frame
    if frame not in (LOCAL_NED, BODY_NED):
        raise ValueError(f"SET_POSITION_TARGET_LOCAL_NED coordinate frame {frame} unsupported")
    position = _unmasked(mask, IGNORE_X, (message.x, message.y, message.z))
    velocity = _unmasked(mask, IGNORE_VX, (message.vx, message.vy, message.vz))
    acceleration = _unmasked(mask, IGNORE_AFX, (message.afx, message.afy, message.afz))
    if frame == BODY_NED:
        c, s = math.cos(yaw_rad), math.sin(yaw_rad)
        position = (math.nan, math.nan, math.nan)
        velocity = (c * velocity[0] - s * velocity[1], s * velocity[0] + c * velocity[1], velocity[2])
    if not any(map(math.isfinite, position + velocity + acceleration)):
        raise ValueError("SET_POSITION_TARGET_LOCAL_NED invalid")
    yaw = math.nan if mask & IGNORE_YAW else message.yaw
    yaw_rate = math.nan if mask & IGNORE_TARGET_YAW_RATE else message.yaw_rate
    return TrajectoryTarget(position, velocity, yaw, yaw_rate)


def _unmasked(mask: int, first: int, vector: Triple) -> Triple:
    """The vector with NaN for what the mask ignores."""
    x, y, z = (math.nan if mask & first << axis else part for axis, part in enumerate(vector))
    return (x, y, z)
