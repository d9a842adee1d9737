"""PX4's rover: what it makes of a velocity, and the velocities that drive it along its tasks."""

from __future__ import annotations

from math import atan2, cos, hypot, pi, radians, sin
from pathlib import Path

import pytest

from guidance.config import load
from guidance.estimate import Estimate
from guidance.estimate.samples import AttitudeSample, PositionSample
from guidance.flying.ground import Px4Rover
from guidance.flying.ground_fit import fitted, px4_allows, px4_rover
from guidance.handling.ground import Demand, Parameters
from guidance.handling.rover_px4 import (
    STANDING_M_S,
    Autopilot,
    turning_radius_m,
    velocity_of,
    yaw_rate_max_rad_s,
)
from guidance.prediction import Acting, History, predict
from guidance.se3 import ZERO, Pose, Reference, Twist, Vec3, from_yaw
from sitl.models.files import load_rover
from sitl.models.rover import at_rest, steered, step, told

DEPLOY = Path(__file__).parents[1] / "deploy" / "px4-rover.toml"
#: Of PX4's simulated Ackermann rover.
VALUES = {
    "RO_SPEED_LIM": 3.0,
    "RO_ACCEL_LIM": 3.0,
    "RO_YAW_P": 5.0,
    "RO_YAW_RATE_LIM": 180.0,
    "RO_YAW_ACCEL_LIM": 400.0,
    "RA_WHEEL_BASE": 0.321,
    "RA_MAX_STR_ANG": 0.5236,
}
RATE_GAIN = VALUES["RO_YAW_P"]
ACKERMANN = Autopilot(**VALUES)
DIFFERENTIAL = Autopilot(RO_YAW_P=5.0, RD_TRANS_DRV_TRN=0.175)
MODEL = load_rover("rover_px4")
RATE = radians(ACKERMANN.RO_YAW_RATE_LIM)


def test_asked_for_1_5_it_drives_2_05() -> None:
    """As measured: its feed-forward is too strong, and nothing corrects it."""
    state = told(MODEL, at_rest(0.0, 0.0, 0.0), 0.0, 1.5)
    for _ in range(1000):
        state = step(MODEL, state, 0.0, 0.0, 0.004)
    assert state.speed_m_s == pytest.approx(2.05, abs=0.05)


def test_it_steers_to_the_bearing_of_a_velocity_and_never_reverses() -> None:
    assert steered(5.0, 3.0, 0.5, cos(0.6), sin(0.6)) == pytest.approx((0.5, 1.0))
    assert steered(5.0, 3.0, 0.5, 2.0 * cos(0.3), 2.0 * sin(0.3)) == pytest.approx((-1.0, 2.0))
    # the short way round, and within its rate
    assert steered(5.0, 3.0, 3.0, cos(-3.0), sin(-3.0))[0] == pytest.approx(5.0 * (2.0 * pi - 6.0))
    assert steered(5.0, 3.0, 0.0, -1.0, 0.1) == pytest.approx((3.0, hypot(1.0, 0.1)))
    # nothing is the bearing 0
    assert steered(5.0, 3.0, 0.2, 0.0, 0.0) == pytest.approx((-1.0, 0.0))


@pytest.mark.parametrize("heading", [0.0, 2.0, -3.0])
@pytest.mark.parametrize("yaw_rate", [-1.5, 0.0, 0.3])
def test_a_velocity_says_a_yaw_rate_and_a_speed(heading: float, yaw_rate: float) -> None:
    v = velocity_of(ACKERMANN, Demand(yaw_rate, 1.2), heading)
    assert steered(ACKERMANN.RO_YAW_P, RATE, heading, v.x, v.y) == pytest.approx((yaw_rate, 1.2))
    assert v.z == 0.0


@pytest.mark.parametrize("heading", [0.7, -2.0])
def test_what_stands_is_told_where_it_heads_not_north(heading: float) -> None:
    v = velocity_of(DIFFERENTIAL, Demand(0.0, 0.0), heading)
    assert atan2(v.y, v.x) == pytest.approx(heading)
    assert hypot(v.x, v.y) == pytest.approx(STANDING_M_S)


def test_a_differential_rover_is_not_made_to_turn_on_the_spot_while_it_drives() -> None:
    most = yaw_rate_max_rad_s(DIFFERENTIAL)
    # the law knows that it gets no more
    assert most < DIFFERENTIAL.RD_TRANS_DRV_TRN * DIFFERENTIAL.RO_YAW_P
    for yaw_rate in (most, 100.0):
        v = velocity_of(DIFFERENTIAL, Demand(yaw_rate, 1.0), 0.0)
        assert atan2(v.y, v.x) < DIFFERENTIAL.RD_TRANS_DRV_TRN
    assert turning_radius_m(DIFFERENTIAL) == 0.0


def fitted_to(values: dict[str, float], *settings: str) -> Parameters:
    autopilot = px4_rover({**values})
    assert not isinstance(autopilot, str)
    return fitted(load(DEPLOY, settings), ZERO, px4_allows(autopilot))


