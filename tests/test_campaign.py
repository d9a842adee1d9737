"""Campaigns: the same seed gives the same numbers, and flights start and fly as they should."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from guidance import error_function
from guidance.allocation import PITCH_YAW
from guidance.law import GLOBAL, UNSTARTED, Gains, Limits, Parameters, guide_step
from guidance.limits import Controls
from guidance.se3 import Pose, Quaternion, Twist, Vec3, norm
from guidance.trajectory import TRAJECTORIES as ALL_TRAJECTORIES
from guidance.trajectory import Circle, Eight, Helix, Lemniscate, Line, Zigzag, sample
from sitl.bench_campaign import PLAN, UnavailableError, c_loop, difference
from sitl.campaign.flight import OUTCOMES, PARAMETERS, START_RATES, TRAJECTORIES, Rows, reference_at
from sitl.campaign.plan import Plan
from sitl.campaign.run import fly_range, run
from sitl.plant import PlantCommand, PlantParameters, PlantState, step

pytestmark = pytest.mark.timeout(120)  # the first of these compiles, and other work may keep the machine busy

SMALL = Plan(
    flights=50,
    seed=7,
    duration_s=3.0,
    law="global",
    k=(0.5, 2.0),
    wind_m_s=(0.0, 0.5),
    delay_s=(0.0, 0.1),
    rate_lag_s=(0.0, 0.1),
)


def outcome(rows: Rows, name: str) -> Rows:
    return rows[:, OUTCOMES.index(name)]


def parameter(rows: Rows, name: str) -> Rows:
    return rows[:, PARAMETERS.index(name)]


@pytest.mark.parametrize(("threads", "chunk"), [(1, 50), (2, 7), (3, 1), (2, 64)])
def test_the_same_seed_gives_the_same_numbers_however_it_is_cut(threads: int, chunk: int) -> None:
    parameters, outcomes = fly_range(SMALL, 0, 50)
    flown: list[int] = []
    result = run(SMALL, threads, chunk, flown.append)
    assert sum(flown) == 50
    assert_array_equal(result.outcomes, outcomes)
    for name, values in result.parameters.items():
        assert_array_equal(values, parameter(parameters, name))
    assert_array_equal(fly_range(SMALL, 31, 8)[1], outcomes[31:39])


def test_another_seed_gives_other_numbers() -> None:
    ours, theirs = fly_range(SMALL, 0, 20)[0], fly_range(replace(SMALL, seed=8), 0, 20)[0]
    assert not np.any(parameter(ours, "north_m") == parameter(theirs, "north_m"))


def test_what_is_drawn_fills_its_ranges() -> None:
    plan = replace(SMALL, flights=4000, duration_s=0.1, distance_m=(10.0, 20.0), start_s=(0.0, 50.0))
    rows, outcomes = fly_range(plan, 0, plan.flights)
    for name, (low, high) in {"k": (0.5, 2.0), "delay_s": (0.0, 0.1), "start_s": (0.0, 50.0)}.items():
        values = parameter(rows, name)
        assert low <= values.min() < low + 0.01 * (high - low)
        assert high - 0.01 * (high - low) < values.max() < high
        assert np.mean(values) == pytest.approx(0.5 * (low + high), rel=0.05)
    distance = outcome(outcomes, "start_error_m")
    assert distance.min() >= 10.0 - 1e-9
    assert distance.max() <= 20.0 + 1e-9
    # Uniform in volume: half of it is outside the cube root of the mean of the cubes.
    assert np.mean(distance > ((1000.0 + 8000.0) / 2.0) ** (1.0 / 3.0)) == pytest.approx(0.5, abs=0.03)
    attitudes = rows[:, 3:7]
    assert_allclose(np.linalg.norm(attitudes, axis=1), 1.0, atol=1e-12)
    # Of uniform attitudes each component has mean 0 and mean square 1/4.
    assert_allclose(np.mean(attitudes, axis=0), 0.0, atol=0.03)
    assert_allclose(np.mean(attitudes**2, axis=0), 0.25, atol=0.02)
    assert set(plan.varying()) >= {"k", "start_s", "wind_north_m_s", "delay_s", "rate_lag_s", "north_m"}
    for name in set(PARAMETERS) - set(plan.varying()):
        assert np.ptp(parameter(rows, name)) == 0.0 or name == "gust_phase_rad"


def test_no_two_of_what_is_drawn_come_from_one_number() -> None:
    plan = Plan(
        flights=4000,
        duration_s=0.1,
        start_s=(0.0, 6.0),
        k=(0.5, 2.0),
        rho2_per_s=(5.0, 20.0),
        rho3_per_s=(5.0, 20.0),
        beta=(0.5, 2.0),
        speed_min_m_s=(-5.0, 0.0),
        speed_max_m_s=(1.0, 5.0),
        rate_max_rad_s=(1.0, 5.0),
        wind_m_s=(0.0, 1.0),
        gust_m_s=(0.0, 1.0),
        delay_s=(0.0, 0.1),
        rate_lag_s=(0.0, 0.1),
        speed_lag_s=(0.0, 0.1),
        start_speed_m_s=(0.0, 5.0),
        start_rate_rad_s=(0.0, 5.0),
    )
    assert set(plan.varying()) == set(PARAMETERS)
    rows, _ = fly_range(plan, 0, plan.flights)
    together = np.abs(np.corrcoef(rows, rowvar=False)) - np.eye(len(PARAMETERS))
    a, b = np.unravel_index(np.argmax(together), together.shape)
    assert together[a, b] < 0.1, (PARAMETERS[a], PARAMETERS[b])


def test_flights_start_with_a_drawn_speed_and_drawn_rates_about_any_axis() -> None:
    plan = replace(
        SMALL, flights=4000, duration_s=0.1, start_speed_m_s=(-1.0, 5.0), start_rate_rad_s=(2.0, 5.0)
    )
    rows, _ = fly_range(plan, 0, plan.flights)
    rates = np.stack([parameter(rows, name) for name in START_RATES], axis=1)
    magnitude = np.linalg.norm(rates, axis=1)
    for values, (low, high) in (
        (parameter(rows, "start_speed_m_s"), (-1.0, 5.0)),
        (magnitude, (2.0, 5.0)),
    ):
        assert low <= values.min() < low + 0.03
        assert high - 0.03 < values.max() <= high + 1e-12
        assert np.mean(values) == pytest.approx(0.5 * (low + high), rel=0.05)
    axes = rates / magnitude[:, None]
    # Of uniform directions each component has mean 0 and mean square 1/3.
    assert_allclose(np.mean(axes, axis=0), 0.0, atol=0.03)
    assert_allclose(np.mean(axes**2, axis=0), 1.0 / 3.0, atol=0.02)
    assert set(plan.varying()) >= {"start_speed_m_s", *START_RATES}
    assert not set(SMALL.varying()) & {"start_speed_m_s", *START_RATES}


def test_a_planar_flight_starts_with_a_yaw_rate_alone_to_either_side() -> None:
    plan = Plan(flights=1000, planar=True, duration_s=0.1, start_rate_rad_s=(2.0, 5.0))
    roll, pitch, yaw = (parameter(fly_range(plan, 0, plan.flights)[0], name) for name in START_RATES)
    assert_array_equal(roll, 0.0)
    assert_array_equal(pitch, 0.0)
    assert np.all((abs(yaw) >= 2.0) & (abs(yaw) <= 5.0))
    assert np.mean(yaw > 0.0) == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("moving", [{"start_speed_m_s": (4.0, 5.0)}, {"start_rate_rad_s": (4.0, 5.0)}])
@pytest.mark.parametrize(
    ("change", "matters"),
    [
        ({}, False),
        ({"rate_lag_s": (0.2, 0.2), "speed_lag_s": (0.2, 0.2)}, True),
        ({"acceleration_m_s2": 2.0, "turn_acceleration_rad_s2": 5.0}, True),
    ],
)
def test_motion_at_the_start_matters_to_lags_and_to_limits_on_change(
    change: dict[str, Any], matters: bool, moving: dict[str, Any]
) -> None:
    at_rest = Plan(flights=20, law="global", duration_s=2.0, **change)
    ours = fly_range(at_rest, 0, 20)[1]
    theirs = fly_range(replace(at_rest, **moving), 0, 20)[1]
    apart = np.abs(outcome(ours, "final_error_m") - outcome(theirs, "final_error_m"))
    assert apart.min() > 1e-4 if matters else apart.max() == 0.0


@pytest.mark.parametrize(
    "curve",
    [
        Helix(radius_m=2.0, down_m=3.0, levels_off_m=2.0),
        Circle(),
        Line(heading_deg=30.0),
        Zigzag(),
        Lemniscate(),
    ],
)
def test_a_campaigns_reference_is_the_trajectorys(curve: Helix | Circle | Line | Zigzag | Lemniscate) -> None:
    common = Plan(trajectory=curve).common()
    for t in (0.0, 3.3, 40.0, 77.0):
        assert reference_at(common.trajectory, common.shape, t) == sample(curve, t)


def test_every_trajectory_can_be_flown_but_the_eight_whose_arc_length_is_a_table() -> None:
    assert set(TRAJECTORIES) == set(ALL_TRAJECTORIES.values()) - {Eight}
    with pytest.raises(ValueError, match="a campaign cannot fly Eight"):
        Plan(trajectory=Eight())


def test_a_trajectory_that_stops_is_refused() -> None:
    with pytest.raises(ValueError, match="a campaign flies none that stops; leave out stop_at_s"):
        Plan(trajectory=Circle(stop_at_s=10.0))


def test_a_flight_with_delay_and_wind_is_what_law_and_plant_give_in_a_loop_of_their_own() -> None:
    plan = Plan(
        flights=1,
        seed=5,
        law="global",
        duration_s=6.0,
        speed_min_m_s=(0.0, 0.0),
        wind_m_s=(0.4, 0.4),
        delay_s=(0.09, 0.09),
        rate_lag_s=(0.05, 0.05),
        speed_lag_s=(0.1, 0.1),
        start_speed_m_s=(4.0, 4.0),
        start_rate_rad_s=(3.0, 3.0),
        acceleration_m_s2=3.0,
        turn_acceleration_rad_s2=20.0,
    )
    rows, outcomes = fly_range(plan, 0, 1)
    values = dict(zip(PARAMETERS, map(float, rows[0]), strict=True))
    limits = Limits(0.0, 5.0, 5.0, 5.0, 5.0, True, 3.0, 20.0, 20.0, 20.0)
    parameters = Parameters(GLOBAL, PITCH_YAW, Gains(1.0, 10.0, 10.0, 1.0), error_function.PAPER, limits)
    body = PlantParameters(5.0, 5.0, 0.05, 0.1)
    x = (values["north_m"], values["east_m"], values["down_m"])
    attitude = (values["qw"], values["qx"], values["qy"], values["qz"])
    roll, pitch, yaw = (values[name] for name in START_RATES)
    assert math.hypot(roll, pitch, yaw) == pytest.approx(3.0)
    state = PlantState(x, attitude, (roll, pitch, yaw), values["start_speed_m_s"])
    memory = UNSTARTED
    sent = [Controls(0.0, 0.0, 0.0, 0.0)] * 5  # 0.09 s is five steps of 0.02 s
    errors = []
    for n in range(301):
        pose = Pose(Vec3(*state.position_ned_m), Quaternion(*state.attitude_wxyz))
        twist = Twist(Vec3(*state.body_rates_frd_rad_s), Vec3(state.speed_m_s, 0.0, 0.0))
        memory, found = guide_step(parameters, memory, pose, twist, sample(Helix(), 0.02 * n), 0.02)
        errors.append(norm(found.e))
        sent.append(found.controls)
        u = sent.pop(0)
        state = step(body, state, PlantCommand((u.u1, u.u2, u.u3), u.u4), 0.02)
        carried = [
            at + 0.02 * values[f"wind_{axis}_m_s"]
            for at, axis in zip(state.position_ned_m, ("north", "east", "down"), strict=True)
        ]
        state = state._replace(position_ned_m=(carried[0], carried[1], carried[2]))
    assert errors[0] == pytest.approx(outcome(outcomes, "start_error_m")[0], abs=1e-12)
    assert errors[-1] == pytest.approx(outcome(outcomes, "final_error_m")[0], abs=1e-9)
    tail = np.array(errors[225:])
    assert math.sqrt(np.mean(tail**2)) == pytest.approx(outcome(outcomes, "rms_m")[0], abs=1e-9)


def test_a_wind_that_the_law_does_not_know_of_leaves_wind_over_lambda_k() -> None:
    # e' = -lambda k e + w once aligned; the turn of the reference, by which the nose lags, adds a little.
    plan = Plan(flights=20, wind_m_s=(0.05, 0.05), k=(2.0, 2.0), duration_s=60.0, within_m=0.2)
    _, outcomes = fly_range(plan, 0, plan.flights)
    assert np.all(np.isfinite(outcome(outcomes, "settled_s")))
    assert np.all(outcome(outcomes, "rms_m") > 0.025)
    assert np.all(outcome(outcomes, "rms_m") < 0.025 * 1.25)


def test_times_say_when_the_error_was_below_the_radius_first_and_for_good() -> None:
    plan = Plan(flights=8, within_m=5.0, law="global", delay_s=(0.3, 0.3), duration_s=20.0, k=(2.0, 2.0))
    _, outcomes = fly_range(plan, 0, plan.flights)
    entered, settled = outcome(outcomes, "entered_s"), outcome(outcomes, "settled_s")
    came = np.isfinite(settled)
    assert came.sum() >= 4
    assert np.all(settled[came] >= entered[came])
    excursion = outcome(outcomes, "excursion_m")
    assert np.all((settled > entered) == (excursion >= 5.0), where=came)
    # Below the radius from the start is 0 s; never is NaN.
    near = fly_range(replace(plan, distance_m=(0.0, 0.1), within_m=50.0), 0, 4)[1]
    assert_array_equal(outcome(near, "entered_s"), 0.0)
    assert_array_equal(outcome(near, "settled_s"), 0.0)
    short = fly_range(replace(plan, distance_m=(40.0, 50.0), duration_s=1.0), 0, 4)[1]
    assert np.all(np.isnan(outcome(short, "entered_s")))
    assert np.all(np.isnan(outcome(short, "settled_s")))
    assert np.all(np.isnan(outcome(short, "excursion_m")))


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_c_loop_of_the_benchmark_flies_the_same_flights() -> None:
    plan = replace(PLAN, flights=100)
    starts, outcomes = fly_range(plan, 0, plan.flights)
    try:
        loop = c_loop()
    except UnavailableError as reason:
        pytest.skip(str(reason))
    assert difference(outcomes, loop(plan, starts[:, :8], 2)) < 1e-9
    other = replace(plan, k=(1.001, 1.001))
    assert difference(outcomes, loop(other, starts[:, :8], 2)) > 1e-6


def test_a_turn_that_counts_on_less_than_its_slew_leaves_the_rest_for_lag_and_delay() -> None:
    """`SLEW_PART`: counting on all of it, 29 of these 40 turn to and fro past the field and do not settle."""
    plan = Plan(
        flights=40,
        seed=1,
        duration_s=30.0,
        law="global",
        trajectory=Circle(speed_m_s=2.0),
        distance_m=(0.0, 10.0),
        speed_min_m_s=(0.0, 0.0),
        rho2_per_s=(5.0, 5.0),
        rho3_per_s=(5.0, 5.0),
        turn_acceleration_rad_s2=5.0,
        rate_lag_s=(0.1, 0.1),
        delay_s=(0.1, 0.1),
    )
    outcomes = fly_range(plan, 0, 40)[1]
    assert np.max(outcome(outcomes, "settled_s")) < 15.0
    assert np.max(outcome(outcomes, "final_error_m")) < 1e-6
