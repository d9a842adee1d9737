"""The step of a ground vehicle as a whole: compiled, in any frame, in every state, and part by part."""

from __future__ import annotations

from math import cos, isfinite, pi, sin
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import guidance
from guidance.allocation import PITCH_YAW
from guidance.config import load
from guidance.flying.ground import ground_parameters
from guidance.flying.ground_fit import ERROR_S, ardupilot_allows, fitted
from guidance.handling.ground import UNSTARTED, Demand, Measured, Memory, Parameters, ground_step
from guidance.handling.waiting import ON_TIME
from guidance.law import GLOBAL, Gains, Limits, guide_step
from guidance.law import UNSTARTED as LAW_UNSTARTED
from guidance.law import Parameters as Law
from guidance.se3 import ZERO, Pose, Reference, Twist, Vec3, from_euler, from_yaw
from sitl.compiled import compiled
from tests.strategies import properties, reals, vectors

DEPLOY = Path(guidance.__file__).parents[1] / "deploy" / "ardupilot-rover.toml"
#: ArduPilot's autotest values.
VALUES = {
    "WP_SPEED": 5.0,
    "ATC_ACCEL_MAX": 1.0,
    "ATC_STR_ACC_MAX": 120.0,
    "ATC_STR_RAT_MAX": 120.0,
    "ATC_TURN_MAX_G": 0.6,
    "TURN_RADIUS": 0.9,
}
ROVER = ground_parameters(load(DEPLOY, ["ground.waits=true"]), ZERO, VALUES)
#: Nothing around the law.
BARE = ground_parameters(
    load(
        DEPLOY,
        [
            "ground.crawl_m_s=0",
            "ground.lateral_acceleration_max_m_s2=1e9",
            "ground.yaw_gain=1",
            "ground.smoothing_s=0",
            "ground.slip_max_deg=0",
            "ground.speed_kp=0",
            "ground.speed_ki_per_s=0",
        ],
    ),
    ZERO,
    {},
)
DT = 0.02


def measured(
    north_m: float, east_m: float, yaw_rad: float, forward_m_s: float = 0.0, right_m_s: float = 0.0
) -> Measured:
    twist = Twist(Vec3(0.0, 0.0, 0.1), Vec3(forward_m_s, right_m_s, 0.0))
    return Measured(Pose(Vec3(north_m, east_m, 0.0), from_yaw(yaw_rad)), twist, 0.1)


def reference(n: int) -> Reference:
    w = 0.2
    t = n * DT
    return Reference(
        Vec3(10.0 * cos(w * t), 10.0 * sin(w * t), 0.0),
        Vec3(-2.0 * sin(w * t), 2.0 * cos(w * t), 0.0),
        Vec3(-0.4 * cos(w * t), -0.4 * sin(w * t), 0.0),
    )


def flat(value: object) -> list[float]:
    """All numbers of nested tuples."""
    if isinstance(value, tuple):
        return [number for item in value for number in flat(item)]
    assert isinstance(value, int | float)
    return [float(value)]


@pytest.mark.parametrize(("profile", "error_s"), [("px4-rover", ERROR_S), ("ardupilot-rover", 0.0)])
def test_only_px4_s_velocity_is_taken_to_be_wrong(profile: str, error_s: float) -> None:
    found = fitted(load(DEPLOY.with_name(f"{profile}.toml")), ZERO, ardupilot_allows(VALUES))
    assert found.smoothing.error_s == error_s


def test_an_ardupilot_rover_that_brakes_slower_than_it_speeds_up_is_taken_at_that() -> None:
    """ATC_DECEL_MAX bounds what slows it (`get_desired_speed_accel_limited`); 0 is as ATC_ACCEL_MAX."""
    assert ardupilot_allows({"ATC_ACCEL_MAX": 1.0, "ATC_DECEL_MAX": 0.4}).acceleration_m_s2 == 0.4
    assert ardupilot_allows({"ATC_ACCEL_MAX": 1.0, "ATC_DECEL_MAX": 3.0}).acceleration_m_s2 == 1.0
    assert ardupilot_allows({"ATC_ACCEL_MAX": 1.0}).acceleration_m_s2 == 1.0
    assert ardupilot_allows({"ATC_DECEL_MAX": 2.0}).acceleration_m_s2 == 2.0


