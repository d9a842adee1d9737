"""One state at one instant: what is refused changes nothing; prediction is exact for a constant twist."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from guidance.estimate import FUTURE_NS, SILENT_NS, Estimate, Estimator
from guidance.geodesy import azimuthal_equidistant
from guidance.mavlink.messages import (
    Attitude,
    AttitudeQuaternion,
    GlobalPositionInt,
    GpsGlobalOrigin,
    LocalPositionNed,
    Odometry,
    StateBody,
)
from guidance.se3 import Pose, Quaternion, Twist, Vec3, is_finite_pose, rotate
from tests.oracle import matrix_of
from tests.strategies import poses, properties, quaternions, reals, twists, vectors

NOW = 100_000_000_000
MS = 1_000_000
NAN, INF = math.nan, math.inf
LEVEL = (1.0, 0.0, 0.0, 0.0)


def quaternion(
    boot_ms: int = 1000, q: tuple[float, ...] = LEVEL, rates: Any = (0.0, 0.0, 0.0)
) -> AttitudeQuaternion:
    return AttitudeQuaternion(boot_ms, *q, *rates)


def position(boot_ms: int = 1000, x: Any = (0.0, 0.0, 0.0), v: Any = (0.0, 0.0, 0.0)) -> LocalPositionNed:
    return LocalPositionNed(boot_ms, *x, *v)


def ready() -> Estimator:
    """An estimator with one attitude and one position, both of NOW."""
    estimator = Estimator(azimuthal_equidistant)
    assert estimator.take(quaternion(), NOW, NOW) is None
    assert estimator.take(position(x=(1.0, 2.0, 3.0)), NOW, NOW) is None
    return estimator


def at(estimator: Estimator, instant_ns: int) -> Estimate:
    estimate = estimator.at(instant_ns)
    assert estimate is not None
    return estimate


def angle_between(a: Quaternion, b: Quaternion) -> float:
    """Of the rotation from one to the other, rad; by scipy."""
    turn = Rotation.from_matrix(matrix_of(a).T @ matrix_of(b))
    return float(turn.magnitude())


def test_without_both_samples_there_is_no_state() -> None:
    estimator = Estimator(azimuthal_equidistant)
    assert estimator.at(NOW) is None
    estimator.take(quaternion(), NOW, NOW)
    assert estimator.at(NOW) is None
    estimator.reset()
    estimator.take(position(), NOW, NOW)
    assert estimator.at(NOW) is None
    full = ready()
    assert full.at(NOW) is not None
    full.reset()
    assert full.at(NOW) is None


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (quaternion(1020, (NAN, 0.0, 0.0, 0.0)), "not_finite"),
        (quaternion(1020, (1.0, 0.0, INF, 0.0)), "not_finite"),
        (quaternion(1020, (3e38, 3e38, 3e38, 3e38)), "not_a_unit_quaternion"),
        (quaternion(1020, (0.9, 0.0, 0.0, 0.0)), "not_a_unit_quaternion"),
        (quaternion(1020, (1.02, 0.0, 0.0, 0.0)), "not_a_unit_quaternion"),
        (quaternion(1020, (0.0, 0.0, 0.0, 0.0)), "not_a_unit_quaternion"),
        (quaternion(1020, rates=(0.0, NAN, 0.0)), "not_finite"),
        (quaternion(1020, rates=(-INF, 0.0, 0.0)), "not_finite"),
        (quaternion(1020, rates=(0.0, 0.0, 101.0)), "absurd"),
        (quaternion(1000), "repeated"),
        (quaternion(980), "late"),
        (position(1020, (NAN, 0.0, 0.0)), "not_finite"),
        (position(1020, (0.0, 0.0, INF)), "not_finite"),
        (position(1020, v=(0.0, NAN, 0.0)), "not_finite"),
        (position(1020, (0.0, -2e7, 0.0)), "absurd"),
        (position(1020, v=(0.0, 0.0, 2000.0)), "absurd"),
        (position(1000), "repeated"),
        (position(980), "late"),
        (Attitude(1020, NAN, 0.0, 0.0, 0.0, 0.0, 0.0), "not_finite"),
        (Attitude(1020, 0.0, 1e20, 0.0, 0.0, 0.0, 0.0), "absurd"),
        (Attitude(1020, 0.0, 0.0, 0.0, 0.0, INF, 0.0), "not_finite"),
        (Attitude(1020, 0.0, 0.0, 0.0, 0.0, 0.0, -200.0), "absurd"),
    ],
    ids=str,
)
def test_what_cannot_be_is_refused_by_name_and_changes_nothing(message: Any, why: str) -> None:
    estimator = ready()
    later = NOW + 20 * MS + (SILENT_NS if isinstance(message, Attitude) else 0)
    before = (estimator.attitude, estimator.position, estimator.at(later))
    assert estimator.take(message, later, later) == why
    assert (estimator.attitude, estimator.position, estimator.at(later)) == before


@pytest.mark.parametrize("kind", ["quaternion", "euler", "position"])
def test_a_sample_from_the_future_is_refused(kind: str) -> None:
    estimator = Estimator(azimuthal_equidistant)
    take: Any = {
        "quaternion": lambda t: estimator.take(quaternion(), t, NOW),
        "euler": lambda t: estimator.take(Attitude(1000, *[0.0] * 6), t, NOW),
        "position": lambda t: estimator.take(position(), t, NOW),
    }[kind]
    assert take(NOW + FUTURE_NS + 1) == "from_the_future"
    assert (estimator.attitude, estimator.position) == (None, None)
    assert take(NOW + FUTURE_NS) is None


@properties
@given(quaternions(), vectors(10.0), vectors(), vectors(50.0))
def test_at_the_sample_instant_the_estimate_is_the_sample(q: Quaternion, w: Vec3, x: Vec3, v: Vec3) -> None:
    estimator = Estimator(azimuthal_equidistant)
    assert estimator.take(quaternion(q=q, rates=w), NOW, NOW) is None
    assert estimator.take(position(x=x, v=v), NOW, NOW) is None
    estimate = at(estimator, NOW)
    assert math.dist(estimate.pose.position, x) < 1e-9
    assert math.dist(estimate.velocity_ned_m_s, v) < 1e-9
    assert angle_between(estimate.pose.attitude, q) < 1e-7
    assert estimate.twist.angular == w
    assert (estimate.attitude_age_s, estimate.position_age_s) == (0.0, 0.0)


@properties
@given(quaternions(), vectors(10.0), st.floats(0.991, 1.009), st.floats(-0.2, 0.2))
def test_q_and_minus_q_and_a_rounded_length_are_the_same_attitude(
    q: Quaternion, w: Vec3, length: float, ahead_s: float
) -> None:
    estimates = []
    for factor in (1.0, -1.0, length, -length):
        estimator = Estimator(azimuthal_equidistant)
        scaled = tuple(factor * part for part in q)
        assert estimator.take(quaternion(q=scaled, rates=w), NOW, NOW) is None
        assert estimator.take(position(v=(1.0, 2.0, 3.0)), NOW, NOW) is None
        estimates.append(at(estimator, NOW + round(ahead_s * 1e9)))
    for estimate in estimates[1:]:
        assert angle_between(estimate.pose.attitude, estimates[0].pose.attitude) < 1e-7
        assert math.dist(estimate.pose.position, estimates[0].pose.position) < 1e-9


def moved(pose: Pose, twist: Twist, dt_s: float) -> tuple[Any, Any]:
    """Position and rotation matrix after a time at constant body twist: the matrix exponential."""
    w, v = twist.angular, twist.linear
    generator = np.array(
        [[0.0, -w.z, w.y, v.x], [w.z, 0.0, -w.x, v.y], [-w.y, w.x, 0.0, v.z], [0.0, 0.0, 0.0, 0.0]]
    )
    start = np.eye(4)
    start[:3, :3] = matrix_of(pose.attitude)
    start[:3, 3] = pose.position
    end = start @ expm(dt_s * generator)
    return end[:3, 3], end[:3, :3]


def quaternion_of(matrix: Any) -> Quaternion:
    x, y, z, w = map(float, Rotation.from_matrix(matrix).as_quat())
    return Quaternion(w, x, y, z)


@properties
@given(poses(), twists(), st.integers(-100, 100), st.integers(0, 300))
def test_prediction_is_exact_for_a_constant_twist(
    pose: Pose, twist: Twist, apart_ms: int, ahead_ms: int
) -> None:
    """Attitude and position measured at different instants of the same motion."""
    x, R = moved(pose, twist, apart_ms * 1e-3)
    at_position = quaternion_of(R)
    velocity = rotate(at_position, twist.linear)
    estimator = Estimator(azimuthal_equidistant)
    assert estimator.take(quaternion(q=pose.attitude, rates=twist.angular), NOW, NOW + 200 * MS) is None
    instant = NOW + apart_ms * MS
    assert estimator.take(position(x=x, v=velocity), instant, NOW + 200 * MS) is None
    estimate = at(estimator, NOW + ahead_ms * MS)
    want_x, want_R = moved(pose, twist, ahead_ms * 1e-3)
    assert math.dist(estimate.pose.position, want_x) < 1e-9
    assert np.abs(matrix_of(estimate.pose.attitude) - want_R).max() < 1e-9
    assert math.dist(estimate.velocity_ned_m_s, want_R @ np.asarray(twist.linear)) < 1e-9
    assert estimate.attitude_age_s == pytest.approx(ahead_ms * 1e-3)
    assert estimate.position_age_s == pytest.approx((ahead_ms - apart_ms) * 1e-3)


any_float = st.floats(width=32) | reals(1.0)
any_int = st.integers(-(2**31), 2**31 - 1) | st.just(0)
boot_times = st.integers(0, 2**32 - 1)


def bodies() -> st.SearchStrategy[StateBody]:
    """Any of the messages, with any values; quaternions of about unit length now and then."""
    near_one = st.sampled_from([(1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -1.0, 0.0), (0.7, 0.7, 0.1, 0.0)])
    q = near_one | st.tuples(any_float, any_float, any_float, any_float)
    six = st.tuples(*[any_float] * 6)
    return st.one_of(
        st.builds(lambda t, q, v: AttitudeQuaternion(t, *q, *v[:3]), boot_times, q, six),
        st.builds(lambda t, v: Attitude(t, *v), boot_times, six),
        st.builds(lambda t, v: LocalPositionNed(t, *v), boot_times, six),
        st.builds(lambda t, v: GlobalPositionInt(t, *v), boot_times, st.tuples(*[any_int] * 6)),
        st.builds(
            lambda t, x, q, v, frames, last: Odometry(t, *x[:3], *q, *v, *frames, *last),
            st.integers(0, 2**32 * 1000),
            six,
            q,
            six,
            st.sampled_from([(1, 1), (1, 12), (20, 12), (1, 8)]),
            st.tuples(st.integers(0, 255), st.sampled_from([8, 0, 2]), st.integers(-1, 100)),
        ),
    )


@properties
@given(st.lists(st.tuples(bodies(), st.integers(-(10**12), 10**12)), max_size=20))
def test_whatever_comes_the_state_is_finite_and_its_attitude_unit(steps: list[tuple[StateBody, int]]) -> None:
    estimator = Estimator(azimuthal_equidistant)
    origin = GpsGlobalOrigin(473977418, 85455939, 488000)
    for message, offset_ns in steps:
        before = (estimator.attitude, estimator.position, estimator.resets)
        refused = estimator.take(message, NOW + offset_ns, NOW, origin)
        if refused is not None:
            assert (estimator.attitude, estimator.position, estimator.resets) == before
        estimate = estimator.at(NOW)
        if estimate is not None:
            assert is_finite_pose(estimate.pose)
            assert math.hypot(*estimate.pose.attitude) == pytest.approx(1.0, abs=1e-9)
