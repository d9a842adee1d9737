"""Sections 2 and 3 of the paper, equation by equation: (5) to (8), (10), (12), (13) and Prop. 3.1.

Each against numerical derivatives along random motions (1) and references; derivatives of sixth order, so
that 1e-6 of the terms is far above what the differences lose. Where the paper is wrong, the test's name and
docstring say so. What `guidance.law` makes of (11), (12) and (14) is in test_law.py, flights in
test_paper_tracking.py, the connection (4) in test_paper_geometry.py.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import null_space

from guidance.law import Gains
from tests.oracle import Array
from tests.paper_oracle import (
    ErrorFunction,
    Motion,
    bounded,
    depending_on_r,
    derivative,
    field,
    growing,
    later,
    law,
    moved,
    projections,
    random_gains,
    random_motion,
    random_rotation,
    rates_10,
    weighted,
)

SKEWED = np.array([[2.0, 0.3, -0.4], [0.3, 0.7, 0.1], [-0.4, 0.1, 1.2]])
ISOTROPIC = weighted("isotropic", 0.7 * np.eye(3))
OF_DIFFERENCE = [ISOTROPIC, weighted("anisotropic", SKEWED), bounded(0.8, 2.0), growing()]


def k_of(r: Array) -> float:
    """k(r), between 0.3 and 1.7."""
    return float(1.0 + 0.5 * np.sin(r[0]) + 0.2 * np.cos(r[1] + r[2]))


def k_gradient(r: Array) -> Array:
    """Its gradient."""
    return np.array([0.5 * np.cos(r[0]), *(2 * [-0.2 * np.sin(r[1] + r[2])])])


K_OF_R = depending_on_r(k_of, k_gradient)
EVERY = [*OF_DIFFERENCE, K_OF_R]


def named(functions: list[ErrorFunction]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Parametrize by error function."""
    return pytest.mark.parametrize("phi", functions, ids=[phi.name for phi in functions])


def draws(seed: int, count: int = 40) -> list[np.random.Generator]:
    """Independent generators, the same in every run."""
    return [np.random.default_rng([seed, n]) for n in range(count)]


@named(EVERY)
def test_the_error_functions_are_error_functions_and_their_derivatives_are_right(phi: ErrorFunction) -> None:
    def check(x: Array, r: Array, along: Array) -> None:
        assert phi.value(r, r) == 0.0
        assert phi.value(x, r) > 0.0
        in_x, in_r = (
            derivative(f)
            for f in (lambda h: phi.value(x + h * along, r), lambda h: phi.value(x, r + h * along))
        )
        assert_allclose((phi.d1(x, r) @ along, phi.d2(x, r) @ along), (in_x, in_r), atol=1e-8)
        assert_allclose(phi.hessian(x, r) @ along, derivative(lambda h: phi.d1(x + h * along, r)), atol=1e-8)
        assert_allclose(phi.mixed(x, r) @ along, derivative(lambda h: phi.d1(x, r + h * along)), atol=1e-8)

    for rng in draws(1, 20):
        check(*rng.normal(size=(3, 3)) * 3.0)


def phi_rate(phi: ErrorFunction, x: Array, v: Array, motion: Motion) -> float:
    """d/dt phi(x, r) with x moving at v."""
    return float(derivative(lambda h: phi.value(x + h * v, later(motion, h)[0])))


@named(EVERY)
def test_5_holds_for_f_of_x_minus_r_and_gains_a_term_in_k_dot_for_k_of_r(phi: ErrorFunction) -> None:
    """(5) needs d2 phi = -d1 phi. Prop. 3.1 admits k(r), for which that is false.

    There V1' = d1 phi.(x' - r') + 1/2 k' |e|^2, and the last term is not small.
    """
    largest = 0.0
    for rng in draws(2):
        x, v = rng.normal(size=(2, 3)) * 3.0
        motion = r, r1, _ = random_motion(rng)
        found = phi_rate(phi, x, v, motion)
        as_printed = phi.d1(x, r) @ (v - r1)
        k_dot = k_gradient(r) @ r1 if phi is K_OF_R else 0.0
        assert found == pytest.approx(as_printed + 0.5 * k_dot * (x - r) @ (x - r), rel=1e-7, abs=1e-7)
        largest = max(largest, abs(found - as_printed))
    assert largest > 10.0 if phi is K_OF_R else largest < 1e-6


