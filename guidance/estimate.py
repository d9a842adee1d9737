"""One state at one instant, from attitude and position that were measured at others.

Both samples are kept with the instant of their measurement, on the companion's clock. The vehicle is taken
to keep its twist: the newest attitude is turned to the instant of the newest position by the body rates,
the velocity is seen from there, and the pose moves on along that constant twist to the instant asked for.
A sample that is not finite, not newer than the one before, or not from a plausible instant is refused under
a name and changes nothing.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from guidance.mavlink.messages import Attitude, AttitudeQuaternion, LocalPositionNed
from guidance.se3 import (
    Pose,
    Quaternion,
    Twist,
    Vec3,
    compose,
    exp,
    from_euler,
    is_finite,
    multiply,
    quaternion_exp,
    rotate,
    rotate_inverse,
    scale,
)

#: |q| may differ from 1 by float32 rounding, not by more than this.
UNIT_TOLERANCE: Final = 1e-2
#: A sample may lie this far in the future, for what the clock filter does not know.
FUTURE_NS: Final = 50_000_000
#: ATTITUDE stands in for ATTITUDE_QUATERNION when that has not come for so long.
PREFERRED_NS: Final = 500_000_000
#: It takes over again as soon as it comes, though an ATTITUDE of about the same instant is there already.
OLDER_MS: Final = 100
#: No vehicle of ours is faster or turns faster; beyond, a number is a fault and not a measurement.
SPEED_MAX_M_S: Final = 1000.0
RATE_MAX_RAD_S: Final = 100.0
POSITION_MAX_M: Final = 1e7
ANGLE_MAX_RAD: Final = 2.0 * math.pi  # and so whatever half turn the autopilot counts from


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


class Estimate(NamedTuple):
    """The state at `instant_ns` and the ages (s, at that instant) of what it was made from."""

    instant_ns: int
    pose: Pose
    twist: Twist
    velocity_ned_m_s: Vec3
    attitude: AttitudeSample
    position: PositionSample
    attitude_age_s: float
    position_age_s: float


class Estimator:
    """Keeps the newest usable samples. Methods return why a sample was refused, None if it was taken."""

    def __init__(self) -> None:
        self.attitude: AttitudeSample | None = None
        self.position: PositionSample | None = None
        self._quaternion: AttitudeSample | None = None

    def reset(self) -> None:
        """Forget everything: the autopilot rebooted."""
        self.attitude = None
        self.position = None
        self._quaternion = None

    def take(
        self, message: AttitudeQuaternion | Attitude | LocalPositionNed, instant_ns: int, now_ns: int
    ) -> str | None:
        """Whichever it is, measured at `instant_ns`."""
        if isinstance(message, AttitudeQuaternion):
            return self.take_quaternion(message, instant_ns, now_ns)
        if isinstance(message, Attitude):
            return self.take_euler(message, instant_ns, now_ns)
        return self.take_position(message, instant_ns, now_ns)

    def take_quaternion(self, message: AttitudeQuaternion, instant_ns: int, now_ns: int) -> str | None:
        """ATTITUDE_QUATERNION (31), measured at `instant_ns`."""
        q = Quaternion(message.q1, message.q2, message.q3, message.q4)
        length = math.sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z)
        if not math.isfinite(length):
            return "not_finite"
        if abs(length - 1.0) > UNIT_TOLERANCE:
            return "not_a_unit_quaternion"
        unit = Quaternion(q.w / length, q.x / length, q.y / length, q.z / length)
        rates = Vec3(message.rollspeed, message.pitchspeed, message.yawspeed)
        sample = AttitudeSample(instant_ns, message.time_boot_ms, unit, rates, "ATTITUDE_QUATERNION")
        newest = self.attitude
        if newest is not None and sample.boot_ms < newest.boot_ms - OLDER_MS:
            return "late"
        refused = self._take_attitude(sample, self._quaternion, now_ns)
        if refused is None:
            self._quaternion = sample
        return refused

    def take_euler(self, message: Attitude, instant_ns: int, now_ns: int) -> str | None:
        """ATTITUDE (30), measured at `instant_ns`; only while there is no ATTITUDE_QUATERNION."""
        preferred = self._quaternion
        if preferred is not None and now_ns - preferred.instant_ns < PREFERRED_NS:
            return "not_needed"
        angles = Vec3(message.roll, message.pitch, message.yaw)
        if not is_finite(angles):
            return "not_finite"
        if _largest(angles) > ANGLE_MAX_RAD:
            return "absurd"
        rates = Vec3(message.rollspeed, message.pitchspeed, message.yawspeed)
        q = from_euler(message.roll, message.pitch, message.yaw)
        sample = AttitudeSample(instant_ns, message.time_boot_ms, q, rates, "ATTITUDE")
        return self._take_attitude(sample, self.attitude, now_ns)

    def take_position(self, message: LocalPositionNed, instant_ns: int, now_ns: int) -> str | None:
        """LOCAL_POSITION_NED (32), measured at `instant_ns`."""
        position = Vec3(message.x, message.y, message.z)
        velocity = Vec3(message.vx, message.vy, message.vz)
        if not (is_finite(position) and is_finite(velocity)):
            return "not_finite"
        if _largest(position) > POSITION_MAX_M or _largest(velocity) > SPEED_MAX_M_S:
            return "absurd"
        newest = self.position
        refused = _refuse_time(newest and newest.boot_ms, message.time_boot_ms, instant_ns, now_ns)
        if refused is None:
            self.position = PositionSample(
                instant_ns, message.time_boot_ms, position, velocity, "LOCAL_POSITION_NED"
            )
        return refused

    def _take_attitude(
        self, sample: AttitudeSample, newest: AttitudeSample | None, now_ns: int
    ) -> str | None:
        if not is_finite(sample.body_rates_frd_rad_s):
            return "not_finite"
        if _largest(sample.body_rates_frd_rad_s) > RATE_MAX_RAD_S:
            return "absurd"
        refused = _refuse_time(newest and newest.boot_ms, sample.boot_ms, sample.instant_ns, now_ns)
        if refused is None:
            self.attitude = sample
        return refused

    def at(self, instant_ns: int) -> Estimate | None:
        """The state at `instant_ns`; None until there are both an attitude and a position.

        Whether it is young enough to be used is the caller's decision, by the ages.
        """
        attitude, position = self.attitude, self.position
        if attitude is None or position is None:
            return None
        rates = attitude.body_rates_frd_rad_s
        back_s = (position.instant_ns - attitude.instant_ns) * 1e-9
        at_position = multiply(attitude.attitude, quaternion_exp(scale(back_s, rates)))
        twist = Twist(rates, rotate_inverse(at_position, position.velocity_ned_m_s))
        ahead_s = (instant_ns - position.instant_ns) * 1e-9
        pose = compose(Pose(position.position_ned_m, at_position), exp(twist, ahead_s))
        return Estimate(
            instant_ns=instant_ns,
            pose=pose,
            twist=twist,
            velocity_ned_m_s=rotate(pose.attitude, twist.linear),
            attitude=attitude,
            position=position,
            attitude_age_s=(instant_ns - attitude.instant_ns) * 1e-9,
            position_age_s=ahead_s,
        )


def _largest(v: Vec3) -> float:
    return max(abs(v.x), abs(v.y), abs(v.z))


def _refuse_time(newest_ms: int | None, boot_ms: int, instant_ns: int, now_ns: int) -> str | None:
    if newest_ms is not None and boot_ms == newest_ms:
        return "repeated"
    if newest_ms is not None and boot_ms < newest_ms:
        return "late"
    if instant_ns > now_ns + FUTURE_NS:
        return "from_the_future"
    return None
