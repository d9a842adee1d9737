"""Each part of an airplane's handling on its own."""

from __future__ import annotations

from math import atan, cos, hypot, inf, pi, radians, sin, sqrt, tan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from guidance.handling import (
    airplane_bank,
    airplane_course,
    airplane_envelope,
    airplane_pitch,
    airplane_throttle,
    airplane_wind,
)
from guidance.handling.airplane_bank import GRAVITY_M_S2
from guidance.se3 import ZERO, Vec3

DT_S = 0.02
ENVELOPE = airplane_envelope.Parameters(10.0, 1.0, 20.0, radians(45.0), 1.5, 3.0, 3.0, -20.0, 0.5)
THROTTLE = airplane_throttle.Parameters(12.5, 0.06, 300.0, 0.3, 0.08, 0.3, 0.0, 1.0)
PITCH = airplane_pitch.Parameters(-0.06, 5.0, 0.5, 0.3, 0.15, radians(-25), radians(25))
BANK = airplane_bank.Parameters(0.6, 1.3, 0.3, 1.0, 0.25)
WIND = airplane_wind.Parameters(0.3, 0.05, 0.5, 15.0)

# --- course ---


def test_course_and_climb_are_those_of_the_field() -> None:
    wanted = airplane_course.wanted_of(Vec3(3.0, 4.0, -2.0), Vec3(-0.4, 0.3, 0.1), 0.0)
    assert wanted.speed_m_s == pytest.approx(5.0)
    assert (cos(wanted.course_rad), sin(wanted.course_rad)) == pytest.approx((0.6, 0.8))
    assert wanted.climb_m_s == 2.0
    assert wanted.climb_rate_m_s2 == -0.1
    # Xr' stands at a right angle to Xr: it turns, to the right, and does not hasten
    assert wanted.acceleration_m_s2 == pytest.approx(0.0)
    assert wanted.course_rate_rad_s == pytest.approx(0.5 / 5.0)


def test_a_field_of_nothing_keeps_the_course() -> None:
    wanted = airplane_course.wanted_of(Vec3(0.0, 0.1, 0.0), Vec3(5.0, 5.0, 5.0), 1.3)
    assert (wanted.course_rad, wanted.course_rate_rad_s) == (1.3, 0.0)


def turn(
    course_off_rad: float, side: int = 0, bank_rad: float = 0.0, feed_rad_s: float = 0.0
) -> airplane_course.Turn:
    wanted = airplane_course.Wanted(12.0, course_off_rad, 0.0, 0.0, feed_rad_s, 0.0)
    return airplane_course.turn_to(1.5, 1.0, 0.8, side, wanted, 0.0, bank_rad)


@pytest.mark.parametrize("side", [1, -1])
def test_about_the_opposite_course_the_side_is_kept(side: int) -> None:
    first = turn(side * 2.9)
    assert first.side == side
    # noise carries the wanted course across: still the same side, the longer way
    second = turn(-side * 3.0, first.side)
    assert second.side == side
    assert second.off_rad * side > pi
    assert second.course_rate_rad_s * side > 0.0
    # once clearly on one side, the shorter way counts again
    assert turn(-side * 2.5, side).side == 0
    assert turn(-side * 2.5, side).course_rate_rad_s * side < 0.0


def test_a_new_side_is_the_one_that_it_banks_to() -> None:
    assert turn(3.0, bank_rad=-0.5).side == -1
    assert turn(3.0, bank_rad=-0.05).side == 1


def test_feed_forward_fades_with_the_course_error() -> None:
    assert turn(0.0, feed_rad_s=0.2).course_rate_rad_s == pytest.approx(0.2)
    ahead = turn(0.5, feed_rad_s=0.1).course_rate_rad_s - turn(0.5).course_rate_rad_s
    assert (
        ahead == pytest.approx(0.1 * cos(0.5), abs=1e-9) or turn(0.5, feed_rad_s=0.1).course_rate_rad_s == 0.8
    )
    assert turn(2.0, feed_rad_s=-0.5).course_rate_rad_s == turn(2.0).course_rate_rad_s


