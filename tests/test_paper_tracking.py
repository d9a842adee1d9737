"""Prop. 3.2, Theorem 3.3, and where they end: flights of the continuous closed loop, and y4 = 0.

The law is written in tests/paper_oracle.py, with the Hessian term that general error functions need
(without it, it is the paper's). That `guidance.law` has the same exponentials is in test_law_flights.py,
what it does at y4 = 0 in test_law_singularity.py.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from guidance.law import Gains
from tests.oracle import Array
from tests.paper_oracle import (
    Curve,
    ErrorFunction,
    Motion,
    bounded,
    derivative,
    field,
    fly,
    hat,
    helix,
    later,
    law,
    leg,
    moved,
    projections,
    random_gains,
    random_motion,
    random_rotation,
    rates_10,
    turn,
    weighted,
)
from tests.test_paper_results import EVERY, K_OF_R, SKEWED, draws, named

SECTION_4 = Gains(k=1.0, rho2=10.0, rho3=10.0, beta=1.0)
ISOTROPIC = weighted("isotropic", np.eye(3))


def wide_helix(t: float) -> Motion:
    """Faster and more curved than that of section 4: 1.6 m/s on a radius of 3 m."""
    s, c = np.sin(0.5 * t), np.cos(0.5 * t)
    return (
        np.array([3.0 * s, 3.0 * c, 0.5 * t]),
        np.array([1.5 * c, -1.5 * s, 0.5]),
        np.array([-0.75 * s, -0.75 * c, 0.0]),
    )


@named(EVERY)
def test_proposition_3_2_y5_and_y6_are_pure_exponentials_whatever_else_happens(phi: ErrorFunction) -> None:
    """For k and k(r) with (11) to the letter, for the others with the Hessian term (the remark after 3.2)."""
    for rng in draws(20, 3):
        g, R = random_gains(rng), random_rotation(rng)
        flight = fly(g, phi, wide_helix, rng.normal(size=3) * 5.0, R, np.linspace(0.0, 0.6, 4))
        y = np.array(
            [
                projections(g, phi, x, R, wide_helix(t))
                for t, x, R in zip(flight.t, flight.x, flight.R, strict=True)
            ]
        )
        assert flight.singular_s is None
        assert np.max(np.abs(y[0, 1:])) > 0.5
        assert_allclose(y[:, 1], y[0, 1] * np.exp(-g.rho3 * flight.t), atol=1e-6)
        assert_allclose(y[:, 2], y[0, 2] * np.exp(-g.rho2 * flight.t), atol=1e-6)


@pytest.mark.parametrize(
    "phi", [bounded(1.0, 2.0), weighted("anisotropic", SKEWED)], ids=["bounded", "anisotropic"]
)
def test_proposition_3_2_needs_the_isotropic_function_as_long_as_11_has_no_hessian_term(
    phi: ErrorFunction,
) -> None:
    """(11) to the letter misses -rho y5 by lambda u4 <H X4, X5>.

    With that term in a, for the u4 that is *applied*, it is exact, limits on u4 and all.
    """
    missed = 0.0
    for rng in draws(21, 30):
        g, R, motion = random_gains(rng), random_rotation(rng), random_motion(rng)
        x, applied = rng.normal(size=3) * 4.0, rng.uniform(0.0, 2.0)
        y4, y5, y6 = projections(g, phi, x, R, motion)
        wanted = (-g.rho3 * y5, -g.rho2 * y6)
        a = field(g, phi, x, motion)[1]
        for u4, term in ((y4 / g.beta, 0.0), (applied, applied / g.beta)):
            a5, a6 = g.beta * (a - term * phi.hessian(x, motion[0]) @ R[:, 0]) @ R[:, 1:]
            u = np.array([0.0, -(g.rho2 * y6 + a6) / y4, (g.rho3 * y5 + a5) / y4, u4])
            found = rates_10(g, phi, x, R, motion, u)
            if term:
                assert_allclose(found, wanted, rtol=1e-9, atol=1e-9)
            else:
                missed = max(missed, *np.abs(found - wanted))
    assert missed > 0.3


def test_the_bounded_function_never_asks_for_an_approach_faster_than_lambda_k_delta() -> None:
    for rng in draws(22):
        g = random_gains(rng)
        motion = random_motion(rng)
        phi = bounded(g.k, 2.0)
        x = rng.normal(size=3) * 10.0 ** rng.uniform(-1.0, 3.0)
        approach = np.linalg.norm(field(g, phi, x, motion)[0] - motion[1])
        assert approach <= g.k * 2.0 / g.beta
    assert approach > 0.9 * g.k * 2.0 / g.beta


@pytest.mark.parametrize("curve", [helix, wide_helix])
@pytest.mark.parametrize("phi", [ISOTROPIC, K_OF_R], ids=["k", "k(r)"])
def test_theorem_3_3_the_reference_is_tracked_where_sigma_is_not_left(
    phi: ErrorFunction, curve: Curve
) -> None:
    """From states with y4 > 0 forwards, from states with y4 < 0 in reverse, the rear on the track.

    The second is convergence in the sense of the theorem, and no use to a vehicle without reverse.
    """
    directions = []
    for rng in draws(23, 6):
        x, R = rng.normal(size=3) * 10.0, random_rotation(rng)
        flight = fly(SECTION_4, phi, curve, x, R, np.linspace(0.0, 30.0, 31), tolerance=1e-8)
        assert flight.singular_s is None
        first, last = (law(SECTION_4, phi, flight.x[n], flight.R[n], curve(flight.t[n])) for n in (0, -1))
        error = np.linalg.norm(flight.x - [curve(t)[0] for t in flight.t], axis=1)
        assert error[0] > 3.0
        assert error[-1] < 1e-5
        assert np.all(error[8:] < error[:-8] + 1e-6)
        speed = np.linalg.norm(curve(30.0)[1])
        assert last[3] == pytest.approx(np.sign(first[3]) * speed, rel=1e-3)
        directions.append(np.sign(last[3]))
    assert set(directions) == {-1.0, 1.0}


def eastbound(t: float) -> Motion:
    """A line at 1 m/s."""
    return np.array([0.0, t, 0.0]), np.array([0.0, 1.0, 0.0]), np.zeros(3)


def to_the_singularity(x: Array, R: Array, curve: Curve) -> tuple[float, Array]:
    """When the closed loop from (x, R) has y4 = 0, and its y then; there must be such a time.

    In the time s of dt = y4 ds nothing is divided by y4, and dy4/ds = 1/2 (y4^2)' is finite: a solver
    passes through y4 = 0 as through any other value.
    """

    def rate(_: float, state: Array) -> Array:
        x, R, motion = state[:3], state[3:12].reshape(3, 3), curve(state[12])
        y4 = projections(SECTION_4, ISOTROPIC, x, R, motion)[0]
        u2, u3 = turn(SECTION_4, ISOTROPIC, x, R, motion)
        return np.concatenate((y4 * y4 * R[:, 0], (R @ hat(np.array([0.0, u2, u3]))).ravel(), [y4]))

    def y(state: Array) -> Array:
        return projections(SECTION_4, ISOTROPIC, state[:3], state[3:12].reshape(3, 3), curve(state[12]))

    def crossing(_: float, state: Array) -> float:
        return float(y(state)[0])

    crossing.terminal = True  # type: ignore[attr-defined]  # how scipy is told
    start = np.concatenate((x, R.ravel(), [0.0]))
    solution = solve_ivp(rate, (0.0, 10.0), start, events=crossing, rtol=1e-9, atol=1e-12)
    assert solution.t_events[0].size == 1
    return float(solution.y[12, -1]), y(solution.y[:, -1])


def half_y4_squared_rate(g: Gains, phi: ErrorFunction, x: Array, R: Array, motion: Motion) -> float:
    """y4 beta Xr'.b1 + y5 (rho3 y5 + a5) + y6 (rho2 y6 + a6), the total Xr' along the closed loop."""
    y4, y5, y6 = projections(g, phi, x, R, motion)
    total = field(g, phi, x, motion)[1] - y4 / g.beta**2 * phi.hessian(x, motion[0]) @ R[:, 0]
    u2, u3 = turn(g, phi, x, R, motion)
    return float(y4 * g.beta * total @ R[:, 0] + y5 * u3 - y6 * u2)


@named(EVERY)
def test_half_the_rate_of_y4_squared_is_what_decides(phi: ErrorFunction) -> None:
    def check(g: Gains, x: Array, R: Array, motion: Motion) -> None:
        u = law(g, phi, x, R, motion)
        rate = derivative(
            lambda h: 0.5 * projections(g, phi, *moved(x, R, u, h), later(motion, h))[0] ** 2,
            h=1e-3 / (1.0 + np.abs(u).max()),
        )
        expected = half_y4_squared_rate(g, phi, x, R, motion)
        assert rate == pytest.approx(expected, rel=1e-5, abs=1e-4)

    for rng in draws(24):
        check(random_gains(rng), rng.normal(size=3) * 2.0, random_rotation(rng), random_motion(rng))


def test_theorem_3_3_is_false_y4_reaches_zero_in_finite_time_from_an_open_set_of_sigma() -> None:
    """After (13) it says: V2' <= 0, so the projection on X4 never decreases and is never zero.

    V2' <= 0 holds here throughout, and y4 falls from 0.02 to 0 within 20 ms, where (11) ends: from a state
    and from every other tried within 3 mm and 0.03 rad per axis. Zero is reached with 1/2 (y4^2)' < 0, so
    crossed, not touched: by continuity an open set of states does the same, not only those tried.
    """
    centre = np.array([-0.02, 1.05, 0.0])
    offsets = [np.zeros(6)] + [rng.uniform(-1.0, 1.0, 6) * ([3e-3] * 3 + [0.03] * 3) for rng in draws(25, 25)]
    for offset in offsets:
        x, R = centre + offset[:3], Rotation.from_rotvec(offset[3:]).as_matrix()
        before = projections(SECTION_4, ISOTROPIC, x, R, eastbound(0.0))
        assert before[0] > 0.01
        assert half_y4_squared_rate(SECTION_4, ISOTROPIC, x, R, eastbound(0.0)) < -0.01
        t, y = to_the_singularity(x, R, eastbound)
        assert 0.002 < t < 0.02
        assert abs(y[0]) < 1e-9
        assert y[1] * (10.0 * y[1] + 1.0) < -0.01  # what is left of 1/2 (y4^2)' where y4 = 0, up to y6
        assert_allclose(y[1:], before[1:] * np.exp(-10.0 * t), atol=1e-9)  # V2 decreased to the end


def test_at_the_corners_of_15_the_field_turns_by_a_right_angle_onto_the_singularity() -> None:
    """The paper says that the reference is not twice differentiable there; not that (11) is undefined."""
    heading = np.pi / 4.0
    for before, at in ((0, 30.0), (1, 60.0)):
        R = Rotation.from_euler("z", heading + before * np.pi / 2.0).as_matrix()
        on_track = leg(before)(at)[0]
        assert_allclose(on_track, leg(before + 1)(at)[0], atol=1e-12)
        y = projections(SECTION_4, ISOTROPIC, on_track, R, leg(before)(at))
        assert_allclose(y, (np.sqrt(2.0), 0.0, 0.0), atol=1e-12)
        turned = projections(SECTION_4, ISOTROPIC, on_track, R, leg(before + 1)(at))
        assert_allclose(np.abs(turned), (0.0, np.sqrt(2.0), 0.0), atol=1e-12)


@pytest.mark.parametrize("without", ["yaw", "pitch"])
def test_the_allocations_announced_in_3_4_satisfy_12_and_have_no_bounded_rates_at_their_target(
    without: str,
) -> None:
    """(10) with u3 = 0 or u2 = 0: exact wherever y4, y6 (or y5) are not zero.

    But y5 = y6 = 0 is Psi, where the flight is to end; on the way there the roll rate grows like a/y.
    """
    for rng in draws(26):
        g, R, motion = random_gains(rng), random_rotation(rng), random_motion(rng)
        x = rng.normal(size=3) * 3.0
        _, y5, y6 = projections(g, ISOTROPIC, x, R, motion)
        u = redundant(g, x, R, motion, without)
        expected = -g.rho3 * y5**2 - g.rho2 * y6**2
        assert rates_10(g, ISOTROPIC, x, R, motion, u) @ (y5, y6) == pytest.approx(expected, rel=1e-8)  # (12)
        # Almost aligned, with a across the field, as on every curve.
        Xr, a = field(g, ISOTROPIC, x, motion)
        b1 = Xr / np.linalg.norm(Xr)
        side = np.cross(b1, a)
        side /= np.linalg.norm(side)
        axis = (np.cross(b1, side) + side) / np.sqrt(2.0)
        aligned = np.column_stack((b1, axis, np.cross(b1, axis)))
        rolls = []
        for angle in (1e-2, 1e-4, 1e-6):
            tilted = Rotation.from_rotvec(angle * (aligned[:, 1] + aligned[:, 2])).as_matrix() @ aligned
            rolls.append(abs(redundant(g, x, tilted, motion, without)[0]))
        assert rolls[2] > 50.0 * rolls[1]
        assert rolls[2] > 1e3


def redundant(g: Gains, x: Array, R: Array, motion: Motion, without: str) -> Array:
    """u with u3 = 0 (yaw failed) or u2 = 0 (pitch failed), rolling instead; from (10)."""
    y4, y5, y6 = projections(g, ISOTROPIC, x, R, motion)
    a5, a6 = g.beta * field(g, ISOTROPIC, x, motion)[1] @ R[:, 1:]
    u4 = y4 / g.beta
    if without == "yaw":
        u1 = -(g.rho3 * y5 + a5) / y6
        return np.array([u1, (-g.rho2 * y6 - a6 + u1 * y5) / y4, 0.0, u4])
    u1 = (g.rho2 * y6 + a6) / y5
    return np.array([u1, 0.0, (g.rho3 * y5 + a5 + u1 * y6) / y4, u4])
