"""Limits: what is asked for stays within them, keeps its direction, and changes no faster than it may."""

from __future__ import annotations

import random
from itertools import pairwise
from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from guidance.allocation import PITCH_YAW, ROLL_PITCH, ROLL_YAW
from guidance.error_function import PAPER as PAPER_PHI
from guidance.law import GLOBAL, PAPER, UNSTARTED, Gains, Parameters, guide_step
from guidance.limits import Controls, Limits, limited_rates, limited_speed, stoppable
from guidance.se3 import ZERO, Pose, Reference, Twist, Vec3
from guidance.trajectory import Helix, sample
from tests.kinematic_flight import FORWARD, GLOBAL_LAW, fly, random_pose
from tests.strategies import poses, properties, reals, references

rates = st.floats(0.01, 10.0)
REST = Controls(0.0, 0.0, 0.0, 0.0)


def bounds(p: float, q: float, r: float, keep: bool, acceleration: float = inf) -> Limits:
    return Limits(-1.0, 3.0, p, q, r, keep, acceleration, acceleration, 2.0 * acceleration, acceleration)


@properties
@given(rates, rates, rates, reals(100.0), reals(100.0), reals(100.0))
def test_saturated_rates_keep_their_direction_and_use_the_limit_that_binds(
    p: float, q: float, r: float, u1: float, u2: float, u3: float
) -> None:
    found = limited_rates(bounds(p, q, r, True), u1, u2, u3, REST, 0.02)
    part = min([1.0, *(limit / abs(u) for u, limit in ((u1, p), (u2, q), (u3, r)) if u != 0.0)])
    assert_allclose(found, (part * u1, part * u2, part * u3), rtol=1e-12, atol=1e-300)
    assert all(abs(u) <= limit for u, limit in zip(found, (p, q, r), strict=True))


@properties
@given(rates, rates, rates, reals(100.0), reals(100.0), reals(100.0))
def test_without_it_each_is_clamped_on_its_own(
    p: float, q: float, r: float, u1: float, u2: float, u3: float
) -> None:
    found = limited_rates(bounds(p, q, r, False), u1, u2, u3, REST, 0.02)
    assert found == (max(-p, min(p, u1)), max(-q, min(q, u2)), max(-r, min(r, u3)))


@pytest.mark.parametrize("keep", [True, False])
def test_a_rate_that_has_no_actuator_does_not_hold_up_the_others(keep: bool) -> None:
    assert limited_rates(bounds(0.0, 0.0, 2.0, keep), 1e-9, 3.0, 4.0, REST, 0.02) == (0.0, 0.0, 2.0)


@properties
@given(st.booleans(), rates, st.floats(0.1, 20.0), st.floats(0.0, 0.5), *(reals(20.0) for _ in range(6)))
def test_rates_change_no_faster_than_they_may_and_stay_within(
    keep: bool,
    limit: float,
    acceleration: float,
    dt: float,
    u1: float,
    u2: float,
    u3: float,
    from1: float,
    from2: float,
    from3: float,
) -> None:
    limits = bounds(limit, 2.0 * limit, limit, keep, acceleration)
    before = limited_rates(bounds(limit, 2.0 * limit, limit, False), from1, from2, from3, REST, 0.0)
    found = limited_rates(limits, u1, u2, u3, Controls(*before, 0.0), dt)
    most = (acceleration * dt, 2.0 * acceleration * dt, acceleration * dt)
    changes = [b - a for a, b in zip(before, found, strict=True)]
    assert all(abs(c) <= m * (1.0 + 1e-9) + 1e-12 for c, m in zip(changes, most, strict=True))
    assert all(abs(u) <= m for u, m in zip(found, (limit, 2.0 * limit, limit), strict=True))
    wanted = limited_rates(limits, u1, u2, u3, Controls(*before, 0.0), 1e9)
    if keep:  # on the straight line to what is wanted, and as far along it as may be
        whole = [b - a for a, b in zip(before, wanted, strict=True)]
        part = min([1.0, *(m / abs(w) for w, m in zip(whole, most, strict=True) if w != 0.0)])
        assert_allclose(changes, [part * w for w in whole], atol=1e-9)


