"""What follows from (11) and (14) wherever the law is regular, the limits, and the SE(2) reading."""

from __future__ import annotations

from math import cos, isclose, sin

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from guidance import se3
from guidance.law import Y4_RATIO_MIN, Gains, Limits, desired_field, evaluate, planar
from guidance.se3 import Pose, Quaternion, Reference, Vec3
from tests.oracle import matrix_of, pose_of, projection_rates, projections
from tests.strategies import (
    INF,
    SECTION_4_GAINS,
    UNBOUNDED,
    angles,
    facing,
    gains,
    limits,
    poses,
    properties,
    quaternions,
    references,
)


def scale_of(g: Gains, pose: Pose, r: Reference) -> float:
    """The size of the terms that cancel in the rates of the projections."""
    field = desired_field(g, pose.position, r)
    rho = 1.0 + g.rho2 + g.rho3
    return 1.0 + g.beta * (rho * se3.norm(field.Xr) + se3.norm(field.a)) * (1.0 + g.k / g.beta)


@properties
@given(gains(), poses(), references())
def test_controls_are_11_and_14(g: Gains, pose: Pose, r: Reference) -> None:
    result = evaluate(g, UNBOUNDED, pose, r)
    assume(not result.singular)
    R = matrix_of(pose.attitude)
    lam = 1.0 / g.beta
    x, r0, r1, r2 = (np.asarray(v) for v in (pose.position, *r))
    Xr = r1 - lam * g.k * (x - r0)
    a = r2 + lam * g.k * r1
    y4, y5, y6 = (g.beta * np.dot(Xr, R[:, i]) for i in range(3))
    u2 = -(g.rho2 * y6 + g.beta * np.dot(a, R[:, 2])) / y4
    u3 = (g.rho3 * y5 + g.beta * np.dot(a, R[:, 1])) / y4
    assert_allclose(result.demanded, (0.0, u2, u3, lam * y4), rtol=1e-8, atol=1e-8)
    assert_allclose((result.y4, result.y5, result.y6), (y4, y5, y6), atol=1e-9)
    assert result.controls == result.demanded
    assert not result.saturated


@properties
@given(gains(), poses(), references())
def test_misalignment_decays_by_itself_y5_at_rho3_and_y6_at_rho2(g: Gains, pose: Pose, r: Reference) -> None:
    result = evaluate(g, UNBOUNDED, pose, r)
    assume(not result.singular)
    rates = projection_rates(g, pose, r, result.controls)
    tolerance = 1e-6 * scale_of(g, pose, r)
    assert rates[1] == pytest.approx(-g.rho3 * result.y5, abs=tolerance)
    assert rates[2] == pytest.approx(-g.rho2 * result.y6, abs=tolerance)


@properties
@given(gains(), poses(), references(), st.floats(-3.0, 3.0))
def test_alignment_does_not_depend_on_the_speed_that_is_applied(
    g: Gains, pose: Pose, r: Reference, u4: float
) -> None:
    result = evaluate(g, Limits(u4, u4, INF, INF, INF), pose, r)
    assume(not result.singular)
    assert result.controls.u4 == u4
    rates = projection_rates(g, pose, r, result.controls)
    tolerance = 1e-6 * scale_of(g, pose, r)
    assert_allclose(rates[1:], (-g.rho3 * result.y5, -g.rho2 * result.y6), rtol=0.0, atol=tolerance)


@properties
@given(gains(), poses(), references())
def test_12_holds_for_v2(g: Gains, pose: Pose, r: Reference) -> None:
    result = evaluate(g, UNBOUNDED, pose, r)
    assume(not result.singular)
    y = projections(g, np.asarray(pose.position), matrix_of(pose.attitude), r)
    assert isclose(result.V2, 0.5 * y[1] ** 2 + 0.5 * y[2] ** 2, rel_tol=1e-9, abs_tol=1e-9)
    rates = projection_rates(g, pose, r, result.controls)
    V2_rate = y[1] * rates[1] + y[2] * rates[2]
    tolerance = 1e-6 * scale_of(g, pose, r) * (1.0 + abs(y[1]) + abs(y[2]))
    assert V2_rate == pytest.approx(-g.rho3 * y[1] ** 2 - g.rho2 * y[2] ** 2, abs=tolerance)


