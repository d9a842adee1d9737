"""Tuning flights by the whole core: what they measure, that they stay in their room, and that others win."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace as with_task
from math import cos, hypot, radians, sin
from pathlib import Path
from typing import Any, Final, NamedTuple

import pytest
from msgspec.structs import replace
from numpy.testing import assert_allclose

from guidance.commands import Hold, Resume, Shutdown
from guidance.config import Config, ConfigError, load
from guidance.flying.around import Phase
from guidance.records import Record, Setpoint, Stepping
from guidance.replay import replay as replayed
from guidance.steps_log import read_log, results_of
from guidance.steps_plan import known, planned
from guidance.supervisor import State
from guidance.tune.answer import Form
from guidance.tune.excitation import Box
from guidance.tune.identify import Identified, Refused
from guidance.tune.propose import Results, ground_lines
from sitl.lockstep import Lockstep
from sitl.logbook import LogBook
from sitl.models.files import load_rover
from sitl.scenarios import rover
from sitl.scenarios.table import fly_row, in_words
from sitl.vehicle import Effect
from sitl.vehicle.estimator import USUAL
from tests.helpers import events_of, fly_until, fly_until_tracking, make_flight, state_of
from tests.pilot import NAMES, Pilot
from tests.tuning_flight import told

#: The built-in rover's tightest circle.
RADIUS: Final = "ground.turning_radius_m=0.9"
SHIPPED: Final = Path(__file__).parents[1] / "deploy" / "ardupilot-rover.toml"
AUTO: Final = ("supervisor.engage=auto", "supervisor.arm=true")
FENCE: Final = "guards.fence_ned_m=[[-60.0,-60.0],[60.0,-60.0],[60.0,60.0],[-60.0,60.0]]"
YAW_RAD: Final = 0.7


def shipped(*overrides: str) -> Config:
    return load(SHIPPED, (*AUTO, FENCE, RADIUS, *overrides))


def flight_of(config: Config, **options: Any) -> Lockstep:
    settings = {"model": "rover", "initial_position_ned_m": (0.0, 0.0, 0.0), "initial_yaw_rad": YAW_RAD}
    return make_flight(config=config, **{**settings, **options})


def newest(flight: Lockstep) -> Stepping | None:
    """What the handler said last."""
    return next((r for r in reversed(flight.records[-200:]) if isinstance(r, Stepping)), None)


def reaches(flight: Lockstep, phase: Phase, run: str, seconds: float = 120.0) -> None:
    """Let time pass until then."""

    def there() -> bool:
        seen = newest(flight)
        return seen is not None and (seen.phase, seen.run) == (phase, run)

    assert flight.run(seconds, until=there), newest(flight)


class Flight(NamedTuple):
    config: Config
    results: Results
    path: list[tuple[float, float]]  # ahead and right of the start, m
    records: list[Record]
    log: Path


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """A whole one, with an outdoor estimator's noise."""
    config = planned(shipped()).config
    flight = flight_of(config, noise=USUAL)
    path = []
    fly_until_tracking(flight)
    while (seen := newest(flight)) is None or seen.phase != Phase.DONE:
        assert flight.run(0.1, until=lambda: False) is False
        assert flight.now_ns < 200e9
        north, east, _ = flight.truth().position_ned_m
        c, s = cos(YAW_RAD), sin(YAW_RAD)
        path.append((north * c + east * s, east * c - north * s))
    flight.guide.command(Shutdown(source="guidance tune"), flight.now_ns)
    fly_until(flight, State.FINISHED, 2.0)
    assert flight.vehicle.mode == NAMES["hold"][1]
    with LogBook(config, tmp_path_factory.mktemp("logs")) as book:
        for record in flight.records:
            book.add(record)
    return Flight(config, results_of(config, flight.records), path, flight.records, book.path)


def test_it_measures_the_vehicle(flown: Flight) -> None:
    """In the tolerances of the identification alone (`test_tune_identify`)."""
    model = load_rover("rover")
    yaw, speed = (flown.results[channel] for channel in ("yaw_rate_rad_s", "speed_m_s"))
    assert isinstance(yaw, Identified)
    assert isinstance(speed, Identified)
    a = yaw.answer
    assert a.form is Form.ONE_LAG
    assert abs(a.delay_s - model.delay_s) < 0.005
    assert_allclose(a.gain, model.yaw_gain, rtol=0.01)
    assert_allclose(a.slew, model.yaw_slew_rad_s2, rtol=0.02)
    assert_allclose(a.tau_s, model.yaw_lag_s, rtol=0.12)
    a = speed.answer
    assert a.form is Form.LED
    assert abs(a.delay_s - model.delay_s) < 0.03
    assert_allclose(a.gain, 1.0, rtol=0.01)
    assert_allclose(a.slew, model.acceleration_m_s2, rtol=0.06)
    assert_allclose(a.tau_s, (model.speed_p + 1.0 / model.drag_s) / model.speed_i, rtol=0.12)


