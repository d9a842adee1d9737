"""`guidance tune` of airplanes, by the whole core: what it measures of the models, and what it never does."""

from __future__ import annotations

from math import inf, radians
from pathlib import Path

import pytest
from msgspec.structs import replace
from numpy.testing import assert_allclose

from guidance.commands import Hold, Resume
from guidance.config import Config, ConfigError
from guidance.flying.around import Phase
from guidance.replay import replay as replayed
from guidance.steps_log import read_log, results_of
from guidance.steps_plan import planned
from guidance.supervisor import State
from guidance.tune.answer import Form
from guidance.tune.identify import Identified, Refused
from sitl.logbook import LogBook
from sitl.models.files import load_airplane
from sitl.scenarios import airplane
from sitl.scenarios.table import in_words
from tests.helpers import events_of, fly_until, setpoints_since
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

PLANES = ("px4-plane", "ardupilot-plane")

#: Whole flights of 200 s: 9 s of a core each, on a busy machine far more.
pytestmark = pytest.mark.timeout(300)


def plan_of(profile: str, *overrides: str, speed_m_s: float | None = None) -> Config:
    return planned(shipped(profile, *overrides), speed_m_s, told(profile)).config


@pytest.fixture(scope="module", params=PLANES)
def tuned(request: pytest.FixtureRequest) -> Flown:
    """A whole flight with an outdoor estimator's noise."""
    return flown(plan_of(request.param))


def test_it_measures_the_model(tuned: Flown) -> None:
    """Delays within 20 ms, gains 5 %, slew and time constants 10 %."""
    profile = tuned.config.vehicle.profile
    model = load_airplane(AIRBORNE[profile]["model"])
    a = tuned.found("roll_rad").answer
    assert a.form is (Form.TWO_LAGS if model.roll_lag2_s else Form.ONE_LAG)
    assert abs(a.delay_s - model.roll_delay_s) < 0.005
    assert_allclose(a.gain, model.roll_gain, rtol=0.01)
    assert_allclose(a.slew, model.roll_slew_rad_s, rtol=0.05)
    assert_allclose((a.tau_s, a.tau2_s), (model.roll_lag_s, model.roll_lag2_s), rtol=0.05)
    a = tuned.found("pitch_rad").answer
    assert abs(a.delay_s - model.pitch_delay_s) < 0.02
    assert_allclose(a.gain, model.pitch_gain, rtol=0.03)
    assert_allclose((a.tau_s, a.tau2_s), (model.pitch_lag_s, model.pitch_lag2_s), rtol=0.1)
    assert a.slew == inf
    V = tuned.config.excitation.back_m_s
    a = tuned.found("throttle").answer
    slope = 2.0 * model.drag_per_m * V - 2.0 * model.induced_m3_s4 / V**3
    assert abs(a.delay_s - model.throttle_delay_s - 0.5 * model.throttle_lag_s) < 0.03
    assert_allclose(a.gain / a.tau_s, model.thrust_m_s2, rtol=0.05)
    assert_allclose(a.tau_s, 1.0 / slope, rtol=0.1)


def test_it_stays_in_its_room_and_its_envelope(tuned: Flown) -> None:
    steps, limits = tuned.config.excitation, tuned.config.airplane
    assert inside(steps.box, tuned.path)
    assert limits.airspeed_min_m_s is not None
    assert min(tuned.airspeeds_m_s) > limits.airspeed_min_m_s
    assert max(tuned.airspeeds_m_s) < steps.fastest_m_s
    assert tuned.flight.vehicle.mode == AIRBORNE[tuned.config.vehicle.profile]["initial_mode"]


def test_what_it_proposes_flies_the_circle(tuned: Flown) -> None:
    result = on_the_circle(airplane.rows(), tuned)
    assert not result.missed, in_words(result)


@pytest.mark.parametrize("tuned", ["px4-plane"], indirect=True)
def test_its_log_replays_to_the_bit_and_identifies_the_same(tuned: Flown, tmp_path: Path) -> None:
    with LogBook(tuned.config, tmp_path) as book:
        for record in tuned.flight.records:
            book.add(record)
    assert replayed(book.path).identical
    config, records = read_log(book.path)
    assert results_of(config, records) == tuned.results


def test_the_pilot_wins_in_a_step() -> None:
    flight = engaged(plan_of("px4-plane"))
    assert flight.run(20.0, until=lambda: (s := newest(flight)) is not None and s.phase == Phase.STEPPING)
    flight.run(4.0)
    Pilot(flight).switch("hold")
    fly_until(flight, State.HANDED_OVER, 1.0)
    flight.run(1.0)
    since_ns = flight.now_ns
    flight.run(2.0)
    assert not setpoints_since(flight, since_ns)
    roll = results_of(flight.guide.config, flight.records)["roll_rad"]
    assert isinstance(roll, Refused)
    assert roll.reason.startswith("its run ended after 4.")


