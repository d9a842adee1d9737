"""Error functions phi(x, r): how far x is from r, and how fast the field Xr = r' - lambda d1 phi closes in.

All are zero only at e = x - r = 0 and, for k > 0, have d1 phi = k(r) e + O(|e|^3) there, so that k/beta is
the rate of the last centimetres whichever is chosen. `kind` says which one an `ErrorFunction` is:

- `QUADRATIC`: phi = 1/2 k |e|^2 of Prop. 3.1, with k constant. The approach is as fast as e is long.
- `K_OF_R`: phi = 1/2 k(r) |e|^2, the whole family of Prop. 3.1, with
  k(r) = k (1 + gain exp(-|r - centre|^2/width^2)): stiffer (or, with -1 < gain < 0, softer) where r is
  close to a place. k(r) is positive everywhere. It violates d2 phi = -d1 phi, so that (5) and (7) fail as
  printed: V1' = d1 phi.(x' - r') + 1/2 k' |e|^2.
- `BOUNDED`: phi = k delta (sqrt(delta^2 + |e|^2) - delta), whose lambda |d1 phi| never reaches the approach
  speed v = lambda k delta: from 30 m off the quadratic function asks for 30 m/s, this one for v. (6) holds as
  printed; (8), which needs the reverse inequality, fails far away, where the error shrinks linearly.
- `BOUNDED_APART`: the same in the horizontal plane and in the vertical, each with a speed of its own, for
  vehicles that climb more slowly than they cruise. Its level sets are no spheres: x and y of the world must
  be the horizontal ones.

Prop. 3.1 allows only the first two, because it wants H X4 to have no part along X5 and X6, so that u4 drops
out of (10). u4 does not depend on u1, u2, u3, so it can as well be computed first and H u4 b1 be kept; that
is what `law.guide_step` does with every one of them.
"""

from __future__ import annotations

from math import exp, sqrt
from typing import Final, NamedTuple

from guidance.se3 import ZERO, Reference, Vec3

QUADRATIC: Final = 0
K_OF_R: Final = 1
BOUNDED: Final = 2
BOUNDED_APART: Final = 3


class ErrorFunction(NamedTuple):
    """One of the above; what its kind does not name is not used. The scale k is in `Gains`.

    `approach_m_s` > 0 is lambda k delta (of `BOUNDED_APART` the horizontal one), `approach_down_m_s` > 0 the
    vertical one; `gain` > -1, `width_m` > 0 and `centre` (m, world) are those of k(r).
    """

    kind: int
    approach_m_s: float
    approach_down_m_s: float
    gain: float
    width_m: float
    centre: Vec3


class Symmetric(NamedTuple):
    """A symmetric 3 x 3 matrix."""

    xx: float
    yy: float
    zz: float
    xy: float
    xz: float
    yz: float


class Derivatives(NamedTuple):
    """phi and what the law needs of it at one x and r, in world coordinates.

    `d1` is d1 phi, `hessian` is H = d^2 phi / dx^2, and `d1_dot` is d/dt (d1 phi | x fixed) of (10), so that
    d/dt d1 phi = d1_dot + H x'.
    """

    phi: float
    d1: Vec3
    hessian: Symmetric
    d1_dot: Vec3


PAPER: Final = ErrorFunction(QUADRATIC, 1.0, 1.0, 0.0, 1.0, ZERO)


def k_of_r(gain: float, width_m: float, centre: Vec3) -> ErrorFunction:
    """phi = 1/2 k(r) |e|^2, with k(centre) = (1 + gain) k; gain > -1, width_m > 0."""
    return ErrorFunction(K_OF_R, 1.0, 1.0, gain, width_m, centre)


def bounded(approach_m_s: float) -> ErrorFunction:
    """Never approaches faster than this (> 0)."""
    return ErrorFunction(BOUNDED, approach_m_s, approach_m_s, 0.0, 1.0, ZERO)


def bounded_apart(horizontal_m_s: float, vertical_m_s: float) -> ErrorFunction:
    """Never approaches faster than these (> 0) in the horizontal plane and in the vertical."""
    return ErrorFunction(BOUNDED_APART, horizontal_m_s, vertical_m_s, 0.0, 1.0, ZERO)


def times(matrix: Symmetric, v: Vec3) -> Vec3:
    """matrix v."""
    return Vec3(
        matrix.xx * v.x + matrix.xy * v.y + matrix.xz * v.z,
        matrix.xy * v.x + matrix.yy * v.y + matrix.yz * v.z,
        matrix.xz * v.x + matrix.yz * v.y + matrix.zz * v.z,
    )


def derivatives(
    error_function: ErrorFunction, k: float, beta: float, e: Vec3, reference: Reference
) -> Derivatives:
    """phi(x, r) and its derivatives for k, beta > 0 and e = x - r (m)."""
    kind = error_function.kind
    r_dot = reference.velocity
    if kind in (BOUNDED, BOUNDED_APART):
        return _bounded(error_function, k, beta, e, r_dot)
    k_dot = 0.0
    if kind == K_OF_R:
        d = reference.position
        c = error_function.centre
        dx, dy, dz = d.x - c.x, d.y - c.y, d.z - c.z
        w = 1.0 / error_function.width_m
        bump = k * error_function.gain * exp(-((dx * w) ** 2 + (dy * w) ** 2 + (dz * w) ** 2))
        k_dot = -2.0 * bump * (dx * w * (r_dot.x * w) + dy * w * (r_dot.y * w) + dz * w * (r_dot.z * w))
        k = k + bump
    return Derivatives(
        0.5 * k * (e.x * e.x + e.y * e.y + e.z * e.z),
        Vec3(k * e.x, k * e.y, k * e.z),
        Symmetric(k, k, k, 0.0, 0.0, 0.0),
        Vec3(k_dot * e.x - k * r_dot.x, k_dot * e.y - k * r_dot.y, k_dot * e.z - k * r_dot.z),
    )


def _bounded(error_function: ErrorFunction, k: float, beta: float, e: Vec3, r_dot: Vec3) -> Derivatives:
    """With s = sqrt(delta^2 + |e|^2): d1 phi = k delta/s e and H = k delta/s (1 - e e^T/s^2)."""
    delta = error_function.approach_m_s * beta / k
    e2 = e.x * e.x + e.y * e.y
    if error_function.kind == BOUNDED:
        e2 += e.z * e.z
    s = sqrt(delta * delta + e2)
    h = k * delta / s
    phi = k * delta * (e2 / (s + delta))
    nx, ny, nz = e.x / s, e.y / s, e.z / s
    if error_function.kind == BOUNDED:
        d1 = Vec3(h * e.x, h * e.y, h * e.z)
        H = Symmetric(
            h * (1.0 - nx * nx),
            h * (1.0 - ny * ny),
            h * (1.0 - nz * nz),
            -h * nx * ny,
            -h * nx * nz,
            -h * ny * nz,
        )
    else:
        delta = error_function.approach_down_m_s * beta / k
        s = sqrt(delta * delta + e.z * e.z)
        h_down = k * delta / s
        phi += k * delta * (e.z * e.z / (s + delta))
        d1 = Vec3(h * e.x, h * e.y, h_down * e.z)
        # 1 - e_z^2/s^2 = delta^2/s^2
        H = Symmetric(
            h * (1.0 - nx * nx),
            h * (1.0 - ny * ny),
            h_down * (delta / s) * (delta / s),
            -h * nx * ny,
            0.0,
            0.0,
        )
    drift = times(H, r_dot)
    return Derivatives(phi, d1, H, Vec3(-drift.x, -drift.y, -drift.z))