def test_it_stays_in_the_room_that_was_announced_and_comes_back(flown: Flight) -> None:
    box = flown.config.excitation.box
    assert max(ahead for ahead, _ in flown.path) < box.ahead_m
    assert min(ahead for ahead, _ in flown.path) > -box.behind_m
    assert max(right for _, right in flown.path) < box.right_m
    assert min(right for _, right in flown.path) > -box.left_m
    begun = [r for r in flown.records if isinstance(r, Stepping) and r.phase == Phase.STEPPING]
    assert {r.run for r in begun} == {"yaw rate", "speed"}
    turned = sum(1 for r in flown.records if isinstance(r, Stepping) and r.phase == Phase.RETURNING)
    assert 20 * 50 < turned < 40 * 50


def test_what_is_proposed_flies_the_tasks(flown: Flight) -> None:
    lines = ground_lines(flown.results, known(flown.config))
    settings = [f"{line.table}.{line.key}={line.value}" for line in lines]
    row = rover.rows()[0]
    task = with_task(row.task, settings=(*row.task.settings, *settings))
    result = fly_row(with_task(row, task=task), seeds=1)
    assert not result.missed, in_words(result)


def test_its_log_replays_to_the_bit_and_identifies_the_same(flown: Flight) -> None:
    assert replayed(flown.log).identical
    config, records = read_log(flown.log)
    assert config == flown.config
    assert results_of(config, records) == flown.results


def test_only_the_last_attempt_at_a_run_counts(flown: Flight) -> None:
    minute = 60_000_000_000
    first: list[Record] = []
    for record in flown.records:
        if isinstance(record, Setpoint):
            first.append(replace(record, t_ns=record.t_ns - minute))
        elif isinstance(record, Stepping):
            seen_ns = record.measured_ns - minute
            first.append(replace(record, t_ns=record.t_ns - minute, measured_ns=seen_ns, measured=9.0))
            if record.phase == Phase.STEPPING and record.into_s > 7.0:
                break
    assert results_of(flown.config, [*first, *flown.records]) == flown.results


def test_a_speed_that_is_wrong_by_a_third_is_found() -> None:
    flight = flight_of(planned(shipped()).config)
    flight.vehicle.refit(flight.now_ns, effect=Effect(speed=0.7))
    reaches(flight, Phase.DONE, "speed")
    speed = results_of(flight.guide.config, flight.records)["speed_m_s"]
    assert isinstance(speed, Identified)
    assert_allclose(speed.answer.gain, 0.7, rtol=0.02)


def test_the_pilot_wins_and_what_was_complete_counts() -> None:
    flight = flight_of(planned(shipped()).config)
    reaches(flight, Phase.STEPPING, "speed")
    flight.run(5.0)
    Pilot(flight).switch("manual")
    fly_until(flight, State.HANDED_OVER, 1.0)
    flight.run(1.0)
    since_ns = flight.now_ns
    flight.run(2.0)
    assert not [t for t in flight.setpoint_times_ns if t > since_ns]
    results = results_of(flight.guide.config, flight.records)
    assert isinstance(results["yaw_rate_rad_s"], Identified)
    speed = results["speed_m_s"]
    assert isinstance(speed, Refused)
    assert speed.reason.startswith("its run ended after 5.")


def test_the_fence_ends_it() -> None:
    config = planned(shipped("guards.fence_ned_m=[[-9.0,-9.0],[9.0,-9.0],[9.0,9.0],[-9.0,9.0]]")).config
    # as if the vehicle went farther than anybody thought
    short = replace(config.excitation, box=Box(1.0, 1.0, 1.0, 1.0, 0.0, 0.0))
    flight = flight_of(replace(config, excitation=short))
    fly_until(flight, State.ABORTED, 30.0)
    assert "outside the fence" in events_of(flight, "guard_fence")[0]
    assert flight.vehicle.mode == NAMES["hold"][1]
    flight.run(5.0)
    north, east, _ = flight.truth().position_ned_m
    assert max(abs(north), abs(east)) < 12.0


def test_without_room_it_is_not_engaged_and_says_what_would_do() -> None:
    config = planned(
        shipped("guards.fence_ned_m=[[-30.0,-30.0],[30.0,-30.0],[30.0,30.0],[-30.0,30.0]]")
    ).config
    flight = flight_of(config)
    flight.run(6.0)
    assert state_of(flight) is State.CONNECTED
    why = flight.guide.engagement.reason
    assert why.startswith("fence: the steps need 44 m ahead, 7 m behind")
    corners = why.rpartition("guards.fence_ned_m = ")[2]
    wider = flight_of(planned(shipped(f"guards.fence_ned_m={corners}")).config)
    fly_until_tracking(wider)


def test_a_vehicle_that_moves_is_not_engaged() -> None:
    flight = flight_of(planned(shipped()).config)
    flight.vehicle.reset_estimator(flight.now_ns, faster_ned_m_s=(0.9, 0.0, 0.0))
    flight.run(5.0)
    assert state_of(flight) is State.CONNECTED
    assert "and steps begin at rest: let it stand" in flight.guide.engagement.reason


