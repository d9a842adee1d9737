"""The small functions around the law of a ground vehicle, each on its own."""

from __future__ import annotations

from math import inf, pi

import pytest
from hypothesis import given
from hypothesis import strategies as st

from guidance.handling import slip, smoothing, speed_loop, stuck, waiting
from guidance.handling.crawl import REST_PART, crawl_floor, rest_m_s
from guidance.handling.saturation import kept_curvature
from guidance.se3 import ZERO, Reference, Vec3
from guidance.trajectory import circle
from tests.strategies import properties

DT = 0.02

# --- crawl ---

REST = REST_PART * 0.8


def test_a_vehicle_that_points_away_crawls() -> None:
    assert crawl_floor(0.8, REST, 3.0, -3.0, 0.0, inf, DT) == 0.8
    assert crawl_floor(0.8, REST, 3.0, 0.0, 0.0, inf, DT) == 0.8


def test_the_crawl_fades_as_it_turns_into_the_field() -> None:
    assert crawl_floor(0.8, REST, 3.0, 1.5, 0.0, inf, DT) == pytest.approx(0.4)
    assert crawl_floor(0.8, REST, 3.0, 3.0, 0.0, inf, DT) == 0.0


def test_it_is_never_asked_for_more_than_the_field_and_rests_where_that_does() -> None:
    assert crawl_floor(0.8, REST, 0.5, 0.0, 0.0, inf, DT) == 0.5
    assert crawl_floor(0.8, REST, REST, -REST, 0.0, inf, DT) == 0.0
    assert crawl_floor(0.8, REST, 1.5 * REST, 0.0, 0.0, inf, DT) == pytest.approx(0.75 * REST)
    assert crawl_floor(0.0, 0.0, 3.0, -3.0, 0.0, inf, DT) == 0.0


def test_the_floor_rises_no_faster_than_the_vehicle() -> None:
    assert crawl_floor(0.8, REST, 3.0, -3.0, 0.3, 1.0, DT) == pytest.approx(0.32)
    assert crawl_floor(0.8, REST, 3.0, -3.0, -2.0, 1.0, DT) == pytest.approx(0.02)


def test_at_a_goal_that_stands_it_rests_within_its_turning_radius() -> None:
    """Once at rest there, and the less of that the faster the goal is."""
    assert rest_m_s(0.8, 1.0, 0.9, 0.0, 0.0) == 0.9
    assert rest_m_s(0.8, 1.0, 0.9, 0.5, 0.0) == pytest.approx(0.4)
    assert rest_m_s(0.8, 1.0, 0.9, 2.0, 0.0) == REST
    assert rest_m_s(0.8, 1.0, 0.9, 0.0, 0.3) == REST


# --- slip ---

SLIP = slip.Parameters(time_constant_s=2.0, speed_min_m_s=0.7, bound_rad=0.15)


def after(seconds: float, forward: float, right: float, memory: slip.Memory = slip.NONE) -> slip.Memory:
    for _ in range(round(seconds / DT)):
        memory = slip.slip_step(SLIP, memory, forward, right, DT)
    return memory


def test_the_slip_is_learned_in_its_time_and_with_its_sign() -> None:
    assert after(2.0, 2.0, 0.1).slip_rad == pytest.approx(0.05 * 0.63, rel=0.02)
    assert after(20.0, 2.0, -0.1).slip_rad == pytest.approx(-0.05, rel=0.01)


def test_in_reverse_it_is_the_same_slip() -> None:
    assert after(20.0, -2.0, -0.1).slip_rad == pytest.approx(after(20.0, 2.0, 0.1).slip_rad)


@pytest.mark.parametrize(("forward", "right"), [(0.6, 0.1), (0.0, 3.0), (1.0, 1.1)])
def test_where_there_is_no_course_nothing_is_learned(forward: float, right: float) -> None:
    known = slip.Memory(0.03)
    assert after(5.0, forward, right, known) == known


