"""The offset after a jump: continuous, bounded, feasible, gone in the end; a turn, let in within a second."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from guidance.blending import (
    LEAST_TIME_S,
    NO_OFFSET,
    NO_TURN,
    TURN_TIME_S,
    Blending,
    Turn,
    blended,
    blending,
    offset_step,
    shifted,
    spare_speed_m_s,
    turn_step,
)
from guidance.se3 import ZERO, Reference, Vec3, add, cross, dot, norm, scale, subtract
from tests.strategies import properties, vectors

#: |d''| <= PEAK V/tau
PEAK = 2.0 / math.e
times_s = st.floats(LEAST_TIME_S, 3.0)
speeds_m_s = st.floats(0.05, 3.0)
steps_s = st.one_of(st.floats(0.0, 0.1), st.floats(0.0, 20.0))
#: Jump, what the reference leaves then (as a part of the most), and the time until the next.
histories = st.lists(st.tuples(vectors(60.0), st.floats(0.0, 1.0), steps_s), min_size=1, max_size=40)


def lasting(time_s: float) -> Blending:
    """With this tau; what a vehicle can do is not asked for."""
    return Blending(0.0, 9.0, 9.0, math.inf, math.inf, time_s)


def after(
    limits: Blending, offset: Reference, speed_m_s: float, seconds: float, dt: float = 0.02
) -> list[Reference]:
    """The offset at each step."""
    found = [offset]
    for _ in range(round(seconds / dt)):
        found.append(offset_step(limits, found[-1], speed_m_s, dt))
    return found


@properties
@given(times_s, speeds_m_s, histories)
def test_whatever_jumps_and_whenever_speed_acceleration_and_jerk_are_bounded(
    time_s: float, speed_m_s: float, history: list[tuple[Vec3, float, float]]
) -> None:
    limits, offset = lasting(time_s), NO_OFFSET
    for jump, part, dt in history:
        before = shifted(offset, jump)
        assert before.position == add(offset.position, jump)
        assert (before.velocity, before.acceleration) == (offset.velocity, offset.acceleration)
        offset = offset_step(limits, before, part * speed_m_s, dt)
        t = min(dt, time_s)
        rounding = 1e-9 * (1.0 + speed_m_s / time_s**2) + 3e-6  # and what is dropped at the end
        assert norm(offset.velocity) <= speed_m_s + rounding
        assert norm(offset.acceleration) <= PEAK * speed_m_s / time_s + rounding
        jerk = 4.0 * speed_m_s / time_s**2
        assert norm(subtract(offset.acceleration, before.acceleration)) <= jerk * t + rounding
        assert norm(subtract(offset.position, before.position)) <= speed_m_s * t + rounding


@properties
@given(times_s, speeds_m_s, histories)
def test_velocity_and_acceleration_are_the_derivatives(
    time_s: float, speed_m_s: float, history: list[tuple[Vec3, float, float]]
) -> None:
    """Exactly, by Simpson's rule over a short step: w is constant in it, the rest is smooth."""
    limits, offset = lasting(time_s), NO_OFFSET
    for jump, part, dt in history:
        a = shifted(offset, jump)
        h = 0.01 * time_s
        w = part * speed_m_s
        assume(norm(a.position) > 1e-3)
        middle, b = offset_step(limits, a, w, 0.5 * h), offset_step(limits, a, w, h)
        for rises, slope in ((0, 1), (1, 2)):
            mean = scale(1.0 / 6.0, add(add(a[slope], scale(4.0, middle[slope])), b[slope]))
            assert math.dist(subtract(b[rises], a[rises]), scale(h, mean)) < 1e-7 * (1.0 + speed_m_s)
        offset = offset_step(limits, a, w, dt)


@properties
@given(times_s, speeds_m_s, vectors(60.0))
def test_a_jump_is_worked_off_straight_without_overshoot_and_then_nothing_is_left(
    time_s: float, speed_m_s: float, jump: Vec3
) -> None:
    assume(norm(jump) > 1e-3)
    # At full speed, then as exp(-t/(3 tau)) t, from kappa |d| = V: below 1e-6 m after 25 of these.
    seconds = 2.0 * norm(jump) / speed_m_s + 75.0 * time_s
    found = after(lasting(time_s), shifted(NO_OFFSET, jump), speed_m_s, seconds, 0.1 * time_s)
    along = scale(1.0 / norm(jump), jump)
    sizes = [dot(offset.position, along) for offset in found]
    assert all(b <= a + 1e-9 for a, b in pairwise(sizes))
    assert min(sizes) > -1e-5
    assert all(norm(cross(offset.position, along)) < 1e-9 for offset in found)
    assert found[-1] is NO_OFFSET


