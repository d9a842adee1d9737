"""The handler of underwater vehicles: what goes beside the law's body rates."""

from __future__ import annotations

import pytest

from guidance.estimate import Estimate
from guidance.estimate.samples import AttitudeSample, PositionSample
from guidance.flying.rates import Rates
from guidance.se3 import ZERO, Pose, Reference, Twist, Vec3, from_yaw, yaw_of
from tests.helpers import make_config

REFERENCE = Reference(Vec3(3.0, 0.0, -10.0), Vec3(0.0, 2.0, 0.0), ZERO)


def turning(at_rad: float, yaw_rate_rad_s: float) -> Estimate:
    """Seen at 1 s, told to turn on; the setpoint arrives and acts at 1.1 s, and is held for 20 ms."""
    rates = Vec3(0.0, 0.0, yaw_rate_rad_s)
    pose = Pose(ZERO, from_yaw(at_rad + 0.1 * yaw_rate_rad_s))
    return Estimate(
        instant_ns=1_100_000_000,
        pose=pose,
        twist=Twist(rates, ZERO),
        attitude=AttitudeSample(1_000_000_000, 0, from_yaw(at_rad), rates, "ATTITUDE_QUATERNION"),
        position=PositionSample(1_000_000_000, 0, ZERO, ZERO, "LOCAL_POSITION_NED"),
        attitude_age_s=0.1,
        position_age_s=0.1,
        seen=pose,
    )


def test_the_attitude_is_the_autopilot_s_own_in_the_middle_of_the_setpoint_s_time() -> None:
    handler = Rates(make_config("link.rate_hz=50"), planar=False)
    estimate = turning(0.3, 1.0)
    for demand in (handler.step(estimate, REFERENCE, 0.02).demand, handler.neutral(estimate)):
        assert yaw_of(demand.attitude) == pytest.approx(0.3 + 0.110, abs=1e-9)


def test_it_is_compared_before_slow_actuators_act() -> None:
    handler = Rates(make_config("link.rate_hz=50", "link.actuation_delay_s=0.06"), planar=False)
    assert yaw_of(handler.neutral(turning(0.3, 1.0)).attitude) == pytest.approx(0.3 + 0.050, abs=1e-9)


def test_what_is_left_of_a_reset_is_not_in_it() -> None:
    """The law's pose may be turned while a jump is blended; the autopilot compares with its own."""
    handler = Rates(make_config("link.rate_hz=50"), planar=False)
    blended = turning(0.3, 1.0)._replace(pose=Pose(ZERO, from_yaw(1.5)))
    assert yaw_of(handler.neutral(blended).attitude) == pytest.approx(0.3 + 0.110, abs=1e-9)