def test_it_stays_within_its_bound() -> None:
    assert after(30.0, 2.0, 1.0) == slip.Memory(0.15)
    assert after(30.0, 2.0, -1.0) == slip.Memory(-0.15)


# --- speed loop ---

LOOP = speed_loop.Parameters(kp=0.45, ki=0.4, lag_s=0.55, part=0.5)


def driven(part: float, wanted: list[float]) -> tuple[speed_loop.Memory, list[float]]:
    """A vehicle that drives `part` of what is asked, with the lag that the loop takes it to have."""
    memory, speed, seen = speed_loop.START, 0.0, []
    for value in wanted:
        memory, asked = speed_loop.speed_step(LOOP, memory, value, speed, 0.0, 0.0, 5.0, DT)
        speed += DT / (LOOP.lag_s + DT) * (part * asked - speed)
        seen.append(speed)
    return memory, seen


@pytest.mark.parametrize("part", [0.7, 1.0, 1.3])
def test_it_drives_the_wanted_speed_with_a_wrong_map(part: float) -> None:
    memory, seen = driven(part, [2.0] * 2000)
    assert seen[-1] == pytest.approx(2.0, rel=1e-3)
    assert memory.integral == pytest.approx(1.0 / part - 1.0, abs=2e-3)


def test_with_a_right_map_a_change_of_speed_teaches_it_nothing() -> None:
    memory, _ = driven(1.0, [2.0] * 100 + [0.5] * 100 + [3.0] * 100)
    assert abs(memory.integral) < 0.02


def test_what_it_learned_at_one_speed_it_knows_at_another() -> None:
    _, seen = driven(0.7, [2.0] * 1000 + [1.0] * 150)
    assert seen[-1] == pytest.approx(1.0, rel=0.03)


def test_its_integral_rests_where_the_speed_is_at_its_end() -> None:
    memory, _ = driven(0.5, [5.0] * 500)
    assert memory.integral == 0.0


def test_a_vehicle_that_does_not_move_does_not_fill_it_beyond_its_part() -> None:
    memory, seen = driven(0.0, [2.0] * 5000)
    assert memory.integral == LOOP.part
    _, asked = speed_loop.speed_step(LOOP, memory, 2.0, 0.0, 0.0, 0.0, 5.0, DT)
    assert asked == pytest.approx(2.0 * (1.0 + LOOP.part) + 0.45 * 2.0)
    assert seen[-1] == 0.0


def test_what_is_seen_late_is_not_missing() -> None:
    """Over a line of half a second a rise of the speed is answered by nearly nothing but the rise."""
    most = []
    for known_s in (0.0, 0.5):
        memory, speeds, asked, most_s = speed_loop.START, [0.0] * 26, 0.0, 0.0
        for _ in range(200):
            memory, asked = speed_loop.speed_step(LOOP, memory, 2.0, speeds[-26], known_s, 0.0, 5.0, DT)
            speeds.append(speeds[-1] + DT / (LOOP.lag_s + DT) * (asked - speeds[-1]))
            most_s = max(most_s, asked)
        most.append(most_s - 2.0)
    assert most[1] < 0.5 * most[0]


def test_told_to_stand_it_asks_for_nothing() -> None:
    memory = speed_loop.Memory(0.0, 0.0, 0.5)
    assert speed_loop.speed_step(LOOP, memory, 0.0, 0.3, 0.0, -5.0, 5.0, DT)[1] == 0.0


# --- waiting ---

WAITING = waiting.Parameters(slowest=0.5, fastest=1.15, per_m=1.0, falls_per_s=2.0, rises_per_s=0.5)
EAST = Reference(ZERO, Vec3(0.0, 2.0, 0.0), ZERO)


def clock(east_m: float, steps: int, memory: waiting.Memory = waiting.ON_TIME) -> waiting.Memory:
    for _ in range(steps):
        memory = waiting.waiting_step(WAITING, memory, Vec3(9.0, east_m, 0.0), EAST, DT)
    return memory