# --- bank ---


@given(st.floats(-10.0, 10.0), st.floats(5.0, 15.0), st.floats(0.6, 1.3))
def test_bank_gives_the_accelerations(lateral: float, vertical: float, eta: float) -> None:
    bank = airplane_bank.bank_for(lateral, vertical, eta, 1.5)
    if not bank.saturated:
        lift = bank.load * GRAVITY_M_S2
        assert eta * lift * sin(bank.bank_rad) == pytest.approx(lateral, abs=1e-9)
        assert lift * cos(bank.bank_rad) == pytest.approx(vertical)


def test_bank_is_limited_by_what_the_wing_carries() -> None:
    assert airplane_bank.bank_limit(1.0, 0.99) == 0.0
    assert airplane_bank.bank_limit(1.0, 1.2) == pytest.approx(atan(sqrt(1.2**2 - 1.0)))
    assert airplane_bank.bank_limit(0.4, 3.0) == 0.4
    assert airplane_bank.bank_for(20.0, 9.8, 1.0, 0.5).saturated


@pytest.mark.parametrize("eta", [0.74, 0.95, 1.1])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_effectiveness_is_learned_in_turns(eta: float, side: float) -> None:
    memory = airplane_bank.unlearned(1.0)
    bank, speed = side * 0.5, 20.0
    rate = eta * GRAVITY_M_S2 * tan(bank) / speed
    for n in range(1500):
        velocity = Vec3(speed * cos(rate * n * DT_S) + 3.0, speed * sin(rate * n * DT_S), 0.0)
        memory = airplane_bank.effectiveness_step(
            BANK, memory, velocity, Vec3(3.0, 0.0, 0.0), bank, GRAVITY_M_S2, False, DT_S
        )
    assert memory.effectiveness == pytest.approx(eta, abs=0.01)


@pytest.mark.parametrize(("bank", "frozen"), [(0.02, False), (0.5, True)])
def test_effectiveness_rests_unless_a_free_turn_teaches_it(bank: float, frozen: bool) -> None:
    memory = airplane_bank.unlearned(0.9)
    for n in range(500):
        velocity = Vec3(20.0 * cos(0.2 * n * DT_S), 20.0 * sin(0.2 * n * DT_S), 0.0)
        memory = airplane_bank.effectiveness_step(
            BANK, memory, velocity, ZERO, bank, GRAVITY_M_S2, frozen, DT_S
        )
    assert memory.effectiveness == 0.9


def test_effectiveness_stays_within_its_bounds() -> None:
    memory = airplane_bank.unlearned(1.0)
    for _ in range(5000):  # banks, and does not turn at all
        memory = airplane_bank.effectiveness_step(
            BANK, memory, Vec3(20.0, 0.0, 0.0), ZERO, 0.5, GRAVITY_M_S2, False, DT_S
        )
    assert memory.effectiveness == BANK.lowest


# --- envelope ---


def test_airspeed_is_kept_within_its_envelope() -> None:
    slowest = 10.0 * sqrt(1.2) + 1.0
    assert airplane_envelope.slowest_m_s(ENVELOPE, 1.2) == pytest.approx(slowest)
    # too fast a wish, too slow a wish (approached softly), and already too slow
    assert airplane_envelope.missing_within(ENVELOPE, 9.0, 15.0, 1.0) == pytest.approx(5.0)
    assert airplane_envelope.missing_within(ENVELOPE, -9.0, 15.0, 1.0) == pytest.approx(-2.0)
    assert airplane_envelope.missing_within(ENVELOPE, -9.0, 10.0, 1.2) == pytest.approx(slowest - 10.0)
    assert airplane_envelope.missing_within(ENVELOPE, 0.3, 15.0, 1.0) == 0.3


