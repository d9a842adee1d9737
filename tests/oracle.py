"""The law's statements in matrices, sharing nothing with the code under test.

R comes from scipy, the motion (1) from the matrix exponential, derivatives from differences.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from guidance.law import Controls, Gains
from guidance.se3 import Pose, Quaternion, Reference, Vec3

Array = np.ndarray[Any, np.dtype[np.float64]]


def matrix_of(q: Quaternion) -> Array:
    """R by scipy."""
    return np.asarray(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), dtype=np.float64)


def pose_of(x: Array, R: Array) -> Pose:
    """The pose with this position and rotation matrix."""
    qx, qy, qz, qw = Rotation.from_matrix(R).as_quat()
    return Pose(Vec3(*map(float, x)), Quaternion(float(qw), float(qx), float(qy), float(qz)))


def hat(u: Controls) -> Array:
    """hat(u1, u2, u3)."""
    return np.array([[0.0, -u.u3, u.u2], [u.u3, 0.0, -u.u1], [-u.u2, u.u1, 0.0]])


def projections(g: Gains, x: Array, R: Array, r: Reference) -> Array:
    """(y4, y5, y6) = (<Xr, X4>, <Xr, X5>, <Xr, X6>) with the metric (3)."""
    e = x - np.asarray(r.position)
    Xr = np.asarray(r.velocity) - g.k / g.beta * e
    return np.asarray(g.beta * R.T @ Xr, dtype=np.float64)


def moved(r: Reference, dt: float) -> Reference:
    """The reference a time dt later, at constant acceleration."""
    v, a = np.asarray(r.velocity), np.asarray(r.acceleration)
    return Reference(
        Vec3(*map(float, r.position + dt * v + 0.5 * dt * dt * a)),
        Vec3(*map(float, v + dt * a)),
        r.acceleration,
    )


def projections_after(g: Gains, pose: Pose, r: Reference, u: Controls, dt: float) -> Array:
    """(y4, y5, y6) a time dt later, moving by (1) under constant u."""
    twist = np.zeros((4, 4))
    twist[:3, :3] = hat(u)
    twist[0, 3] = u.u4
    start = np.eye(4)
    start[:3, :3] = matrix_of(pose.attitude)
    start[:3, 3] = pose.position
    end = start @ expm(dt * twist)
    return projections(g, end[:3, 3], end[:3, :3], moved(r, dt))


def projection_rates(g: Gains, pose: Pose, r: Reference, u: Controls) -> Array:
    """d/dt (y4, y5, y6) under u, which is (10) by differences.

    Of fourth order, with a step that the rates allow: u may be large close to the singularity.
    """
    h = 1e-3 / (1.0 + abs(u.u2) + abs(u.u3))
    f = [projections_after(g, pose, r, u, n * h) for n in (-2, -1, 1, 2)]
    return np.asarray((f[0] - 8.0 * f[1] + 8.0 * f[2] - f[3]) / (12.0 * h), dtype=np.float64)
