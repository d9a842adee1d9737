"""The forward-only law: what it does exactly, where it decides, and that every flight arrives."""

from __future__ import annotations

import random
from math import acos, atan2, cos, isfinite, pi, sin, sqrt

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from guidance import se3
from guidance.alignment import FIELD_MIN_M_S, global_turn, paper_turn
from guidance.allocation import PITCH_YAW
from guidance.error_function import PAPER as PAPER_PHI
from guidance.error_function import ErrorFunction, bounded, bounded_apart, k_of_r
from guidance.law import (
    GLOBAL,
    PAPER,
    REST,
    UNSTARTED,
    Evaluation,
    Gains,
    Parameters,
    desired_field,
    guide_step,
)
from guidance.se3 import IDENTITY, ZERO, Pose, Reference, Twist, Vec3
from guidance.trajectory import Circle, Helix, Lemniscate, Line, Trajectory, sample
from tests.kinematic_flight import (
    FORWARD,
    GLOBAL_LAW,
    across,
    facing,
    fly,
    random_pose,
    random_twist,
    settled_s,
)
from tests.oracle import moved
from tests.strategies import INF, UNBOUNDED, angles, gains, poses, properties, references, vectors

ERROR_FUNCTIONS = [PAPER_PHI, k_of_r(0.5, 20.0, ZERO), bounded(2.0), bounded_apart(2.0, 1.0)]


def step(parameters: Parameters, pose: Pose, r: Reference) -> Evaluation:
    return guide_step(parameters, UNSTARTED, pose, REST, r, 0.02)[1]


# What holds exactly ----------------------------------------------------------------------------------


@properties
@given(gains(), angles(), st.floats(1e-6, 1e-2), st.floats(0.1, 50.0), vectors(20.0))
def test_near_alignment_it_is_11(g: Gains, side: float, theta: float, speed: float, a: Vec3) -> None:
    y = Vec3(speed * cos(theta), speed * sin(theta) * cos(side), speed * sin(theta) * sin(side))
    mine, papers = global_turn(g, INF, y, a), paper_turn(g, y, a)
    assume(not papers.singular and not mine.singular)
    assert abs(mine.u2) + abs(mine.u3) > 0.0
    # to second order in theta, but for the part of Xr' along b1, which (11) does not look at
    along = abs(a.x) / speed * theta
    second = (20.0 + 2.0 * se3.norm(a) / speed) * theta * theta
    assert_allclose(mine[:2], papers[:2], atol=along + second, rtol=0.0)
    still = Vec3(0.0, a.y, a.z)
    assert_allclose(global_turn(g, INF, y, still)[:2], paper_turn(g, y, still)[:2], atol=second, rtol=0.0)


def angle(pose: Pose, field: Vec3) -> float:
    b1 = se3.body_axes(pose.attitude)[0]
    return atan2(se3.norm(se3.cross(b1, field)), se3.dot(b1, field))


@properties
@given(
    st.sampled_from(ERROR_FUNCTIONS),
    st.floats(0.5, 12.0),
    poses(20.0),
    references(),
    st.floats(0.0, 5.0),
)
def test_the_angle_decays_at_rho_from_every_attitude_whatever_reference_and_speed_do(
    f: ErrorFunction, rho: float, pose: Pose, r: Reference, speed_max: float
) -> None:
    g = Gains(0.8, rho, rho, 1.3)
    limits = UNBOUNDED._replace(speed_min_m_s=0.0, speed_max_m_s=speed_max)
    found = step(Parameters(GLOBAL, PITCH_YAW, g, f, limits), pose, r)
    Xr = desired_field(g, pose.position, r, f).Xr
    theta = angle(pose, Xr)
    assume(not found.singular and se3.norm(Xr) > 0.3 and 1e-3 < theta < pi - 0.05)
    u = found.controls
    twist = Twist(Vec3(u.u1, u.u2, u.u3), Vec3(u.u4, 0.0, 0.0))
    h = 1e-5

    def after(t: float) -> float:
        later, at = moved(r, t), se3.compose(pose, se3.exp(twist, t))
        return angle(at, desired_field(g, at.position, later, f).Xr)

    assert (after(h) - after(-h)) / (2.0 * h) == pytest.approx(-rho * theta, abs=1e-3 * (1.0 + rho))


