"""Messages as samples of attitude and position, or the name under which one is refused.

Whatever is not finite, not plausible or in a frame that is not the local NED is refused, never guessed.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from pymavlink.dialects.v20 import all as dialect

from guidance.geodesy import ARDUPILOT_RADIUS_M, Projection
from guidance.mavlink.messages import (
    Attitude,
    AttitudeQuaternion,
    GlobalPositionInt,
    GpsGlobalOrigin,
    LocalPositionNed,
    Odometry,
    on_earth,
)
from guidance.se3 import Quaternion, Vec3, from_euler, is_finite, rotate

#: |q| may differ from 1 by float32 rounding, not by more than this.
UNIT_TOLERANCE: Final = 1e-2
#: No vehicle of ours is faster or turns faster; beyond, a number is a fault and not a measurement.
SPEED_MAX_M_S: Final = 1000.0
RATE_MAX_RAD_S: Final = 100.0
POSITION_MAX_M: Final = 1e7
ANGLE_MAX_RAD: Final = 2.0 * math.pi  # and so whatever half turn the autopilot counts from

#: 1e-7 deg of latitude; of longitude it is less. Both firmwares cut off what is less than a step.
_STEP_M: Final = 1e-7 * math.radians(ARDUPILOT_RADIUS_M)

_LOCAL_NED: Final = dialect.MAV_FRAME_LOCAL_NED
_BODY_FRD: Final = dialect.MAV_FRAME_BODY_FRD
#: PX4 before 1.14 can be told (MAV_ODOM_LP) to send back what a camera measured, in place of its estimate.
_ITS_ESTIMATE: Final = frozenset(
    {
        dialect.MAV_ESTIMATOR_TYPE_UNKNOWN,
        dialect.MAV_ESTIMATOR_TYPE_GPS_INS,
        dialect.MAV_ESTIMATOR_TYPE_AUTOPILOT,
    }
)


class AttitudeSample(NamedTuple):
    """Attitude, body to NED, and body rates (FRD, rad/s) at `instant_ns`."""

    instant_ns: int
    boot_ms: int
    attitude: Quaternion
    body_rates_frd_rad_s: Vec3
    source: str


class PositionSample(NamedTuple):
    """Position (m) and velocity (m/s) in NED from the estimator's origin at `instant_ns`."""

    instant_ns: int
    boot_ms: int
    position_ned_m: Vec3
    velocity_ned_m_s: Vec3
    source: str


def from_quaternion(message: AttitudeQuaternion, instant_ns: int) -> AttitudeSample | str:
    """ATTITUDE_QUATERNION (31), measured at `instant_ns`."""
    q = _unit(message.q1, message.q2, message.q3, message.q4)
    if isinstance(q, str):
        return q
    rates = Vec3(message.rollspeed, message.pitchspeed, message.yawspeed)
    refused = _refused(rates, RATE_MAX_RAD_S)
    return refused or AttitudeSample(instant_ns, message.time_boot_ms, q, rates, "ATTITUDE_QUATERNION")


def from_euler_angles(message: Attitude, instant_ns: int) -> AttitudeSample | str:
    """ATTITUDE (30), measured at `instant_ns`."""
    rates = Vec3(message.rollspeed, message.pitchspeed, message.yawspeed)
    refused = _refused(Vec3(message.roll, message.pitch, message.yaw), ANGLE_MAX_RAD) or _refused(
        rates, RATE_MAX_RAD_S
    )
    if refused is not None:
        return refused
    q = from_euler(message.roll, message.pitch, message.yaw)
    return AttitudeSample(instant_ns, message.time_boot_ms, q, rates, "ATTITUDE")


def from_local(message: LocalPositionNed, instant_ns: int) -> PositionSample | str:
    """LOCAL_POSITION_NED (32), measured at `instant_ns`."""
    position = Vec3(message.x, message.y, message.z)
    velocity = Vec3(message.vx, message.vy, message.vz)
    refused = _refused(position, POSITION_MAX_M) or _refused(velocity, SPEED_MAX_M_S)
    if refused is not None:
        return refused
    return PositionSample(instant_ns, message.time_boot_ms, position, velocity, "LOCAL_POSITION_NED")


