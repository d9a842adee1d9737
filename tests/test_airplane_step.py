"""An airplane's prediction and clock, and what the step that is composed of all parts never does."""

from __future__ import annotations

from math import atan, cos, hypot, isfinite, pi, radians, sin, sqrt, tan

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guidance.handling import (
    airplane,
    airplane_bank,
    airplane_clock,
    airplane_envelope,
    airplane_pitch,
    airplane_prediction,
    airplane_throttle,
    airplane_wind,
    waiting,
)
from guidance.handling.airplane import Measured, airplane_step
from guidance.handling.airplane_bank import GRAVITY_M_S2
from guidance.handling.airplane_defaults import patience
from guidance.se3 import ZERO, Pose, Reference, Vec3, from_euler
from guidance.trajectory import circle
from sitl.airplane_tasks import airplane_12, airplane_20

DT_S = 0.02
ENVELOPE = airplane_envelope.Parameters(10.0, 1.0, 20.0, radians(45.0), 1.5, 3.0, 3.0, -20.0, 0.5)
THROTTLE = airplane_throttle.Parameters(12.5, 0.06, 300.0, 0.3, 0.08, 0.3, 0.0, 1.0)
PITCH = airplane_pitch.Parameters(-0.06, 5.0, 0.5, 0.3, 0.15, radians(-25), radians(25))
BANK = airplane_bank.Parameters(0.6, 1.3, 0.3, 1.0, 0.25)
WIND = airplane_wind.Parameters(0.3, 0.05, 0.5, 15.0)

# --- prediction ---


def test_coasting_is_the_turn_at_this_bank() -> None:
    wind = Vec3(2.0, -1.0, 0.0)
    bank, eta, air = 0.5, 0.8, 20.0
    rate = eta * GRAVITY_M_S2 * tan(bank) / air
    x, v = airplane_prediction.coasted(ZERO, Vec3(air + wind.x, wind.y, -1.0), wind, bank, eta, 0.3)
    angle = rate * 0.3
    assert v == pytest.approx((air * cos(angle) + wind.x, air * sin(angle) + wind.y, -1.0))
    assert x.x == pytest.approx(air / rate * sin(angle) + wind.x * 0.3, abs=0.02)
    assert x.y == pytest.approx(air / rate * (1.0 - cos(angle)) + wind.y * 0.3, abs=0.02)
    assert x.z == pytest.approx(-0.3)


# --- the clock ---


def clock(e_north_m: float, v_m_s: float, slower: float, faster: float, curve_m_s2: float = 0.0) -> float:
    """The rate that it settles at, for a plan of 10 m/s to the north."""
    planned = Reference(ZERO, Vec3(10.0, 0.0, 0.0), Vec3(0.0, curve_m_s2, 0.0))
    memory = waiting.ON_TIME
    for _ in range(500):
        memory = airplane_clock.clock_step(
            PATIENCE,
            memory,
            planned,
            Vec3(e_north_m, 0.0, 0.0),
            Vec3(v_m_s, 0.0, 0.0),
            slower,
            faster,
            8.0,
            DT_S,
        )
    return memory.rate


def test_the_clock_waits_and_hastens_within_its_bounds() -> None:
    assert clock(0.0, 10.0, 2.0, 4.0) == pytest.approx(1.0)
    assert clock(-airplane_clock.FAR_M, 10.0, 2.0, 4.0) == PATIENCE.slowest
    assert clock(100.0, 10.0, 2.0, 4.0) == PATIENCE.fastest


def test_the_clock_is_what_the_wind_leaves() -> None:
    # against the wind it flies 8 m/s at most, with it 13 m/s at least
    assert clock(0.0, 7.0, 1.0, 1.0) == pytest.approx(0.8)
    assert clock(0.0, 14.0, 1.0, 4.0) == pytest.approx(1.3)
    assert clock(5.0, 14.0, 1.0, 4.0) == pytest.approx(1.3 + airplane_clock.CAUGHT_UP)
    # but one that is behind is waited for
    assert clock(-20.0, 14.0, 1.0, 4.0) == PATIENCE.slowest


def test_the_further_off_the_airplane_the_slower_the_clock() -> None:
    assert clock(-2.0 * airplane_clock.FAR_M, 10.0, 2.0, 4.0) == pytest.approx(0.5 * PATIENCE.slowest)
    assert clock(-10.0 * airplane_clock.FAR_M, 10.0, 2.0, 4.0) == pytest.approx(0.1 * PATIENCE.slowest)


def test_the_clock_is_no_quicker_than_the_turn_that_a_bank_gives() -> None:
    turned = sqrt(airplane_clock.TURNED_PART * 8.0 / 7.0)
    assert turned < 1.0
    assert clock(50.0, 10.0, 2.0, 4.0, 7.0) == pytest.approx(turned)
    assert clock(50.0, 10.0, 2.0, 4.0, -7.0) == pytest.approx(turned)


