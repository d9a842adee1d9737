"""Flights of the kinematic body (1) under the law: its exponentials, and figures 1 and 2 of section 4."""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from guidance import se3
from guidance.law import Evaluation, Gains, Limits, evaluate, planar
from guidance.se3 import IDENTITY, ZERO, Pose, Twist, Vec3
from guidance.trajectory import Helix, Lemniscate, Line, Trajectory, Zigzag, sample
from tests.oracle import Array, hat, matrix_of, pose_of, projections
from tests.strategies import SECTION_4_BOUNDS, SECTION_4_GAINS, UNBOUNDED, poses, properties


def closed_loop(g: Gains, curve: Trajectory, pose: Pose, end_s: float) -> tuple[Array, Array, Array]:
    """t, x and R of the unbounded closed loop by scipy's integrator, with R integrated as a matrix."""

    def rate(t: float, state: Array) -> Array:
        x, R = state[:3], state[3:].reshape(3, 3)
        result = evaluate(g, UNBOUNDED, pose_of(x, R), sample(curve, t))
        assert not result.singular, t
        return np.concatenate((result.controls.u4 * R[:, 0], (R @ hat(result.controls)).ravel()))

    start = np.concatenate((pose.position, matrix_of(pose.attitude).ravel()))
    times = np.linspace(0.0, end_s, 11)
    solution = solve_ivp(rate, (0.0, end_s), start, method="DOP853", t_eval=times, rtol=1e-9, atol=1e-10)
    assert solution.success
    return times, solution.y[:3].T, solution.y[3:].T.reshape(-1, 3, 3)


FIGURE_1_START = Pose(Vec3(-10.0, -30.0, -5.0), IDENTITY)


@pytest.mark.parametrize(
    ("g", "curve"),
    [
        (SECTION_4_GAINS, Helix()),
        (Gains(k=0.6, rho2=3.0, rho3=5.0, beta=2.0), Helix()),
        (Gains(k=0.3, rho2=6.0, rho3=2.0, beta=0.5), Lemniscate(speed_m_s=2.0)),
    ],
)
def test_along_a_flight_y5_and_y6_are_pure_exponentials(g: Gains, curve: Trajectory) -> None:
    times, x, R = closed_loop(g, curve, FIGURE_1_START, 2.0)
    y = np.array([projections(g, x[i], R[i], sample(curve, t)) for i, t in enumerate(times)])
    assert abs(y[0, 1]) > 1.0
    assert abs(y[0, 2]) > 1.0
    assert_allclose(y[:, 1], y[0, 1] * np.exp(-g.rho3 * times), atol=1e-5)
    assert_allclose(y[:, 2], y[0, 2] * np.exp(-g.rho2 * times), atol=1e-5)


def test_figure_1_converges_with_rate_lambda_k_once_aligned() -> None:
    times, x, _ = closed_loop(SECTION_4_GAINS, Helix(), FIGURE_1_START, 10.0)
    error = [float(np.linalg.norm(x[i] - sample(Helix(), t).position)) for i, t in enumerate(times)]
    assert error[0] == pytest.approx(32.95, abs=0.01)
    assert_allclose(np.diff(np.log(error[3:])), -1.0, atol=1e-4)
    assert error[-1] < 2.5e-3


def fly(
    curve: Trajectory, pose: Pose, bounds: Limits, end_s: float, steps_per_s: int, in_plane: bool = False
) -> list[tuple[float, float, Evaluation]]:
    """(t, |e|, evaluation) of a flight in which each control is held for one step."""
    flight = []
    for n in range(round(end_s * steps_per_s) + 1):
        t = n / steps_per_s
        r = sample(curve, t)
        result = evaluate(SECTION_4_GAINS, bounds, *(planar(pose, r) if in_plane else (pose, r)))
        flight.append((t, se3.norm(result.e), result))
        u = result.controls
        twist = Twist(Vec3(u.u1, u.u2, u.u3), Vec3(u.u4, 0.0, 0.0))
        pose = se3.compose(pose, se3.exp(twist, 1.0 / steps_per_s))
        pose = Pose(pose.position, se3.normalized(pose.attitude))
    return flight