def from_global(
    message: GlobalPositionInt, instant_ns: int, origin: GpsGlobalOrigin | None, project: Projection
) -> PositionSample | str:
    """GLOBAL_POSITION_INT (33) about GPS_GLOBAL_ORIGIN, at `instant_ns`: in steps of 11 mm and 1 cm/s."""
    if message.lat == 0 and message.lon == 0:
        return "no_position"  # ArduPilot's zeros before it has one
    if not on_earth(message.lat, message.lon):
        return "absurd"
    if origin is None:
        return "no_origin"
    position = project(
        (message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3),
        (origin.latitude * 1e-7, origin.longitude * 1e-7, origin.altitude * 1e-3),
    )
    refused = _refused(position, POSITION_MAX_M)
    if refused is not None:
        return refused
    velocity = Vec3(message.vx * 0.01, message.vy * 0.01, message.vz * 0.01)
    return PositionSample(instant_ns, message.time_boot_ms, position, velocity, "GLOBAL_POSITION_INT")


def within_step(before: PositionSample, sample: PositionSample) -> PositionSample:
    """A GLOBAL_POSITION_INT that goes on from `before` as long as that is within a step of what it says.

    Its position stands still and then leaps by 11 mm; what its velocity leads to is known better.
    """
    dt_s = (sample.boot_ms - before.boot_ms) * 1e-3
    x, v, w = before.position_ned_m, before.velocity_ned_m_s, sample.velocity_ned_m_s
    said = sample.position_ned_m
    return sample._replace(
        position_ned_m=Vec3(
            min(max(x.x + 0.5 * dt_s * (v.x + w.x), said.x - _STEP_M), said.x + _STEP_M),
            min(max(x.y + 0.5 * dt_s * (v.y + w.y), said.y - _STEP_M), said.y + _STEP_M),
            said.z,
        )
    )


def from_odometry(message: Odometry, instant_ns: int) -> tuple[AttitudeSample, PositionSample] | str:
    """ODOMETRY (331), measured at `instant_ns`.

    The pose must be in MAV_FRAME_LOCAL_NED: in MAV_FRAME_LOCAL_FRD the heading counts from anywhere. The
    velocity is in the child frame, which is MAV_FRAME_BODY_FRD by the standard and in PX4 up to 1.13, and
    MAV_FRAME_LOCAL_NED in PX4 since (`streams/ODOMETRY.hpp`, recorded).
    """
    if message.frame_id != _LOCAL_NED:
        return "pose_not_in_local_ned"
    child = message.child_frame_id
    if child not in (_LOCAL_NED, _BODY_FRD):
        return "velocity_frame"
    if message.quality < 0:
        return "failed"  # 0 is unknown, which is what PX4 sends
    if message.estimator_type not in _ITS_ESTIMATE:
        return "not_its_own_estimate"
    q = _unit(message.q1, message.q2, message.q3, message.q4)
    if isinstance(q, str):
        return q
    rates = Vec3(message.rollspeed, message.pitchspeed, message.yawspeed)
    position = Vec3(message.x, message.y, message.z)
    velocity = Vec3(message.vx, message.vy, message.vz)
    refused = (
        _refused(rates, RATE_MAX_RAD_S)
        or _refused(position, POSITION_MAX_M)
        or _refused(velocity, SPEED_MAX_M_S)
    )
    if refused is not None:
        return refused
    if child == _BODY_FRD:
        velocity = rotate(q, velocity)
    boot_ms = message.time_boot_ms
    return (
        AttitudeSample(instant_ns, boot_ms, q, rates, "ODOMETRY"),
        PositionSample(instant_ns, boot_ms, position, velocity, "ODOMETRY"),
    )


def _unit(w: float, x: float, y: float, z: float) -> Quaternion | str:
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if not math.isfinite(length):
        return "not_finite"
    if abs(length - 1.0) > UNIT_TOLERANCE:
        return "not_a_unit_quaternion"
    return Quaternion(w / length, x / length, y / length, z / length)


def _refused(v: Vec3, largest: float) -> str | None:
    if -largest <= v.x <= largest and -largest <= v.y <= largest and -largest <= v.z <= largest:
        return None
    return "absurd" if is_finite(v) else "not_finite"
