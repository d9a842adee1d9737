"""The best source that comes steadily is used; a switch between sources shows in no state."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from guidance.estimate import (
    ATTITUDE_JUMP_RAD,
    BLEND_TIME_S,
    POSITION_JUMP_M,
    SILENT_NS,
    STEADY_NS,
    Estimate,
    Estimator,
    Reset,
    Switch,
)
from guidance.geodesy import azimuthal_equidistant
from guidance.mavlink.messages import (
    Attitude,
    AttitudeQuaternion,
    GlobalPositionInt,
    GpsGlobalOrigin,
    LocalPositionNed,
    Odometry,
)
from guidance.se3 import ZERO, Pose, Quaternion, Twist, Vec3, compose, exp, quaternion_exp, rotate, scale
from sitl.vehicle import projection
from sitl.vehicle.options import Origin
from tests.oracle import matrix_of
from tests.strategies import properties, vectors

NOW = 100_000_000_000
MS = 1_000_000
ORIGIN = GpsGlobalOrigin(473977418, 85455939, 488000)
PLACE = Origin(47.3977418, 8.5455939, 488.0)
START = Pose(Vec3(3.0, -2.0, 1.0), Quaternion(0.8, 0.0, 0.0, 0.6))
TWIST = Twist(Vec3(0.1, -0.2, 0.5), Vec3(4.0, 0.0, 0.0))
ALL = ("ODOMETRY", "ATTITUDE_QUATERNION", "ATTITUDE", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT")


class Motion:
    """A constant twist, and every message that tells of it; `off` is how far all but ODOMETRY are off."""

    def __init__(self, off_m: Vec3 = ZERO, off_rad: Vec3 = ZERO) -> None:
        self.estimator = Estimator(azimuthal_equidistant)
        self.off_m = off_m
        self.off = quaternion_exp(off_rad)
        self.counter = 7

    def pose(self, at_ms: float) -> Pose:
        return compose(START, exp(TWIST, at_ms * 1e-3))

    def say(self, name: str, at_ms: int) -> str | None:
        pose = self.pose(at_ms)
        x, q = pose.position, pose.attitude
        v = rotate(q, TWIST.linear)
        if name != "ODOMETRY":
            x = Vec3(x.x + self.off_m.x, x.y + self.off_m.y, x.z + self.off_m.z)
            q = Quaternion(*_product(self.off, q))
        message: Odometry | AttitudeQuaternion | Attitude | LocalPositionNed | GlobalPositionInt
        match name:
            case "ODOMETRY":
                message = Odometry(at_ms * 1000, *x, *q, *v, *TWIST.angular, 1, 1, self.counter, 8, 0)
            case "ATTITUDE_QUATERNION":
                message = AttitudeQuaternion(at_ms, *q, *TWIST.angular)
            case "ATTITUDE":
                yaw, pitch, roll = Rotation.from_matrix(matrix_of(q)).as_euler("ZYX")
                message = Attitude(at_ms, roll, pitch, yaw, *TWIST.angular)
            case "LOCAL_POSITION_NED":
                message = LocalPositionNed(at_ms, *x, *v)
            case _:
                latitude, longitude, altitude_m = projection.azimuthal_equidistant(PLACE, x)
                speeds = (round(part * 100.0) for part in v)
                message = GlobalPositionInt(at_ms, latitude, longitude, round(altitude_m * 1e3), *speeds)
        now_ns = NOW + at_ms * MS
        return self.estimator.take(message, now_ns, now_ns, ORIGIN)

    def hear(self, names: Iterable[str], since_ms: int, until_ms: int, every_ms: int = 20) -> None:
        for at_ms in range(since_ms, until_ms, every_ms):
            for name in names:
                self.say(name, at_ms)

    def at(self, at_ms: float) -> Estimate:
        estimate = self.estimator.at(NOW + round(at_ms * MS))
        assert estimate is not None
        return estimate

    @property
    def sources(self) -> tuple[str, str]:
        assert self.estimator.attitude is not None
        assert self.estimator.position is not None
        return self.estimator.attitude.source, self.estimator.position.source


def _product(a: Quaternion, b: Quaternion) -> tuple[float, ...]:
    x, y, z, w = (
        Rotation.from_quat([a.x, a.y, a.z, a.w]) * Rotation.from_quat([b.x, b.y, b.z, b.w])
    ).as_quat()
    return float(w), float(x), float(y), float(z)


def angle(a: Quaternion, b: Quaternion) -> float:
    return float(Rotation.from_matrix(matrix_of(a).T @ matrix_of(b)).magnitude())


@pytest.mark.parametrize("order", [ALL, tuple(reversed(ALL))], ids=["best first", "best last"])
def test_at_the_start_the_best_is_used_at_once_whatever_comes_first(order: tuple[str, ...]) -> None:
    motion = Motion()
    motion.hear(order, 1000, 1040)
    assert motion.sources == ("ODOMETRY", "ODOMETRY")
    assert motion.estimator.resets == 0


def test_each_falls_to_the_next_and_comes_back_only_after_it_is_steady() -> None:
    motion = Motion()
    motion.hear(ALL, 1000, 2000)
    quick = SILENT_NS // MS
    motion.hear(ALL[1:], 2000, 2000 + quick - 20)
    assert motion.sources == ("ODOMETRY", "ODOMETRY"), "silence has only begun"
    motion.hear(ALL[1:], 2000 + quick - 20, 2040 + quick)
    assert motion.sources == ("ATTITUDE_QUATERNION", "LOCAL_POSITION_NED")
    motion.hear(("ATTITUDE", "GLOBAL_POSITION_INT"), 2200, 2400)
    assert motion.sources == ("ATTITUDE", "GLOBAL_POSITION_INT")
    steady = STEADY_NS // MS
    motion.hear(ALL[1:], 2400, 2400 + steady)
    assert motion.sources == ("ATTITUDE", "GLOBAL_POSITION_INT"), "not steady yet"
    motion.hear(ALL[1:], 2400 + steady, 2440 + steady)
    assert motion.sources == ("ATTITUDE_QUATERNION", "LOCAL_POSITION_NED")
    motion.hear(ALL, 2440 + steady, 2480 + 2 * steady)
    assert motion.sources == ("ODOMETRY", "ODOMETRY")
    told = [(s.quantity, s.after) for s in motion.estimator.news if isinstance(s, Switch)]
    assert len(told) == len(motion.estimator.news) == 8
    assert told[-2:] == [("attitude", "ODOMETRY"), ("position", "ODOMETRY")]


def test_a_source_that_comes_and_goes_is_left_alone() -> None:
    """Bursts of 0.5 s with as long between them: one switch away from it, none back."""
    motion = Motion()
    motion.hear(ALL, 1000, 2000)
    motion.estimator.news.clear()
    for start in range(2000, 22_000, 1000):
        motion.hear(ALL[1:], start, start + 500)
        motion.hear(ALL, start + 500, start + 1000)
    assert [s.after for s in motion.estimator.news if isinstance(s, Switch)] == [
        "ATTITUDE_QUATERNION",
        "LOCAL_POSITION_NED",
    ]


@settings(parent=properties, max_examples=30)
@given(st.lists(st.sampled_from(ALL), min_size=2, max_size=5, unique=True), st.integers(0, 2**31))
def test_without_error_no_choice_shows(names: list[str], seed: int) -> None:
    """Whatever is lost (60 %, at random), the state is the motion, to the resolution of what is used."""
    dice = np.random.default_rng(seed)
    motion = Motion()
    for at_ms in range(1000, 4000, 20):
        for name in names:
            if dice.random() < 0.4:
                motion.say(name, at_ms)
        state = motion.estimator.at(NOW + at_ms * MS)
        if state is None or state.attitude_age_s > 0.3 or state.position_age_s > 0.3:
            continue
        # GLOBAL_POSITION_INT is off by 6 mm a horizontal axis and 5 mm/s, for 0.3 s.
        assert math.dist(state.pose.position, motion.pose(at_ms).position) < 0.02
        assert angle(state.pose.attitude, motion.pose(at_ms).attitude) < 1e-6
    assert motion.estimator.resets == 0


@settings(parent=properties, max_examples=30)
@given(vectors(0.25), vectors(0.04))
def test_a_switch_takes_over_without_a_step_and_the_difference_dies_away(off_m: Vec3, off_rad: Vec3) -> None:
    motion = Motion(off_m, off_rad)
    motion.hear(ALL, 1000, 2000)
    silence = SILENT_NS // MS
    motion.hear(ALL[1:], 2000, 2000 + silence - 20)
    last = 1980 + silence
    before = motion.at(last + 20)
    motion.hear(ALL[1:], last, last + 40)
    assert motion.sources == ("ATTITUDE_QUATERNION", "LOCAL_POSITION_NED")
    after = motion.at(last + 20)
    assert motion.estimator.resets == 0
    assert math.dist(after.pose.position, before.pose.position) < 2e-3
    assert angle(after.pose.attitude, before.pose.attitude) < 2e-3
    assert after.offset_m == pytest.approx(math.hypot(*off_m), abs=2e-3)
    # Each step from one sample to the next is that of the motion, to a part of the offset.
    now = last + 40
    for at_ms in range(now, now + 3000, 20):
        motion.hear(ALL[1:], at_ms, at_ms + 20)
        state = motion.at(at_ms)
        left = math.exp(-(at_ms - last - 20) * 1e-3 / BLEND_TIME_S)
        wanted = motion.pose(at_ms).position
        gone = scale(1.0 - left, off_m)
        assert math.dist(state.pose.position, (wanted[i] + gone[i] for i in range(3))) < 3e-3
    state = motion.at(now + 15_000)
    assert state.offset_m == 0.0


@pytest.mark.parametrize(
    ("off_m", "off_rad"),
    [(Vec3(0.0, 2.4 * POSITION_JUMP_M, 0.0), Vec3(0.0, 0.0, 0.0)),
     (Vec3(0.0, 0.0, 0.0), Vec3(0.0, 0.0, 20.0 * ATTITUDE_JUMP_RAD))],
    ids=["moved", "turned"],
)  # fmt: skip
def test_sources_that_disagree_by_more_are_a_reset_and_the_new_one_counts(off_m: Vec3, off_rad: Vec3) -> None:
    motion = Motion(off_m, off_rad)
    motion.hear(ALL, 1000, 2000)
    motion.hear(ALL[1:], 2000, 2200)
    (reset,) = [r for r in motion.estimator.news if isinstance(r, Reset)]
    assert reset.cause == "switch"
    assert math.dist(reset.moved_ned_m, off_m) < 0.02
    assert math.dist(reset.turned_ned_rad, off_rad) < 0.02
    wanted = motion.pose(2180)
    assert math.dist(motion.at(2180).pose.position, (wanted.position[i] + off_m[i] for i in range(3))) < 0.02


def test_after_a_long_silence_the_first_that_comes_is_used_and_is_no_reset() -> None:
    """Prediction across 3 s is off by metres; that is no jump of the estimator."""
    motion = Motion()
    motion.hear(("ODOMETRY",), 1000, 2000)
    motion.hear(("ATTITUDE_QUATERNION", "LOCAL_POSITION_NED"), 5000, 5100)
    assert motion.sources == ("ATTITUDE_QUATERNION", "LOCAL_POSITION_NED")
    assert motion.estimator.resets == 0
    assert math.dist(motion.at(5080).pose.position, motion.pose(5080).position) < 1e-3


@pytest.mark.parametrize(("off_m", "off_rad"), [(5.0, 0.0), (0.0, 0.5)], ids=["place", "turn"])
def test_a_large_difference_that_is_no_jump_is_taken_at_once_and_not_blended(
    off_m: float, off_rad: float
) -> None:
    """After 3 s it is our prediction that is wrong: a vehicle does not keep its twist for so long."""
    motion = Motion(Vec3(off_m, 0.0, 0.0), Vec3(0.0, 0.0, off_rad))
    motion.hear(("ODOMETRY",), 1000, 2000)
    motion.hear(("ATTITUDE_QUATERNION", "LOCAL_POSITION_NED"), 5000, 5040)
    assert motion.estimator.resets == 0
    state, wanted = motion.at(5020), motion.pose(5020)
    assert state.offset_m == 0.0
    assert state.pose.position.x == pytest.approx(wanted.position.x + off_m, abs=1e-3)
    assert angle(state.pose.attitude, wanted.attitude) == pytest.approx(off_rad, abs=1e-3)


def test_nobody_waits_for_a_better_source_that_cannot_be_used() -> None:
    """ATTITUDE_QUATERNION was heard beside ODOMETRY; now it comes with NaN."""
    motion = Motion()
    motion.hear(ALL, 1000, 2000)
    for at_ms in range(2000, 2200, 20):
        now_ns = NOW + at_ms * MS
        broken = AttitudeQuaternion(at_ms, math.nan, 0.0, 0.0, 0.0, *TWIST.angular)
        assert motion.estimator.take(broken, now_ns, now_ns) in ("not_needed", "not_finite")
        motion.say("ATTITUDE", at_ms)
    assert motion.estimator.attitude is not None
    assert motion.estimator.attitude.source == "ATTITUDE"
    taken = next(s for s in motion.estimator.news if isinstance(s, Switch) and s.after == "ATTITUDE")
    assert taken.instant_ns <= NOW + 2120 * MS


def test_a_late_or_repeated_sample_of_any_source_changes_nothing() -> None:
    motion = Motion()
    motion.hear(ALL, 1000, 2000)
    assert motion.say("ODOMETRY", 1980) == "repeated"
    assert motion.say("ODOMETRY", 1900) == "late"
    assert motion.say("LOCAL_POSITION_NED", 1900) == "not_needed"
    motion.hear(ALL[1:], 2000, 2200)
    assert motion.say("LOCAL_POSITION_NED", 2180) == "repeated"
    assert motion.say("ATTITUDE_QUATERNION", 2100) == "late"
    assert motion.estimator.resets == 0


def test_a_backlog_of_the_better_source_does_not_replace_what_is_young() -> None:
    motion = Motion()
    motion.hear(ALL, 1000, 2000)
    motion.hear(ALL[1:], 2000, 4000)
    motion.hear(("ODOMETRY",), 2000, 3800)  # 1.8 s of it, steady, and all of it old
    assert motion.sources == ("ATTITUDE_QUATERNION", "LOCAL_POSITION_NED")