@properties
@given(gains(), poses(), references())
def test_it_never_asks_for_reverse_and_all_is_bounded(g: Gains, pose: Pose, r: Reference) -> None:
    for f in ERROR_FUNCTIONS:
        found = step(Parameters(GLOBAL, PITCH_YAW, g, f, UNBOUNDED), pose, r)
        assert found.controls.u4 == max(0.0, 1.0 / g.beta * found.y4)
        rate = sqrt(found.demanded.u2**2 + found.demanded.u3**2)
        assert rate <= 20.0 * max(g.rho2, g.rho3) * (1.0 + 1e-9)
        assert found.demanded.u1 == 0.0
        assert all(map(isfinite, (*found.demanded, found.V1, found.V2)))


# Where there is no direction -------------------------------------------------------------------------


@properties
@given(gains(), st.floats(1e-2, 100.0))
def test_exactly_opposite_to_the_field_it_turns_to_the_right(g: Gains, speed: float) -> None:
    turn = global_turn(g, INF, Vec3(-speed, 0.0, 0.0), ZERO)
    assert (turn.u2, turn.u3) == (0.0, g.rho3 * pi)
    assert turn.singular


@properties
@given(gains(), poses(), vectors(10.0))
def test_without_a_field_the_heading_is_held(g: Gains, pose: Pose, acceleration: Vec3) -> None:
    found = step(
        Parameters(GLOBAL, PITCH_YAW, g, PAPER_PHI, UNBOUNDED),
        pose,
        Reference(pose.position, ZERO, acceleration),
    )
    assert found.demanded == (0.0, 0.0, 0.0, 0.0)
    assert found.singular


@properties
@given(angles(), angles(), st.floats(0.0, 1.0), vectors(10.0))
@example(0.0, 0.0, 1.0, ZERO)
def test_rates_fade_with_the_field(theta: float, side: float, part: float, a: Vec3) -> None:
    g = Gains(1.0, 10.0, 10.0, 2.0)

    def turn(speed: float) -> Vec3:
        size = g.beta * speed
        y = Vec3(size * cos(theta), size * sin(theta) * cos(side), size * sin(theta) * sin(side))
        found = global_turn(g, INF, y, se3.scale(1e-2, a))
        return Vec3(found.u2, found.u3, 0.0)

    whole = turn(FIELD_MIN_M_S * (1.0 + 1e-9))
    assert se3.norm(turn(part * FIELD_MIN_M_S)) <= part * se3.norm(whole) * (1.0 + 1e-6) + 1e-9


def test_arrived_where_nothing_moves_it_stands_still_despite_the_noise_of_the_position() -> None:
    dice = random.Random(1)
    for _ in range(100):
        x = Vec3(*(dice.gauss(0.0, 1e-5) for _ in range(3)))
        found = step(GLOBAL_LAW, Pose(x, IDENTITY), Reference(ZERO, ZERO, ZERO))
        assert max(abs(found.controls.u2), abs(found.controls.u3)) < 2.0
        assert found.controls.u4 < 1e-4


# Every flight arrives --------------------------------------------------------------------------------


def test_from_random_starts_within_50_m_of_the_helix_every_flight_is_within_1_cm_after_20_s() -> None:
    dice = random.Random(20)
    settled = []
    for n in range(40):
        start = random_pose(dice, sample(Helix(), 0.0).position, 50.0)
        lag_s = 0.1 if n % 4 == 0 else 0.0
        flight = fly(GLOBAL_LAW, Helix(), start, 24.0, twist=random_twist(dice), lag_s=lag_s)
        settled.append(settled_s(flight))
        assert min(m.evaluation.controls.u4 for m in flight) >= 0.0
    assert max(settled) < 15.0


