"""Vectors, quaternions and rigid motions as plain functions on NamedTuples of floats.

Frames: the world is any right-handed frame, NED in flight; the body is FRD. A quaternion is a Hamilton
unit quaternion that maps body coordinates to world coordinates, `v_world = R(q) v_body`, so that the
columns of `R(q)` are the body axes `b1, b2, b3` of the paper.

No function checks its input: attitudes are unit quaternions and all numbers finite (`is_finite_pose`)
before they come here. With that, none raises.
"""

from __future__ import annotations

from math import asin, atan2, cos, isfinite, sin, sqrt
from typing import Final, NamedTuple


class Vec3(NamedTuple):
    """A vector of R^3; frame and unit are in the name of whatever holds it."""

    x: float
    y: float
    z: float


class Quaternion(NamedTuple):
    """A unit quaternion, scalar first, body to world."""

    w: float
    x: float
    y: float
    z: float


class Pose(NamedTuple):
    """An element of SE(3): position in the world (m) and attitude, body to world."""

    position: Vec3
    attitude: Quaternion


class Twist(NamedTuple):
    """An element of se(3) in body coordinates (FRD): rates in rad/s, velocity in m/s."""

    angular: Vec3
    linear: Vec3


class Reference(NamedTuple):
    """r, r' and r'' of the paper: a point moving in the world, in m, m/s and m/s^2.

    It stands here because the law takes it and the trajectories give it, and neither imports the other.
    """

    position: Vec3
    velocity: Vec3
    acceleration: Vec3


ZERO: Final = Vec3(0.0, 0.0, 0.0)
IDENTITY: Final = Quaternion(1.0, 0.0, 0.0, 0.0)
IDENTITY_POSE: Final = Pose(ZERO, IDENTITY)

#: Below this angle (rad) the translation part of `exp` takes a series: from here down
#: `theta - sin(theta)` loses digits, and up to here the first term left out is below 1e-15 of the sum.
SERIES_ANGLE_RAD: Final = 0.25

#: Horizontal part of b1 below which the body counts as vertical and has no heading of its own.
VERTICAL_SINE: Final = 1e-9


def add(a: Vec3, b: Vec3) -> Vec3:
    """a + b."""
    return Vec3(a.x + b.x, a.y + b.y, a.z + b.z)


def subtract(a: Vec3, b: Vec3) -> Vec3:
    """a - b."""
    return Vec3(a.x - b.x, a.y - b.y, a.z - b.z)


def scale(factor: float, v: Vec3) -> Vec3:
    """factor * v."""
    return Vec3(factor * v.x, factor * v.y, factor * v.z)


def dot(a: Vec3, b: Vec3) -> float:
    """a . b."""
    return a.x * b.x + a.y * b.y + a.z * b.z


def cross(a: Vec3, b: Vec3) -> Vec3:
    """a x b."""
    return Vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


def norm(v: Vec3) -> float:
    """|v|."""
    return sqrt(v.x * v.x + v.y * v.y + v.z * v.z)


def is_finite(v: Vec3) -> bool:
    """Whether no component is NaN or infinite."""
    return isfinite(v.x) and isfinite(v.y) and isfinite(v.z)


def is_finite_quaternion(q: Quaternion) -> bool:
    """Whether no component is NaN or infinite; says nothing about the norm."""
    return isfinite(q.w) and isfinite(q.x) and isfinite(q.y) and isfinite(q.z)


def is_finite_pose(pose: Pose) -> bool:
    """Whether no number of the pose is NaN or infinite."""
    return is_finite(pose.position) and is_finite_quaternion(pose.attitude)


def multiply(q: Quaternion, p: Quaternion) -> Quaternion:
    """The Hamilton product: R(multiply(q, p)) = R(q) R(p)."""
    return Quaternion(
        q.w * p.w - q.x * p.x - q.y * p.y - q.z * p.z,
        q.w * p.x + q.x * p.w + q.y * p.z - q.z * p.y,
        q.w * p.y - q.x * p.z + q.y * p.w + q.z * p.x,
        q.w * p.z + q.x * p.y - q.y * p.x + q.z * p.w,
    )


def conjugate(q: Quaternion) -> Quaternion:
    """The inverse of a unit quaternion: world to body."""
    return Quaternion(q.w, -q.x, -q.y, -q.z)


def normalized(q: Quaternion) -> Quaternion:
    """q / |q|; the norm must be positive (a zero quaternion is no attitude: ZeroDivisionError)."""
    inverse_norm = 1.0 / sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z)
    return Quaternion(q.w * inverse_norm, q.x * inverse_norm, q.y * inverse_norm, q.z * inverse_norm)


def rotate(q: Quaternion, v: Vec3) -> Vec3:
    """R(q) v: body coordinates to world coordinates."""
    # v + 2 w (u x v) + 2 u x (u x v), with u the vector part
    tx = 2.0 * (q.y * v.z - q.z * v.y)
    ty = 2.0 * (q.z * v.x - q.x * v.z)
    tz = 2.0 * (q.x * v.y - q.y * v.x)
    return Vec3(
        v.x + q.w * tx + q.y * tz - q.z * ty,
        v.y + q.w * ty + q.z * tx - q.x * tz,
        v.z + q.w * tz + q.x * ty - q.y * tx,
    )


def rotate_inverse(q: Quaternion, v: Vec3) -> Vec3:
    """R(q)^T v: world coordinates to body coordinates."""
    return rotate(conjugate(q), v)


