"""Laws of SO(3) and SE(3), against matrices from scipy."""

from __future__ import annotations

from math import inf, isclose, nan, pi
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from guidance import se3
from guidance.se3 import IDENTITY, IDENTITY_POSE, SERIES_ANGLE_RAD, ZERO, Pose, Quaternion, Twist, Vec3
from tests.strategies import angles, poses, properties, quaternions, reals, twists, vectors

Matrix = np.ndarray[Any, np.dtype[np.float64]]


def rotation_matrix(q: Quaternion) -> Matrix:
    """R(q) by scipy, which takes the scalar last."""
    return np.asarray(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), dtype=np.float64)


def hat(w: Vec3) -> Matrix:
    """The matrix of the cross product, as in (2)."""
    return np.array([[0.0, -w.z, w.y], [w.z, 0.0, -w.x], [-w.y, w.x, 0.0]])


def motion_matrix(pose: Pose) -> Matrix:
    """The 4 x 4 matrix of a pose."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_matrix(pose.attitude)
    matrix[:3, 3] = pose.position
    return matrix


def twist_matrix(twist: Twist) -> Matrix:
    """(2)."""
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = hat(twist.angular)
    matrix[:3, 3] = twist.linear
    return matrix


def assert_same_pose(a: Pose, b: Pose, tolerance: float = 1e-9) -> None:
    """Same motion; q and -q are one attitude."""
    assert_allclose(motion_matrix(a), motion_matrix(b), rtol=0.0, atol=tolerance)


@properties
@given(vectors(), vectors(), reals(10.0))
def test_vector_functions_are_those_of_numpy(a: Vec3, b: Vec3, factor: float) -> None:
    assert_allclose(se3.add(a, b), np.add(a, b))
    assert_allclose(se3.subtract(a, b), np.subtract(a, b))
    assert_allclose(se3.scale(factor, a), factor * np.asarray(a))
    assert isclose(se3.dot(a, b), float(np.dot(a, b)), rel_tol=1e-12, abs_tol=1e-9)
    assert_allclose(se3.cross(a, b), hat(a) @ np.asarray(b), atol=1e-9)
    assert isclose(se3.norm(a), float(np.linalg.norm(a)), abs_tol=1e-12)


@properties
@given(quaternions(), vectors())
def test_rotate_maps_body_to_world_and_rotate_inverse_back(q: Quaternion, v: Vec3) -> None:
    R = rotation_matrix(q)
    assert_allclose(se3.rotate(q, v), R @ np.asarray(v), atol=1e-11)
    assert_allclose(se3.rotate_inverse(q, v), R.T @ np.asarray(v), atol=1e-11)
    assert_allclose(se3.rotate_inverse(q, se3.rotate(q, v)), v, atol=1e-11)


@properties
@given(quaternions())
def test_body_axes_are_the_columns_of_the_rotation_matrix(q: Quaternion) -> None:
    assert_allclose(np.column_stack(se3.body_axes(q)), rotation_matrix(q), atol=1e-14)


@properties
@given(quaternions(), quaternions(), quaternions())
def test_rotations_form_a_group(a: Quaternion, b: Quaternion, c: Quaternion) -> None:
    multiply = se3.multiply
    assert_allclose(rotation_matrix(multiply(a, b)), rotation_matrix(a) @ rotation_matrix(b), atol=1e-13)
    assert_allclose(multiply(multiply(a, b), c), multiply(a, multiply(b, c)), atol=1e-14)
    assert_allclose(multiply(a, IDENTITY), a, atol=0.0)
    assert_allclose(multiply(IDENTITY, a), a, atol=0.0)
    assert_allclose(multiply(a, se3.conjugate(a)), IDENTITY, atol=1e-14)


@properties
@given(poses(), poses(), poses())
def test_motions_form_a_group(a: Pose, b: Pose, c: Pose) -> None:
    compose = se3.compose
    assert_allclose(motion_matrix(compose(a, b)), motion_matrix(a) @ motion_matrix(b), atol=1e-11)
    assert_same_pose(compose(compose(a, b), c), compose(a, compose(b, c)))
    assert_same_pose(compose(a, IDENTITY_POSE), a)
    assert_same_pose(compose(IDENTITY_POSE, a), a)
    assert_same_pose(compose(a, se3.inverse(a)), IDENTITY_POSE)
    assert_same_pose(compose(se3.inverse(a), a), IDENTITY_POSE)


@properties
@given(vectors(20.0))
@example(ZERO)
@example(Vec3(1e-300, 0.0, -1e-310))
@example(Vec3(1e-9, 2e-9, -1e-9))
@example(Vec3(0.0, pi, 0.0))
@example(Vec3(0.0, 0.0, 2.0 * pi))
def test_quaternion_exp_is_that_of_scipy_and_its_logarithm_comes_back(rotation_vector: Vec3) -> None:
    q = se3.quaternion_exp(rotation_vector)
    assert_allclose(rotation_matrix(q), expm(hat(rotation_vector)), atol=1e-12)
    if se3.norm(rotation_vector) < 3.0:
        log = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_rotvec()
        assert_allclose(log, rotation_vector, rtol=1e-12, atol=1e-15)


@properties
@given(twists(), reals(2.0))
@example(Twist(ZERO, Vec3(1.0, -2.0, 3.0)), 0.02)
@example(Twist(Vec3(0.0, 0.0, 2.0 * pi), Vec3(1.0, 0.0, 0.5)), 1.0)
@example(Twist(Vec3(1e-200, 0.0, 0.0), Vec3(1.0, 1.0, 1.0)), 1.0)
def test_exp_is_the_matrix_exponential(twist: Twist, dt_s: float) -> None:
    assert_allclose(motion_matrix(se3.exp(twist, dt_s)), expm(dt_s * twist_matrix(twist)), atol=1e-11)


def series(first: float, theta: float, n: int) -> float:
    """first * (1 - theta^2/((n+1)(n+2)) * (1 - theta^2/((n+3)(n+4)) * (...))), like sine and cosine."""
    terms = [first]
    for m in range(n, n + 24, 2):
        terms.append(-terms[-1] * theta * theta / ((m + 1) * (m + 2)))
    return sum(reversed(terms))


@pytest.mark.parametrize("ratio", [1e-8, 1e-4, 1e-2, 0.5, 0.9, 1.0 - 1e-12, 1.0, 1.0 + 1e-12, 1.1, 2.0])
def test_exp_keeps_its_digits_where_the_series_takes_over(ratio: float) -> None:
    theta = ratio * SERIES_ANGLE_RAD
    # Rolling while moving sideways.
    position = se3.exp(Twist(Vec3(theta, 0.0, 0.0), Vec3(0.0, 1.0, 0.0)), 1.0).position
    assert position.x == 0.0
    assert isclose(position.y, series(1.0, theta, 1), rel_tol=1e-15)  # sin(theta)/theta
    assert isclose(position.z, series(theta / 2.0, theta, 2), rel_tol=1e-15)  # (1 - cos theta)/theta
    # With pitch as well, the way forward is (theta - sin theta)/theta^3 times 0.48 theta^2 alone.
    position = se3.exp(Twist(Vec3(0.6 * theta, 0.8 * theta, 0.0), Vec3(0.0, 1.0, 0.0)), 1.0).position
    assert isclose(position.x, 0.48 * theta * theta * series(1.0 / 6.0, theta, 3), rel_tol=3e-14)


def test_exp_of_the_smallest_rotations_is_their_half() -> None:
    # Their squares underflow to zero.
    assert se3.quaternion_exp(Vec3(2e-200, 0.0, -4e-200)) == (1.0, 1e-200, 0.0, -2e-200)
    step = se3.exp(Twist(Vec3(2e-200, 0.0, 0.0), Vec3(0.0, 1.0, 0.0)), 1.0)
    assert step == ((0.0, 1.0, 1e-200), (1.0, 1e-200, 0.0, 0.0))


@properties
@given(twists(), reals(1.0), reals(1.0))
def test_exp_over_two_steps_is_exp_over_their_sum(twist: Twist, first_s: float, second_s: float) -> None:
    two = se3.compose(se3.exp(twist, first_s), se3.exp(twist, second_s))
    assert_same_pose(two, se3.exp(twist, first_s + second_s), 1e-11)


@properties
@given(poses(), poses(), twists(), st.floats(0.0, 1.0))
def test_motion_under_a_body_twist_is_left_invariant(a: Pose, g: Pose, twist: Twist, dt_s: float) -> None:
    step = se3.exp(twist, dt_s)
    assert_same_pose(se3.compose(a, se3.compose(g, step)), se3.compose(se3.compose(a, g), step))


@properties
@given(poses(), twists(2.0))
def test_exp_solves_the_kinematics_1(pose: Pose, twist: Twist) -> None:
    h = 1e-4
    after = motion_matrix(se3.compose(pose, se3.exp(twist, h)))
    before = motion_matrix(se3.compose(pose, se3.exp(twist, -h)))
    assert_allclose((after - before) / (2.0 * h), motion_matrix(pose) @ twist_matrix(twist), atol=1e-6)


@properties
@given(angles(), angles(), angles())
def test_from_euler_is_yaw_then_pitch_then_roll(roll: float, pitch: float, yaw: float) -> None:
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    assert_allclose(rotation_matrix(se3.from_euler(roll, pitch, yaw)), expected, atol=1e-13)
    assert_allclose(se3.from_yaw(yaw), se3.from_euler(0.0, 0.0, yaw), atol=1e-15)


@properties
@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_angles_come_back_from_an_attitude(roll: float, pitch: float, yaw: float) -> None:
    q = se3.from_euler(roll, pitch, yaw)
    assert_allclose([se3.roll_of(q), se3.pitch_of(q), se3.yaw_of(q)], [roll, pitch, yaw], atol=1e-9)


@pytest.mark.parametrize("pitch", [pi / 2.0, -pi / 2.0])
@pytest.mark.parametrize("yaw", [-2.5, -0.3, 0.0, 1.0, 3.0])
def test_yaw_of_a_vertical_body_is_the_one_it_pitched_up_from(pitch: float, yaw: float) -> None:
    assert isclose(se3.yaw_of(se3.from_euler(0.0, pitch, yaw)), yaw, abs_tol=1e-7)
    assert isclose(se3.yaw_of(se3.from_euler(0.0, pitch * (1.0 - 1e-6), yaw)), yaw, abs_tol=1e-7)
    vertical = se3.from_euler(0.4, pitch, yaw)
    again = se3.from_euler(se3.roll_of(vertical), se3.pitch_of(vertical), se3.yaw_of(vertical))
    assert_allclose(rotation_matrix(again), rotation_matrix(vertical), atol=1e-7)


@properties
@given(quaternions(), st.floats(1e-6, 1e6))
def test_normalized_has_norm_one_and_the_same_direction(q: Quaternion, factor: float) -> None:
    scaled = Quaternion(factor * q.w, factor * q.x, factor * q.y, factor * q.z)
    assert_allclose(se3.normalized(scaled), q, atol=1e-14)


@pytest.mark.parametrize("bad", [nan, inf, -inf])
def test_each_non_finite_component_is_found(bad: float) -> None:
    assert se3.is_finite_pose(IDENTITY_POSE)
    for i in range(3):
        v = Vec3(*[bad if j == i else 1.0 for j in range(3)])
        assert not se3.is_finite(v)
        assert not se3.is_finite_pose(Pose(v, IDENTITY))
    for i in range(4):
        q = Quaternion(*[bad if j == i else 0.5 for j in range(4)])
        assert not se3.is_finite_quaternion(q)
        assert not se3.is_finite_pose(Pose(ZERO, q))