@pytest.mark.timeout(120)  # it compiles
@pytest.mark.parametrize("parameters", [ROVER, BARE], ids=["rover", "bare"])
def test_compiled_it_is_the_same(parameters: Parameters) -> None:
    fast = compiled(ground_step)
    memory = same = UNSTARTED
    for n in range(200):
        at = measured(15.0 - 0.03 * n, 3.0, -2.0 + 0.03 * n, min(0.05 * n, 2.0), 0.05)
        memory, *found = ground_step(parameters, memory, at, reference(n), DT)
        same, *others = fast(parameters, same, at, reference(n), DT)
        assert flat(tuple(others)) == pytest.approx(flat(tuple(found)), rel=1e-9, abs=1e-9)
    assert flat(same) == pytest.approx(flat(memory), rel=1e-9, abs=1e-9)


@properties
@given(
    vectors(1e6), reals(10.0), vectors(1e3), vectors(1e6), vectors(1e3), vectors(1e3), st.floats(1e-4, 1.0)
)
def test_every_state_has_a_demand_within_the_limits(
    position: Vec3, yaw_rad: float, velocity: Vec3, at: Vec3, r_dot: Vec3, r_ddot: Vec3, dt: float
) -> None:
    seen = Measured(Pose(position, from_yaw(yaw_rad)), Twist(Vec3(0.0, 0.0, 0.0), velocity), 0.0)
    memory = UNSTARTED
    for _ in range(3):
        memory, demand, around = ground_step(ROVER, memory, seen, Reference(at, r_dot, r_ddot), dt)
        limits = ROVER.law.limits
        assert 0.0 <= demand.speed_m_s <= limits.speed_max_m_s
        assert abs(demand.yaw_rate_rad_s) <= limits.yaw_rate_rad_s
        assert all(map(isfinite, flat((memory, around))))


def test_with_all_switched_off_it_is_the_law() -> None:
    limits = Limits(-1e3, 1e3, 0.0, 0.0, 1e3)
    law = Law(GLOBAL, PITCH_YAW, Gains(1.0, 3.0, 3.0, 1.0), ROVER.law.error_function, limits)
    bare = BARE._replace(law=law)
    at = measured(12.0, 1.0, 1.2, 1.5)
    _, demand, around = ground_step(bare, UNSTARTED, at, reference(0), DT)
    _, found = guide_step(law, LAW_UNSTARTED, at.pose, at.twist, reference(0), DT)
    # but for the rounding of a heading that went through its quaternion
    assert flat(around.law) == pytest.approx(flat(found), rel=1e-12)
    assert demand == Demand(around.law.controls.u3, around.law.controls.u4)


def test_height_and_tilt_do_not_matter() -> None:
    level = ground_step(ROVER, UNSTARTED, measured(12.0, 1.0, 1.2, 1.5), reference(0), DT)[1]
    tilted = Measured(
        Pose(Vec3(12.0, 1.0, -7.0), from_euler(0.0, 0.05, 1.2)),
        Twist(Vec3(0.0, 0.0, 0.1), Vec3(1.5, 0.0, 0.0)),
        0.1,
    )
    demand = ground_step(ROVER, UNSTARTED, tilted, reference(0), DT)[1]
    assert demand == pytest.approx(level, abs=1e-9)


def test_turning_the_world_turns_nothing_of_the_demand() -> None:
    memory = turned_memory = UNSTARTED
    angle = 2.1
    c, s = cos(angle), sin(angle)

    def turned(v: Vec3) -> Vec3:
        return Vec3(c * v.x - s * v.y, s * v.x + c * v.y, v.z)

    for n in range(100):
        at = measured(14.0 - 0.02 * n, 2.0, 0.3 + 0.01 * n, 0.02 * n)
        r = reference(n)
        memory, demand, _ = ground_step(ROVER, memory, at, r, DT)
        p = at.pose.position
        there = Measured(Pose(turned(p), from_yaw(0.3 + 0.01 * n + angle)), at.twist, 0.1)
        turned_memory, same, _ = ground_step(ROVER, turned_memory, there, Reference(*map(turned, r)), DT)
        assert same == pytest.approx(demand, abs=1e-9)