@pytest.mark.parametrize("steps_per_s", [50, 1000])
def test_figure_1_bounded_to_5_is_within_a_decimetre_for_good_after_12_s(steps_per_s: int) -> None:
    flight = fly(Helix(), FIGURE_1_START, SECTION_4_BOUNDS, 20.0, steps_per_s)
    late = [error for t, error, _ in flight if t >= 12.0]
    assert len(late) > 8 * steps_per_s
    assert max(late) < 0.1
    assert late[-1] < 1e-4
    for _, _, result in flight:
        assert max(map(abs, result.controls)) <= 5.0


@properties
@given(poses(20.0))
def test_bounded_with_reverse_the_helix_is_found_from_any_pose(start: Pose) -> None:
    flight = fly(Helix(), start, SECTION_4_BOUNDS, 25.0, 50)
    assert max(error for t, error, _ in flight if t >= 22.0) < 0.05


FIGURE_2_START = Pose(Vec3(20.0, 100.0, 0.0), se3.from_yaw(pi))


def test_figure_2_agrees_with_a_stiff_solver_up_to_the_corner() -> None:
    def unicycle(t: float, state: Array) -> list[float]:
        # (11) and (14) on SE(2), by hand: heading psi, field (f, g), a = r'' + r'
        north, east, psi = state
        f, g = 1.0 - (north - t), 1.0 - (east - t)
        y4, y5 = f * cos(psi) + g * sin(psi), -f * sin(psi) + g * cos(psi)
        a5 = -sin(psi) + cos(psi)
        return [y4 * cos(psi), y4 * sin(psi), (10.0 * y5 + a5) / y4]

    times = [0.5, 1.0, 2.0, 4.0, 29.0]
    solution = solve_ivp(
        unicycle, (0.0, 29.0), [20.0, 100.0, pi], method="Radau", t_eval=times, rtol=1e-8, atol=1e-9
    )
    expected = [np.hypot(n - t, e - t) for t, n, e in zip(times, *solution.y[:2], strict=True)]
    flight = fly(Zigzag(), FIGURE_2_START, UNBOUNDED, 29.0, 1000, in_plane=True)
    found = [flight[round(1000 * t)][1] for t in times]
    assert expected[0] > 30.0
    assert_allclose(found, expected, rtol=0.02, atol=1e-3)


@pytest.mark.parametrize("bounds", [UNBOUNDED, SECTION_4_BOUNDS])
def test_at_the_corners_of_15_the_branch_turns_and_the_track_is_found_again(bounds: Limits) -> None:
    start = Pose(ZERO, se3.from_yaw(pi / 4.0))
    zigzag = Zigzag(leg_m=4.0)
    peaks = []
    for steps_per_s in (1000, 4000):
        flight = fly(zigzag, start, bounds, 12.0, steps_per_s, in_plane=True)
        for corner_s in (4.0, 8.0):
            at = round(corner_s * steps_per_s)
            assert flight[at][1] < 0.01
            assert flight[at][2].singular
            after = flight[at + 1 : at + round(3.9 * steps_per_s)]
            assert all(result.controls.u4 > 0.0 for _, _, result in after)
            assert not any(result.singular for _, _, result in after[steps_per_s // 50 :])
            assert after[-1][1] < 0.02
            peaks.append(max(error for _, error, _ in after))
    assert_allclose(peaks[:2], peaks[2:], rtol=0.02)
    assert min(peaks) > 0.05
    assert max(peaks) < 0.4


def test_with_the_field_behind_it_a_vehicle_backs_up_and_one_that_cannot_reverse_never_arrives() -> None:
    start = Pose(ZERO, IDENTITY)
    behind = Line(north_m=-10.0, east_m=3.0, heading_deg=180.0, speed_m_s=0.5)
    backing = fly(behind, start, SECTION_4_BOUNDS, 10.0, 50)
    assert all(result.controls.u4 < 0.0 for _, _, result in backing)
    assert backing[-1][1] < 0.01
    standing = fly(behind, start, SECTION_4_BOUNDS._replace(speed_min_m_s=0.0), 10.0, 50)
    assert all(result.controls.u4 == 0.0 for _, _, result in standing)
    assert standing[-1][1] > standing[0][1]
