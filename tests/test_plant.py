"""The kinematic plant against an independent integrator and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from sitl.plant import (
    SERIES_BELOW_RAD,
    PlantCommand,
    PlantParameters,
    PlantState,
    attitude_from_euler,
    bounded,
    euler_from_attitude,
    rotation,
    step,
)

START = PlantState((-10.0, -30.0, -5.0), attitude_from_euler(0.3, -0.4, 2.0), (1.0, -2.0, 0.5), -1.0)
EASY = st.floats(-4.0, 4.0)


def matrix(state: PlantState) -> np.ndarray:
    return np.array(rotation(state.attitude_wxyz))


def difference(a: PlantState, b: PlantState) -> float:
    """Largest difference of position (m), rotation matrix, rates and speed."""
    return float(
        max(
            np.abs(np.subtract(a.position_ned_m, b.position_ned_m)).max(),
            np.abs(matrix(a) - matrix(b)).max(),
            np.abs(np.subtract(a.body_rates_frd_rad_s, b.body_rates_frd_rad_s)).max(),
            abs(a.speed_m_s - b.speed_m_s),
        )
    )


def integrated(
    parameters: PlantParameters, state: PlantState, command: PlantCommand, dt_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Position and R by solving (1) and the lags numerically, on rotation matrices."""
    rates, speed = bounded(parameters, command)

    def lagged(now: float, target: float, tau: float, t: float) -> float:
        return target if tau == 0.0 else target + (now - target) * math.exp(-t / tau)

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        r_body = y[3:].reshape(3, 3)
        p, q, r = (
            lagged(now, target, parameters.rate_lag_s, t)
            for now, target in zip(state.body_rates_frd_rad_s, rates, strict=True)
        )
        u4 = lagged(state.speed_m_s, speed, parameters.speed_lag_s, t)
        hat = np.array([[0.0, -r, q], [r, 0.0, -p], [-q, p, 0.0]])
        return np.concatenate([u4 * r_body[:, 0], (r_body @ hat).ravel()])

    y0 = np.concatenate([state.position_ned_m, matrix(state).ravel()])
    end = solve_ivp(slope, (0.0, dt_s), y0, rtol=1e-12, atol=1e-12, method="DOP853").y[:, -1]
    return end[:3], end[3:].reshape(3, 3)


@pytest.mark.parametrize(
    ("parameters", "tolerance"),
    [
        (PlantParameters(), 1e-10),
        (PlantParameters(planar=True), 1e-10),
        (PlantParameters(rate_lag_s=0.1, speed_lag_s=0.3), 1e-8),
        (PlantParameters(rate_lag_s=0.05), 1e-7),
        (PlantParameters(speed_lag_s=0.05), 1e-7),
    ],
)
def test_a_step_solves_equation_1(parameters: PlantParameters, tolerance: float) -> None:
    command = PlantCommand((-4.0, 3.0, 5.0), 4.0)
    position, r_body = integrated(parameters, START, command, 1.5)
    end = step(parameters, START, command, 1.5)
    assert np.abs(np.array(end.position_ned_m) - position).max() < tolerance
    assert np.abs(matrix(end) - r_body).max() < tolerance


@given(EASY, EASY, EASY, EASY, st.floats(1e-3, 2.0), st.integers(2, 50))
def test_one_long_run_equals_many_short_ones(
    p: float, q: float, r: float, u4: float, dt_s: float, pieces: int
) -> None:
    parameters, command = PlantParameters(), PlantCommand((p, q, r), u4)
    many = START
    for _ in range(pieces):
        many = step(parameters, many, command, dt_s / pieces)
    assert difference(step(parameters, START, command, dt_s), many) < 1e-12 * pieces


def test_one_long_run_equals_many_short_ones_with_lags() -> None:
    parameters = PlantParameters(rate_lag_s=0.1, speed_lag_s=0.2)
    command = PlantCommand((1.0, -2.0, 3.0), 4.0)
    many = START
    for _ in range(1000):
        many = step(parameters, many, command, 0.002)
    assert difference(step(parameters, START, command, 2.0), many) < 1e-8


def test_yawing_at_constant_speed_drives_the_circle_of_radius_speed_over_rate() -> None:
    command = PlantCommand((0.0, 0.0, 0.5), 2.0)
    quarter = step(PlantParameters(), PlantState(), command, math.pi)
    assert quarter.position_ned_m == pytest.approx((4.0, 4.0, 0.0), abs=1e-12)
    assert euler_from_attitude(quarter.attitude_wxyz)[2] == pytest.approx(math.pi / 2.0)


