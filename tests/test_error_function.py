"""Error functions: their derivatives, their bounds, and (10) for all of them."""

from __future__ import annotations

from math import hypot, isfinite, log

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.linalg import expm

from guidance import se3
from guidance.allocation import PITCH_YAW
from guidance.error_function import (
    PAPER,
    ErrorFunction,
    bounded,
    bounded_apart,
    derivatives,
    k_of_r,
    times,
)
from guidance.law import (
    GLOBAL,
    REST,
    UNSTARTED,
    Controls,
    Evaluation,
    Gains,
    Limits,
    Parameters,
    desired_field,
    guide_step,
)
from guidance.law import PAPER as PAPER_LAW
from guidance.se3 import ZERO, Pose, Reference, Vec3
from guidance.trajectory import Helix, Line, sample
from tests.kinematic_flight import FORWARD, GLOBAL_LAW, fly, settled_s
from tests.oracle import Array, hat, matrix_of, moved
from tests.strategies import INF, UNBOUNDED, gains, poses, properties, references, vectors

speeds = st.floats(0.1, 10.0)
#: Every kind, around its usual parameters.
error_functions = st.one_of(
    st.just(PAPER),
    st.builds(k_of_r, st.floats(-0.9, 3.0), st.floats(5.0, 100.0), vectors(50.0)),
    st.builds(bounded, speeds),
    st.builds(bounded_apart, speeds, speeds),
)
KINDS = [PAPER, k_of_r(1.5, 10.0, Vec3(5.0, 0.0, 0.0)), bounded(2.0), bounded_apart(2.0, 1.0)]


def phi_of(f: ErrorFunction, g: Gains, x: Array, r: Reference) -> float:
    e = Vec3(*map(float, x - np.asarray(r.position)))
    return derivatives(f, g.k, g.beta, e, r).phi


def d1_of(f: ErrorFunction, g: Gains, x: Array, r: Reference) -> Array:
    e = Vec3(*map(float, x - np.asarray(r.position)))
    return np.asarray(derivatives(f, g.k, g.beta, e, r).d1)


@properties
@given(error_functions, gains(), vectors(50.0), references())
def test_d1_hessian_and_d1_dot_are_derivatives_of_phi(
    f: ErrorFunction, g: Gains, x: Vec3, r: Reference
) -> None:
    e = se3.subtract(x, r.position)
    d = derivatives(f, g.k, g.beta, e, r)
    at, h = np.asarray(x), 1e-4
    size = 1e-6 * (1.0 + 4.0 * g.k * (1.0 + se3.norm(e)) * (1.0 + se3.norm(r.velocity)))
    for axis in np.eye(3):
        slope = (phi_of(f, g, at + h * axis, r) - phi_of(f, g, at - h * axis, r)) / (2.0 * h)
        assert slope == pytest.approx(float(np.dot(d.d1, axis)), abs=size * (1.0 + se3.norm(e)))
        column = (d1_of(f, g, at + h * axis, r) - d1_of(f, g, at - h * axis, r)) / (2.0 * h)
        assert_allclose(times(d.hessian, Vec3(*map(float, axis))), column, atol=size)
    rate = (d1_of(f, g, at, moved(r, h)) - d1_of(f, g, at, moved(r, -h))) / (2.0 * h)
    assert_allclose(d.d1_dot, rate, atol=10.0 * size)


@properties
@given(error_functions, gains(), vectors(50.0), references())
def test_phi_is_zero_on_the_reference_alone_and_quadratic_close_to_it(
    f: ErrorFunction, g: Gains, e: Vec3, r: Reference
) -> None:
    assume(se3.norm(e) > 1e-3)
    assert derivatives(f, g.k, g.beta, ZERO, r).phi == 0.0
    assert derivatives(f, g.k, g.beta, ZERO, r).d1 == ZERO
    far = derivatives(f, g.k, g.beta, e, r)
    assert far.phi > 0.0
    assert se3.dot(far.d1, e) > 0.0
    H = derivatives(f, g.k, g.beta, ZERO, r).hessian
    assert H.xx == pytest.approx(H.yy)
    assert H.xx == pytest.approx(H.zz)
    assert (H.xy, H.xz, H.yz) == (0.0, 0.0, 0.0)
    if f.kind == KINDS[1].kind:
        apart = se3.norm(se3.subtract(r.position, f.centre)) / f.width_m
        assert H.xx == pytest.approx(g.k * (1.0 + f.gain * np.exp(-(apart**2))))
    else:
        assert H.xx == pytest.approx(g.k)


