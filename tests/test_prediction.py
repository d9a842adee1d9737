"""What is on its way to the vehicle is flown on: exact against the plant, of fixed memory, and stable."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from guidance.estimate import Estimator
from guidance.geodesy import azimuthal_equidistant
from guidance.mavlink.messages import AttitudeQuaternion, LocalPositionNed
from guidance.prediction import NOTHING_SENT, REMEMBERED, Acting, History, predict, sent
from guidance.se3 import IDENTITY, ZERO, Pose, Twist, Vec3, compose, exp, rotate_inverse
from sitl.lockstep import Channel
from sitl.plant import PlantCommand, PlantParameters, PlantState, step
from tests.helpers import fly_until_tracking, make_flight
from tests.strategies import poses, properties, reals, twists, vectors
from tests.test_flights import fly

MS = 1_000_000
UNBOUNDED = PlantParameters(max_rate_rad_s=1e3, max_speed_m_s=1e3)


def of(*setpoints: tuple[int, Vec3]) -> History:
    """A history of (ms, rates)."""
    history = NOTHING_SENT
    for at_ms, rates in setpoints:
        history = sent(history, at_ms * MS, rates)
    return history


@properties
@given(poses(), vectors(5.0), reals(5.0), st.lists(vectors(5.0), max_size=12), st.integers(0, 300))
def test_it_is_where_the_plant_is_that_obeys_each_setpoint_in_its_turn(
    pose: Pose, rates: Vec3, speed_m_s: float, later: list[Vec3], to_ms: int
) -> None:
    times_ms = [7 + 20 * i for i in range(len(later))]
    plant = PlantState(pose.position, pose.attitude, rates, speed_m_s)
    at_ms, acting = 0, rates
    for turn_ms, following in [*zip(times_ms, later, strict=True), (to_ms, ZERO)]:
        until_ms = min(turn_ms, to_ms)
        if until_ms > at_ms:
            command = PlantCommand(acting, speed_m_s)
            plant = step(UNBOUNDED, plant, command, (until_ms - at_ms) * 1e-3)
            at_ms = until_ms
        acting = following
    history = of((-20, Vec3(9.0, 9.0, 9.0)), *zip(times_ms, later, strict=True))
    end, twist = predict(history, pose, Twist(rates, Vec3(speed_m_s, 0.0, 0.0)), 0, to_ms * MS)
    assert math.dist(end.position, plant.position_ned_m) < 1e-9
    assert abs(sum(a * b for a, b in zip(end.attitude, plant.attitude_wxyz, strict=True))) > 1.0 - 1e-12
    obeyed = [turn for at, turn in zip(times_ms, later, strict=True) if at < to_ms]
    assert twist == Twist(obeyed[-1] if obeyed else rates, Vec3(speed_m_s, 0.0, 0.0))


@properties
@given(poses(), twists(), st.integers(-300, 300))
def test_without_setpoints_that_act_in_between_the_measured_twist_holds(
    pose: Pose, twist: Twist, to_ms: int
) -> None:
    expected = compose(pose, exp(twist, to_ms * MS * 1e-9)), twist
    before_and_after = of((-400, Vec3(1.0, 2.0, 3.0)), (0, Vec3(3.0, 2.0, 1.0)), (300, Vec3(4.0, 5.0, 6.0)))
    for history in (NOTHING_SENT, before_and_after):
        assert predict(history, pose, twist, 0, to_ms * MS) == expected


def test_the_memory_is_of_fixed_size_and_keeps_the_newest() -> None:
    history = NOTHING_SENT
    for i in range(3 * REMEMBERED):
        history = sent(history, i, Vec3(float(i), 0.0, 0.0))
        assert len(history) == min(i + 1, REMEMBERED)
    assert history[-1] == Acting(3 * REMEMBERED - 1, Vec3(3.0 * REMEMBERED - 1.0, 0.0, 0.0))
    assert history[0].instant_ns == 2 * REMEMBERED


def test_the_estimator_turns_as_the_setpoints_say_and_keeps_the_velocity_in_body_axes() -> None:
    estimator = Estimator(azimuthal_equidistant)
    assert estimator.take(AttitudeQuaternion(1000, *IDENTITY, 0.0, 0.0, 0.0), 0, 0) is None
    assert estimator.take(LocalPositionNed(1000, 1.0, 2.0, 3.0, 2.0, 0.5, 0.0), 0, 0) is None
    turning = of((100, Vec3(0.0, 0.0, 1.0)))
    straight, turned = estimator.at(200 * MS), estimator.at(200 * MS, turning)
    assert straight is not None
    assert turned is not None
    assert straight.pose == Pose(Vec3(1.4, 2.1, 3.0), IDENTITY)
    assert 2.0 * math.atan2(turned.pose.attitude.z, turned.pose.attitude.w) == pytest.approx(0.1)
    assert turned.twist.angular == Vec3(0.0, 0.0, 1.0)
    assert rotate_inverse(turned.pose.attitude, turned.velocity_ned_m_s) == pytest.approx((2.0, 0.5, 0.0))


def test_only_the_setpoints_of_a_flight_under_way_are_flown_on() -> None:
    flight = make_flight()
    tracker = flight.guide.tracker
    flight.run(20.0, until=lambda: flight.guide.setpoints_sent > 0)
    assert tracker.history == NOTHING_SENT  # neutral ones, which nobody obeys
    fly_until_tracking(flight)
    flight.run(1.0)
    assert 40 < len(tracker.history) <= REMEMBERED
    tracker.stop()
    assert tracker.history == NOTHING_SENT
    tracker.start(flight.now_ns, ZERO)
    assert tracker.history == NOTHING_SENT


@pytest.mark.parametrize("delay_s", [0.05, 0.1, 0.15])
def test_a_delay_that_would_make_the_papers_gains_unstable_costs_nothing(delay_s: float) -> None:
    """rho times the delay there and back is 1 to 3; about 1.5 is where the loop oscillates."""
    late = Channel(delay_s=delay_s)
    figures = fly(make_flight(to_guide=late, to_vehicle=late), 25.0)
    assert figures.converged_s is not None
    assert figures.converged_s < 12.0
    assert figures.max_error_m is not None
    assert figures.max_error_m < 1e-3


def test_a_reference_that_turns_is_met_where_the_setpoint_arrives() -> None:
    """On a helix the setpoints are all alike, and their delay does not show; here it would cost 50 mm."""
    late = Channel(delay_s=0.05)
    quick = ("trajectory.name=lemniscate", "trajectory.speed_m_s=3")
    figures = fly(make_flight(*quick, to_guide=late, to_vehicle=late), 30.0)
    assert figures.rms_error_m is not None
    assert figures.rms_error_m < 0.005
