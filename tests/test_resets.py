"""An estimator's jump is found by the first sample after it; motion, noise and gaps are none."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from guidance.estimate import ATTITUDE_JUMP_RAD, POSITION_JUMP_M, Estimator, Reset, together
from guidance.estimate.resets import (
    ACCELERATION_M_S2,
    ACCELERATION_RAD_S2,
    attitude_jumped,
    moved,
    position_jumped,
    turned,
)
from guidance.estimate.samples import AttitudeSample, PositionSample
from guidance.geodesy import azimuthal_equidistant
from guidance.mavlink.messages import AttitudeQuaternion, LocalPositionNed, Odometry, StateBody
from guidance.reporting import RESET_RUN_NS, News
from guidance.se3 import (
    IDENTITY,
    ZERO,
    Quaternion,
    Vec3,
    add,
    multiply,
    norm,
    quaternion_exp,
    quaternion_log,
    scale,
)
from tests.strategies import properties, quaternions, vectors

NOW = 100_000_000_000
MS = 1_000_000
LEVEL = Quaternion(1.0, 0.0, 0.0, 0.0)
NORTH_2 = Vec3(2.0, 0.0, 0.0)
gaps_ms = st.integers(1, 5000)


def at(boot_ms: int, x: Vec3, v: Vec3) -> PositionSample:
    return PositionSample(NOW + boot_ms * MS, boot_ms, x, v, "LOCAL_POSITION_NED")


def lies(boot_ms: int, q: Quaternion, w: Vec3) -> AttitudeSample:
    return AttitudeSample(NOW + boot_ms * MS, boot_ms, q, w, "ATTITUDE_QUATERNION")


@properties
@given(vectors(30.0), vectors(ACCELERATION_M_S2 / 2.0), vectors(0.25), gaps_ms)
def test_no_acceleration_and_no_noise_is_a_jump_of_position(
    v: Vec3, a: Vec3, noise: Vec3, dt_ms: int
) -> None:
    """Constant acceleration from sample to sample, and one that is gone again by the second sample."""
    dt_s = dt_ms * 1e-3
    x = add(add(scale(dt_s, v), scale(0.5 * dt_s * dt_s, a)), noise)
    before = at(0, ZERO, v)
    assert not position_jumped(before, at(dt_ms, x, add(v, scale(dt_s, a))))
    assert not position_jumped(before, at(dt_ms, x, v))


@properties
@given(vectors(10.0), vectors(ACCELERATION_RAD_S2 / 2.0), gaps_ms)
def test_no_angular_acceleration_is_a_jump_of_attitude(w: Vec3, a: Vec3, dt_ms: int) -> None:
    dt_s = dt_ms * 1e-3
    q = IDENTITY  # integrated in small steps: the axis moves
    for n in range(200):
        rates = add(w, scale((n + 0.5) / 200.0 * dt_s, a))
        q = multiply(q, quaternion_exp(scale(dt_s / 200.0, rates)))
    assert not attitude_jumped(lies(0, IDENTITY, w), lies(dt_ms, q, add(w, scale(dt_s, a))))


@properties
@given(vectors(20.0), vectors(1000.0), st.integers(1, 50))
def test_a_jump_of_position_is_found_with_its_size(v: Vec3, jump: Vec3, dt_ms: int) -> None:
    assume(norm(jump) > 1.2 * POSITION_JUMP_M)
    before, after = at(0, ZERO, v), at(dt_ms, add(scale(dt_ms * 1e-3, v), jump), v)
    assert position_jumped(before, after)
    assert math.dist(moved(before, after), jump) < 1e-9


@properties
@given(quaternions(), vectors(3.0), vectors(1.8), st.integers(1, 20))
def test_a_jump_of_attitude_is_found_with_its_size(q: Quaternion, w: Vec3, jump: Vec3, dt_ms: int) -> None:
    assume(1.2 * ATTITUDE_JUMP_RAD < norm(jump) < 3.1)
    there = multiply(quaternion_exp(jump), multiply(q, quaternion_exp(scale(dt_ms * 1e-3, w))))
    for sign in (1.0, -1.0):
        after = lies(dt_ms, Quaternion(*(sign * part for part in there)), w)
        assert attitude_jumped(lies(0, q, w), after)
        assert math.dist(turned(lies(0, q, w), after), jump) < 1e-6


@properties
@given(vectors(3.1))
def test_the_rotation_vector_is_the_inverse_of_the_exponential(v: Vec3) -> None:
    assume(norm(v) < 3.1)
    assert math.dist(quaternion_log(quaternion_exp(v)), v) < 1e-9


# Through the estimator ------------------------------------------------------------------------------------


def odometry(boot_ms: int, x: Vec3 = ZERO, q: Quaternion = LEVEL, counter: int = 0) -> Odometry:
    return Odometry(boot_ms * 1000, *x, *q, *NORTH_2, *ZERO, 1, 1, counter, 8, 0)


class Heard:
    """An estimator that drives north at 2 m/s, at 50 Hz."""

    def __init__(self) -> None:
        self.estimator = Estimator(azimuthal_equidistant)

    def take(self, *messages: StateBody) -> list[Reset]:
        for message in messages:
            now_ns = NOW + message.since_boot_ns
            self.estimator.take(message, now_ns, now_ns)
        found = [one for one in self.estimator.news if isinstance(one, Reset)]
        self.estimator.news.clear()
        return found

    def position_m(self, boot_ms: int) -> Vec3:
        estimate = self.estimator.at(NOW + boot_ms * MS)
        assert estimate is not None
        return estimate.pose.position


@pytest.mark.parametrize(("before", "after"), [(0, 1), (255, 0), (7, 3)])
def test_the_counter_tells_a_reset_however_small_and_the_estimate_follows_at_once(
    before: int, after: int
) -> None:
    heard = Heard()
    assert (
        heard.take(odometry(1000, counter=before), odometry(1020, Vec3(0.04, 0.0, 0.0), counter=before)) == []
    )
    (reset,) = heard.take(odometry(1040, Vec3(0.08, 0.1, 0.0), counter=after))
    assert (reset.cause, reset.source, reset.instant_ns) == ("counter", "ODOMETRY", NOW + 1040 * MS)
    assert math.dist(reset.moved_ned_m, (0.0, 0.1, 0.0)) < 1e-9
    assert math.dist(heard.position_m(1040), (0.08, 0.1, 0.0)) < 1e-9
    assert heard.take(odometry(1060, Vec3(0.12, 0.1, 0.0), counter=after)) == []
    assert heard.estimator.resets == 1


def test_without_a_counter_a_jump_tells() -> None:
    heard = Heard()
    assert heard.take(AttitudeQuaternion(1000, *LEVEL, *ZERO), LocalPositionNed(1000, *ZERO, *NORTH_2)) == []
    (reset,) = heard.take(LocalPositionNed(1020, 0.04, -5.0, 0.0, *NORTH_2))
    assert (reset.cause, reset.source) == ("jump", "LOCAL_POSITION_NED")
    assert math.dist(reset.moved_ned_m, (0.0, -5.0, 0.0)) < 1e-9
    yaw = math.radians(30.0)
    (reset,) = heard.take(AttitudeQuaternion(1020, math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2), *ZERO))
    assert (reset.cause, reset.source) == ("jump", "ATTITUDE_QUATERNION")
    assert math.dist(reset.turned_ned_rad, (0.0, 0.0, yaw)) < 1e-9
    assert heard.estimator.resets == 2


def test_late_and_repeated_samples_and_a_reboot_are_no_reset() -> None:
    heard = Heard()
    heard.take(odometry(5000), odometry(5020, Vec3(0.04, 0.0, 0.0)))
    assert heard.take(odometry(5020, Vec3(9.0, 0.0, 0.0), counter=1)) == []
    assert heard.take(odometry(4900, Vec3(9.0, 0.0, 0.0), counter=1)) == []
    heard.estimator.reset()
    assert heard.take(odometry(100, Vec3(50.0, 0.0, 0.0), counter=3)) == []


@pytest.mark.parametrize("silent_s", [0.5, 1.0, 3.0, 30.0])
def test_seconds_without_samples_are_no_reset_by_themselves(silent_s: float) -> None:
    """In the meantime it turned round and drove back."""
    heard = Heard()
    heard.take(odometry(1000), odometry(1020, Vec3(0.04, 0.0, 0.0)))
    back = odometry(1020 + round(silent_s * 1e3), Vec3(0.0, 1.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
    assert heard.take(back._replace(vx=-2.0)) == []


def test_a_run_of_resets_is_told_once_and_what_is_larger_again() -> None:
    """As an airplane that crashed was recorded: 44 m, then a step with every sample."""
    news = News()

    def told(now_ms: int, size_m: float, cause: str = "jump") -> bool:
        reset = Reset(NOW, "LOCAL_POSITION_NED", cause, Vec3(size_m, 0.0, 0.0), ZERO)
        return news.told(reset, NOW + now_ms * MS) is not None

    assert [told(20 * n, 44.0 * 0.5**n) for n in range(10)] == [True] + [False] * 9
    assert told(200, 50.0)
    assert not told(220, 1.0)
    assert told(240, 0.0, "counter")
    assert told(240 + RESET_RUN_NS // MS, 1.0)


@properties
@given(vectors(50.0), vectors(50.0), quaternions(), quaternions())
def test_two_resets_are_as_one_from_before_both_to_after_both(
    first_m: Vec3, second_m: Vec3, first: Quaternion, second: Quaternion
) -> None:
    one = Reset(1, "ATTITUDE", "jump", first_m, quaternion_log(first))
    other = Reset(2, "ODOMETRY", "counter", second_m, quaternion_log(second))
    both = together(one, other)
    assert both[:3] == other[:3]
    assert both.moved_ned_m == add(first_m, second_m)
    found, expected = quaternion_exp(both.turned_ned_rad), multiply(second, first)
    assert abs(sum(a * b for a, b in zip(found, expected, strict=True))) == pytest.approx(1.0)
