"""Section 4: the integration behind figures 1 to 4, against a stiff solver and against finer steps.

"Agrees" is the goal of the project: to 1 % of each component of the error, or to 1e-6 m.
"""

from __future__ import annotations

from functools import cache
from math import exp, pi, sqrt

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from guidance.law import Y4_RATIO_MIN
from guidance.se3 import ZERO, Pose, from_yaw
from guidance.trajectory import Zigzag
from sitl.paper import FIGURES, STEP_MAX_S, STEP_S, Problem, error, simulate
from tests.oracle import Array, matrix_of
from tests.paper_oracle import Curve, fly, helix, leg, projections, weighted

QUADRATIC = weighted("1/2 |x - r|^2", np.eye(3))
UNTIL_CORNER = {2: FIGURES[2]._replace(end_s=30.0), 3: FIGURES[3]._replace(end_s=30.0)}
#: (15) with legs of 6 m, entered on the track: both corners in 18 s.
SHORT = {
    number: FIGURES[number]._replace(
        start=Pose(ZERO, from_yaw(pi / 4.0)), reference=Zigzag(leg_m=6.0), corners_s=(6.0, 12.0), end_s=18.0
    )
    for number in (2, 3)
}


@cache
def errors(problem: Problem, step_s: float, sample_s: float = 0.1) -> tuple[Array, Array]:
    """t and r - x."""
    samples = simulate(problem, step_s, sample_s)
    return np.array([at.t_s for at in samples]), np.array([error(problem, at) for at in samples])


def disagreement(found: Array, expected: Array) -> float:
    """1 where a component differs by 1 % or by 1e-6 m, whichever is more."""
    return float(np.max(np.abs(found - expected) / np.maximum(0.01 * np.abs(expected), 1e-6)))


@pytest.mark.parametrize(
    ("problem", "curve", "limit"),
    [
        (FIGURES[1], helix, np.inf),
        (UNTIL_CORNER[2], leg(0), np.inf),
        (UNTIL_CORNER[3], leg(0), 5.0),
    ],
    ids=["figure 1", "figure 2", "figure 3"],
)
def test_figures_agree_with_a_stiff_solver_on_the_continuous_closed_loop(
    problem: Problem, curve: Curve, limit: float
) -> None:
    t, found = errors(problem, STEP_S)
    start = np.array(problem.start.position)
    R = np.diag([-1.0, -1.0, 1.0]) if problem.in_plane else np.eye(3)
    flight = fly(problem.gains, QUADRATIC, curve, start, R, t, limit=limit, method="Radau", tolerance=1e-8)
    assert flight.singular_s is None
    expected = np.array([curve(at)[0] for at in t]) - flight.x
    assert len(expected) == len(found) == round(problem.end_s / 0.1) + 1
    assert np.max(np.abs(found[0])) > 30.0
    assert np.max(np.abs(found[-1])) < 1e-5
    assert disagreement(found, expected) < 0.1


@pytest.mark.parametrize("step_s", [STEP_S, STEP_MAX_S])
@pytest.mark.parametrize(
    "problem",
    [FIGURES[1]._replace(end_s=20.0), UNTIL_CORNER[2], UNTIL_CORNER[3]],
    ids=["figure 1", "figure 2", "figure 3"],
)
def test_half_the_step_changes_no_error_before_the_first_corner(problem: Problem, step_s: float) -> None:
    coarse, fine = errors(problem, step_s)[1], errors(problem, step_s / 2.0)[1]
    assert disagreement(coarse, fine) < (0.02 if step_s == STEP_S else 1.0)


def test_where_nothing_jumps_the_integration_is_of_fourth_order() -> None:
    coarse, fine, finest = (errors(FIGURES[1]._replace(end_s=3.0), h)[1] for h in (0.02, 0.01, 0.0025))
    ratio = np.max(np.abs(coarse - finest)) / np.max(np.abs(fine - finest))
    assert 12.0 < ratio < 24.0


@pytest.mark.parametrize("problem", SHORT.values(), ids=["figure 2", "figure 3"])
def test_after_the_corners_the_named_branch_converges_with_the_step(problem: Problem) -> None:
    results = [errors(problem, h)[1] for h in (0.02, STEP_S, STEP_S / 2.0)]
    assert np.max(np.abs(results[2])) > 0.05
    assert disagreement(results[0], results[2]) < 1.0
    assert disagreement(results[1], results[2]) < 0.1


