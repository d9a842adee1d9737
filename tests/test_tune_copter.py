"""`guidance tune` of copters and PX4's rovers, by the whole core: what it measures of the models."""

from __future__ import annotations

from math import inf

import pytest
from msgspec.structs import replace
from numpy.testing import assert_allclose

from guidance.config import Config, ConfigError
from guidance.flying.around import Phase
from guidance.steps_log import results_of
from guidance.steps_plan import planned
from guidance.supervisor import State
from guidance.tune.answer import character
from guidance.tune.identify import Refused
from sitl.models.files import load_copter, load_rover
from sitl.scenarios import copter, px4_rover
from sitl.scenarios.table import in_words
from sitl.vehicle.estimator import SILENT
from tests.helpers import fly_until, make_flight
from tests.pilot import Pilot
from tests.tuning_flight import (
    AIRBORNE,
    Flown,
    engaged,
    fence,
    flown,
    inside,
    newest,
    on_the_circle,
    shipped,
    told,
)

COPTERS = ("px4-copter", "ardupilot-copter")


def plan_of(profile: str, *overrides: str, speed_m_s: float | None = None) -> Config:
    return planned(shipped(profile, fence(60.0), *overrides), speed_m_s, told(profile)).config


@pytest.fixture(scope="module", params=COPTERS)
def tuned(request: pytest.FixtureRequest) -> Flown:
    """A whole flight with an outdoor estimator's noise."""
    return flown(plan_of(request.param))


@pytest.fixture(scope="module")
def driven() -> Flown:
    """The same of PX4's rover."""
    return flown(plan_of("px4-rover"), model="rover_px4")


def test_yaw_rate_is_the_models_own(tuned: Flown) -> None:
    model = load_copter(AIRBORNE[tuned.config.vehicle.profile]["model"])
    a = tuned.found("yaw_rate_rad_s").answer
    assert abs(a.delay_s - model.delay_s) < 0.005
    assert_allclose(a.gain, model.yaw_gain, rtol=0.01)
    assert_allclose((a.tau_s, a.tau2_s), (model.yaw_lag_s, model.yaw_lag2_s), rtol=0.05)
    # PX4's is not reached by steps of half of its highest yaw rate, and none is made up
    assert_allclose(a.slew, inf if model.yaw_slew_rad_s2 < 3.0 else model.yaw_slew_rad_s2, rtol=0.05)


def test_velocity_is_what_it_is_without_noise(tuned: Flown) -> None:
    """Its loop is no lag of first order, so that the truth is the same flight without noise."""
    steps = tuned.config.excitation
    alone = replace(steps, runs=(steps.runs[0], steps.runs[2]))
    still = flown(replace(tuned.config, excitation=alone), noise=SILENT)
    for channel in ("north_m_s", "down_m_s"):
        a, true = tuned.found(channel), still.found(channel)
        if a.answer.form is true.answer.form:  # a second lag takes its part of the delay
            assert abs(a.answer.delay_s - true.answer.delay_s) < 0.02
        assert_allclose(a.answer.gain, true.answer.gain, rtol=0.02)
        late = [found.answer.delay_s + character(found.answer, 1.0).lag_s for found in (a, true)]
        assert_allclose(late[0], late[1], rtol=0.1)


def test_it_stays_in_its_room_and_comes_back(tuned: Flown) -> None:
    assert inside(tuned.config.excitation.box, tuned.path)
    first, last = tuned.steppings[0], tuned.steppings[-1]
    assert (first.phase, last.phase) == (Phase.RESTING, Phase.DONE)
    assert {stepping.phase for stepping in tuned.steppings} == set(Phase)
    ahead, right, down = tuned.path[-1]
    assert max(abs(ahead), abs(right), abs(down)) < 1.0


def test_what_it_proposes_flies_the_circle(tuned: Flown) -> None:
    result = on_the_circle(copter.rows(), tuned)
    assert not result.missed, in_words(result)


def test_px4s_rover_turns_and_drives_as_its_model(driven: Flown) -> None:
    model = load_rover("rover_px4")
    a = driven.found("yaw_rate_rad_s").answer
    assert abs(a.delay_s - model.delay_s) < 0.005
    # PX4 takes the bearing off the heading when the setpoint comes, not in the middle of its 20 ms
    sampled = 1.0 - told("px4-rover")["RO_YAW_P"] * 0.01
    assert_allclose(a.gain * sampled, model.yaw_gain, rtol=0.01)
    assert_allclose(a.slew, model.yaw_slew_rad_s2, rtol=0.05)
    assert_allclose(a.tau_s, model.yaw_lag_s, rtol=0.12)
    # each command is one, whatever rounding makes of the length of a velocity that turns
    assert driven.found("speed_m_s").spread.repeats <= 4
    a = driven.found("speed_m_s").answer
    # as good as no loop: feed-forward against the drag
    per_s = 1.0 / model.drag_s + model.speed_p
    assert_allclose(a.gain, (model.speed_feed / model.drag_s + model.speed_p) / per_s, rtol=0.05)
    assert_allclose(a.tau_s, 1.0 / per_s, rtol=0.1)
    assert inside(driven.config.excitation.box._replace(up_m=1.0, down_m=1.0), driven.path)


def test_what_px4s_rover_proposes_flies_the_circle(driven: Flown) -> None:
    result = on_the_circle(px4_rover.rows(), driven)
    assert not result.missed, in_words(result)


def test_the_pilot_wins_over_a_copter() -> None:
    flight = engaged(plan_of("px4-copter"))
    assert flight.run(20.0, until=lambda: (s := newest(flight)) is not None and s.phase == Phase.STEPPING)
    flight.run(5.0)
    Pilot(flight).switch("hold")
    fly_until(flight, State.HANDED_OVER, 1.0)
    north = results_of(flight.guide.config, flight.records)["north_m_s"]
    assert isinstance(north, Refused)
    assert north.reason.startswith("its run ended after 5.")


def test_without_room_a_copter_is_not_engaged() -> None:
    with pytest.raises(AssertionError, match=r"the steps need 10 m ahead, 2 m behind"):
        engaged(plan_of("px4-copter", fence(6.0)))


def test_a_copter_that_moves_is_not_engaged() -> None:
    flight = make_flight(
        config=plan_of("px4-copter"),
        initial_position_ned_m=(0.0, 0.0, -100.0),
        initially_armed=True,
        **AIRBORNE["px4-copter"],
    )
    flight.vehicle.reset_estimator(flight.now_ns, faster_ned_m_s=(0.9, 0.0, 0.0))
    flight.run(5.0)
    assert "and steps begin at rest: let it stand" in flight.guide.engagement.reason


@pytest.mark.parametrize(
    ("profile", "values", "speed_m_s", "words"),
    [
        ("px4-copter", {}, None, r"neither MPC_XY_VEL_MAX nor WP_SPD is told by the autopilot"),
        ("px4-copter", told("px4-copter"), 3.0, r"--speed 3: must be above 0 and at most 2"),
        ("px4-rover", {}, None, r"RO_YAW_P must be above 0"),
        ("px4-rover", told("px4-rover"), 9.0, r"--speed 9: must be above 0 and at most 3"),
    ],
)
def test_what_cannot_be_stepped_says_why(
    profile: str, values: dict[str, float], speed_m_s: float | None, words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        planned(shipped(profile), speed_m_s, values)