@properties
@given(speeds, speeds, gains(), vectors(1e4), references())
def test_bounded_functions_never_ask_for_a_faster_approach(
    speed: float, down: float, g: Gains, e: Vec3, r: Reference
) -> None:
    whole = derivatives(bounded(speed), g.k, g.beta, e, r).d1
    assert se3.norm(whole) / g.beta <= speed * (1.0 + 1e-12)
    apart = derivatives(bounded_apart(speed, down), g.k, g.beta, e, r).d1
    assert hypot(apart.x, apart.y) / g.beta <= speed * (1.0 + 1e-12)
    assert abs(apart.z) / g.beta <= down * (1.0 + 1e-12)


def test_far_off_the_whole_approach_speed_is_used() -> None:
    far, r = Vec3(3e4, 4e4, -5e4), sample(Helix(), 0.0)
    assert se3.norm(derivatives(bounded(2.0), 1.5, 0.5, far, r).d1) / 0.5 == pytest.approx(2.0)
    d1 = derivatives(bounded_apart(2.0, 0.5), 1.5, 0.5, far, r).d1
    assert (hypot(d1.x, d1.y) / 0.5, d1.z / 0.5) == pytest.approx((2.0, -0.5))


@pytest.mark.parametrize("f", KINDS)
@pytest.mark.parametrize("size", [5e-324, 1e-160, 1e-9, 1e30, 1e70])
def test_errors_of_any_size_give_finite_numbers(f: ErrorFunction, size: float) -> None:
    e, v = Vec3(size, -size, size), Vec3(-size, 1.0, size)
    for law in (PAPER_LAW, GLOBAL):
        pose, r = Pose(e, se3.from_euler(1.0, 2.0, 3.0)), Reference(ZERO, v, Vec3(1e70, 0.0, -1e70))
        parameters = Parameters(law, PITCH_YAW, Gains(1.0, 10.0, 10.0, 1.0), f, UNBOUNDED)
        found = guide_step(parameters, UNSTARTED, pose, REST, r, 0.02)[1]
        assert all(map(isfinite, (*found.demanded, *found.controls, found.V1, found.V2)))
        assert max(abs(found.demanded.u2), abs(found.demanded.u3)) <= 200.0 * (1.0 + 1e-9)


# (10) ------------------------------------------------------------------------------------------------


def projections_after(f: ErrorFunction, g: Gains, pose: Pose, r: Reference, u: Controls, dt: float) -> Array:
    """(y4, y5, y6) a time dt later, moving by (1) under constant u."""
    twist = np.zeros((4, 4))
    twist[:3, :3] = hat(u)
    twist[0, 3] = u.u4
    start = np.eye(4)
    start[:3, :3] = matrix_of(pose.attitude)
    start[:3, 3] = pose.position
    end, later = start @ expm(dt * twist), moved(r, dt)
    Xr = np.asarray(later.velocity) - d1_of(f, g, end[:3, 3], later) / g.beta
    return np.asarray(g.beta * end[:3, :3].T @ Xr, dtype=np.float64)


def rates_of(f: ErrorFunction, g: Gains, pose: Pose, r: Reference, u: Controls) -> Array:
    """d/dt (y4, y5, y6), by differences of fourth order."""
    h = 1e-3 / (1.0 + abs(u.u2) + abs(u.u3))
    y = [projections_after(f, g, pose, r, u, n * h) for n in (-2, -1, 1, 2)]
    return np.asarray((y[0] - 8.0 * y[1] + 8.0 * y[2] - y[3]) / (12.0 * h), dtype=np.float64)


