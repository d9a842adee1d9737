"""An airplane's handling from its autopilot's parameters: flight mechanics, refusals, and flights."""

from __future__ import annotations

from math import inf, nan, radians

import pytest

from guidance.handling import airplane_throttle, waiting
from guidance.handling.airplane_bank import GRAVITY_M_S2
from guidance.handling.airplane_defaults import Airframe, handling, patience
from sitl.airplane_flight import fly
from sitl.airplane_tasks import (
    AIRFRAME_12,
    AIRFRAME_20,
    Airplane,
    airplane_12,
    airplane_20,
    figures,
    flown,
    scenarios,
)
from sitl.compiled import compiled

FRAMES = {12: (airplane_12(), AIRFRAME_12), 20: (airplane_20(), AIRFRAME_20)}


@pytest.fixture(scope="module", autouse=True)
def _machine_code() -> None:
    """Compiled once, before a test's time runs."""
    flown(FRAMES[12][0], scenarios(12.0)["circle 100 m"]._replace(duration_s=1.0), 0, compiled(fly))


@pytest.mark.parametrize("frame", [AIRFRAME_12, AIRFRAME_20])
def test_both_throttles_are_those_of_the_airframe(frame: Airframe) -> None:
    guide = handling(frame)
    v = frame.airspeed_cruise_m_s
    level = airplane_throttle.throttle_for(guide.throttle, 0.0, 0.0, v, 0.0, 1.0, 0.0, False, 0.02)
    assert level.throttle == pytest.approx(frame.throttle_cruise)
    steepest = airplane_throttle.steepest_sine(guide.throttle, 0.0, v, 1.0)
    climb = min(frame.climb_full_m_s, 0.5 * v)
    assert v * steepest == pytest.approx(climb)
    alpha = guide.pitch.alpha_zero_rad + guide.pitch.alpha_per_load_rad_m2_s2 / (v * v)
    assert alpha == pytest.approx(frame.pitch_cruise_rad)


def test_a_sluggish_airframe_is_asked_gently() -> None:
    quick, slow = handling(AIRFRAME_20), handling(AIRFRAME_20._replace(lag_s=1.0))
    heavy = handling(AIRFRAME_20._replace(throttle_lag_s=1.5))
    assert slow.rho_per_s < quick.rho_per_s
    assert heavy.rho_per_s == quick.rho_per_s
    for gentle in (slow, heavy):
        assert gentle.k_per_s < quick.k_per_s
        assert gentle.throttle.proportional_s_m < quick.throttle.proportional_s_m
        assert gentle.throttle.integral_per_m < quick.throttle.integral_per_m
    # the approach bends no sharper than the greatest bank can
    for guide in (quick, slow, heavy, handling(AIRFRAME_12._replace(bank_max_rad=radians(20.0)))):
        most = GRAVITY_M_S2 * (guide.envelope.load_max**2 / 1.06**2 - 1.0) ** 0.5
        assert guide.k_per_s * guide.approach_m_s < most


def test_the_clock_waits_only_where_it_is_asked_to() -> None:
    assert handling(AIRFRAME_20).waiting == waiting.OFF
    assert handling(AIRFRAME_20, waits=True).waiting == patience(20.0, handling(AIRFRAME_20).k_per_s)
    # one whose field is slow is not chased by its own reference
    assert patience(45.0, 0.3).per_m * 45.0 == pytest.approx(3.6)
    # what a fast airplane is asked to speed up by, along its reference, is no more than that of a slow one
    for speed in (20.0, 45.0, 90.0):
        assert patience(speed, 0.5).rises_per_s * speed == pytest.approx(8.0)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"airspeed_min_m_s": 0.0}, "airspeeds must be 0 < min < cruise <= max, not 0, 20, 26"),
        ({"airspeed_cruise_m_s": 11.0}, "airspeeds"),
        ({"airspeed_max_m_s": 19.0}, "airspeeds"),
        ({"airspeed_max_m_s": inf}, "airspeeds"),
        ({"climb_max_m_s": nan}, "climb_max_m_s must be above 0"),
        ({"climb_full_m_s": -1.0}, "climb_full_m_s must be above 0 and below inf, not -1"),
        ({"throttle_cruise": 1.0}, "throttle_cruise must be above 0 and below 1, not 1"),
        ({"bank_max_rad": 45.0}, "bank_max_rad must be above 0 and below 1.396, not 45"),
        ({"lag_s": 0.0}, "lag_s must be above 0"),
        ({"pitch_cruise_rad": 0.5}, "pitch must be"),
        ({"floor_down_m": nan}, "floor_down_m must be a number"),
        ({"lag_s": -1.0, "throttle_cruise": 0.0}, "throttle_cruise .*; lag_s"),
    ],
)
def test_what_no_airplane_has_is_refused(changes: dict[str, float], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        handling(AIRFRAME_20._replace(**changes))


#: As wrong as an autopilot's defaults are for its airplane: the climb of full throttle (ArduPlane says 5 of
#: 17 m/s), throttle and pitch of level flight.
WRONG = {
    "full throttle climbs a third": {"climb_full_m_s": 0.33},
    "full throttle climbs half as much again": {"climb_full_m_s": 1.5},
    "less throttle": {"throttle_cruise": 0.85},
    "more throttle": {"throttle_cruise": 1.15},
    # with half the lag the gains are those of the limit cycle
    "quicker": {"lag_s": 0.75},
}


@pytest.mark.timeout(180)  # the first of these compiles
@pytest.mark.parametrize("what", WRONG)
@pytest.mark.parametrize("speed", FRAMES)
def test_numbers_that_are_far_off_fly_within_the_limits(speed: int, what: str) -> None:
    plane, frame = FRAMES[speed]
    factors = WRONG[what]
    wrong = frame._replace(**{name: getattr(frame, name) * factor for name, factor in factors.items()})
    plane = Airplane(plane.body, handling(wrong._replace(pitch_cruise_rad=radians(1.5))), plane.ahead_s)
    for name in ("circle 100 m", "lemniscate 400 x 200 m +-10 m"):
        found = figures(flown(plane, scenarios(float(speed))[name], 1, compiled(fly)))
        assert found.rms_m < 0.5, name
        assert found.max_m < 1.5, name