@named(OF_DIFFERENCE)
def test_7_along_the_desired_field_v1_decreases_by_lambda_times_its_slope_squared(phi: ErrorFunction) -> None:
    for rng in draws(3):
        g, x, motion = random_gains(rng), rng.normal(size=3) * 3.0, random_motion(rng)
        found = phi_rate(phi, x, field(g, phi, x, motion)[0], motion)
        d1 = phi.d1(x, motion[0])
        assert found == pytest.approx(-d1 @ d1 / g.beta, rel=1e-6, abs=1e-7)


def test_7_fails_for_k_of_r_where_v1_may_even_grow_along_the_desired_field() -> None:
    """V1' = -lambda |d1 phi|^2 + 1/2 k' |e|^2 is positive where k' > 2 lambda k^2.

    The error decays all the same, e' = -lambda k e: it is V1 that is no Lyapunov function.
    """
    grew = []
    for rng in draws(4):
        g, x, motion = random_gains(rng), rng.normal(size=3) * 3.0, random_motion(rng)
        r, r1, _ = motion
        Xr = field(g, K_OF_R, x, motion)[0]
        e, k, k_dot = x - r, k_of(r), float(k_gradient(r) @ r1)
        found = phi_rate(K_OF_R, x, Xr, motion)
        assert found == pytest.approx((-(k**2) / g.beta + 0.5 * k_dot) * e @ e, rel=1e-6, abs=1e-6)
        assert_allclose(Xr - r1, -k / g.beta * e, rtol=1e-9, atol=1e-12)
        grew.append(found > 0.0)
        assert grew[-1] == (k_dot > 2.0 / g.beta * k * k)
    assert {True, False} == set(grew)


@pytest.mark.parametrize("K", [0.7 * np.eye(3), SKEWED], ids=["isotropic", "anisotropic"])
def test_8_holds_with_the_reverse_of_6_and_is_an_equality_for_isotropic_quadratics(K: Array) -> None:
    """phi <= b |d1 phi|^2 with b = 1/(2 k_min), where (6) has >=: then V1' <= -(lambda/b) phi."""
    phi, b = weighted("", K), 0.5 / np.linalg.eigvalsh(K)[0]
    for rng in draws(5):
        e = rng.normal(size=3) * 3.0
        slope2 = phi.d1(e, np.zeros(3)) @ phi.d1(e, np.zeros(3))
        value = phi.value(e, np.zeros(3))
        assert value <= b * slope2 * (1.0 + 1e-12)
        assert -slope2 <= -value / b * (1.0 - 1e-12)
        if K[0, 1] == 0.0:
            assert slope2 == pytest.approx(value / b)


def test_6_as_printed_allows_any_small_b_and_then_8_is_false() -> None:
    """phi = 1/2 |e|^2 is above b |d1 phi|^2 for every b <= 1/2; (8) would make it decay at any rate."""
    phi = weighted("", np.eye(3))
    e, zero = np.array([1.0, -2.0, 0.5]), np.zeros(3)
    slope2 = phi.d1(e, zero) @ phi.d1(e, zero)
    for b in (0.4, 0.1, 1e-3):
        assert phi.value(e, zero) >= b * slope2  # (6)
        assert not -slope2 <= -phi.value(e, zero) / b  # (8), over lambda