def paper_step(f: ErrorFunction, g: Gains, bounds: Limits, pose: Pose, r: Reference) -> Evaluation:
    parameters = Parameters(PAPER_LAW, PITCH_YAW, g, f, bounds)
    return guide_step(parameters, UNSTARTED, pose, REST, r, 0.02)[1]


@properties
@given(error_functions, gains(), poses(30.0), references(), st.floats(-3.0, 3.0))
def test_10_and_12_hold_for_any_error_function_with_the_speed_that_is_applied(
    f: ErrorFunction, g: Gains, pose: Pose, r: Reference, u4: float
) -> None:
    for bounds in (UNBOUNDED, Limits(u4, u4, INF, INF, INF)):
        found = paper_step(f, g, bounds, pose, r)
        assume(not found.singular)
        field = desired_field(g, pose.position, r, f)
        rho = 1.0 + g.rho2 + g.rho3
        size = 1.0 + g.beta * (rho * se3.norm(field.Xr) + se3.norm(field.a)) * (1.0 + 4.0 * g.k / g.beta)
        assume(size < 1e4)
        rates = rates_of(f, g, pose, r, found.controls)
        assert_allclose(rates[1:], (-g.rho3 * found.y5, -g.rho2 * found.y6), rtol=0.0, atol=1e-5 * size)


def test_without_the_hessian_term_10_would_not_hold_for_the_bounded_function() -> None:
    g, f = Gains(1.0, 10.0, 10.0, 1.0), bounded(2.0)
    pose, r = Pose(Vec3(-2.0, 4.0, 2.0), se3.from_euler(0.3, 0.1, -0.3)), sample(Helix(), 1.0)
    found = paper_step(f, g, UNBOUNDED, pose, r)
    assert not found.singular
    d = derivatives(f, g.k, g.beta, found.e, r)
    b1, b2, _ = se3.body_axes(pose.attitude)
    assert abs(found.controls.u4 * se3.dot(times(d.hessian, b1), b2)) > 0.1
    rates = rates_of(f, g, pose, r, found.controls)
    assert rates[1] == pytest.approx(-g.rho3 * found.y5, abs=1e-6)


# Flights ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("f", KINDS)
def test_flights_converge_with_every_error_function(f: ErrorFunction) -> None:
    start = Pose(Vec3(-10.0, -15.0, -5.0), se3.IDENTITY)
    flight = fly(GLOBAL_LAW._replace(error_function=f), Helix(), start, 25.0)
    assert settled_s(flight) < 20.0


def test_from_30_m_off_the_approach_is_flown_at_the_chosen_speed() -> None:
    behind = Line(north_m=30.0, speed_m_s=0.5)
    limits = FORWARD._replace(speed_max_m_s=100.0)
    start = Pose(ZERO, se3.IDENTITY)
    flight = fly(GLOBAL_LAW._replace(error_function=bounded(2.0), limits=limits), behind, start, 25.0)
    assert max(m.evaluation.controls.u4 for m in flight) < 2.5
    early = [m.error for m in flight if 1.0 <= m.t <= 5.0]
    assert (early[0] - early[-1]) / 4.0 == pytest.approx(2.0, abs=0.05)
    paper = fly(GLOBAL_LAW._replace(limits=limits), behind, start, 1.0)
    assert max(m.evaluation.controls.u4 for m in paper) > 40.0


def test_the_last_centimetres_go_at_lambda_k_whichever_is_chosen() -> None:
    for f in (PAPER, bounded(2.0), bounded_apart(2.0, 1.0)):
        start = Pose(Vec3(-0.5, 0.0, 0.0), se3.IDENTITY)
        flight = fly(GLOBAL_LAW._replace(error_function=f), Line(speed_m_s=0.5), start, 6.0)
        assert log(flight[200].error / flight[250].error) == pytest.approx(1.5, rel=0.02)