def test_pitching_up_climbs_which_is_negative_down() -> None:
    up = step(PlantParameters(), PlantState(), PlantCommand((0.0, 0.5, 0.0), 2.0), math.pi)
    assert up.position_ned_m == pytest.approx((4.0, 0.0, -4.0), abs=1e-12)


def test_rolling_right_drops_the_right_wing_and_does_not_turn_the_nose() -> None:
    rolled = step(PlantParameters(), PlantState(), PlantCommand((0.5, 0.0, 0.0), 1.0), 1.0)
    right = [row[1] for row in rotation(rolled.attitude_wxyz)]
    assert right == pytest.approx([0.0, math.cos(0.5), math.sin(0.5)])
    assert rolled.position_ned_m == pytest.approx((1.0, 0.0, 0.0))


@pytest.mark.parametrize("factor", [1e-9, 0.5, 1.0 - 1e-9, 1.0 + 1e-9, 2.0])
def test_the_series_meets_the_closed_form_where_they_change_over(factor: float) -> None:
    """The circle's chord, known in closed form on both sides of the switch."""
    angle = SERIES_BELOW_RAD * factor
    end = step(PlantParameters(), PlantState(), PlantCommand((0.0, 0.0, angle), 1.0), 1.0)
    half = 0.5 * angle
    chord = math.sin(half) / half
    expected = (chord * math.cos(half), chord * math.sin(half), 0.0)
    assert end.position_ned_m == pytest.approx(expected, rel=1e-12, abs=1e-15)


@given(EASY, EASY, EASY)
def test_the_attitude_stays_a_unit_quaternion(p: float, q: float, r: float) -> None:
    state = START
    for _ in range(200):
        state = step(PlantParameters(), state, PlantCommand((p, q, r), 1.0), 0.02)
    assert math.sqrt(sum(part * part for part in state.attitude_wxyz)) == pytest.approx(1.0, abs=1e-15)


def test_every_input_saturates_at_its_bound() -> None:
    parameters = PlantParameters(max_rate_rad_s=2.0, max_speed_m_s=3.0)
    high = step(parameters, START, PlantCommand((9.0, 9.0, 9.0), 9.0), 0.1)
    low = step(parameters, START, PlantCommand((-9.0, -9.0, -9.0), -9.0), 0.1)
    assert (high.body_rates_frd_rad_s, high.speed_m_s) == ((2.0, 2.0, 2.0), 3.0)
    assert (low.body_rates_frd_rad_s, low.speed_m_s) == ((-2.0, -2.0, -2.0), -3.0)


def test_a_planar_vehicle_only_yaws_and_stays_level() -> None:
    end = step(PlantParameters(planar=True), PlantState(), PlantCommand((1.0, 1.0, 1.0), 2.0), 3.0)
    roll, pitch, _ = euler_from_attitude(end.attitude_wxyz)
    assert (roll, pitch, end.position_ned_m[2]) == (0.0, 0.0, 0.0)
    assert end.body_rates_frd_rad_s == (0.0, 0.0, 1.0)


def test_a_lag_answers_63_percent_after_its_time_constant() -> None:
    parameters = PlantParameters(rate_lag_s=0.1, speed_lag_s=0.4)
    end = step(parameters, PlantState(), PlantCommand((0.0, 0.0, 1.0), 1.0), 0.1)
    assert end.body_rates_frd_rad_s[2] == pytest.approx(1.0 - math.exp(-1.0))
    assert end.speed_m_s == pytest.approx(1.0 - math.exp(-0.25))


def test_euler_angles_and_attitude_are_inverse() -> None:
    for angles in [(0.3, -0.4, 2.0), (-3.0, 1.2, -3.1), (0.0, 0.0, 0.0)]:
        assert euler_from_attitude(attitude_from_euler(*angles)) == pytest.approx(angles)


@pytest.mark.parametrize("dt_s", [-1e-9, math.nan, math.inf])
def test_time_must_be_finite_and_forward(dt_s: float) -> None:
    with pytest.raises(ValueError, match="dt_s"):
        step(PlantParameters(), START, PlantCommand(), dt_s)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_command_must_be_finite(bad: float) -> None:
    for command in (PlantCommand((bad, 0.0, 0.0), 0.0), PlantCommand((0.0, 0.0, 0.0), bad)):
        with pytest.raises(ValueError, match="command"):
            step(PlantParameters(), START, command, 0.1)