def body_axes(q: Quaternion) -> tuple[Vec3, Vec3, Vec3]:
    """b1, b2, b3, the columns of R(q): forward, right and down in world coordinates."""
    w, x, y, z = q
    return (
        Vec3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        Vec3(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        Vec3(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


def quaternion_exp(rotation_vector: Vec3) -> Quaternion:
    """The rotation by |rotation_vector| rad about rotation_vector (exponential of so(3))."""
    theta = norm(rotation_vector)
    # sin(theta/2)/theta is accurate down to the smallest theta; only 0/0 needs its limit.
    s = 0.5 if theta == 0.0 else sin(0.5 * theta) / theta
    return Quaternion(cos(0.5 * theta), s * rotation_vector.x, s * rotation_vector.y, s * rotation_vector.z)


def quaternion_log(q: Quaternion) -> Vec3:
    """The rotation vector (rad, at most pi long) of a unit quaternion: the inverse of `quaternion_exp`."""
    sine = sqrt(q.x * q.x + q.y * q.y + q.z * q.z)
    if sine == 0.0:
        return Vec3(0.0, 0.0, 0.0)
    # q and -q are one rotation; the one with w >= 0 is the short way.
    s = 2.0 * atan2(sine, abs(q.w)) / (sine if q.w >= 0.0 else -sine)
    return Vec3(s * q.x, s * q.y, s * q.z)


def exp(twist: Twist, dt_s: float) -> Pose:
    """The exact motion in the body frame under a constant twist held for `dt_s` (exponential of SE(3)).

    `compose(pose, exp(twist, dt_s))` solves (1) over a step in which the controls are constant. With
    phi = angular * dt_s and theta = |phi|, the translation is J linear * dt_s with the left Jacobian
    J = I + (1 - cos theta)/theta^2 hat(phi) + (theta - sin theta)/theta^3 hat(phi)^2.
    """
    phi = scale(dt_s, twist.angular)
    d = scale(dt_s, twist.linear)
    theta2 = dot(phi, phi)
    theta = sqrt(theta2)
    s = 0.5 if theta == 0.0 else sin(0.5 * theta) / theta
    j1 = 2.0 * s * s  # = (1 - cos theta)/theta^2, without the cancellation
    if theta < SERIES_ANGLE_RAD:
        j2 = (
            1.0 - theta2 / 20.0 * (1.0 - theta2 / 42.0 * (1.0 - theta2 / 72.0 * (1.0 - theta2 / 110.0)))
        ) / 6.0
    else:
        j2 = (theta - sin(theta)) / (theta2 * theta)
    phi_d = cross(phi, d)
    phi_phi_d = cross(phi, phi_d)
    translation = Vec3(
        d.x + j1 * phi_d.x + j2 * phi_phi_d.x,
        d.y + j1 * phi_d.y + j2 * phi_phi_d.y,
        d.z + j1 * phi_d.z + j2 * phi_phi_d.z,
    )
    return Pose(translation, Quaternion(cos(0.5 * theta), s * phi.x, s * phi.y, s * phi.z))


def compose(a: Pose, b: Pose) -> Pose:
    """The product a b in SE(3): b is given in the frame of a."""
    return Pose(add(a.position, rotate(a.attitude, b.position)), multiply(a.attitude, b.attitude))


def inverse(pose: Pose) -> Pose:
    """The pose of the world seen from the body."""
    q = conjugate(pose.attitude)
    return Pose(scale(-1.0, rotate(q, pose.position)), q)


def from_yaw(yaw_rad: float) -> Quaternion:
    """The level attitude with this heading (rad, from north, positive to the east)."""
    return Quaternion(cos(0.5 * yaw_rad), 0.0, 0.0, sin(0.5 * yaw_rad))


def from_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Quaternion:
    """The attitude Rz(yaw) Ry(pitch) Rx(roll), as in MAVLink's ATTITUDE."""
    cr, sr = cos(0.5 * roll_rad), sin(0.5 * roll_rad)
    cp, sp = cos(0.5 * pitch_rad), sin(0.5 * pitch_rad)
    cy, sy = cos(0.5 * yaw_rad), sin(0.5 * yaw_rad)
    return Quaternion(
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def pitch_of(q: Quaternion) -> float:
    """The angle of b1 above the horizontal, rad, in [-pi/2, pi/2]."""
    return asin(max(-1.0, min(1.0, 2.0 * (q.w * q.y - q.x * q.z))))


def roll_of(q: Quaternion) -> float:
    """The roll angle of `from_euler`, rad, in (-pi, pi]; 0 with the yaw of `yaw_of` where b1 is vertical."""
    b3_down = 1.0 - 2.0 * (q.x * q.x + q.y * q.y)
    b2_down = 2.0 * (q.y * q.z + q.w * q.x)
    if b3_down * b3_down + b2_down * b2_down < VERTICAL_SINE * VERTICAL_SINE:
        return 0.0
    return atan2(b2_down, b3_down)


def yaw_of(q: Quaternion) -> float:
    """The heading of b1 projected on the horizontal, rad from north to the east, in [-pi, pi].

    Where b1 is vertical it has no heading: there it is the heading from which the body pitched up (or
    down) without rolling, that of its belly (or back), so that a pitch through the vertical meets no jump.
    """
    b1_north = 1.0 - 2.0 * (q.y * q.y + q.z * q.z)
    b1_east = 2.0 * (q.x * q.y + q.w * q.z)
    if b1_north * b1_north + b1_east * b1_east >= VERTICAL_SINE * VERTICAL_SINE:
        return atan2(b1_east, b1_north)
    b3_north = 2.0 * (q.x * q.z + q.w * q.y)
    b3_east = 2.0 * (q.y * q.z - q.w * q.x)
    if q.w * q.y > q.x * q.z:  # nose up
        return atan2(b3_east, b3_north)
    return atan2(-b3_east, -b3_north)