def test_a_clock_that_is_off_is_off() -> None:
    planned = Reference(ZERO, Vec3(10.0, 0.0, 0.0), ZERO)
    memory = airplane_clock.clock_step(
        waiting.OFF, waiting.ON_TIME, planned, Vec3(-50.0, 0.0, 0.0), ZERO, 1.0, 1.0, 8.0, DT_S
    )
    assert memory == waiting.ON_TIME


# --- the step ---

PATIENCE = patience(20.0, 0.7)
AIRPLANES = {12: airplane_12(), 20: airplane_20()}
REACH = st.floats(-500.0, 500.0)
SPEED = st.floats(-40.0, 40.0)
ANGLE = st.floats(-1.4, 1.4)


@settings(max_examples=300)
@given(
    st.sampled_from([12, 20]),
    st.tuples(REACH, REACH, REACH),
    st.tuples(SPEED, SPEED, SPEED),
    st.tuples(ANGLE, ANGLE, st.floats(-pi, pi)),
    st.floats(0.0, 40.0),
    st.tuples(SPEED, SPEED),
    st.floats(0.0, 100.0),
    st.booleans(),
    st.sampled_from([0.0, 1e-3, 0.02, 0.5]),
)
def test_whatever_is_measured_what_is_asked_is_finite_and_within_limits(
    speed: int,
    position: tuple[float, float, float],
    velocity: tuple[float, float, float],
    angles: tuple[float, float, float],
    airspeed: float,
    wind: tuple[float, float],
    t_s: float,
    given_wind: bool,
    dt_s: float,
) -> None:
    guide = AIRPLANES[speed].guide._replace(waiting=PATIENCE)
    memory = airplane.unstarted(airplane.UNTRIMMED)
    measured = Measured(
        Pose(Vec3(*position), from_euler(*angles)),
        Vec3(*velocity),
        airspeed,
        given_wind,
        Vec3(*wind, 0.0),
        0.1,
    )
    reference = circle(t_s, 100.0, float(speed), True, -60.0)
    for _ in range(3):
        memory, demand, found = airplane_step(guide, memory, measured, reference, dt_s)
        assert all(map(isfinite, (*demand.attitude, *demand[1:])))
        assert abs(demand.roll_rad) <= guide.envelope.bank_max_rad
        assert guide.pitch.lowest_rad <= demand.pitch_rad <= guide.pitch.highest_rad
        assert 0.0 <= demand.throttle <= 1.0
        assert all(map(isfinite, (*found.e, *found.trims, *found.wind_ned_m_s, found.asked_m_s, found.load)))
        if found.airspeed_m_s < guide.envelope.airspeed_min_m_s:
            # before everything: level, full throttle, not up
            assert demand.roll_rad == 0.0
            assert demand.throttle == guide.throttle.highest
            assert found.climb_m_s <= 0.0


def test_a_wrong_wind_alone_is_no_reason_to_dive() -> None:
    """Without an airspeed: by the wind it would be 2 m/s slow, but nothing has measured that."""
    guide = AIRPLANES[12].guide
    reference = circle(0.0, 100.0, 12.0, True, -60.0)
    pose = Pose(reference.position, from_euler(0.0, 0.0, 0.5 * pi))
    memory = airplane.unstarted(airplane.UNTRIMMED)
    for _ in range(200):
        measured = Measured(pose, Vec3(0.0, 12.0, 0.0), 0.0, True, Vec3(0.0, 10.0, 0.0), 0.0)
        memory, demand, found = airplane_step(guide, memory, measured, reference, DT_S)
    assert found.airspeed_m_s == guide.envelope.airspeed_min_m_s
    assert demand.pitch_rad > 0.0
    assert demand.throttle == guide.throttle.highest


def test_on_the_path_it_asks_for_the_turn_of_the_path() -> None:
    plane = AIRPLANES[20]
    guide, speed, radius = plane.guide, 20.0, 100.0
    reference = circle(0.0, radius, speed, True, -60.0)
    trims = airplane.Trims(0.74, 0.0, 0.0)
    bank = atan(speed * speed / radius / GRAVITY_M_S2 / 0.74)
    measured = Measured(
        Pose(reference.position, from_euler(bank, 0.0, 0.5 * pi)), reference.velocity, speed, True, ZERO, 0.0
    )
    _, demand, found = airplane_step(guide, airplane.unstarted(trims), measured, reference, DT_S)
    assert demand.roll_rad == pytest.approx(bank, abs=1e-6)
    assert found.e == ZERO
    assert found.asked_m_s == pytest.approx(speed)
    assert found.climb_m_s == pytest.approx(0.0)


def test_in_a_cross_wind_the_acceleration_is_shared_between_bank_and_throttle() -> None:
    """Eastbound on the circle in a wind to the south: the air's direction is not the ground's."""
    guide, speed, radius, eta = AIRPLANES[20].guide, 20.0, 100.0, 0.74
    reference = circle(0.0, radius, speed, True, -60.0)
    wind = Vec3(-8.0, 0.0, 0.0)
    air = hypot(speed, 8.0)
    bank = atan(speed * speed / radius * speed / air / GRAVITY_M_S2 / eta)
    measured = Measured(
        Pose(reference.position, from_euler(bank, 0.0, 1.2)), reference.velocity, air, True, wind, 0.0
    )
    memory = airplane.unstarted(airplane.Trims(eta, 0.0, 0.0))
    _, demand, found = airplane_step(guide, memory, measured, reference, DT_S)
    assert demand.roll_rad == pytest.approx(bank, abs=1e-6)
    # turning into the tail wind it must fly slower in the air by and by
    along = guide.throttle.thrust_m_s2 * demand.throttle - airplane_throttle.drag_m_s2(
        guide.throttle, air, found.load
    )
    assert along == pytest.approx(-speed * speed / radius * 8.0 / air, abs=1e-6)