@given(st.floats(-50.0, 50.0), st.floats(3.0, 30.0), st.floats(-200.0, 50.0), st.floats(-5.0, 5.0))
def test_the_stall_guard_has_the_last_word(wanted: float, airspeed: float, down: float, held: float) -> None:
    climb = airplane_envelope.climb_within(ENVELOPE, wanted, airspeed, down, held)
    if airspeed < 10.0:
        assert climb.climb_m_s <= 0.0
    assert climb.climb_m_s <= ENVELOPE.climb_max_m_s
    if airspeed > 11.0 and held >= ENVELOPE.climb_max_m_s:
        # nothing else than the floor
        assert climb.climb_m_s >= min(0.5 * (down + 20.0), ENVELOPE.climb_max_m_s) or down < -26.0
        assert climb.climb_m_s >= -ENVELOPE.sink_max_m_s


def test_the_floor_is_approached_and_not_passed() -> None:
    down = -60.0
    lowest = down
    for _ in range(5000):
        climb = airplane_envelope.climb_within(ENVELOPE, -3.0, 15.0, down, 5.0)
        down -= climb.climb_m_s * DT_S
        lowest = max(lowest, down)
    assert lowest < -20.0 + 1e-6
    assert down == pytest.approx(-20.0, abs=0.01)
    assert climb.floored


def test_without_a_floor_there_is_none() -> None:
    free = ENVELOPE._replace(floor_down_m=inf)
    climb = airplane_envelope.climb_within(free, -2.0, 15.0, 500.0, 5.0)
    assert climb == airplane_envelope.Climb(-2.0, False, False, False)


# --- pitch ---


def pitch(wanted: float, path: float = 0.0, bank: float = 0.0, load_max: float = 1.5) -> airplane_pitch.Pitch:
    return airplane_pitch.pitch_for(PITCH, 0.01, wanted, path, bank, 1.0, 12.0, load_max, 0.0, False, DT_S)


def test_pitch_is_path_and_angle_of_attack_and_trim() -> None:
    assert pitch(0.05, 0.05).pitch_rad == pytest.approx(0.05 - 0.06 + 5.0 / 144.0 + 0.01)
    # n cos(phi) = 1: the part of the load is the same at every bank
    assert pitch(0.0, 0.0, 0.6).pitch_rad == pytest.approx(-0.06 * cos(0.6) + 5.0 / 144.0 + 0.01)


def test_no_pull_up_is_sharper_than_the_wing_carries() -> None:
    free = pitch(0.3, -0.2).pitch_rad
    assert free < -0.2 + 1.5 * airplane_pitch.TURNED_S * 0.5 * GRAVITY_M_S2 / 12.0
    # with a load below 1 the nose goes down, whatever is wanted
    assert pitch(0.3, 0.0, load_max=0.7).pitch_rad < pitch(0.0, 0.0).pitch_rad


def test_a_slow_wing_is_unloaded_and_the_nose_pushed_down() -> None:
    least = ENVELOPE.airspeed_min_m_s
    assert airplane_envelope.unloaded(ENVELOPE, 1.01 * least, 1.3) == 1.3
    assert airplane_envelope.unloaded(ENVELOPE, 0.85 * least, 1.3) == pytest.approx(0.5 * 0.85**2)
    assert airplane_envelope.unloaded(ENVELOPE, 0.999 * least, 1.3) == pytest.approx(1.0, abs=0.01)
    slow_s = 0.0
    for _ in range(400):
        slow_s = airplane_envelope.slow_step(ENVELOPE, slow_s, 0.95 * least, 0.01)
    assert airplane_envelope.pushed_rad(slow_s) == pytest.approx(0.6)
    for _ in range(300):
        slow_s = airplane_envelope.slow_step(ENVELOPE, slow_s, 1.05 * least, 0.01)
    assert slow_s == pytest.approx(0.0)


