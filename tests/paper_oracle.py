"""The paper in matrices, for any error function: the field, (10), (11), (14) and the closed loop.

Written from the paper and apart from `guidance`: nothing here calls the law under test. Positions and
vectors are world coordinates, columns of R are b1, b2, b3, and y = (y4, y5, y6) = beta R^T Xr.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from guidance.law import Gains
from tests.oracle import Array

#: r, r', r''
Motion = tuple[Array, Array, Array]
Curve = Callable[[float], Motion]


class ErrorFunction(NamedTuple):
    """phi(x, r) with everything that the paper differentiates, as functions of x and r.

    d1, d2: gradients in x and r. hessian: of x. mixed: d/dr of d1, so that d/dt(d1 phi | x fixed) = mixed r'.
    """

    name: str
    value: Callable[[Array, Array], float]
    d1: Callable[[Array, Array], Array]
    d2: Callable[[Array, Array], Array]
    hessian: Callable[[Array, Array], Array]
    mixed: Callable[[Array, Array], Array]


def of_difference(
    name: str,
    f: Callable[[Array], float],
    gradient: Callable[[Array], Array],
    hessian: Callable[[Array], Array],
) -> ErrorFunction:
    """phi = f(x - r)."""
    return ErrorFunction(
        name,
        lambda x, r: f(x - r),
        lambda x, r: gradient(x - r),
        lambda x, r: -gradient(x - r),
        lambda x, r: hessian(x - r),
        lambda x, r: -hessian(x - r),
    )


def weighted(name: str, K: Array) -> ErrorFunction:
    """1/2 (x - r)^T K (x - r); isotropic where K is a multiple of I."""
    return of_difference(name, lambda e: float(0.5 * e @ K @ e), lambda e: K @ e, lambda e: K)


def bounded(k: float, delta: float) -> ErrorFunction:
    """k delta (sqrt(delta^2 + |e|^2) - delta): |d1 phi| stays below k delta."""

    def hessian(e: Array) -> Array:
        s2 = delta * delta + e @ e
        return np.asarray(k * delta / np.sqrt(s2) * (np.eye(3) - np.outer(e, e) / s2))

    return of_difference(
        "bounded",
        lambda e: float(k * delta * (np.sqrt(delta * delta + e @ e) - delta)),
        lambda e: k * delta * e / np.sqrt(delta * delta + e @ e),
        hessian,
    )


def growing() -> ErrorFunction:
    """sum of w_i (cosh(e_i/3) - 1): convex, neither quadratic nor isotropic, and steep far off."""
    w = np.array([1.0, 2.0, 0.5])
    return of_difference(
        "growing",
        lambda e: float(w @ (np.cosh(e / 3.0) - 1.0)),
        lambda e: w * np.sinh(e / 3.0) / 3.0,
        lambda e: np.diag(w * np.cosh(e / 3.0) / 9.0),
    )


def depending_on_r(k: Callable[[Array], float], k_gradient: Callable[[Array], Array]) -> ErrorFunction:
    """1/2 k(r) |x - r|^2, which Prop. 3.1 admits."""
    return ErrorFunction(
        "k(r)",
        lambda x, r: float(0.5 * k(r) * (x - r) @ (x - r)),
        lambda x, r: k(r) * (x - r),
        lambda x, r: -k(r) * (x - r) + 0.5 * (x - r) @ (x - r) * k_gradient(r),
        lambda x, r: k(r) * np.eye(3),
        lambda x, r: -k(r) * np.eye(3) + np.outer(x - r, k_gradient(r)),
    )


def hat(w: Array) -> Array:
    """w x, as a matrix."""
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def field(g: Gains, phi: ErrorFunction, x: Array, motion: Motion) -> tuple[Array, Array]:
    """Xr of 3.3, and a = r'' - lambda d/dt(d1 phi | x fixed) of (10)."""
    r, r1, r2 = motion
    return r1 - phi.d1(x, r) / g.beta, r2 - phi.mixed(x, r) @ r1 / g.beta


def projections(g: Gains, phi: ErrorFunction, x: Array, R: Array, motion: Motion) -> Array:
    """(y4, y5, y6)."""
    return np.asarray(g.beta * R.T @ field(g, phi, x, motion)[0])


def rates_10(g: Gains, phi: ErrorFunction, x: Array, R: Array, motion: Motion, u: Array) -> Array:
    """d/dt (y5, y6): the two brackets of (10), which V2' multiplies by dpsi_1 and dpsi_2."""
    y4, y5, y6 = projections(g, phi, x, R, motion)
    a5, a6 = g.beta * field(g, phi, x, motion)[1] @ R[:, 1:]
    # lambda <H X4, X5> and lambda <H X4, X6>
    cross5, cross6 = 1.0 / g.beta * (g.beta * R[:, 1:].T @ phi.hessian(x, motion[0]) @ R[:, 0])
    u1, u2, u3, u4 = u
    return np.array([a5 - u4 * cross5 + u1 * y6 - u3 * y4, a6 - u4 * cross6 + u2 * y4 - u1 * y5])