@pytest.mark.parametrize(("east_m", "rate"), [(0.0, 1.0), (-0.2, 0.8), (-5.0, 0.5), (0.1, 1.1), (5.0, 1.15)])
def test_the_clock_follows_the_error_along_the_track_alone(east_m: float, rate: float) -> None:
    assert clock(east_m, 200).rate == pytest.approx(rate)


def test_it_falls_and_rises_as_fast_as_it_may() -> None:
    fallen = clock(-5.0, 5)
    assert fallen.rate == pytest.approx(1.0 - 2.0 * 5 * DT)
    assert clock(0.0, 5, fallen).rate == pytest.approx(fallen.rate + 0.5 * 5 * DT)


def test_it_counts_how_long_it_waited() -> None:
    memory = clock(-5.0, 200)
    waited = memory.waited_s
    assert clock(-5.0, 100, memory).waited_s - waited == pytest.approx(0.5 * 100 * DT)


def test_switched_off_or_before_a_point_that_stands_it_is_on_time() -> None:
    off = waiting.waiting_step(waiting.OFF, waiting.ON_TIME, Vec3(0.0, -50.0, 0.0), EAST, DT)
    assert off == waiting.ON_TIME
    still = Reference(ZERO, ZERO, ZERO)
    at = waiting.waiting_step(WAITING, waiting.ON_TIME, Vec3(0.0, -50.0, 0.0), still, DT)
    assert at == waiting.ON_TIME


def test_on_its_clock_a_reference_keeps_its_derivatives() -> None:
    """Against differences of r(s(t)) with s' = 0.7 and s'' = 0.2 at this instant."""

    def position(t: float) -> Vec3:
        return circle(3.0 + 0.7 * t + 0.1 * t * t, 10.0, 2.0, True, 0.0).position

    found = waiting.on_clock(circle(3.0, 10.0, 2.0, True, 0.0), 0.7, 0.2)
    h = 1e-3
    before, now, then = position(-h), position(0.0), position(h)
    assert found.position == now
    for n in range(3):
        assert found.velocity[n] == pytest.approx((then[n] - before[n]) / (2 * h), abs=1e-6)
        assert found.acceleration[n] == pytest.approx((then[n] - 2 * now[n] + before[n]) / (h * h), abs=1e-6)


# --- stuck ---

STUCK = stuck.Parameters(asked_m_s=0.3, speed_m_s=0.15, yaw_rate_rad_s=0.05, after_s=3.0)


def watched(
    seconds: float, asked: float, speed: float, yaw_rate: float, memory: stuck.Memory = stuck.MOVING
) -> stuck.Memory:
    for _ in range(round(seconds / DT)):
        memory = stuck.stuck_step(STUCK, memory, asked, speed, yaw_rate, DT)
    return memory


def test_asked_and_still_for_too_long_is_stuck() -> None:
    assert not watched(2.9, 1.0, 0.0, 0.0).stuck
    assert watched(3.1, 1.0, 0.0, 0.0).stuck
    assert watched(3.1, -1.0, 0.0, 0.0).stuck


@pytest.mark.parametrize(("asked", "speed", "yaw_rate"), [(0.2, 0.0, 0.0), (1.0, 0.2, 0.0), (1.0, 0.0, -0.1)])
def test_at_rest_driving_or_turning_is_not(asked: float, speed: float, yaw_rate: float) -> None:
    assert watched(60.0, asked, speed, yaw_rate) == stuck.MOVING


def test_one_noisy_sample_neither_makes_nor_unmakes_it() -> None:
    memory = watched(60.0, 1.0, 0.0, 0.0)
    memory = watched(DT, 1.0, 0.3, 0.0, memory)
    assert memory.stuck
    assert not watched(1.1, 1.0, 0.3, 0.0, memory).stuck