def starts_near_the_reference(curve: Trajectory, lambda_k: float) -> list[tuple[str, Pose, float]]:
    """What is hard about a start, the start, and its speed in m/s."""
    dice = random.Random(7)
    r = sample(curve, 0.0)
    v = r.velocity
    zero = se3.add(r.position, se3.scale(1.0 / lambda_k, v))
    ahead = se3.scale(1.0 / se3.norm(v), v)
    starts = []
    for distance in (1e-6, 0.1, 3.0):
        x = random_pose(dice, r.position, distance).position
        field = se3.subtract(v, se3.scale(lambda_k, se3.subtract(x, r.position)))
        starts += [
            ("exactly opposite", Pose(x, facing(se3.scale(-1.0, field))), 0.0),
            ("exactly opposite, at speed", Pose(x, facing(se3.scale(-1.0, field))), 5.0),
            ("field orthogonal", Pose(x, facing(across(field, dice))), 0.0),
            ("field orthogonal, at speed", Pose(x, facing(across(field, dice))), 5.0),
            ("close to field zero", random_pose(dice, zero, 0.1 * distance), 0.0),
        ]
        for away in (distance, se3.norm(v) / lambda_k):
            x = se3.add(r.position, se3.scale(away, ahead))
            starts.append(("ahead on the axis", Pose(x, facing(v)), 0.0))
            starts.append(("ahead on the axis, facing back", Pose(x, facing(se3.scale(-1.0, v))), 5.0))
    starts.append(("field zero", Pose(zero, facing(across(v, dice))), 0.0))
    return starts


@pytest.mark.parametrize("lag_s", [0.0, 0.1])
@pytest.mark.parametrize(
    ("curve", "within_s"),
    [
        (Helix(), 12.0),
        (Circle(speed_m_s=4.5), 12.0),
        (Line(speed_m_s=4.5), 15.0),
    ],
)
def test_from_the_hard_starts_every_flight_arrives_also_at_nine_tenths_of_the_highest_speed(
    curve: Trajectory, within_s: float, lag_s: float
) -> None:
    hard = starts_near_the_reference(curve, GLOBAL_LAW.gains.k / GLOBAL_LAW.gains.beta)
    for what, start, speed in hard[:: 2 if lag_s else 1]:
        twist = Twist(ZERO, Vec3(speed, 0.0, 0.0))
        flight = fly(GLOBAL_LAW, curve, start, within_s + 2.0, twist=twist, lag_s=lag_s)
        assert settled_s(flight) < within_s, what


@pytest.mark.parametrize(("speed_min", "lag_s"), [(0.5, 0.0), (1.5, 0.1)])
def test_a_vehicle_that_cannot_stop_converges_on_a_circle_and_never_gets_less(
    speed_min: float, lag_s: float
) -> None:
    dice = random.Random(5)
    curve = Circle(radius_m=10.0, speed_m_s=2.0)
    parameters = GLOBAL_LAW._replace(limits=FORWARD._replace(speed_min_m_s=speed_min))
    starts = [pose for _, pose, _ in starts_near_the_reference(curve, 1.5)[::3]]
    starts += [random_pose(dice, sample(curve, 0.0).position, 15.0) for _ in range(6)]
    for start in starts:
        flight = fly(parameters, curve, start, 20.0, lag_s=lag_s)
        assert min(m.evaluation.controls.u4 for m in flight) >= speed_min
        assert settled_s(flight) < 18.0


def test_the_law_of_the_paper_does_not_arrive_from_behind_without_reverse() -> None:
    start = Pose(Vec3(-10.0, 0.0, 0.0), facing(Vec3(-1.0, 0.1, 0.0)))
    curve = Line(speed_m_s=1.0)
    assert settled_s(fly(GLOBAL_LAW, curve, start, 15.0)) < 10.0
    assert fly(GLOBAL_LAW._replace(law=PAPER), curve, start, 15.0)[-1].error > 10.0


def test_with_rates_that_slew_the_turn_does_not_overshoot() -> None:
    slow = FORWARD._replace(acceleration_m_s2=2.0, pitch_acceleration_rad_s2=2.0, yaw_acceleration_rad_s2=2.0)
    curve = Lemniscate(speed_m_s=1.5)
    start = Pose(Vec3(-3.0, 4.0, 0.0), se3.from_yaw(-2.0))
    flight = fly(GLOBAL_LAW._replace(limits=slow), curve, start, 20.0)
    assert settled_s(flight, 0.05) < 12.0
    heading = Line(speed_m_s=4.0)
    turning = fly(GLOBAL_LAW._replace(limits=slow), heading, Pose(ZERO, se3.from_yaw(2.5)), 6.0)
    cosines = [m.evaluation.y4 / sqrt(m.evaluation.y4**2 + 2.0 * m.evaluation.V2) for m in turning]
    angles_rad = [acos(min(1.0, c)) for c in cosines]
    arrived = next(n for n, a in enumerate(angles_rad) if a < 0.05)
    assert max(angles_rad[arrived:]) < 0.1