def test_it_takes_as_long_as_its_speed_says() -> None:
    found = after(lasting(0.4), shifted(NO_OFFSET, Vec3(3.0, -4.0, 0.0)), 1.0, 20.0)
    seconds = next(n for n, offset in enumerate(found) if norm(offset.position) < 0.05) * 0.02
    assert 5.0 < seconds < 12.0


@properties
@given(times_s, speeds_m_s, vectors(60.0), st.floats(0.0, 5.0))
def test_jumps_add_up_and_one_that_is_taken_back_leaves_what_was_worked_off(
    time_s: float, speed_m_s: float, jump: Vec3, seconds: float
) -> None:
    assert shifted(shifted(NO_OFFSET, jump), jump).position == scale(2.0, jump)
    away = after(lasting(time_s), shifted(NO_OFFSET, jump), speed_m_s, seconds)[-1]
    back = shifted(away, scale(-1.0, jump))
    assert norm(back.position) <= speed_m_s * seconds + 1e-6
    rest = after(lasting(time_s), back, speed_m_s, 2.0 * seconds + 90.0 * time_s, 0.1 * time_s)
    assert rest[-1] is NO_OFFSET


def test_where_the_reference_leaves_nothing_the_offset_stays() -> None:
    moving = after(lasting(0.4), shifted(NO_OFFSET, Vec3(5.0, 0.0, 0.0)), 1.0, 2.0)[-1]
    stays = after(lasting(0.4), moving, 0.0, 20.0)
    assert norm(stays[-1].velocity) < 1e-9
    assert stays[-1].position.x == pytest.approx(stays[500].position.x, abs=1e-9)
    assert stays[-1].position.x > 1.0


def test_after_a_gap_the_offset_has_waited() -> None:
    offset = after(lasting(0.4), shifted(NO_OFFSET, Vec3(5.0, 0.0, 0.0)), 1.0, 2.0)[-1]
    assert offset_step(lasting(0.4), offset, 1.0, 100.0) == offset_step(lasting(0.4), offset, 1.0, 0.4)


def test_an_offset_that_passes_through_zero_goes_on() -> None:
    """As when a jump is taken back: it moves still, and is not dropped for being nowhere."""
    moving = after(lasting(0.4), shifted(NO_OFFSET, Vec3(5.0, 0.0, 0.0)), 1.0, 2.0)[-1]
    at_zero = moving._replace(position=ZERO)
    assert offset_step(lasting(0.4), at_zero, 1.0, 0.02).velocity.x < -0.5


def test_no_offset_changes_no_bit() -> None:
    reference = Reference(Vec3(0.1, 0.2, 0.3), Vec3(1.0, 2.0, 3.0), Vec3(4.0, 5.0, 6.0))
    assert offset_step(lasting(0.4), NO_OFFSET, 1.0, 0.02) is NO_OFFSET
    assert blended(reference, NO_OFFSET) == reference


# What the vehicle can do ----------------------------------------------------------------------------------


@properties
@given(
    vectors(4.0),
    vectors(3.0),
    vectors(1.0),
    vectors(1.0),
    st.floats(0.0, 1.0),
    st.floats(0.5, 8.0),
    st.floats(0.5, 5.0),
    st.floats(0.2, 5.0),
)
def test_a_feasible_reference_stays_feasible_with_the_largest_offset(
    velocity: Vec3,
    acceleration: Vec3,
    toward: Vec3,
    changing: Vec3,
    slowest: float,
    fastest: float,
    turn_rate: float,
    gain: float,
) -> None:
    """Speed, turns and acceleration along the path; d' and d'' of their largest size, in any direction."""
    speed = norm(velocity)
    assume(min(norm(toward), norm(changing)) > 1e-3)
    assume(slowest <= speed <= fastest and speed > 0.05)
    assume(norm(acceleration) <= turn_rate * speed)
    assume(abs(dot(velocity, acceleration)) / speed <= gain)
    limits = blending(slowest, fastest, turn_rate, gain)
    r = Reference(ZERO, velocity, acceleration)
    V = spare_speed_m_s(limits, r)
    assert V >= 0.0
    offset = Reference(
        ZERO,
        scale(V / norm(toward), toward),
        scale(PEAK * V / limits.time_s / norm(changing), changing),
    )
    _, v, a = blended(r, offset)
    rounding = 1e-9
    assert slowest - rounding <= norm(v) <= fastest + rounding
    assert norm(cross(v, a)) / dot(v, v) <= turn_rate + rounding
    assert abs(dot(v, a)) / norm(v) <= gain + rounding


