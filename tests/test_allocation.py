"""Allocations: the same turn of b1 by other rates, convergence, and switching in flight."""

from __future__ import annotations

import random
from math import atan2, inf, isfinite, pi, sqrt
from pathlib import Path

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from guidance import se3
from guidance.alignment import global_turn
from guidance.allocation import PITCH_YAW, ROLL_PITCH, ROLL_YAW, TURN_MIN_RAD_S, allocate
from guidance.commands import Allocate, Allocation
from guidance.error_function import PAPER as PAPER_PHI
from guidance.law import GLOBAL, PAPER, REST, UNSTARTED, Gains, Memory, Parameters, guide_step
from guidance.limits import Controls, Limits, stoppable
from guidance.records import Setpoint, Status
from guidance.replay import replay
from guidance.se3 import IDENTITY, ZERO, Pose, Quaternion, Reference, Vec3
from guidance.supervisor import State
from guidance.trajectory import Circle, Helix, Line, Trajectory, sample
from sitl.lockstep import Lockstep
from sitl.logbook import LogBook
from tests.helpers import ROVER, events_of, fly_until_tracking, make_config, make_flight, records_of, state_of
from tests.kinematic_flight import FORWARD, GLOBAL_LAW, fly, random_pose, random_twist, settled_s
from tests.strategies import properties, reals

turns = st.tuples(reals(50.0), reals(50.0))


@properties
@given(turns, st.floats(0.1, 20.0), st.one_of(st.just(inf), st.floats(0.1, 20.0)))
def test_failed_actuators_rest_and_the_roll_rate_is_bounded(
    turn: tuple[float, float], rho: float, acceleration: float
) -> None:
    u2, u3 = turn
    assert allocate(PITCH_YAW, rho, acceleration, u2, u3) == (0.0, u2, u3)
    u1, pitch, yaw = allocate(ROLL_PITCH, rho, acceleration, u2, u3)
    assert (pitch, yaw) == (u2, 0.0)
    assert abs(u1) <= rho * 0.5 * pi
    u1, pitch, yaw = allocate(ROLL_YAW, rho, acceleration, u2, u3)
    assert (pitch, yaw) == (0.0, u3)
    assert abs(u1) <= rho * 0.5 * pi


def wanted_in_body(attitude: Quaternion, world: Vec3) -> tuple[float, float]:
    """(u2, u3) for a wanted b1' that stands still in the world."""
    _, b2, b3 = se3.body_axes(attitude)
    return -se3.dot(b3, world), se3.dot(b2, world)


