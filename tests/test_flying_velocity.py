"""The handler of copters: what it takes of the configuration and the autopilot, and what it measures."""

from __future__ import annotations

from math import pi, radians
from pathlib import Path

import pytest

from guidance.config import Config, ConfigError, load
from guidance.estimate import Estimate
from guidance.estimate.samples import AttitudeSample, PositionSample
from guidance.flying.velocity import Velocity, measured
from guidance.flying.velocity_fit import fitted
from guidance.handling.velocity import Parameters
from guidance.mavlink.setpoints import Demand
from guidance.records import VelocityHandling
from guidance.se3 import ZERO, Pose, Reference, Twist, Vec3, from_euler, rotate, yaw_of

DEPLOY = Path(__file__).parents[1] / "deploy"
PX4 = {"MPC_XY_VEL_MAX": 12.0, "MPC_Z_VEL_MAX_UP": 3.0, "MPC_Z_VEL_MAX_DN": 1.5, "MPC_ACC_HOR": 3.0}
ARDUPILOT = {"WP_SPD": 10.0, "WP_SPD_UP": 2.5, "WP_SPD_DN": 1.5, "WP_ACC": 2.5, "WP_ACC_Z": 1.0}
REFERENCE = Reference(Vec3(3.0, 0.0, -10.0), Vec3(0.0, 2.0, 0.0), ZERO)


def shipped(profile: str = "px4-copter", *settings: str) -> Config:
    return load(DEPLOY / f"{profile}.toml", settings)


def parameters(config: Config, values: dict[str, float]) -> Parameters:
    found = fitted(config, ZERO, values)
    assert not isinstance(found, str)
    return found


def seen(
    position: Vec3, velocity: Vec3, yaw: float = 0.0, yaw_rate: float = 0.0, roll: float = 0.0
) -> Estimate:
    """100 ms before the instant at which the demand acts."""
    rates = Vec3(0.0, 0.0, yaw_rate)
    q = from_euler(roll, 0.0, yaw)
    pose = Pose(position, q)
    return Estimate(
        instant_ns=1_100_000_000,
        pose=pose,
        twist=Twist(rates, ZERO),
        attitude=AttitudeSample(1_000_000_000, 0, q, rates, "ATTITUDE_QUATERNION"),
        position=PositionSample(1_000_000_000, 0, position, velocity, "LOCAL_POSITION_NED"),
        attitude_age_s=0.1,
        position_age_s=0.1,
        seen=pose,
    )


def test_the_tighter_of_configuration_and_autopilot_holds() -> None:
    p = parameters(shipped(), PX4)
    assert (p.limits.speed_max_m_s, p.up_max_m_s, p.down_max_m_s) == (5.0, 3.0, 1.5)
    assert p.limits.acceleration_m_s2 == pytest.approx(0.9 * 3.0)
    assert p.limits.yaw_rate_rad_s == pytest.approx(radians(60.0))  # PX4's default
    assert p.limits.yaw_acceleration_rad_s2 == 1.5
    slow = parameters(shipped(), {**PX4, "MPC_XY_VEL_MAX": 2.0, "MC_YAWRATE_MAX": 20.0})
    assert slow.limits.speed_max_m_s == 2.0
    assert slow.limits.yaw_rate_rad_s == pytest.approx(radians(20.0))
    own = parameters(
        shipped(
            "px4-copter",
            "copter.up_max_m_s=1",
            "copter.down_max_m_s=0.5",
            "limits.acceleration_max_m_s2=1",
            "limits.yaw_acceleration_max_rad_s2=0.5",
            "law.error_function.vertical_m_s=0.4",
        ),
        PX4,
    )
    assert (own.up_max_m_s, own.down_max_m_s) == (1.0, 0.5)
    assert own.limits.acceleration_m_s2 == 0.9
    assert own.limits.yaw_acceleration_rad_s2 == 0.5
    ardu = parameters(shipped("ardupilot-copter"), {**ARDUPILOT, "ATC_RATE_Y_MAX": 30.0})
    assert ardu.limits.acceleration_m_s2 == pytest.approx(0.9 * 2.5)
    assert ardu.limits.yaw_rate_rad_s == pytest.approx(radians(30.0))


def test_the_law_and_the_section_are_used() -> None:
    p = parameters(
        shipped(
            "px4-copter",
            "law.k=0.5",
            "law.beta=2",
            "law.rho3_per_s=0.7",
            "copter.heading=held",
            "copter.slow_m_s=0.6",
            "copter.drag_per_s=1.1",
            "copter.learns=false",
            "copter.short_gain=0.2",
            "copter.smoothing_s=0",
            "copter.stuck_s=9",
            "copter.waits=true",
        ),
        PX4,
    )
    assert (p.gains.k, p.gains.beta, p.gains.rho3) == (0.5, 2.0, 0.7)
    assert (p.follows, p.slow_m_s, p.drag_per_s) == (False, 0.6, 1.1)
    assert (p.response.per_s, p.response.kp) == (0.0, 0.2)
    assert (p.smoothing.time_constant_s, p.stuck.after_s) == (0.0, 9.0)
    assert p.waiting.slowest < 1.0