def test_an_offset_towards_the_inside_of_a_curve_gains_no_more_speed_than_is_allowed() -> None:
    """There r'' is no longer across the path."""
    limits = blending(0.0, 9.0, 5.0, 0.5)
    r = Reference(ZERO, Vec3(2.0, 0.0, 0.0), Vec3(0.0, 8.0, 0.0))
    V = spare_speed_m_s(limits, r)
    peak = Vec3(PEAK * V / limits.time_s, 0.0, 0.0)
    _, v, a = blended(r, Reference(ZERO, Vec3(0.0, V, 0.0), peak))
    assert 0.2 < dot(v, a) / norm(v) <= 0.5


def test_what_is_left_is_used() -> None:
    straight = Reference(ZERO, Vec3(2.0, 0.0, 0.0), ZERO)
    assert spare_speed_m_s(blending(0.0, 9.0, 5.0), straight) == 1.0, "half of its speed"
    assert spare_speed_m_s(blending(0.0, 2.5, 5.0), straight) == 0.25, "half of what is left to the fastest"
    assert spare_speed_m_s(blending(1.8, 9.0, 5.0), straight) == pytest.approx(0.1), "and to the slowest"
    assert spare_speed_m_s(blending(-9.0, 9.0, 5.0), straight) == 1.0, "nobody is sent in reverse"
    assert spare_speed_m_s(blending(0.0, 9.0, 5.0, approach_m_s=0.3), straight) == 0.3
    turning = straight._replace(acceleration=Vec3(0.0, 4.0, 0.0))
    assert spare_speed_m_s(blending(0.0, 9.0, 4.0), turning) == 0.5, "half of what turns leave"
    assert spare_speed_m_s(blending(0.0, 9.0, 2.0), turning) == 0.0
    assert spare_speed_m_s(blending(0.0, 1.0, 2.0), straight) == 0.0
    assert spare_speed_m_s(blending(0.0, 9.0, 5.0), NO_OFFSET) == 0.0, "it stands"


def test_slow_turns_and_slow_changes_of_them_take_time() -> None:
    assert blending(0.0, 9.0, 100.0).time_s == LEAST_TIME_S
    assert blending(0.0, 9.0, 0.5).time_s == 2.0
    assert blending(0.0, 9.0, 100.0, turn_acceleration_rad_s2=1.0).time_s == 2.0


# A turn ---------------------------------------------------------------------------------------------------


@properties
@given(vectors(1.8), st.floats(0.001, 0.3))
def test_a_turn_is_let_in_smoothly_and_within_a_second(angle: Vec3, dt: float) -> None:
    assume(norm(angle) > 1e-3)
    turn = Turn(angle, ZERO)
    for n in range(1, 400):
        before, turn = turn, turn_step(turn, dt)
        x = n * dt / TURN_TIME_S
        left = (1.0 + x) * math.exp(-x)
        assert math.dist(turn.angle_rad, scale(left, angle)) < 3e-6, "whatever the steps"
        assert norm(turn.rate_rad_s) <= norm(angle) / (math.e * TURN_TIME_S) + 1e-6
        assert norm(turn.angle_rad) <= norm(before.angle_rad)
    if 399 * dt > 4.0:
        assert turn is NO_TURN
    assert turn_step(NO_TURN, dt) is NO_TURN


def test_of_a_turn_one_percent_is_left_after_a_second() -> None:
    assert 0.005 < turn_step(Turn(Vec3(1.0, 0.0, 0.0), ZERO), 1.0).angle_rad.x < 0.011