def test_the_tighter_of_configuration_and_autopilot_holds() -> None:
    p = fitted_to(VALUES)
    assert (p.law.limits.speed_max_m_s, p.law.limits.yaw_rate_rad_s) == (3.0, 2.6)
    assert p.law.limits.acceleration_m_s2 == 2.8
    assert p.crawl_m_s == pytest.approx(0.556 * 2.6, abs=1e-3)
    assert p.lateral_acceleration_m_s2 == 3.0
    gentle = fitted_to({**VALUES, "RO_YAW_RATE_LIM": 30.0, "RO_SPEED_LIM": 1.5, "RO_ACCEL_LIM": 1.0})
    assert gentle.law.limits.yaw_rate_rad_s == pytest.approx(radians(30.0))
    assert gentle.crawl_m_s == pytest.approx(0.556 * radians(30.0), abs=1e-3)
    assert gentle.law.limits.speed_max_m_s == 1.5
    assert gentle.law.limits.acceleration_m_s2 == pytest.approx(0.95)
    assert fitted_to(VALUES, "ground.turning_radius_m=0.2").crawl_m_s == pytest.approx(0.52)


def test_a_build_has_the_parameters_of_every_rover_and_those_that_are_set_count() -> None:
    everything = {**VALUES, "RD_WHEEL_TRACK": 0.0, "RD_TRANS_DRV_TRN": 0.1745}
    assert px4_rover(everything) == ACKERMANN
    differential = {"RO_YAW_P": 5.0, "RA_WHEEL_BASE": 0.0, "RD_WHEEL_TRACK": 0.5, "RD_TRANS_DRV_TRN": 0.175}
    assert px4_rover(differential) == Autopilot(5.0, RD_TRANS_DRV_TRN=0.175)
    assert fitted_to(differential).crawl_m_s == 0.0


@pytest.mark.parametrize(
    ("missing", "said"),
    [
        (("RO_YAW_P",), "RO_YAW_P"),
        (("RA_WHEEL_BASE",), "neither RA_WHEEL_BASE"),
        (("RA_MAX_STR_ANG",), "neither RA_WHEEL_BASE"),
    ],
)
def test_a_rover_that_does_not_say_how_it_turns_is_refused(missing: tuple[str, ...], said: str) -> None:
    values = {name: value for name, value in VALUES.items() if name not in missing}
    handler = Px4Rover(load(DEPLOY))
    assert said in (handler.fit({**values, "RD_TRANS_DRV_TRN": 0.1745}) or "")
    assert handler.fit(VALUES) is None


def test_an_ackermann_rover_without_a_speed_of_full_throttle_is_refused() -> None:
    """`AckermannRateControl::runSanityChecks` (1.16 to main of 2026-03): it would not steer."""
    handler = Px4Rover(load(DEPLOY))
    assert "RO_MAX_THR_SPEED must be above 0" in (handler.fit({**VALUES, "RO_MAX_THR_SPEED": 0.0}) or "")
    assert handler.fit({**VALUES, "RO_MAX_THR_SPEED": 3.2}) is None


def test_a_trajectory_that_it_cannot_drive_is_refused_with_numbers() -> None:
    handler = Px4Rover(load(DEPLOY))
    why = handler.fit({**VALUES, "RO_YAW_RATE_LIM": 5.0})
    assert why is not None
    assert "yaw rate: 0.2 rad/s needed" in why
    assert "0.087266 rad/s available" in why


def seen(heading: float, yaw_rate: float, history: History = (), speed_m_s: float = 0.0) -> Estimate:
    """Seen 40 ms ago at this heading; a setpoint comes in 20 ms, is held for 20, acts after 100."""
    now_ns, acts_ns = 1_000_000_000, 1_120_000_000
    at = now_ns - 40_000_000
    rates = Vec3(0.0, 0.0, yaw_rate)
    q = from_yaw(heading)
    pose = Pose(ZERO, q)
    led, twist = predict(history, pose, Twist(rates, Vec3(speed_m_s, 0.0, 0.0)), at, acts_ns)
    return Estimate(
        instant_ns=acts_ns,
        pose=led,
        twist=twist,
        attitude=AttitudeSample(at, 0, q, rates, "ATTITUDE_QUATERNION"),
        position=PositionSample(at, 0, ZERO, ZERO, "LOCAL_POSITION_NED"),
        attitude_age_s=0.16,
        position_age_s=0.16,
        seen=pose,
        history=history,
    )


def test_the_bearing_is_off_the_heading_while_the_setpoint_is_held() -> None:
    handler = Px4Rover(load(DEPLOY))
    assert handler.fit(VALUES) is None
    v = handler.neutral(seen(0.5, 1.0)).velocity_ned_m_s
    assert atan2(v.y, v.x) == pytest.approx(0.57)
    # from half of the way on it turns by the setpoint that acts by then
    v = handler.neutral(seen(0.5, 1.0, (Acting(990_000_000, Vec3(0.0, 0.0, 2.0)),))).velocity_ned_m_s
    assert atan2(v.y, v.x) == pytest.approx(0.5 + 0.03 + 0.08)


def test_it_asks_for_the_laws_turn_off_that_heading() -> None:
    handler = Px4Rover(load(DEPLOY))
    assert handler.fit(VALUES) is None
    estimate = seen(0.5, 1.0, speed_m_s=1.0)
    flown = handler.step(estimate, Reference(Vec3(5.0, 1.0, 0.0), Vec3(1.0, 0.0, 0.0), ZERO), 0.02)
    v = flown.demand.velocity_ned_m_s
    asked = RATE_GAIN * (atan2(v.y, v.x) - 0.57)
    assert asked == pytest.approx(flown.acting_rates_frd_rad_s.z)
    assert abs(asked) > 0.01
    assert flown.demand.body_rates_frd_rad_s == ZERO