def test_at_rest_facing_away_it_is_told_to_drive_and_to_turn() -> None:
    memory: Memory = UNSTARTED
    for _ in range(50):
        memory, demand, around = ground_step(ROVER, memory, measured(25.0, 0.0, 0.0), reference(0), DT)
    assert around.crawling
    assert demand.speed_m_s > 0.5
    assert abs(demand.yaw_rate_rad_s) > 1.0


def test_what_cannot_turn_at_rest_is_not_asked_to() -> None:
    """It would look like a vehicle that obeys nothing, and end the flight."""
    goal = Reference(Vec3(0.0, 0.0, 0.0), ZERO, ZERO)
    turning = ROVER._replace(crawl_m_s=0.0)
    memory: Memory = UNSTARTED
    same: Memory = UNSTARTED
    for _ in range(100):
        memory, demand, _ = ground_step(ROVER, memory, measured(-0.2, 0.2, pi), goal, DT)
        same, other, _ = ground_step(turning, same, measured(-0.2, 0.2, pi), goal, DT)
    assert demand == Demand(0.0, 0.0)
    assert abs(other.yaw_rate_rad_s) > 0.5


def test_the_reference_that_is_tracked_runs_on_the_clock_that_waits() -> None:
    memory = UNSTARTED
    for _ in range(100):
        waited = memory.waiting.waited_s
        memory, _, around = ground_step(ROVER, memory, measured(10.0, -5.0, 0.5 * pi), reference(0), DT)
        assert memory.waiting.waited_s > waited
    assert around.clock_rate == ROVER.waiting.slowest
    assert around.reference.velocity.y == pytest.approx(2.0 * ROVER.waiting.slowest)
    assert UNSTARTED.waiting == ON_TIME


def test_a_clock_that_slows_is_an_acceleration_of_the_reference() -> None:
    _, _, around = ground_step(ROVER, UNSTARTED, measured(10.0, -5.0, 0.5 * pi), reference(0), DT)
    assert around.reference.acceleration.y == pytest.approx(-2.0 * ROVER.waiting.falls_per_s)


def test_too_fast_a_turn_is_driven_more_slowly_and_the_next_step_knows() -> None:
    fast = measured(-30.0, 0.0, -pi / 3.0, 4.0)
    memory, demand, around = ground_step(ROVER, UNSTARTED, fast, reference(0), DT)
    speed = demand.speed_m_s - around.speed_correction_m_s
    assert around.slowed
    assert speed < around.law.controls.u4 - 0.5
    assert memory.law.controls.u4 == pytest.approx(speed)


@pytest.mark.parametrize(
    ("values", "yaw_rate", "crawl"),
    [
        ({}, 2.0, 1.8),
        ({"ATC_STR_RAT_MAX": 0.0}, 2.0, 1.8),
        ({"ATC_STR_RAT_MAX": 90.0}, 0.5 * pi, 0.45 * pi),
        ({"WP_SPEED": 1.0}, 2.0, 1.0),
    ],
)
def test_the_tighter_of_configuration_and_autopilot_holds(
    values: dict[str, float], yaw_rate: float, crawl: float
) -> None:
    found = ground_parameters(load(DEPLOY), ZERO, {**VALUES, **values})
    assert found.law.limits.yaw_rate_rad_s == pytest.approx(yaw_rate)
    assert found.crawl_m_s == pytest.approx(crawl)
    assert found.lateral_acceleration_m_s2 == pytest.approx(0.7 * 9.81 * 0.6)
    assert found.law.limits.acceleration_m_s2 == pytest.approx(0.95)
