"""One state at one instant: what is refused changes nothing; prediction is exact for a constant twist."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from guidance.estimate import FUTURE_NS, OLDER_MS, PREFERRED_NS, Estimate, Estimator
from guidance.mavlink.messages import Attitude, AttitudeQuaternion, LocalPositionNed
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
    estimator = Estimator()
    assert estimator.take_quaternion(quaternion(), NOW, NOW) is None
    assert estimator.take_position(position(x=(1.0, 2.0, 3.0)), NOW, NOW) is None
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
    estimator = Estimator()
    assert estimator.at(NOW) is None
    estimator.take_quaternion(quaternion(), NOW, NOW)
    assert estimator.at(NOW) is None
    estimator.reset()
    estimator.take_position(position(), NOW, NOW)
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
        (Attitude(980, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), "late"),
    ],
    ids=str,
)
def test_what_cannot_be_is_refused_by_name_and_changes_nothing(message: Any, why: str) -> None:
    estimator = ready()
    later = NOW + 20 * MS + (PREFERRED_NS if isinstance(message, Attitude) else 0)
    before = (estimator.attitude, estimator.position, estimator.at(later))
    take: Any = {
        AttitudeQuaternion: estimator.take_quaternion,
        Attitude: estimator.take_euler,
        LocalPositionNed: estimator.take_position,
    }[type(message)]
    assert take(message, later, later) == why
    assert (estimator.attitude, estimator.position, estimator.at(later)) == before


@pytest.mark.parametrize("kind", ["quaternion", "euler", "position"])
def test_a_sample_from_the_future_is_refused(kind: str) -> None:
    estimator = Estimator()
    take: Any = {
        "quaternion": lambda t: estimator.take_quaternion(quaternion(), t, NOW),
        "euler": lambda t: estimator.take_euler(Attitude(1000, *[0.0] * 6), t, NOW),
        "position": lambda t: estimator.take_position(position(), t, NOW),
    }[kind]
    assert take(NOW + FUTURE_NS + 1) == "from_the_future"
    assert (estimator.attitude, estimator.position) == (None, None)
    assert take(NOW + FUTURE_NS) is None


@properties
@given(quaternions(), vectors(10.0), vectors(), vectors(50.0))
def test_at_the_sample_instant_the_estimate_is_the_sample(q: Quaternion, w: Vec3, x: Vec3, v: Vec3) -> None:
    estimator = Estimator()
    assert estimator.take_quaternion(quaternion(q=q, rates=w), NOW, NOW) is None
    assert estimator.take_position(position(x=x, v=v), NOW, NOW) is None
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
        estimator = Estimator()
        scaled = tuple(factor * part for part in q)
        assert estimator.take_quaternion(quaternion(q=scaled, rates=w), NOW, NOW) is None
        assert estimator.take_position(position(v=(1.0, 2.0, 3.0)), NOW, NOW) is None
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
    estimator = Estimator()
    assert (
        estimator.take_quaternion(quaternion(q=pose.attitude, rates=twist.angular), NOW, NOW + 200 * MS)
        is None
    )
    instant = NOW + apart_ms * MS
    assert estimator.take_position(position(x=x, v=velocity), instant, NOW + 200 * MS) is None
    estimate = at(estimator, NOW + ahead_ms * MS)
    want_x, want_R = moved(pose, twist, ahead_ms * 1e-3)
    assert math.dist(estimate.pose.position, want_x) < 1e-9
    assert np.abs(matrix_of(estimate.pose.attitude) - want_R).max() < 1e-9
    assert math.dist(estimate.velocity_ned_m_s, want_R @ np.asarray(twist.linear)) < 1e-9
    assert estimate.attitude_age_s == pytest.approx(ahead_ms * 1e-3)
    assert estimate.position_age_s == pytest.approx((ahead_ms - apart_ms) * 1e-3)


def euler_of(R: Any) -> tuple[float, float, float]:
    yaw, pitch, roll = map(float, Rotation.from_matrix(R).as_euler("ZYX"))
    return roll, pitch, yaw


@settings(parent=properties, max_examples=10)  # each is a flight of 80 instants
@given(quaternions(), twists(2.0))
def test_attitude_stands_in_and_steps_back_without_a_jump(q: Quaternion, twist: Twist) -> None:
    """ATTITUDE_QUATERNION comes, stays away, comes again; the motion is one constant twist throughout."""
    start = Pose(Vec3(0.0, 0.0, 0.0), q)
    estimator = Estimator()
    sources = []
    for n in range(80):
        now = NOW + n * 20 * MS
        x, R = moved(start, twist, n * 0.02)
        assume(abs(R[2, 0]) < 0.999)  # roll and yaw are not defined straight up and down
        attitude = quaternion_of(R)
        if n < 20 or n >= 60:
            assert (
                estimator.take_quaternion(quaternion(1000 + 20 * n, attitude, twist.angular), now, now)
                is None
            )
        # ATTITUDE is always there, and a little newer, as PX4 sends it.
        _, R_euler = moved(start, twist, n * 0.02 + 0.004)
        message = Attitude(1004 + 20 * n, *euler_of(R_euler), *twist.angular)
        refused = estimator.take_euler(message, now + 4 * MS, now + 5 * MS)
        sources.append("ATTITUDE" if refused is None else refused)
        v = rotate(attitude, twist.linear)
        assert estimator.take_position(position(1000 + 20 * n, x, v), now, now) is None
        estimate = at(estimator, now + 10 * MS)
        want_x, want_R = moved(start, twist, n * 0.02 + 0.01)
        assert np.abs(matrix_of(estimate.pose.attitude) - want_R).max() < 1e-6
        assert math.dist(estimate.pose.position, want_x) < 1e-6
    assert sources[:20] == ["not_needed"] * 20
    assert "ATTITUDE" in sources[20:60]
    assert sources[50:60] == ["ATTITUDE"] * 10
    assert sources[60:] == ["not_needed"] * 20


def test_quaternions_come_back_though_attitude_of_the_same_instant_was_first() -> None:
    estimator = ready()
    later = NOW + PREFERRED_NS
    assert estimator.take_euler(Attitude(1500, *[0.0] * 6), later, later) is None
    assert estimator.take_quaternion(quaternion(1500), later, later) is None
    assert estimator.attitude is not None
    assert estimator.attitude.source == "ATTITUDE_QUATERNION"


def test_a_quaternion_from_a_backlog_does_not_replace_a_younger_attitude() -> None:
    estimator = ready()
    later = NOW + 2 * PREFERRED_NS
    assert estimator.take_euler(Attitude(2000, *[0.0] * 6), later, later) is None
    old = later - (OLDER_MS + 1) * MS
    assert estimator.take_quaternion(quaternion(2000 - OLDER_MS - 1), old, later) == "late"
    assert estimator.attitude is not None
    assert estimator.attitude.source == "ATTITUDE"


any_float = st.floats(width=32)


@properties
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["quaternion", "euler", "position"]),
            st.integers(0, 2**32 - 1),
            st.lists(any_float | reals(1.0), min_size=7, max_size=7),
            st.integers(-(10**12), 10**12),
        ),
        max_size=20,
    )
)
def test_whatever_comes_the_state_is_finite_and_its_attitude_unit(
    steps: list[tuple[str, int, Any, int]],
) -> None:
    estimator = Estimator()
    for kind, boot_ms, numbers, offset_ns in steps:
        if kind == "quaternion":
            estimator.take_quaternion(AttitudeQuaternion(boot_ms, *numbers), NOW + offset_ns, NOW)
        elif kind == "euler":
            estimator.take_euler(Attitude(boot_ms, *numbers[:6]), NOW + offset_ns, NOW)
        else:
            estimator.take_position(LocalPositionNed(boot_ms, *numbers[:6]), NOW + offset_ns, NOW)
        estimate = estimator.at(NOW)
        if estimate is not None:
            assert is_finite_pose(estimate.pose)
            assert math.hypot(*estimate.pose.attitude) == pytest.approx(1.0, abs=1e-9)