def test_6_as_printed_holds_for_the_bounded_function_with_b_one_half_and_8_fails_with_every_b() -> None:
    phi, zero = bounded(1.0, 2.0), np.zeros(3)
    quotients = []
    for distance in np.geomspace(1e-3, 1e4, 50):
        e = distance * np.array([0.6, 0.0, -0.8])
        slope2 = phi.d1(e, zero) @ phi.d1(e, zero)
        assert phi.value(e, zero) >= 0.5 * slope2 * (1.0 - 1e-9)  # (6) with b = 1/2
        assert slope2 < phi.value(e, zero) / 0.5 * (1.0 + 1e-9)  # the reverse of (8), over lambda
        quotients.append(phi.value(e, zero) / slope2)
    # The corrected constant is 1/2 close to r and has no bound: only close by is the decay exponential.
    assert quotients[0] == pytest.approx(0.5, rel=1e-4)
    assert np.all(np.diff(quotients) > 0.0)
    assert quotients[-1] > 1e3


@named(EVERY)
def test_10_is_the_derivative_of_v2_for_any_pose_reference_controls_and_error_function(
    phi: ErrorFunction,
) -> None:
    """Both brackets of (10), with the terms -lambda u4 <H X4, X5> and <H X4, X6> and all four controls."""

    def check(g: Gains, x: Array, R: Array, motion: Motion, u: Array) -> float:
        def y(h: float) -> Array:
            return projections(g, phi, *moved(x, R, u, h), later(motion, h))

        found, expected = derivative(y), rates_10(g, phi, x, R, motion, u)
        assert_allclose(found[1:], expected, rtol=1e-6, atol=1e-6 * float(np.linalg.norm(found)))
        V2_rate = derivative(lambda h: 0.5 * y(h)[1:] @ y(h)[1:])
        assert V2_rate == pytest.approx(y(0.0)[1:] @ expected, rel=1e-6, abs=1e-5)
        coasting = u * (1.0, 1.0, 1.0, 0.0)
        return float(np.max(np.abs(expected - rates_10(g, phi, x, R, motion, coasting))))

    crossed = max(
        check(
            random_gains(rng),
            rng.normal(size=3) * 4.0,
            random_rotation(rng),
            random_motion(rng),
            rng.normal(size=4) * 2.0,
        )
        for rng in draws(6)
    )
    assert crossed < 1e-12 if phi in (ISOTROPIC, K_OF_R) else crossed > 0.1


Scalar = Callable[[float], float]
#: psi and its derivative: the paper's, one that is bounded in slope, one that is steep.
PSI: dict[str, tuple[Scalar, Scalar]] = {
    "quadratic": (lambda s: 0.5 * s * s, lambda s: s),
    "bounded": (lambda s: sqrt(1.0 + s * s) - 1.0, lambda s: s / sqrt(1.0 + s * s)),
    "quartic": (lambda s: 0.5 * s * s + 0.25 * s**4, lambda s: s + s**3),
}


@pytest.mark.parametrize("phi", [ISOTROPIC, K_OF_R], ids=["isotropic", "k(r)"])
@pytest.mark.parametrize("name", PSI)
def test_12_holds_for_every_psi_and_13_with_the_corrected_inequality(phi: ErrorFunction, name: str) -> None:
    """(13) with psi <= b dpsi^2; for quadratic psi (b = 1/2) equality, V2' = -2 rho3 psi_1 - 2 rho2 psi_2.

    As with (8), (6) as printed allows b = 0.1 for the quadratic psi, with which (13) is false.
    """
    psi, dpsi = PSI[name]

    def check(g: Gains, x: Array, R: Array, motion: Motion) -> bool:
        y4, y5, y6 = map(float, projections(g, phi, x, R, motion))
        if abs(y4) < 0.1:
            return False
        a5, a6 = g.beta * field(g, phi, x, motion)[1] @ R[:, 1:]
        u = np.array([0.0, -(g.rho2 * dpsi(y6) + a6) / y4, (g.rho3 * dpsi(y5) + a5) / y4, y4 / g.beta])

        def v2(h: float) -> float:
            _, s5, s6 = map(float, projections(g, phi, *moved(x, R, u, h), later(motion, h)))
            return psi(s5) + psi(s6)

        found = derivative(v2, h=1e-3 / (1.0 + np.abs(u).max()))
        expected = -g.rho3 * dpsi(y5) ** 2 - g.rho2 * dpsi(y6) ** 2
        assert found == pytest.approx(expected, rel=1e-5, abs=1e-4)  # (12)
        decay = g.rho3 * psi(y5) + g.rho2 * psi(y6)
        if name == "quadratic":
            assert expected == pytest.approx(-decay / 0.5)  # (13), b = 1/2
            assert psi(y5) >= 0.1 * dpsi(y5) ** 2  # (6) with b = 0.1
            assert found > -decay / 0.1  # against (13) with it
        elif name == "quartic":
            assert expected <= -decay / 0.5  # (13): psi <= 1/2 dpsi^2
        return True

    checked = [
        check(random_gains(rng), rng.normal(size=3) * 3.0, random_rotation(rng), random_motion(rng))
        for rng in draws(7)
    ]
    assert sum(checked) > 30