def test_the_trim_is_learned_bounded_and_frozen() -> None:
    trim = 0.0
    for _ in range(5000):
        trim = airplane_pitch.pitch_for(PITCH, trim, 0.1, 0.0, 0.0, 1.0, 12.0, 1.5, 0.0, False, DT_S).trim_rad
    assert trim == PITCH.trim_max_rad
    frozen = airplane_pitch.pitch_for(PITCH, 0.02, 0.1, 0.0, 0.0, 1.0, 12.0, 1.5, 0.0, True, DT_S)
    assert frozen.trim_rad == 0.02
    # at the pitch's own limit it does not wind up, but unwinds
    at_limit = PITCH._replace(highest_rad=-0.2)
    for missing, moves in ((0.1, False), (-0.1, True)):
        found = airplane_pitch.pitch_for(at_limit, 0.1, missing, 0.0, 0.0, 1.0, 12.0, 1.5, 0.0, False, DT_S)
        assert (found.trim_rad != 0.1) == moves


# --- throttle ---


def test_throttle_is_what_the_flight_takes() -> None:
    drag = 0.06 * 144.0 + 300.0 * 1.3**2 / 144.0
    found = airplane_throttle.throttle_for(THROTTLE, 0.0, 0.0, 12.0, 0.05, 1.3, -0.5, False, DT_S)
    assert found.throttle == pytest.approx((drag + GRAVITY_M_S2 * sin(0.05) - 0.5) / 12.5)
    assert found.trim == 0.0


def test_the_fastest_speed_and_the_steepest_path_take_full_throttle() -> None:
    fastest = airplane_throttle.fastest_m_s(THROTTLE, 0.1, 1.2, 0.5)
    needed = airplane_throttle.drag_m_s2(THROTTLE, fastest, 1.2) + GRAVITY_M_S2 * 0.5 / fastest
    assert needed == pytest.approx(12.5 * 0.9, rel=1e-3)
    assert airplane_throttle.fastest_m_s(THROTTLE, 0.9, 1.2, 0.5) == 0.0
    sine = airplane_throttle.steepest_sine(THROTTLE, 0.0, 11.0, 1.0)
    drag = airplane_throttle.drag_m_s2(THROTTLE, 11.0, 1.0)
    assert drag + GRAVITY_M_S2 * sine == pytest.approx(12.5)


def test_the_throttle_does_not_wind_up() -> None:
    full = airplane_throttle.throttle_for(THROTTLE, 0.1, 5.0, 14.0, 0.1, 1.0, 0.0, False, DT_S)
    assert (full.throttle, full.saturated, full.trim) == (1.0, True, 0.1)
    idle = airplane_throttle.throttle_for(THROTTLE, 0.1, -9.0, 14.0, -0.5, 1.0, 0.0, False, DT_S)
    assert (idle.throttle, idle.trim) == (0.0, 0.1)
    assert airplane_throttle.throttle_for(THROTTLE, 0.0, 0.2, 12.0, 0.0, 1.0, 0.0, False, DT_S).trim > 0.0
    assert airplane_throttle.throttle_for(THROTTLE, 0.0, 0.2, 12.0, 0.0, 1.0, 0.0, True, DT_S).trim == 0.0


# --- wind ---


def estimated(bias_rad: float, straight: bool) -> airplane_wind.Memory:
    memory = airplane_wind.UNKNOWN
    for n in range(6000):
        heading = 0.3 if straight else 0.1 * n * DT_S
        velocity = Vec3(15.0 * cos(heading) + 4.0, 15.0 * sin(heading) - 3.0, 0.0)
        memory = airplane_wind.wind_step(WIND, memory, velocity, heading + bias_rad, 15.0, False, ZERO, DT_S)
    return memory


@pytest.mark.parametrize("straight", [True, False])
def test_wind_is_found_from_airspeed_and_heading(straight: bool) -> None:
    found = estimated(0.0, straight)
    assert hypot(found.north_m_s - 4.0, found.east_m_s + 3.0) < 0.05


def test_in_a_turn_a_heading_bias_is_not_taken_for_wind() -> None:
    turning, straight = estimated(0.035, False), estimated(0.035, True)
    assert hypot(turning.north_m_s - 4.0, turning.east_m_s + 3.0) < 0.35
    assert hypot(straight.north_m_s - 4.0, straight.east_m_s + 3.0) > 0.4