def test_at_the_least_airspeed_a_turn_in_wind_takes_no_thrust() -> None:
    """As above, but as slow as it may be: the throttle is that of flying faster."""
    guide, speed, radius = AIRPLANES[20].guide, 14.0, 60.0
    reference = circle(0.0, radius, speed, True, -60.0)
    wind = Vec3(-8.0, 0.0, 0.0)
    bank = atan(speed * speed / radius / GRAVITY_M_S2)
    memory = airplane.unstarted(airplane.UNTRIMMED)
    for airspeed, slow in ((11.5, True), (hypot(speed, 8.0), False)):
        measured = Measured(
            Pose(reference.position, from_euler(bank, 0.0, 1.2)),
            reference.velocity,
            airspeed,
            True,
            wind,
            0.0,
        )
        _, demand, found = airplane_step(guide, memory, measured, reference, DT_S)
        missing = found.asked_m_s - airspeed
        drag = airplane_throttle.drag_m_s2(guide.throttle, found.asked_m_s, found.load)
        accelerates = (
            guide.throttle.thrust_m_s2 * (demand.throttle - guide.throttle.proportional_s_m * missing) - drag
        )
        assert (missing > 0.0) == slow
        assert (accelerates > -0.1) == slow


def test_nothing_is_learned_of_a_bank_that_is_saturated() -> None:
    guide = AIRPLANES[20].guide
    memory = airplane.unstarted(airplane.UNTRIMMED)
    attitude = from_euler(1.0, 0.0, 0.0)
    for _ in range(200):  # banks as far as it may, and does not turn; the reference is abeam
        measured = Measured(
            Pose(Vec3(0.0, 0.0, -60.0), attitude), Vec3(20.0, 0.0, 0.0), 20.0, True, ZERO, 0.0
        )
        reference = Reference(Vec3(0.0, 300.0, -60.0), Vec3(-20.0, 0.0, 0.0), ZERO)
        memory, _, found = airplane_step(guide, memory, measured, reference, DT_S)
        assert found.bank_saturated
    assert airplane.trims_of(memory).effectiveness == 1.0


def test_no_bank_is_asked_for_that_is_farther_than_it_rolls_meanwhile() -> None:
    """From the bank it has when it begins: it was 45 degrees with the first setpoint."""
    guide = AIRPLANES[20].guide
    step_rad = guide.roll_rate_rad_s * DT_S
    measured = Measured(
        Pose(Vec3(0.0, 0.0, -60.0), from_euler(-0.1, 0.0, 0.0)), Vec3(20.0, 0.0, 0.0), 20.0, True, ZERO, 0.0
    )
    reference = Reference(Vec3(0.0, 300.0, -60.0), Vec3(-20.0, 0.0, 0.0), ZERO)
    memory, before = airplane.unstarted(airplane.UNTRIMMED), -0.1
    for _ in range(round(1.2 / step_rad)):
        memory, demand, found = airplane_step(guide, memory, measured, reference, DT_S)
        assert 0.0 <= demand.roll_rad - before <= step_rad * (1.0 + 1e-9)
        assert found.load * cos(demand.roll_rad) == pytest.approx(1.0, abs=0.25)
        before = demand.roll_rad
    assert before == pytest.approx(guide.envelope.bank_max_rad, abs=0.05)


def test_to_the_left_is_the_mirror_of_to_the_right() -> None:
    guide = AIRPLANES[20].guide
    asked = []
    for side in (1.0, -1.0):
        measured = Measured(
            Pose(Vec3(-30.0, side * 20.0, -60.0), from_euler(side * 0.2, 0.0, side * 0.4)),
            Vec3(18.0, side * 8.0, 1.0),
            20.0,
            True,
            Vec3(1.0, side * 3.0, 0.0),
            0.1,
        )
        reference = Reference(Vec3(0.0, 0.0, -65.0), Vec3(20.0, side * 1.0, 0.0), Vec3(0.0, side * 2.0, 0.0))
        memory = airplane.unstarted(airplane.UNTRIMMED)
        asked.append(airplane_step(guide, memory, measured, reference, DT_S)[1])
    right, left = asked
    assert left.roll_rad == pytest.approx(-right.roll_rad)
    assert left.pitch_rad == pytest.approx(right.pitch_rad)
    assert left.throttle == pytest.approx(right.throttle)


def test_what_was_learned_starts_the_next_flight() -> None:
    trims = airplane.Trims(0.8, 0.03, -0.1)
    assert airplane.trims_of(airplane.unstarted(trims)) == trims