@properties
@given(st.booleans(), st.sampled_from([1.0, inf]), *(reals(3.0) for _ in range(6)))
def test_what_no_limit_bites_is_asked_for_to_the_bit(
    keep: bool, dt: float, u1: float, u2: float, u3: float, from1: float, from2: float, from3: float
) -> None:
    previous = Controls(from1, from2, from3, 0.0)
    assert limited_rates(bounds(3.0, 3.0, 3.0, keep, 6.0), u1, u2, u3, previous, dt) == (u1, u2, u3)


@properties
@given(
    st.floats(0.0, 2.0),
    st.floats(2.1, 9.0),
    st.floats(0.1, 10.0),
    reals(50.0),
    reals(50.0),
    st.floats(0.0, 1.0),
)
def test_the_speed_range_goes_before_its_rate_of_change(
    low: float, high: float, acceleration: float, u4: float, previous: float, dt: float
) -> None:
    limits = Limits(low, high, 1.0, 1.0, 1.0, True, acceleration)
    found = limited_speed(limits, u4, previous, dt)
    assert low <= found <= high
    if low <= previous <= high:
        assert abs(found - previous) <= acceleration * dt * (1.0 + 1e-9) + 1e-12
    free = limited_speed(limits._replace(acceleration_m_s2=inf), u4, previous, 0.0)
    assert free == max(low, min(high, u4))


def test_a_turn_that_slews_is_started_no_faster_than_it_can_be_stopped() -> None:
    assert stoppable(3.0, 0.1, inf) == 3.0
    assert stoppable(0.1, 0.1, 2.0) == 0.1
    angle, dt, rate = 2.0, 1e-3, 0.0
    while angle > 1e-3:
        wanted = stoppable(5.0, angle, 2.0)
        rate += max(-2.0 * dt, min(2.0 * dt, wanted - rate))
        angle -= rate * dt
    assert abs(rate) < 0.1
    assert angle > -1e-3


@properties
@given(
    st.sampled_from([PITCH_YAW, ROLL_PITCH, ROLL_YAW]),
    st.sampled_from([PAPER, GLOBAL]),
    poses(),
    references(),
)
def test_the_first_step_starts_from_the_measured_twist(
    allocation: int, law: int, pose: Pose, r: Reference
) -> None:
    limits = FORWARD._replace(
        acceleration_m_s2=1.0,
        roll_acceleration_rad_s2=1.0,
        pitch_acceleration_rad_s2=1.0,
        yaw_acceleration_rad_s2=1.0,
    )
    parameters = Parameters(law, allocation, Gains(1.0, 10.0, 10.0, 1.0), PAPER_PHI, limits)
    twist = Twist(Vec3(0.5, -1.0, 2.0), Vec3(3.0, 9.0, 9.0))
    memory, found = guide_step(parameters, UNSTARTED, pose, twist, r, 0.0)
    pitch, yaw = (0.0 if allocation == ROLL_YAW else -1.0), (0.0 if allocation == ROLL_PITCH else 2.0)
    assert found.controls == (0.5, pitch, yaw, 3.0), "as measured, and a failed actuator rests"
    assert memory.controls == found.controls
    again, found = guide_step(parameters, memory, pose, Twist(ZERO, ZERO), r, 0.1)
    changes = [abs(b - a) for a, b in zip(memory.controls, again.controls, strict=True)]
    assert max(changes) <= 0.1 + 1e-12


def test_along_a_flight_every_limit_holds() -> None:
    limits = FORWARD._replace(
        speed_min_m_s=0.3,
        speed_max_m_s=2.0,
        pitch_rate_rad_s=0.8,
        acceleration_m_s2=1.5,
        roll_acceleration_rad_s2=3.0,
        pitch_acceleration_rad_s2=4.0,
        yaw_acceleration_rad_s2=6.0,
    )
    start = random_pose(random.Random(3), sample(Helix(), 0.0).position, 5.0)
    flight = fly(GLOBAL_LAW._replace(limits=limits), Helix(speed_m_s=0.5), start, 10.0)
    steps = [m.evaluation for m in flight]
    assert sum(s.saturated for s in steps) > 50
    for before, after in pairwise(steps):
        u, v = before.controls, after.controls
        assert 0.3 <= v.u4 <= 2.0
        assert abs(v.u4 - u.u4) <= 1.5 * 0.02 + 1e-12
        assert abs(v.u2) <= 0.8
        assert abs(v.u2 - u.u2) <= 4.0 * 0.02 + 1e-12
        assert abs(v.u3 - u.u3) <= 6.0 * 0.02 + 1e-12