def test_given_wind_is_taken_and_then_followed() -> None:
    memory = airplane_wind.wind_step(
        WIND, airplane_wind.UNKNOWN, ZERO, 0.0, 0.0, True, Vec3(5.0, 0.0, 0.0), DT_S
    )
    assert memory == airplane_wind.Memory(5.0, 0.0, True)
    memory = airplane_wind.wind_step(WIND, memory, ZERO, 0.0, 0.0, True, Vec3(7.0, 0.0, 0.0), DT_S)
    assert 5.0 < memory.north_m_s < 5.1
    # and kept when nothing says anything but a heading that fits
    along = Vec3(memory.north_m_s + 9.0, memory.east_m_s, 9.0)
    kept = airplane_wind.wind_step(WIND, memory, along, 0.0, 0.0, False, ZERO, DT_S)
    assert kept == pytest.approx(memory)


def test_a_given_wind_that_airspeed_and_heading_deny_is_outvoted() -> None:
    calm = airplane_wind.Memory(0.0, 0.0, True)
    for heading in (0.0, 0.7, 1.6, 2.0, 2.6, 3.1, 4.4):
        ground = Vec3(12.0 * cos(heading), 12.0 * sin(heading), 0.0)
        after = airplane_wind.wind_step(WIND, calm, ground, heading, 12.0, True, Vec3(-14.0, 0.0, 0.0), DT_S)
        assert hypot(after.north_m_s, after.east_m_s) < 1e-9
        near = airplane_wind.wind_step(WIND, calm, ground, heading, 12.0, True, Vec3(-3.0, 0.0, 0.0), DT_S)
        assert near.north_m_s < 0.0


def test_a_wind_that_nobody_tells_any_more_is_followed_by_the_heading() -> None:
    """So that an airspeed that is doubted because the wind turned is believed again."""
    memory = airplane_wind.Memory(4.0, -3.0, True)
    for n in range(6000):
        heading = 0.12 * n * DT_S
        velocity = Vec3(12.0 * cos(heading) - 4.0, 12.0 * sin(heading) + 3.0, 0.0)
        memory = airplane_wind.wind_step(WIND, memory, velocity, heading, 0.0, False, ZERO, DT_S)
    assert (memory.north_m_s, memory.east_m_s) == pytest.approx((-4.0, 3.0), abs=0.5)
    assert airplane_wind.believed_m_s(memory, velocity, 12.0, 15.0) == 12.0


def test_without_an_airspeed_a_turn_tells_the_wind_by_the_heading_alone() -> None:
    memory = airplane_wind.UNKNOWN
    for n in range(3000):
        heading = 0.12 * n * DT_S
        velocity = Vec3(12.0 * cos(heading) - 4.0, 12.0 * sin(heading) + 3.0, 0.0)
        memory = airplane_wind.wind_step(WIND, memory, velocity, heading, 0.0, False, ZERO, DT_S)
    assert (memory.north_m_s, memory.east_m_s) == pytest.approx((-4.0, 3.0), abs=0.3)


def test_wind_is_bounded() -> None:
    memory = airplane_wind.wind_step(
        WIND, airplane_wind.UNKNOWN, ZERO, 0.0, 0.0, True, Vec3(90.0, 0.0, 0.0), DT_S
    )
    assert memory.north_m_s == pytest.approx(15.0)


def test_where_the_wind_is_at_its_bound_the_airspeed_is_not_doubted() -> None:
    """A gale of 22 m/s from ahead: by the bounded estimate the airspeed would be 7 m/s less than it is."""
    ground = Vec3(2.0, 0.0, 0.0)
    bounded = airplane_wind.Memory(-15.0, 0.0, True)
    assert airplane_wind.believed_m_s(bounded, ground, 24.0, 15.0) == 24.0
    known = airplane_wind.Memory(-8.0, 0.0, True)
    assert airplane_wind.believed_m_s(known, ground, 24.0, 15.0) == 0.0