def test_the_loops_gains_are_the_autopilots() -> None:
    p = parameters(
        shipped(), {**PX4, "MPC_XY_VEL_P_ACC": 3.0, "MPC_XY_VEL_I_ACC": 0.5, "MPC_XY_VEL_D_ACC": 0.5}
    )
    assert p.response.level.lag_s == pytest.approx(0.5)
    assert p.response.level.washout_s == pytest.approx(6.0)
    ardu = parameters(shipped("ardupilot-copter"), {**ARDUPILOT, "PSC_NE_JERK": 10.0})
    assert ardu.response.level.lag_s == pytest.approx(0.25)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({}, "neither MPC_XY_VEL_MAX nor WP_SPD"),
        ({**PX4, "MPC_XY_VEL_P_ACC": 0.0}, "MPC_XY_VEL_P_ACC"),
        ({**PX4, "MPC_XY_VEL_MAX": 1.0}, "horizontal speed: 3 m/s needed"),
        ({**PX4, "MPC_ACC_HOR": 0.5}, "horizontal acceleration: 0.9 m/s^2 needed"),
    ],
)
def test_what_cannot_be_flown_is_refused_with_numbers(values: dict[str, float], said: str) -> None:
    handler = Velocity(shipped())
    why = handler.fit(values)
    assert why is not None
    assert said in why
    assert handler.fit(PX4) is None


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (("limits.speed_max_m_s=2",), "horizontal speed"),
        (("limits.acceleration_max_m_s2=0.5",), "horizontal acceleration"),
        (("trajectory.name=helix", "trajectory.down_m_s=-2", "copter.up_max_m_s=1"), "climb: 2 m/s"),
    ],
)
def test_the_configuration_alone_refuses_it_too(settings: tuple[str, ...], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        shipped("px4-copter", *settings)


def test_the_section_is_for_copters_alone() -> None:
    with pytest.raises(ConfigError, match="is no copter"):
        load(DEPLOY / "px4-uuv.toml", ["copter.waits=true"])
    with pytest.raises(ConfigError, match=r"ground\.enabled = false"):
        load(DEPLOY / "px4-rover.toml", ["ground.enabled=false"])


def test_a_copter_that_is_told_nothing_yet_stands() -> None:
    assert Velocity(shipped()).neutral(seen(ZERO, ZERO)) == Demand()


def test_the_pose_is_led_by_the_velocity_that_turns_with_the_nose_and_not_with_the_tilt() -> None:
    found = measured(seen(Vec3(1.0, 2.0, -3.0), Vec3(2.0, 0.0, 0.5), yaw=0.5 * pi, roll=0.3))
    assert found.pose.position == pytest.approx((1.2, 2.0, -2.95))
    assert rotate(found.pose.attitude, found.twist.linear) == pytest.approx((2.0, 0.0, 0.5))
    turning = measured(seen(ZERO, Vec3(2.0, 0.0, 0.0), yaw_rate=1.0))
    assert yaw_of(turning.pose.attitude) == pytest.approx(0.1)
    assert turning.pose.position.y == pytest.approx(2.0 * 0.5 * 0.1**2, rel=0.01)
    assert turning.seen_yaw_rate_rad_s == 1.0


def test_a_step_asks_for_a_velocity_and_says_why() -> None:
    handler = Velocity(shipped())
    assert handler.fit(PX4) is None
    handler.start()
    flown = handler.step(seen(Vec3(3.0, -0.2, -10.0), Vec3(0.0, 2.0, 0.0), 0.5 * pi), REFERENCE, 0.0)
    assert flown.demand.velocity_ned_m_s.y > 1.9
    assert flown.demand.body_rates_frd_rad_s == ZERO
    assert isinstance(flown.around, VelocityHandling)
    assert flown.around.heading_rad == pytest.approx(0.5 * pi, abs=0.2)
    assert not flown.around.stuck


def test_the_record_s_clock_is_that_of_its_step() -> None:
    handler = Velocity(shipped("px4-copter", "copter.waits=true"))
    assert handler.fit(PX4) is None
    handler.start()
    for _ in range(5):
        waited_s = handler.waited_s
        around = handler.step(seen(Vec3(3.0, -4.0, -10.0), ZERO), REFERENCE, 0.02).around
        assert isinstance(around, VelocityHandling)
        assert around.waited_s == waited_s
    assert handler.waited_s > waited_s > 0.0


def test_a_jump_of_the_frame_moves_what_is_remembered() -> None:
    jump = Vec3(0.4, 0.0, 0.0)
    errors = []
    for told in (True, False):
        handler = Velocity(shipped())
        assert handler.fit(PX4) is None
        handler.start()
        for _ in range(5):
            handler.step(seen(ZERO, ZERO), REFERENCE, 0.02)
        if told:
            handler.shifted(jump)
        errors.append(handler.step(seen(jump, ZERO), REFERENCE, 0.02).evaluation.e.x)
    assert errors[0] == pytest.approx(0.4 - 3.0, abs=1e-6)
    assert errors[1] < errors[0] - 0.3


def test_what_it_learned_is_for_one_flight() -> None:
    handler = Velocity(shipped())
    assert handler.learned == ""
    assert handler.recall("{}") is not None
    assert handler.waited_s == 0.0