@properties
@given(gains(), poses(), references())
def test_error_obeys_its_exponential_disturbed_by_the_misalignment(
    g: Gains, pose: Pose, r: Reference
) -> None:
    result = evaluate(g, UNBOUNDED, pose, r)
    R = matrix_of(pose.attitude)
    e = np.asarray(pose.position) - np.asarray(r.position)
    e_dot = result.controls.u4 * R[:, 0] - np.asarray(r.velocity)
    expected = -g.k / g.beta * e - (result.y5 * R[:, 1] + result.y6 * R[:, 2]) / g.beta
    assert_allclose(result.e, e, atol=1e-12)
    assert_allclose(e_dot, expected, atol=1e-9 * scale_of(g, pose, r))


@properties
@given(gains(), poses(), references())
def test_v1_is_phi_and_decays_as_7_once_aligned(g: Gains, pose: Pose, r: Reference) -> None:
    Xr = np.asarray(desired_field(g, pose.position, r).Xr)
    assume(np.linalg.norm(Xr) > 1e-3)
    R = Rotation.align_vectors([Xr / np.linalg.norm(Xr)], [[1.0, 0.0, 0.0]])[0].as_matrix()
    result = evaluate(g, UNBOUNDED, pose_of(np.asarray(pose.position), R), r)
    e = np.asarray(pose.position) - np.asarray(r.position)
    assert isclose(result.V1, 0.5 * g.k * np.dot(e, e), rel_tol=1e-9)
    assert result.y4 > 0.0
    d1_phi = g.k * e
    V1_rate = np.dot(d1_phi, result.demanded.u4 * R[:, 0] - np.asarray(r.velocity))
    size = 1.0 + float(np.linalg.norm(d1_phi)) * scale_of(g, pose, r)
    assert V1_rate == pytest.approx(-np.dot(d1_phi, d1_phi) / g.beta, abs=1e-7 * size)


@properties
@given(gains(), poses(), references(), poses())
def test_controls_are_left_invariant(g: Gains, pose: Pose, r: Reference, motion: Pose) -> None:
    here = evaluate(g, UNBOUNDED, pose, r)
    R, p = matrix_of(motion.attitude), np.asarray(motion.position)
    there = evaluate(
        g,
        UNBOUNDED,
        pose_of(p + R @ np.asarray(pose.position), R @ matrix_of(pose.attitude)),
        Reference(
            Vec3(*map(float, p + R @ np.asarray(r.position))),
            Vec3(*map(float, R @ np.asarray(r.velocity))),
            Vec3(*map(float, R @ np.asarray(r.acceleration))),
        ),
    )
    assume(abs(abs(here.y4) - Y4_RATIO_MIN * se3.norm(Vec3(here.y4, here.y5, here.y6))) > 1e-6)
    assert there.singular == here.singular
    assert_allclose(there.demanded, here.demanded, rtol=1e-6, atol=1e-6)
    assert_allclose((there.V1, there.V2), (here.V1, here.V2), rtol=1e-6, atol=1e-6)


@properties
@given(gains(), poses(), references(), angles())
def test_roll_by_theta_turns_u2_u3_by_minus_theta_and_leaves_u4(
    g: Gains, pose: Pose, r: Reference, theta: float
) -> None:
    g = g._replace(rho3=g.rho2)
    Rx = Rotation.from_rotvec([theta, 0.0, 0.0]).as_matrix()
    rolled = evaluate(g, UNBOUNDED, pose_of(np.asarray(pose.position), matrix_of(pose.attitude) @ Rx), r)
    u = evaluate(g, UNBOUNDED, pose, r)
    assume(abs(abs(u.y4) - Y4_RATIO_MIN * se3.norm(Vec3(u.y4, u.y5, u.y6))) > 1e-6)
    u2, u3 = u.demanded.u2, u.demanded.u3
    expected = (
        0.0,
        cos(theta) * u2 + sin(theta) * u3,
        -sin(theta) * u2 + cos(theta) * u3,
        u.demanded.u4,
    )
    assert_allclose(rolled.demanded, expected, rtol=1e-6, atol=1e-6 * (1.0 + abs(u2) + abs(u3)))