def test_figure_2_after_a_corner_is_what_ever_narrower_branches_lead_to() -> None:
    """Prop. 3.2 carries the limit across the corner without a division by y4.

    y5 = y5(30) exp(-10 (t - 30)) holds from y4 = +0 on, so b1 is the field's direction turned back by
    asin(y5/|Xr|), and x' = y4 b1 is an ordinary equation for the error alone.
    """

    def rate(t: float, e: Array) -> Array:
        Xr = np.array([-1.0, 1.0]) - e
        y5 = sqrt(2.0) * exp(-10.0 * t)
        y4 = sqrt(max(0.0, float(Xr @ Xr) - y5 * y5))
        b1 = (y4 * Xr - y5 * np.array([-Xr[1], Xr[0]])) / (Xr @ Xr)
        return np.asarray(y4 * b1 - (-1.0, 1.0))

    t, found = errors(FIGURES[2]._replace(end_s=36.0), STEP_S, 0.05)
    after = t >= 30.0
    limit = solve_ivp(
        rate, (0.0, 6.0), [0.0, 0.0], method="Radau", t_eval=t[after] - 30.0, rtol=1e-9, atol=1e-12
    )
    assert_allclose(found[after, :2], -limit.y.T, atol=3e-4)
    peak = np.max(np.linalg.norm(limit.y, axis=0))
    assert 0.09 < peak < 0.12
    assert np.max(np.linalg.norm(found[after], axis=1)) == pytest.approx(peak, rel=0.01)
    assert_allclose(found[-40:, :2], -limit.y.T[-40:], rtol=0.01)


def test_figure_3_after_a_corner_agrees_with_a_stiff_solver_that_turns_to_the_same_side() -> None:
    """u3 = 5 until the field is reached; at 5 rad/s that takes away the singularity, but for the side."""

    def rate(t: float, state: Array) -> list[float]:
        e, heading = state[:2], state[2]
        b1 = np.array([np.cos(heading), np.sin(heading)])
        b2 = np.array([-b1[1], b1[0]])
        Xr = np.array([-1.0, 1.0]) - e
        y4, y5, a5 = Xr @ b1, Xr @ b2, np.array([-1.0, 1.0]) @ b2
        u3 = 5.0 if y4 <= 0.0 else min(5.0, (10.0 * y5 + a5) / y4)
        return [*(y4 * b1 - (-1.0, 1.0)), u3]

    t, found = errors(FIGURES[3]._replace(end_s=36.0), STEP_S)
    after = t >= 30.0
    start = [*-found[after][0, :2], pi / 4.0]
    solution = solve_ivp(
        rate, (0.0, 6.0), start, method="Radau", t_eval=t[after] - 30.0, rtol=1e-8, atol=1e-10
    )
    assert disagreement(found[after, :2], -solution.y[:2].T) < 1.0
    assert np.max(np.abs(found[after])) == pytest.approx(0.25, abs=0.01)


@pytest.mark.parametrize("sample_s", [0.5, 0.07])
def test_steps_end_on_the_corners_whether_or_not_a_sample_does(sample_s: float) -> None:
    t, found = errors(SHORT[2], 0.01, sample_s)
    dense_t, dense = errors(SHORT[2], 0.01, 0.01)
    assert_allclose(t, np.arange(len(t)) * sample_s, atol=1e-12)
    assert t[-1] > 18.0 - sample_s
    assert disagreement(found, dense[np.searchsorted(dense_t, t - 1e-9)]) < 0.1


def test_up_to_a_corner_the_leg_that_ends_counts_and_at_it_the_one_that_begins() -> None:
    samples = simulate(SHORT[2], 0.1, 0.5)
    assert samples[12].t_s == 6.0
    assert samples[12].reference.velocity == (-1.0, 1.0, 0.0)
    # On the track the old leg leaves no error, in the last stage before the corner neither.
    assert all(abs(c) < 1e-12 for at in samples[:13] for c in error(SHORT[2], at))
    # The field is at a right angle: the branch turns to its side as fast as it does anywhere.
    assert abs(samples[12].controls.u4) < 1e-12
    assert samples[12].controls.u3 == pytest.approx(10.0 / Y4_RATIO_MIN)
    assert simulate(SHORT[3], 0.1, 0.5)[12].controls.u3 == 5.0


def test_figure_1_decays_with_rho2_and_rho3_the_gains_that_section_4_calls_rho1_and_rho2() -> None:
    problem = FIGURES[1]._replace(end_s=0.5, gains=FIGURES[1].gains._replace(rho2=4.0, rho3=8.0))
    y = [
        projections(
            problem.gains,
            QUADRATIC,
            np.array(at.pose.position),
            matrix_of(at.pose.attitude),
            (np.array(at.reference.position), np.array(at.reference.velocity), np.zeros(3)),
        )
        for at in simulate(problem, STEP_S, 0.5)
    ]
    assert y[1][1] / y[0][1] == pytest.approx(exp(-4.0), rel=1e-5)  # <Xr, X5> by rho3
    assert y[1][2] / y[0][2] == pytest.approx(exp(-2.0), rel=1e-5)  # <Xr, X6> by rho2
    assert (FIGURES[1].gains.rho2, FIGURES[1].gains.rho3) == (10.0, 10.0)
