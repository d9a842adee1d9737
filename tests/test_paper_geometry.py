"""(2), (3) and (4): the metric and the kinematic connection, verified, and what they have to do with (10).

X1 to X6 are the left-invariant fields of (1). A field V = V^j X_j has the covariant derivative
`nabla_Xi V = (Xi(V^j) + Gamma_ik^j V^k) X_j`; Gamma_ik^j stands in `CHRISTOFFEL[i, k, j]`, counted from 0.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import null_space

from guidance.law import evaluate
from guidance.se3 import Reference, Vec3
from sitl.paper import FIGURES, simulate
from tests.oracle import Array, matrix_of, pose_of
from tests.paper_oracle import (
    ErrorFunction,
    derivative,
    field,
    later,
    moved,
    projections,
    random_gains,
    random_motion,
    random_rotation,
    rates_10,
)
from tests.strategies import UNBOUNDED
from tests.test_paper_results import EVERY, ISOTROPIC, draws, named


def christoffel() -> Array:
    """(4) as printed."""
    gamma = np.zeros((6, 6, 6))
    for i, k, j, value in (
        (1, 2, 3, 0.5), (3, 1, 2, 0.5), (2, 3, 1, 0.5),
        (2, 1, 3, -0.5), (1, 3, 2, -0.5), (3, 2, 1, -0.5),
        (1, 5, 6, 1.0), (2, 6, 4, 1.0), (3, 4, 5, 1.0),
        (2, 4, 6, -1.0), (3, 5, 4, -1.0), (1, 6, 5, -1.0),
    ):  # fmt: skip
        gamma[i - 1, k - 1, j - 1] = value
    return gamma


CHRISTOFFEL = christoffel()


def algebra(coordinates: Array) -> Array:
    """(2): {(w1, w2, w3), (v1, v2, v3)} as a 4x4 matrix."""
    w1, w2, w3, v1, v2, v3 = coordinates
    return np.array([[0.0, -w3, w2, v1], [w3, 0.0, -w1, v2], [-w2, w1, 0.0, v3], [0.0, 0.0, 0.0, 0.0]])


def coordinates(matrix: Array) -> Array:
    """The reverse of `algebra`."""
    return np.array([matrix[2, 1], matrix[0, 2], matrix[1, 0], *matrix[:3, 3]])


def bracket(i: int, k: int) -> Array:
    """[Xi, Xk] in coordinates."""
    A, B = algebra(np.eye(6)[i]), algebra(np.eye(6)[k])
    return coordinates(A @ B - B @ A)


def theta(alpha: float, beta: float) -> Array:
    """(3)."""
    return np.diag([alpha] * 3 + [beta] * 3)


def test_4_has_no_torsion() -> None:
    """nabla_Xi Xk - nabla_Xk Xi = [Xi, Xk] for all 36 pairs, with the brackets of 4x4 matrices."""
    for i, k in product(range(6), repeat=2):
        assert_allclose(CHRISTOFFEL[i, k] - CHRISTOFFEL[k, i], bracket(i, k), atol=1e-15)


@pytest.mark.parametrize(("alpha", "beta"), [(1.0, 1.0), (0.3, 2.0), (5.0, 0.1)])
def test_4_preserves_the_metric_3_for_every_alpha_and_beta_so_it_is_its_levi_civita_connection(
    alpha: float, beta: float
) -> None:
    for i in range(6):
        moved_metric = CHRISTOFFEL[i] @ theta(alpha, beta)
        assert_allclose(moved_metric + moved_metric.T, 0.0, atol=1e-15)


def test_3_are_all_left_invariant_metrics_that_4_preserves() -> None:
    """The conclusions speak of a reduced set: of the 21 dimensions of left-invariant metrics two are left."""
    basis = [(np.outer(a, b) + np.outer(b, a)) for n, a in enumerate(np.eye(6)) for b in np.eye(6)[n:]]
    assert len(basis) == 21
    conditions = np.array(
        [
            np.concatenate([(CHRISTOFFEL[i] @ G + (CHRISTOFFEL[i] @ G).T).ravel() for i in range(6)])
            for G in basis
        ]
    ).T
    left = null_space(conditions)
    assert left.shape[1] == 2
    for weights in left.T:
        G = sum(w * B for w, B in zip(weights, basis, strict=True))
        assert_allclose(G, theta(G[0, 0], G[3, 3]), atol=1e-12)


def test_3_gives_lambda_and_the_projections_that_the_law_computes() -> None:
    """<V, X_i> at g of a translational field V is Theta(g^-1 V, X_i), whatever alpha; y4, y5, y6 are that."""
    for rng in draws(30):
        g, R, motion = random_gains(rng), random_rotation(rng), random_motion(rng)
        x, alpha = rng.normal(size=3) * 5.0, rng.uniform(0.1, 10.0)
        pose, tangent = np.eye(4), np.zeros((4, 4))
        pose[:3, :3], pose[:3, 3] = R, x
        tangent[:3, 3] = field(g, ISOTROPIC._replace(d1=lambda x, r: 0.7 * (x - r)), x, motion)[0]
        body = coordinates(np.asarray(np.linalg.solve(pose, tangent), dtype=np.float64))
        products = theta(alpha, g.beta) @ body
        reference = Reference(*(Vec3(*map(float, v)) for v in motion))
        result = evaluate(g._replace(k=0.7), UNBOUNDED, pose_of(x, R), reference)
        assert_allclose(products[:3], 0.0, atol=1e-12)
        assert_allclose((result.y4, result.y5, result.y6), products[3:], atol=1e-9)
        # (14): u4 = <Xr, X4>/<X4, X4>
        assert result.demanded.u4 == pytest.approx(products[3] / theta(alpha, g.beta)[3, 3], abs=1e-9)


@named(EVERY)
def test_10_follows_from_4(phi: ErrorFunction) -> None:
    """d/dt <Xr, X5> = <dXr/dt, X5> + <nabla_g' Xr, X5> + <Xr, nabla_g' X5>, and the same for X6.

    By (4), nabla_g' X5 = u1 X6 - u3 X4 and nabla_g' X6 = u2 X4 - u1 X5; and nabla_g' Xr, r fixed, is
    -lambda u4 H X4: rotating the body does not move a field of the world.
    """

    def check(rng: np.random.Generator) -> None:
        g, R, motion = random_gains(rng), random_rotation(rng), random_motion(rng)
        x, u = rng.normal(size=3) * 3.0, rng.normal(size=4)
        g_dot = np.array([*u, 0.0, 0.0])

        def components(direction: Array, h: float) -> Array:
            """Xr in the basis X1 to X6, h further along `direction`, at one instant."""
            x_h, R_h = moved(x, R, direction, h)
            return np.concatenate((np.zeros(3), R_h.T @ field(g, phi, x_h, motion)[0]))

        def nabla(direction: Array, V: Array, V_dot: Array) -> Array:
            return np.asarray(V_dot + np.einsum("i,ikj,k->j", direction, CHRISTOFFEL, V))

        metric, zero = theta(1.7, g.beta), np.zeros(6)
        Xr = components(u, 0.0)
        nabla_Xr = nabla(g_dot, Xr, derivative(lambda h: components(u, h)))
        hessian_term = -u[3] / g.beta * R.T @ phi.hessian(x, motion[0]) @ R[:, 0]
        assert_allclose(nabla_Xr, np.concatenate((np.zeros(3), hessian_term)), atol=1e-6)
        X4, X5, X6 = np.eye(6)[3:]
        nabla_X5, nabla_X6 = nabla(g_dot, X5, zero), nabla(g_dot, X6, zero)
        assert_allclose(nabla_X5, u[0] * X6 - u[2] * X4, atol=1e-15)
        assert_allclose(nabla_X6, u[1] * X4 - u[0] * X5, atol=1e-15)
        a = np.concatenate((np.zeros(3), R.T @ field(g, phi, x, motion)[1]))
        assembled = [
            a @ metric @ X + nabla_Xr @ metric @ X + Xr @ metric @ nabla_X
            for X, nabla_X in ((X5, nabla_X5), (X6, nabla_X6))
        ]
        assert_allclose(assembled, rates_10(g, phi, x, R, motion, u), atol=1e-5)
        in_time = derivative(lambda h: projections(g, phi, *moved(x, R, u, h), later(motion, h)))
        assert_allclose(assembled, in_time[1:], rtol=1e-5, atol=1e-5)

    for rng in draws(31, 10):
        check(rng)


def test_se2_is_closed_under_the_bracket_and_under_4() -> None:
    """X3, X4, X5 (yaw, forward, sideways): nothing leaves the plane, and (10) keeps its terms in u3, u4."""
    plane = (2, 3, 4)
    for i, k in product(plane, repeat=2):
        for out in (bracket(i, k), CHRISTOFFEL[i, k]):
            assert not out[[0, 1, 5]].any()
    assert CHRISTOFFEL[2, 3, 4] == 1.0
    assert CHRISTOFFEL[2, 4, 3] == -1.0


def test_se2_the_law_on_se3_started_in_the_plane_is_the_law_on_se2() -> None:
    """Level, with a reference in the plane, (11) gives u2 = 0 by itself: `in_plane` changes nothing here."""
    problem = FIGURES[2]._replace(end_s=3.0)
    flat, spatial = simulate(problem, 0.01), simulate(problem._replace(in_plane=False), 0.01)
    for a, b in zip(flat, spatial, strict=True):
        assert a.pose.position.z == b.pose.position.z == 0.0
        assert_allclose(b.pose.position, a.pose.position, atol=1e-9)
        assert_allclose(matrix_of(b.pose.attitude), matrix_of(a.pose.attitude), atol=1e-9)
        assert_allclose(b.controls, a.controls, atol=1e-6)
        assert (a.controls.u1, a.controls.u2) == (0.0, 0.0)