@properties
@given(st.sampled_from([ROLL_PITCH, ROLL_YAW]), st.floats(-3.1, 3.1), st.floats(0.5, 5.0))
def test_rolling_leads_the_shorter_way_into_the_plane_at_the_rate_rho(
    allocation: int, roll: float, size: float
) -> None:
    rho, dt = 5.0, 1e-3
    attitude, world = se3.from_euler(roll, 0.0, 0.0), Vec3(0.0, 0.0, size)

    def off() -> float:
        u2, u3 = wanted_in_body(attitude, world)
        along, across = (u2, u3) if allocation == ROLL_PITCH else (u3, u2)
        return atan2(abs(across), abs(along))

    before = off()
    assume(before < 0.5 * pi - 1e-6)
    for _ in range(400):
        u1 = allocate(allocation, rho, inf, *wanted_in_body(attitude, world))[0]
        attitude = se3.multiply(attitude, se3.quaternion_exp(Vec3(u1 * dt, 0.0, 0.0)))
    fading = size / (size + TURN_MIN_RAD_S)
    expected = before * (1.0 - rho * fading * dt) ** 400
    assert off() == pytest.approx(expected, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("allocation", [ROLL_PITCH, ROLL_YAW])
def test_without_a_turn_the_roll_is_held_and_at_a_right_angle_a_side_is_chosen(allocation: int) -> None:
    assert allocate(allocation, 5.0, inf, 0.0, 0.0)[0] == 0.0
    tiny = 1e-3 * TURN_MIN_RAD_S
    assert all(
        abs(allocate(allocation, 5.0, inf, a, b)[0]) < 0.01 for a in (tiny, -tiny) for b in (tiny, 0.0)
    )
    for sign in (1.0, -1.0):
        u2, u3 = (0.0, sign) if allocation == ROLL_PITCH else (sign, 0.0)
        u1 = allocate(allocation, 5.0, inf, u2, u3)[0]
        assert abs(u1) == pytest.approx(5.0 * 0.5 * pi, rel=0.05)
        assert isfinite(u1)


@pytest.mark.parametrize("law", [PAPER, GLOBAL])
@pytest.mark.parametrize("allocation", [ROLL_PITCH, ROLL_YAW])
@pytest.mark.parametrize(
    ("curve", "radius_m", "lag_s"),
    [
        (Helix(), 40.0, 0.0),
        (Helix(), 20.0, 0.1),
        (Circle(speed_m_s=2.0), 15.0, 0.0),
        (Circle(speed_m_s=2.0), 15.0, 0.1),
        (Line(speed_m_s=2.0), 10.0, 0.0),
    ],
)
def test_every_allocation_converges_from_random_starts(
    curve: Trajectory, radius_m: float, lag_s: float, allocation: int, law: int
) -> None:
    dice = random.Random(11)
    limits = FORWARD if law == GLOBAL else FORWARD._replace(speed_min_m_s=-5.0)
    parameters = GLOBAL_LAW._replace(law=law, allocation=allocation, limits=limits)
    for _ in range(4):
        start = random_pose(dice, sample(curve, 0.0).position, radius_m)
        flight = fly(parameters, curve, start, 22.0, twist=random_twist(dice), lag_s=lag_s)
        dead = [m.evaluation.controls[2 if allocation == ROLL_PITCH else 1] for m in flight]
        assert set(dead) == {0.0}
        assert settled_s(flight) < 20.0


@pytest.mark.parametrize("allocation", [ROLL_PITCH, ROLL_YAW])
def test_an_actuator_that_fails_on_the_way_costs_next_to_nothing(allocation: int) -> None:
    dice = random.Random(4)
    curve = Circle(speed_m_s=2.0)

    def failing(t: float, p: Parameters) -> Parameters:
        return p._replace(allocation=allocation if 3.0 <= t < 16.0 else PITCH_YAW)

    flight = fly(
        GLOBAL_LAW, curve, random_pose(dice, sample(curve, 0.0).position, 8.0), 20.0, changed=failing
    )
    assert settled_s(flight) < 15.0
    steps = [m.evaluation.controls for m in flight if 3.0 <= m.t < 16.0]
    assert {u[2 if allocation == ROLL_PITCH else 1] for u in steps} == {0.0}
    assert max(abs(u.u1) for u in steps) > 0.01


def test_the_redundant_allocations_align_more_slowly_because_they_wait_for_the_roll() -> None:
    """rho' tau < 1 of the module's docstring: beyond it a limit cycle, and so half the rate is aligned at."""
    curve = Circle(speed_m_s=2.0)
    start = random_pose(random.Random(2), sample(curve, 0.0).position, 5.0)
    errors = []
    for rho in (10.0, 20.0):
        parameters = GLOBAL_LAW._replace(gains=Gains(1.0, rho, rho, 1.0), allocation=ROLL_PITCH)
        flight = fly(parameters, curve, start, 25.0, lag_s=0.15)
        errors.append(max(m.error for m in flight if m.t > 20.0))
    slower = GLOBAL_LAW._replace(gains=Gains(1.0, 8.0, 8.0, 1.0), allocation=ROLL_PITCH)
    assert max(m.error for m in fly(slower, curve, start, 25.0, lag_s=0.15) if m.t > 20.0) < 1e-3
    assert min(errors) > 5e-3


# In flight, through the core --------------------------------------------------------------------------


def error_m(flight: Lockstep) -> float:
    tracker = flight.guide.tracker
    assert tracker.start_ns is not None
    assert tracker.origin_ned_m is not None
    r = sample(flight.guide.config.trajectory, (flight.now_ns - tracker.start_ns) * 1e-9)
    x = Vec3(*flight.truth().position_ned_m)
    return se3.norm(se3.subtract(x, se3.add(tracker.origin_ned_m, r.position)))


def rates_since(flight: Lockstep, since_ns: int) -> list[tuple[float, float, float]]:
    sent = [s for s in records_of(flight, Setpoint, since_ns) if not s.neutral]
    assert sent
    return [s.body_rates_frd_rad_s for s in sent]


CIRCLE = ("trajectory.name=circle", "trajectory.speed_m_s=2", "law.name=global")


def test_the_allocation_is_switched_in_flight_without_stopping_and_replays(tmp_path: Path) -> None:
    flight = make_flight(*CIRCLE)
    fly_until_tracking(flight)
    flight.run(14.0)
    assert error_m(flight) < 0.01
    for command, dead in ((Allocate(allocation="roll-pitch"), 2), (Allocate(allocation="roll-yaw"), 1)):
        flight.guide.command(command, flight.now_ns)
        commanded_ns = flight.now_ns + 1
        flight.run(0.06)
        assert records_of(flight, Status)[-1].allocation == command.allocation  # at once
        worst = 0.0
        for _ in range(100):
            flight.run(0.05)
            worst = max(worst, error_m(flight))
        assert worst < 0.1
        assert error_m(flight) < 0.01
        rates = rates_since(flight, commanded_ns)
        assert {r[dead] for r in rates} == {0.0}
        assert max(abs(r[0]) for r in rates) > 0.1
        assert records_of(flight, Status)[-1].allocation == command.allocation
        assert state_of(flight) is State.TRACKING
    flight.guide.command(Allocate(allocation="pitch-yaw"), flight.now_ns)
    commanded_ns = flight.now_ns + 1
    flight.run(3.0)
    assert {r[0] for r in rates_since(flight, commanded_ns)} == {0.0}
    assert events_of(flight, "allocated") == [
        "turning by roll-pitch",
        "turning by roll-yaw",
        "turning by pitch-yaw",
    ]
    with LogBook(make_config(*CIRCLE), tmp_path) as book:
        for record in flight.records:
            book.add(record)
    found = replay(book.path)
    assert found.difference is None
    assert found.identical


def test_the_configured_allocation_is_flown_and_one_commanded_before_engaging_is_kept() -> None:
    flight = make_flight(*CIRCLE, "law.allocation=roll-yaw")
    fly_until_tracking(flight)
    flight.run(3.0)
    assert {r[1] for r in rates_since(flight, 0)} == {0.0}
    flight = make_flight(*CIRCLE)
    flight.guide.command(Allocate(allocation="roll-pitch"), flight.now_ns)
    fly_until_tracking(flight)
    flight.run(3.0)
    assert {r[2] for r in rates_since(flight, 0)} == {0.0}
    assert {s.allocation for s in records_of(flight, Status)} == {"roll-pitch"}


@pytest.mark.parametrize(
    ("overrides", "flown", "asked", "why"),
    [
        (ROVER, "pitch-yaw", "roll-yaw", "ardupilot-rover is planar and cannot roll"),
        (
            ("limits.roll_rate_max_rad_s=0",),
            "pitch-yaw",
            "roll-yaw",
            "limits.roll_rate_max_rad_s = 0 leaves it without that rate",
        ),
        (
            ("limits.pitch_rate_max_rad_s=0", "law.allocation=roll-yaw"),
            "roll-yaw",
            "pitch-yaw",
            "limits.pitch_rate_max_rad_s = 0 leaves it without that rate",
        ),
    ],
)
def test_what_the_vehicle_cannot_turn_by_is_refused_in_flight_with_the_reason(
    overrides: tuple[str, ...], flown: str, asked: Allocation, why: str
) -> None:
    flight = make_flight(*overrides, "trajectory.name=circle")
    fly_until_tracking(flight)
    flight.guide.command(Allocate(allocation=asked), flight.now_ns)
    flight.run(1.0)
    assert events_of(flight, "allocation_refused") == [f"{asked} refused: {why}"]
    assert records_of(flight, Status)[-1].allocation == flown
    assert state_of(flight) is State.TRACKING


def test_a_planar_vehicle_that_cannot_pitch_is_told_pitch_yaw_and_goes_on() -> None:
    flight = make_flight(*ROVER, "limits.pitch_rate_max_rad_s=0", "trajectory.name=circle")
    fly_until_tracking(flight)
    flight.guide.command(Allocate(allocation="pitch-yaw"), flight.now_ns)
    flight.run(0.1)
    assert events_of(flight, "allocation_refused") == []
    assert events_of(flight, "allocated") == ["turning by pitch-yaw"]


@pytest.mark.parametrize(
    ("allocation", "pitch", "yaw", "slowest"),
    [
        (PITCH_YAW, 3.0, 5.0, 3.0),
        (PITCH_YAW, 5.0, 3.0, 3.0),
        (ROLL_PITCH, 3.0, 0.1, 3.0),
        (ROLL_PITCH, 3.0, inf, 3.0),
        (ROLL_YAW, 0.1, 3.0, 3.0),
        (ROLL_YAW, inf, 3.0, 3.0),
    ],
)
def test_only_an_axis_that_acts_slows_the_turn(
    allocation: int, pitch: float, yaw: float, slowest: float
) -> None:
    """The field stands still at a right angle, where the actuators that are left turn b1 without a roll."""
    limits = Limits(-5.0, 5.0, 9.0, 9.0, 9.0, True, inf, inf, pitch, yaw)
    parameters = Parameters(GLOBAL, allocation, Gains(1.0, 9.0, 9.0, 1.0), PAPER_PHI, limits)
    side = Vec3(0.0, 1.0, 0.0) if allocation != ROLL_PITCH else Vec3(0.0, 0.0, 1.0)
    reference = Reference(ZERO, side, ZERO)
    found = guide_step(parameters, UNSTARTED, Pose(ZERO, IDENTITY), REST, reference, 0.02)[1]
    expected = stoppable(inf, pi / 2.0, slowest)
    assert sqrt(found.demanded.u2**2 + found.demanded.u3**2) == pytest.approx(expected)


def test_the_law_global_flies_the_demo_in_lockstep_with_a_bounded_field() -> None:
    flight = make_flight(
        "law.name=global", "law.error_function.name=bounded", "law.error_function.approach_m_s=3"
    )
    fly_until_tracking(flight)
    flight.run(20.0)
    sent = [s for s in records_of(flight, Setpoint) if not s.neutral]
    assert min(s.speed_m_s for s in sent) >= 0.0
    assert max(s.speed_m_s for s in sent) < 3.0 + sqrt(0.02)
    assert error_m(flight) < 0.01


def test_the_vehicle_reports_that_an_actuator_failed() -> None:
    """NAMED_VALUE_FLOAT "ALLOC" of the autopilot, as a script there sends it; anything else is counted."""
    flight = make_flight()
    fly_until_tracking(flight)
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    for value in (1.0, 1.0, 7.0, float("nan")):
        flight.inject(bytes(dialect.MAVLink_named_value_float_message(0, b"ALLOC", value).pack(mav)))
        mav.seq += 1
    flight.inject(bytes(dialect.MAVLink_named_value_float_message(0, b"OTHER", 2.0).pack(mav)))
    assert flight.guide.tracker.allocation == "roll-pitch"
    assert events_of(flight, "allocated") == ["turning by roll-pitch"]
    assert flight.guide.link.counters["NAMED_VALUE_FLOAT:unknown_allocation"] == 2
    stranger = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    flight.inject(bytes(dialect.MAVLink_named_value_float_message(0, b"ALLOC", 2.0).pack(stranger)))
    assert flight.guide.tracker.allocation == "roll-pitch"


def test_a_repeated_report_undoes_nothing_that_the_operator_commanded() -> None:
    flight = make_flight()
    fly_until_tracking(flight)
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)

    def report(value: float) -> None:
        mav.seq = (mav.seq + 1) % 256
        flight.inject(bytes(dialect.MAVLink_named_value_float_message(0, b"ALLOC", value).pack(mav)))

    report(0.0)
    flight.guide.command(Allocate(allocation="roll-pitch"), flight.now_ns)
    report(0.0)
    assert flight.guide.tracker.allocation == "roll-pitch"
    report(2.0)
    assert flight.guide.tracker.allocation == "roll-yaw"


def test_a_failed_actuator_that_still_turned_does_not_hold_back_the_others() -> None:
    slow_yaw = Limits(-5.0, 5.0, 5.0, 5.0, 5.0, True, inf, 20.0, 20.0, 1.0)
    parameters = Parameters(GLOBAL, ROLL_PITCH, Gains(1.0, 4.0, 4.0, 1.0), PAPER_PHI, slow_yaw)
    pose = Pose(Vec3(-3.0, 2.0, 1.0), IDENTITY)
    reference = Reference(ZERO, Vec3(0.1, 0.0, 0.0), ZERO)
    still, turning = (
        guide_step(parameters, Memory(True, Controls(0.0, 0.0, u3, 1.0)), pose, REST, reference, 0.02)[1]
        for u3 in (0.0, 3.0)
    )
    assert still.controls == turning.controls
    assert turning.controls.u3 == 0.0
    assert turning.controls.u1 != 0.0


def test_a_misalignment_whose_square_is_zero_is_no_error() -> None:
    turn = global_turn(Gains(1.0, 0.1, 0.1, 1.0), 5.0, Vec3(1.0, 2e-162, 0.0), ZERO)
    assert isfinite(turn.u2)
    assert abs(turn.u3) < 1e-100