def turn(g: Gains, phi: ErrorFunction, x: Array, R: Array, motion: Motion) -> Array:
    """(u2 y4, u3 y4) of (11) for quadratic psi, with the Hessian term, for the u4 of (14).

    For phi = 1/2 k(r) |x - r|^2 that term is zero, and this is (11) to the letter.
    """
    y4, y5, y6 = projections(g, phi, x, R, motion)
    a = field(g, phi, x, motion)[1] - y4 / g.beta**2 * phi.hessian(x, motion[0]) @ R[:, 0]
    a5, a6 = g.beta * a @ R[:, 1:]
    return np.array([-(g.rho2 * y6 + a6), g.rho3 * y5 + a5])


def law(g: Gains, phi: ErrorFunction, x: Array, R: Array, motion: Motion) -> Array:
    """(11) and (14), no limits and no branch: u = (u1, u2, u3, u4)."""
    y4 = projections(g, phi, x, R, motion)[0]
    u2, u3 = turn(g, phi, x, R, motion) / y4
    return np.array([0.0, u2, u3, y4 / g.beta])


def moved(x: Array, R: Array, u: Array, dt: float) -> tuple[Array, Array]:
    """(1) under constant u for a short time, by the power series of the matrix exponential."""
    twist = np.zeros((4, 4))
    twist[:3, :3], twist[0, 3] = dt * hat(u), dt * u[3]
    assert np.abs(twist).max() < 0.2  # what is left out is below 1e-15
    step = term = np.eye(4)
    for n in range(1, 13):
        term = term @ twist / n
        step = step + term
    return x + R @ step[:3, 3], R @ step[:3, :3]


def derivative(f: Callable[[float], Any], h: float = 1e-3) -> Any:
    """f'(0) by central differences of sixth order, of a number or an array."""
    pairs = zip((45.0, -9.0, 1.0), (1, 2, 3), strict=True)
    return sum(c * (f(n * h) - f(-n * h)) for c, n in pairs) / (60.0 * h)


class Flight(NamedTuple):
    """The closed loop at some times; `singular_s` is when y4 = 0 was reached, None if it was not."""

    t: Array
    x: Array
    R: Array
    singular_s: float | None


def fly(
    g: Gains,
    phi: ErrorFunction,
    curve: Curve,
    x: Array,
    R: Array,
    times: Array,
    *,
    limit: float = np.inf,
    method: str = "LSODA",
    tolerance: float = 1e-9,
) -> Flight:
    """The continuous closed loop by a stiff solver, every |u_i| bounded by `limit`; ends where y4 = 0."""

    def rate(t: float, state: Array) -> Array:
        x, R = state[:3], state[3:].reshape(3, 3)
        u = np.clip(law(g, phi, x, R, curve(t)), -limit, limit)
        return np.concatenate((u[3] * R[:, 0], (R @ hat(u)).ravel()))

    def y4(t: float, state: Array) -> float:
        return float(projections(g, phi, state[:3], state[3:].reshape(3, 3), curve(t))[0])

    y4.terminal = True  # type: ignore[attr-defined]  # how scipy is told
    solution = solve_ivp(
        rate,
        (times[0], times[-1]),
        np.concatenate((x, R.ravel())),
        method=method,
        t_eval=times,
        events=y4,
        rtol=tolerance,
        atol=0.1 * tolerance,
    )
    assert solution.success, solution.message
    states = solution.y.T
    singular = float(solution.t_events[0][0]) if solution.t_events[0].size else None
    return Flight(solution.t, states[:, :3], states[:, 3:].reshape(-1, 3, 3), singular)


def helix(t: float) -> Motion:
    """The helix of section 4."""
    s, c = np.sin(t / 10.0), np.cos(t / 10.0)
    return np.array([s, c, t / 10.0]), np.array([c / 10.0, -s / 10.0, 0.1]), np.array([-s, -c, 0.0]) / 100.0


def leg(number: int) -> Curve:
    """One leg of (15), 0 to 2, in the plane, continued for all times."""
    sign = -1.0 if number == 1 else 1.0
    offset = (0.0, 60.0, -60.0)[number]

    def curve(t: float) -> Motion:
        return np.array([offset + sign * t, t, 0.0]), np.array([sign, 1.0, 0.0]), np.zeros(3)

    return curve


def random_rotation(rng: np.random.Generator) -> Array:
    """Uniform over SO(3)."""
    return np.asarray(Rotation.random(rng=rng).as_matrix())


def random_motion(rng: np.random.Generator) -> Motion:
    """r, r', r'' of some metres, m/s and m/s^2."""
    return rng.normal(size=3) * 5.0, rng.normal(size=3) * 2.0, rng.normal(size=3)


def later(motion: Motion, dt: float) -> Motion:
    """The reference a time dt later, at constant acceleration."""
    r, r1, r2 = motion
    return r + dt * r1 + 0.5 * dt * dt * r2, r1 + dt * r2, r2


def random_gains(rng: np.random.Generator) -> Gains:
    """Around the paper's, beta != 1 and rho2 != rho3."""
    return Gains(*map(float, rng.uniform((0.3, 1.0, 1.0, 0.5), (2.0, 12.0, 12.0, 2.0))))