@properties
@given(gains(), limits(), poses(), references())
def test_each_control_is_clamped_on_its_own(g: Gains, bounds: Limits, pose: Pose, r: Reference) -> None:
    result = evaluate(g, bounds, pose, r)
    u, demanded = result.controls, result.demanded
    assert demanded == evaluate(g, UNBOUNDED, pose, r).demanded
    rates = (bounds.pitch_rate_rad_s, bounds.yaw_rate_rad_s)
    assert (u.u2, u.u3) == tuple(np.clip((demanded.u2, demanded.u3), np.negative(rates), rates))
    assert u.u4 == np.clip(demanded.u4, bounds.speed_min_m_s, bounds.speed_max_m_s)
    assert u.u1 == 0.0
    assert result.saturated == (tuple(u) != tuple(demanded))


def test_saturation_of_each_axis_is_told() -> None:
    pose, r = facing(0.5, 0.7, speed=2.0)
    free = evaluate(SECTION_4_GAINS, UNBOUNDED, pose, r)
    assert not free.saturated
    assert min(abs(free.demanded.u2), abs(free.demanded.u3), free.demanded.u4) > 0.5
    for bounds in (
        UNBOUNDED._replace(speed_max_m_s=0.5),
        UNBOUNDED._replace(pitch_rate_rad_s=0.5),
        UNBOUNDED._replace(yaw_rate_rad_s=0.5),
    ):
        assert evaluate(SECTION_4_GAINS, bounds, pose, r).saturated
    reverse = facing(-0.5, 0.7, speed=2.0)
    assert evaluate(SECTION_4_GAINS, UNBOUNDED, *reverse).controls.u4 == pytest.approx(-1.0)
    stopped = evaluate(SECTION_4_GAINS, UNBOUNDED._replace(speed_min_m_s=0.0), *reverse)
    assert stopped.controls.u4 == 0.0
    assert stopped.saturated


@properties
@given(gains(), limits(), poses(), references())
def test_planar_leaves_yaw_rate_and_speed_alone(g: Gains, bounds: Limits, pose: Pose, r: Reference) -> None:
    flat_pose, flat_r = planar(pose, r)
    result = evaluate(g, bounds, flat_pose, flat_r)
    assert (result.demanded.u1, result.demanded.u2) == (0.0, 0.0)
    assert (result.controls.u1, result.controls.u2) == (0.0, 0.0)
    assert (result.e.z, result.y6) == (0.0, 0.0)
    assert_allclose(result.e[:2], np.subtract(pose.position, r.position)[:2], atol=1e-12)
    b1 = matrix_of(pose.attitude)[:, 0]
    assume(np.hypot(b1[0], b1[1]) > 1e-6)
    projected = np.array([b1[0], b1[1], 0.0]) / np.hypot(b1[0], b1[1])
    assert_allclose(matrix_of(flat_pose.attitude)[:, 0], projected, atol=1e-8)


@properties
@given(quaternions(), references())
def test_planar_of_a_level_motion_changes_nothing(q: Quaternion, r: Reference) -> None:
    level = Pose(Vec3(3.0, 4.0, 5.0), se3.from_yaw(se3.yaw_of(q)))
    flat = Reference(r.position._replace(z=5.0), r.velocity._replace(z=0.0), r.acceleration._replace(z=0.0))
    again, same = planar(level, flat)
    assert same == flat
    assert_allclose(matrix_of(again.attitude), matrix_of(level.attitude), atol=1e-12)