def test_a_flight_that_was_held_goes_back_and_does_its_run_again() -> None:
    flight = engaged(plan_of("px4-plane", "supervisor.engage_max_error_m=50.0"))
    flight.run(12.0)
    flight.guide.command(Hold(), flight.now_ns)
    fly_until(flight, State.HOLDING, 3.0)
    flight.run(10.0)
    flight.guide.command(Resume(), flight.now_ns)
    fly_until(flight, State.TRACKING, 5.0)
    flight.run(0.1)
    again = newest(flight)
    assert again is not None
    assert (again.phase, again.run) == (Phase.RETURNING, "bank")
    assert flight.run(90.0, until=lambda: (s := newest(flight)) is not None and s.run == "pitch")
    assert isinstance(results_of(flight.guide.config, flight.records)["roll_rad"], Identified)


def test_the_fence_ends_it() -> None:
    config = plan_of("px4-plane", fence(90.0))
    box = config.excitation.box._replace(ahead_m=1.0, behind_m=1.0, right_m=1.0, left_m=1.0)
    flight = engaged(replace(config, excitation=replace(config.excitation, box=box)))
    fly_until(flight, State.ABORTED, 60.0)
    assert "outside the fence" in events_of(flight, "guard_fence")[0]


def test_without_airspeed_and_wind_it_ends() -> None:
    """10 s by the last wind, and 5 s of the guard."""
    flight = engaged(plan_of("px4-plane"))
    flight.run(2.0)
    flight.vehicle.withhold("VFR_HUD", "WIND_COV")
    fly_until(flight, State.ABORTED, 17.0)
    assert "neither airspeed nor wind" in events_of(flight, "guard_air")[0]


def test_without_room_it_is_not_engaged_and_says_what_would_do() -> None:
    why = r"fence: the steps need [34]\d\d m ahead.*guards\.fence_ned_m = \[\["
    with pytest.raises(AssertionError, match=why):
        engaged(plan_of("px4-plane", fence(100.0)))


def test_beyond_its_envelope_the_handler_flies_and_the_run_is_lost() -> None:
    """As if the greatest airspeed were just above that of the steps: the throttle's run is given up."""
    config = plan_of("px4-plane")
    steps = config.excitation
    throttle_alone = replace(steps, runs=steps.runs[2:], fastest_m_s=steps.back_m_s + 0.6)
    done = flown(replace(config, excitation=throttle_alone))
    lost = done.results["throttle"]
    assert isinstance(lost, Refused)
    assert "of 18.0 s" in lost.reason
    assert max(done.airspeeds_m_s[60:]) < steps.back_m_s + 1.2


def test_wind_is_allowed_for_and_stronger_is_not_flown() -> None:
    config = plan_of("ardupilot-plane")
    steps = config.excitation
    bank_alone = replace(config, excitation=replace(steps, runs=steps.runs[:1]))
    done = flown(bank_alone, wind_ned_m_s=(3.0, -3.0, 0.0), gusts_m_s=0.5)
    assert inside(steps.box, done.path)
    model = load_airplane("airplane_20")
    assert_allclose(done.found("roll_rad").answer.gain, model.roll_gain, rtol=0.02)
    assert_allclose(done.found("roll_rad").answer.delay_s, model.roll_delay_s, atol=0.02)
    with pytest.raises(AssertionError, match=r"the wind is 7\.\d m/s, and the room of the steps is counted"):
        engaged(config, wind_ned_m_s=(5.0, -5.0, 0.0))


def test_too_low_it_is_not_engaged() -> None:
    with pytest.raises(AssertionError, match=r"10 m above the floor .* lose 11 m: climb"):
        engaged(plan_of("px4-plane", "airplane.floor_down_m=-90.0"))


def test_steps_scale_with_what_the_autopilot_allows() -> None:
    values = {**told("ardupilot-plane"), "ROLL_LIMIT_DEG": 30.0}
    bank = planned(shipped("ardupilot-plane"), None, values).config.excitation.runs[0]
    assert_allclose(max(hold.value for hold in bank.holds), radians(27.0))
    plan = planned(shipped("px4-plane"), None, told("px4-plane"))
    assert "airspeed of 12 m/s" in plan.text
    assert "in a wind of 3.6 m/s at most" in plan.text


@pytest.mark.parametrize(
    ("profile", "overrides", "speed_m_s", "words"),
    [
        ("ardupilot-plane", (), 12.0, r"--speed 12: must be an airspeed from 13.2"),
        ("px4-plane", ("airplane.output=rates",), None, r"body rates and throttle: there are no steps"),
        ("px4-plane", ("airplane.throttle_cruise=0.93",), None, r"throttle 0.93 in level flight leaves no"),
        ("px4-plane", ("airplane.airspeed_max_m_s=12.5",), None, r"already uses up the room"),
    ],
)
def test_what_cannot_be_stepped_says_why(
    profile: str, overrides: tuple[str, ...], speed_m_s: float | None, words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        plan_of(profile, *overrides, speed_m_s=speed_m_s)