def test_it_can_be_switched_off() -> None:
    off = STUCK._replace(after_s=0.0)
    assert not stuck.stuck_step(off, stuck.Memory(99.0, True), 1.0, 0.0, 0.0, DT).stuck


# --- saturation ---


@properties
@given(st.floats(0.0, 20.0), st.floats(-20.0, 20.0))
def test_a_turn_too_fast_keeps_its_curvature(speed: float, turn: float) -> None:
    found = kept_curvature(speed, turn, 2.0, 4.0, 0.0)
    assert 0.0 <= found <= speed
    if speed > 1e-6:
        driven_turn = abs(turn) * found / speed
        assert driven_turn <= 2.0 * (1.0 + 1e-9)
        assert driven_turn * found <= 4.0 * (1.0 + 1e-9)
        if abs(turn) <= 2.0 and abs(turn) * speed <= 4.0:
            assert found == speed


def test_it_is_not_slowed_below_the_crawl() -> None:
    assert kept_curvature(2.0, 20.0, 2.0, 4.0, 0.8) == pytest.approx(0.8)
    assert kept_curvature(0.5, 20.0, 2.0, 4.0, 0.8) == 0.5
    assert kept_curvature(-2.0, 4.0, 2.0, inf, 0.8) == -1.0


# --- smoothing ---

SMOOTH = smoothing.Parameters(time_constant_s=0.15, jump_m=0.5)


def test_a_motion_that_the_velocity_shows_is_not_late() -> None:
    memory = smoothing.UNSTARTED
    for n in range(500):
        memory = smoothing.smoothing_step(
            SMOOTH, memory, Vec3(2.0 * n * DT, 0.0, 0.0), Vec3(2.0, 0.0, 0.0), DT
        )
    assert memory.position.x == pytest.approx(2.0 * 499 * DT)


def test_what_the_velocity_does_not_show_comes_in_its_time() -> None:
    memory = smoothing.Memory(True, ZERO, ZERO)
    for _ in range(round(0.15 / DT) + 1):
        memory = smoothing.smoothing_step(SMOOTH, memory, Vec3(0.1, 0.0, 0.0), ZERO, DT)
    assert memory.position.x == pytest.approx(0.063, abs=0.005)


@pytest.mark.parametrize(("wrong_m_s", "found_m_s"), [(0.4, 0.4), (3.0, 0.8)])
def test_the_error_of_a_velocity_is_found_within_its_bound(wrong_m_s: float, found_m_s: float) -> None:
    memory, wrong = smoothing.UNSTARTED, Vec3(0.6 * wrong_m_s, 0.0, -0.8 * wrong_m_s)
    finds = smoothing.Parameters(0.3, 5.0, error_s=0.6, error_max_m_s=0.8)
    for _ in range(500):  # it stands
        memory = smoothing.smoothing_step(finds, memory, ZERO, wrong, DT)
    assert memory.error == pytest.approx(Vec3(0.6 * found_m_s, 0.0, -0.8 * found_m_s), abs=0.01)
    blind = smoothing.smoothing_step(SMOOTH, smoothing.Memory(True, ZERO, ZERO), ZERO, wrong, DT)
    assert blind.error == ZERO


def test_a_jump_is_taken_at_once_and_none_is_smoothed_when_off() -> None:
    memory = smoothing.Memory(True, ZERO, ZERO)
    far, near = Vec3(0.0, 0.6, 0.0), Vec3(0.0, 0.4, 0.0)
    assert smoothing.smoothing_step(SMOOTH, memory, far, ZERO, DT).position == far
    assert smoothing.smoothing_step(SMOOTH, memory, near, ZERO, DT).position.y < 0.1
    off = SMOOTH._replace(time_constant_s=0.0)
    assert smoothing.smoothing_step(off, memory, near, Vec3(pi, 0.0, 0.0), DT).position == near