@named(EVERY)
def test_proposition_3_1_the_cross_terms_vanish_for_the_isotropic_functions_and_for_no_other(
    phi: ErrorFunction,
) -> None:
    largest = 0.0
    for rng in draws(8):
        x, r = rng.normal(size=(2, 3)) * 3.0
        R = random_rotation(rng)
        largest = max(largest, *np.abs(R[:, 1:].T @ phi.hessian(x, r) @ R[:, 0]))
    assert largest < 1e-15 if phi in (ISOTROPIC, K_OF_R) else largest > 0.1


def test_proposition_3_1_only_if_a_hessian_without_cross_terms_at_any_attitude_is_a_multiple_of_i() -> None:
    """b1.H b2 = b1.H b3 = 0 at a few attitudes leaves one of the six dimensions of symmetric matrices."""
    basis = [np.eye(3)[[i]].T @ np.eye(3)[[j]] for i in range(3) for j in range(i, 3)]
    basis = [H + H.T for H in basis]
    attitudes = [random_rotation(rng) for rng in draws(9, 4)]
    conditions = [[R[:, 0] @ H @ R[:, n] for H in basis] for R in attitudes for n in (1, 2)]
    left = null_space(np.array(conditions), rcond=1e-10)
    assert left.shape[1] == 1
    H = sum(c * B for c, B in zip(left[:, 0], basis, strict=True))
    assert_allclose(H / H[0, 0], np.eye(3), atol=1e-9)


def test_9_is_zero_on_psi_which_3_4_prints_with_a_wrong_sign() -> None:
    """3.4 prints Psi with <Xr, X5> > 0. V2 = 0 asks for = 0, and so does Xr in Span{X4}.

    States of the printed set have V2 > 0 and are left for its edge: (12) takes <Xr, X5> to zero.
    """
    g = random_gains(np.random.default_rng(10))
    x, motion = np.array([1.0, 2.0, -1.0]), (np.zeros(3), np.array([0.5, 0.2, 0.1]), np.zeros(3))
    Xr = field(g, ISOTROPIC, x, motion)[0]
    b1 = Xr / np.linalg.norm(Xr)
    b2 = np.cross([0.0, 0.0, 1.0], b1)
    b2 /= np.linalg.norm(b2)
    aligned = np.column_stack((b1, b2, np.cross(b1, b2)))
    assert_allclose(projections(g, ISOTROPIC, x, aligned, motion)[1:], 0.0, atol=1e-12)
    c, s = np.cos(0.3), np.sin(0.3)
    printed = aligned @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    _, y5, y6 = projections(g, ISOTROPIC, x, printed, motion)
    assert y5 > 0.1
    assert y6 == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.norm(np.cross(printed[:, 0], Xr)) > 0.1  # Xr is not along X4
    u = law(g, ISOTROPIC, x, printed, motion)
    assert rates_10(g, ISOTROPIC, x, printed, motion, u)[0] == pytest.approx(-g.rho3 * y5)
