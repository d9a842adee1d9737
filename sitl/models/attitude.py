"""Attitudes of a body that its rotors push: what a thrust makes of them, and how fast they turn.

World NED, body FRD; unit quaternions, body to world.
"""

from __future__ import annotations

from math import asin, atan2, cos, sin, sqrt
from typing import Final

GRAVITY_M_S2: Final = 9.80665

Triple = tuple[float, float, float]
Wxyz = tuple[float, float, float, float]


def roll_pitch_heading(attitude_wxyz: Wxyz) -> Triple:
    """The angles of MAVLink's ATTITUDE, rad."""
    w, x, y, z = attitude_wxyz
    return (
        atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        asin(max(-1.0, min(1.0, 2.0 * (w * y - x * z)))),
        atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )


def tilted(a_n: float, a_e: float, a_d: float, heading_rad: float) -> Wxyz:
    """The attitude whose -z pushes with this acceleration and the weight, with this heading."""
    up = GRAVITY_M_S2 - a_d
    c, s = cos(heading_rad), sin(heading_rad)
    along, across = c * a_n + s * a_e, c * a_e - s * a_n
    pitch = atan2(-along, up)
    roll = atan2(across, sqrt(along * along + up * up))
    cr, sr = cos(0.5 * roll), sin(0.5 * roll)
    cp, sp = cos(0.5 * pitch), sin(0.5 * pitch)
    cy, sy = cos(0.5 * heading_rad), sin(0.5 * heading_rad)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def turned(before: Wxyz, after: Wxyz, dt: float) -> Triple:
    """The body rates from one attitude to the next, rad/s."""
    w, x, y, z = multiplied((before[0], -before[1], -before[2], -before[3]), after)
    # q and -q are one attitude
    rate = 2.0 / dt if w >= 0.0 else -2.0 / dt
    return (rate * x, rate * y, rate * z)


def multiplied(a: Wxyz, b: Wxyz) -> Wxyz:
    """The Hamilton product, as a unit quaternion."""
    w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    z = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    n = 1.0 / sqrt(w * w + x * x + y * y + z * z)
    return (n * w, n * x, n * y, n * z)
