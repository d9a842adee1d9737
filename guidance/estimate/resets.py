"""Where the autopilot's estimator jumped: a sample that no motion since the one before it explains.

Two samples of one quantity bring their own derivative at both ends. Had it gone straight from one to the
other, the mean of both would lead from sample to sample exactly; what a vehicle does in between bends that by
half the change, and by an acceleration that shows at neither end. More than that, and more than any noise, is
a jump. The instants are the autopilot's own, so that no delay and no clock of ours enters. The limit grows
with the square of the time between: after seconds without samples there is nothing to be said, nor is it.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from guidance.estimate.samples import AttitudeSample, PositionSample
from guidance.se3 import (
    Quaternion,
    Vec3,
    add,
    conjugate,
    multiply,
    norm,
    quaternion_exp,
    quaternion_log,
    scale,
    subtract,
)

#: Noise and corrections of a healthy estimator stay below: five recorded flights have at most 0.18 m and
#: 1.8 deg from one sample to the next, sources of one flight differ by at most 0.05 m.
POSITION_JUMP_M: Final = 0.5
ATTITUDE_JUMP_RAD: Final = math.radians(5.0)
#: What happened between two samples and shows at neither: a gust, a bump, a setpoint and the next. At 50 Hz
#: this adds 1 cm and 2.3 deg, at 10 Hz 0.25 m and 57 deg: a turn is found only where samples come quickly.
#: The ideal vehicle, whose rates jump by up to 10 rad/s with each setpoint, needs 146 rad/s2 where samples are lost.
ACCELERATION_M_S2: Final = 50.0
ACCELERATION_RAD_S2: Final = 200.0


class Reset(NamedTuple):
    """The estimator was reset before `instant_ns`: by how much the vehicle seems to have moved and turned.

    `cause` is "counter" (ODOMETRY's reset_counter changed; the move may be none), "jump", or "switch" (the
    sources before and after disagree by more than `POSITION_JUMP_M` or `ATTITUDE_JUMP_RAD`).
    `turned_ned_rad` is the rotation vector in NED.
    """

    instant_ns: int
    source: str
    cause: str
    moved_ned_m: Vec3
    turned_ned_rad: Vec3

    def __str__(self) -> str:
        size = f"{norm(self.moved_ned_m):.2f} m and {math.degrees(norm(self.turned_ned_rad)):.1f} deg"
        return f"the autopilot's estimator was reset, by {size} ({self.cause}, {self.source})"


def together(first: Reset, second: Reset) -> Reset:
    """Two resets as one: where the estimator was before both, and where it is after."""
    turn = multiply(quaternion_exp(second.turned_ned_rad), quaternion_exp(first.turned_ned_rad))
    return second._replace(
        moved_ned_m=add(first.moved_ned_m, second.moved_ned_m), turned_ned_rad=quaternion_log(turn)
    )


def moved(before: PositionSample, after: PositionSample) -> Vec3:
    """The move (NED, m) that the velocities at both ends do not explain."""
    half_s = 0.5e-3 * (after.boot_ms - before.boot_ms)
    going = scale(half_s, add(before.velocity_ned_m_s, after.velocity_ned_m_s))
    return subtract(subtract(after.position_ned_m, before.position_ned_m), going)


def turned(before: AttitudeSample, after: AttitudeSample) -> Vec3:
    """The turn (rotation vector in NED, rad) that the rates at both ends do not explain."""
    half_s = 0.5e-3 * (after.boot_ms - before.boot_ms)
    turning = quaternion_exp(scale(half_s, add(before.body_rates_frd_rad_s, after.body_rates_frd_rad_s)))
    predicted = multiply(before.attitude, turning)
    return quaternion_log(multiply(after.attitude, conjugate(predicted)))


def position_jumped(before: PositionSample, after: PositionSample) -> bool:
    """Whether `after` is farther from where `before` led than a vehicle can be."""
    dt_s = 1e-3 * (after.boot_ms - before.boot_ms)
    a, b, v, w = before.position_ned_m, after.position_ned_m, before.velocity_ned_m_s, after.velocity_ned_m_s
    half_s = 0.5 * dt_s
    x = b.x - a.x - half_s * (v.x + w.x)
    y = b.y - a.y - half_s * (v.y + w.y)
    z = b.z - a.z - half_s * (v.z + w.z)
    unexplained2 = x * x + y * y + z * z
    if unexplained2 <= POSITION_JUMP_M * POSITION_JUMP_M:
        return False
    bent_m = 0.5 * abs(dt_s) * (norm(subtract(w, v)) + ACCELERATION_M_S2 * abs(dt_s))
    return math.sqrt(unexplained2) > POSITION_JUMP_M + bent_m


def attitude_jumped(before: AttitudeSample, after: AttitudeSample) -> bool:
    """Whether `after` is turned farther from where `before` led than a vehicle can be."""
    dt_s = 1e-3 * (after.boot_ms - before.boot_ms)
    v, w = before.body_rates_frd_rad_s, after.body_rates_frd_rad_s
    if _close(before.attitude, after.attitude) and _slow(v, w, dt_s):
        return False
    bent_rad = 0.5 * abs(dt_s) * (norm(subtract(w, v)) + ACCELERATION_RAD_S2 * abs(dt_s))
    return norm(turned(before, after)) > ATTITUDE_JUMP_RAD + bent_rad


#: cos of a quarter of the limit: two quaternions with this product are half the limit apart.
_HALF_LIMIT: Final = math.cos(0.25 * ATTITUDE_JUMP_RAD)


def _close(a: Quaternion, b: Quaternion) -> bool:
    """Less than half the limit apart, whatever the rates: the quick answer for nearly every sample."""
    return abs(a.w * b.w + a.x * b.x + a.y * b.y + a.z * b.z) > _HALF_LIMIT


def _slow(v: Vec3, w: Vec3, dt_s: float) -> bool:
    """Less than half the limit at the mean of both rates."""
    x, y, z = v.x + w.x, v.y + w.y, v.z + w.z
    return (x * x + y * y + z * z) * dt_s * dt_s < ATTITUDE_JUMP_RAD * ATTITUDE_JUMP_RAD