def test_a_flight_that_was_held_goes_back_and_does_its_run_again() -> None:
    flight = flight_of(
        planned(shipped("supervisor.hold_mode=hold", "supervisor.engage_max_error_m=60.0")).config
    )
    reaches(flight, Phase.STEPPING, "yaw rate")
    flight.run(9.0)
    flight.guide.command(Hold(), flight.now_ns)
    fly_until(flight, State.HOLDING, 3.0)
    flight.run(4.0)
    flight.guide.command(Resume(), flight.now_ns)
    fly_until(flight, State.TRACKING, 5.0)
    flight.run(0.1)
    again = newest(flight)
    assert again is not None
    assert (again.phase, again.run) == (Phase.RETURNING, "yaw rate")
    reaches(flight, Phase.STEPPING, "yaw rate")
    north, east, _ = flight.truth().position_ned_m
    assert hypot(north, east) < 2.0
    reaches(flight, Phase.RETURNING, "speed")
    assert isinstance(results_of(flight.guide.config, flight.records)["yaw_rate_rad_s"], Identified)


def test_the_place_moves_with_the_estimators_frame() -> None:
    flight = flight_of(planned(shipped()).config)
    reaches(flight, Phase.RETURNING, "speed")
    flight.run(3.0)
    flight.vehicle.reset_estimator(flight.now_ns, moved_ned_m=(5.0, -3.0, 0.0))
    reaches(flight, Phase.STEPPING, "speed")
    north, east, _ = flight.truth().position_ned_m
    assert hypot(north, east) < 2.0


def test_a_boat_in_a_current_never_rests_and_is_measured_all_the_same() -> None:
    flight = flight_of(planned(shipped()).config, model="boat", noise=USUAL)
    reaches(flight, Phase.DONE, "speed")
    yaw = results_of(flight.guide.config, flight.records)["yaw_rate_rad_s"]
    assert isinstance(yaw, Identified)
    assert_allclose(yaw.answer.gain, load_rover("boat").yaw_gain, rtol=0.01)


def without_fence() -> None:
    planned(load(SHIPPED, (*AUTO, RADIUS)))


def too_fast() -> None:
    planned(shipped(), 5.5)


def a_submarine() -> None:
    planned(load(SHIPPED.with_name("px4-uuv.toml"), AUTO))


def in_a_file() -> None:
    load(SHIPPED, ("excitation.stop_m=1.0",))


@pytest.mark.parametrize(
    ("refused", "words"),
    [
        (without_fence, r"there is no fence.*44 m ahead.*\nfence_ned_m = \[\[46"),
        (too_fast, r"--speed 5.5: must be above 0 and at most 5, its highest speed"),
        (
            a_submarine,
            r"px4-uuv, which is asked for body rates and thrust for a speed: there are no",
        ),
        (in_a_file, r"excitation: only `guidance tune` flies steps"),
    ],
)
def test_what_cannot_be_flown_is_refused(refused: Callable[[], None], words: str) -> None:
    with pytest.raises(ConfigError, match=f"(?s){words}"):
        refused()


def test_the_plan_is_announced() -> None:
    plan = planned(shipped(), 1.5)
    assert "yaw rate: -0.83, -0.25, 0.25, 0.83 rad/s at speed 1.5 m/s, 18 s" in plan.text
    assert "speed: 0.6, 1.5 m/s" in plan.text
    assert "It needs " in plan.text
    assert plan.config.flight.origin == "engage"


def test_steps_that_were_not_flown_are_refused_one_by_one() -> None:
    config = planned(shipped()).config
    results = results_of(config, [])
    assert list(results) == ["yaw_rate_rad_s", "speed_m_s"]
    assert all(result == Refused("its run was not flown") for result in results.values())


def test_the_radius_is_the_autopilots_where_it_tells_one() -> None:
    config = load(SHIPPED, (*AUTO, FENCE))
    values = told("ardupilot-rover")
    plan = planned(config, None, values)
    assert plan.config.ground.turning_radius_m == pytest.approx(0.9)
    assert_allclose(plan.config.excitation.box, planned(shipped()).config.excitation.box)
    wider = planned(config, None, {**values, "TURN_RADIUS": 3.0}).config.excitation
    assert wider.back_radius_m == 6.0
    # what the configuration says goes before it
    assert planned(shipped(), None, {**values, "TURN_RADIUS": 3.0}).config.ground.turning_radius_m == 0.9
    with pytest.raises(ConfigError, match=r"the autopilot does not tell TURN_RADIUS, so it must be set"):
        planned(config)


def test_steps_are_within_what_the_autopilot_allows() -> None:
    slow = {**told("ardupilot-rover"), "WP_SPEED": 1.0, "ATC_STR_RAT_MAX": 30.0}
    steps = planned(shipped(), None, slow).config.excitation
    yaw, speed = ([hold.value for hold in run.holds] for run in steps.runs)
    assert max(speed) == 0.5
    assert_allclose(max(yaw), 0.5 * radians(30.0))
    with pytest.raises(ConfigError, match=r"--speed 1.5: must be above 0 and at most 1, its highest speed"):
        planned(shipped(), 1.5, slow)
