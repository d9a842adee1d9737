"""PX4's rover: what it makes of a velocity, and the velocities that drive it along its tasks."""

from __future__ import annotations

from math import atan2, cos, hypot, pi, radians, sin

import pytest

from guidance.handling.ground import Demand
from guidance.handling.rover_px4 import STANDING_M_S, Autopilot, handling, velocity_of
from sitl.models.files import load_rover
from sitl.models.rover import at_rest, steered, step, told

ACKERMANN = Autopilot()
DIFFERENTIAL = Autopilot(RA_WHEEL_BASE=0.0, RA_MAX_STR_ANG=0.0, RD_TRANS_DRV_TRN=0.175)
MODEL = load_rover("rover_px4")
DELAY_S = 0.1
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
    p = handling(DIFFERENTIAL, DELAY_S)
    most = p.law.limits.yaw_rate_rad_s
    # the law knows that it gets no more
    assert most < DIFFERENTIAL.RD_TRANS_DRV_TRN * DIFFERENTIAL.RO_YAW_P
    v = velocity_of(DIFFERENTIAL, Demand(most, 1.0), 0.0)
    assert atan2(v.y, v.x) < DIFFERENTIAL.RD_TRANS_DRV_TRN
    v = velocity_of(DIFFERENTIAL, Demand(100.0, 1.0), 0.0)
    assert atan2(v.y, v.x) < DIFFERENTIAL.RD_TRANS_DRV_TRN
    assert p.crawl_m_s == 0.0


def test_an_ackermann_rover_crawls_where_it_must_turn() -> None:
    p = handling(ACKERMANN, DELAY_S)
    assert p.crawl_m_s == 0.5 * ACKERMANN.RO_SPEED_LIM
    gentle = Autopilot(RO_YAW_RATE_LIM=30.0)
    assert handling(gentle, DELAY_S).crawl_m_s == pytest.approx(0.556 * radians(30.0), abs=1e-3)
