"""The copter line of the figures: every task on both autopilots, with the noise of an estimator."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import Any

import numpy as np
import pytest

from guidance.handling.copter import Configured
from sitl.compiled import compiled
from sitl.copter_flight import CIRCLE, COLUMNS, EIGHT, HELIX, LEG, Task, fly, planned
from sitl.copter_tasks import (
    Copter,
    Figures,
    Scenario,
    copter_ardupilot,
    copter_px4,
    figures,
    flown,
    scenarios,
)

COPTERS = {"px4": copter_px4(), "ardupilot": copter_ardupilot()}
TABLE = scenarios()
CIRCLE_TASK = "circle r 10 m at 3 m/s"
SEEDS = 12


@pytest.fixture(scope="module", autouse=True)
def _machine_code() -> None:
    """Compiled once, before a test's time runs."""
    flown(COPTERS["px4"], TABLE[CIRCLE_TASK]._replace(duration_s=1.0), 0, compiled(fly))


def outcome(copter: Copter, asked: Scenario, seed: int = 1) -> Figures:
    return figures(flown(copter, asked, seed, compiled(fly)), asked.settled_s)


@pytest.mark.timeout(240)  # the first of these compiles
@pytest.mark.parametrize("task", TABLE)
@pytest.mark.parametrize("name", COPTERS)
def test_every_task_is_flown_within_its_limits(name: str, task: str) -> None:
    asked = TABLE[task]
    for seed in range(SEEDS):
        record = flown(COPTERS[name], asked, seed, compiled(fly))
        found = figures(record, asked.settled_s)
        assert found.converged_s < asked.converged_s
        assert found.rms_m < asked.rms_m
        assert found.max_m < asked.max_m
        # the nose goes along the path; at the end of the leg it stays as it was
        assert found.nose_off_rad < 0.3
        assert not record[:, COLUMNS.index("stuck")].any()
        if asked.task.kind == LEG:
            assert found.speed_at_end_m_s < 0.12


def altered(copter: Copter, **changes: float) -> Copter:
    return copter._replace(body=copter.body._replace(**changes))


@pytest.mark.parametrize("name", COPTERS)
def test_two_tenths_of_a_second_that_nobody_knows_of_make_no_limit_cycle(name: str) -> None:
    late = altered(COPTERS[name], delay_s=COPTERS[name].body.delay_s + 0.2)
    assert outcome(late, TABLE[CIRCLE_TASK]).rms_m < 0.25
    # standing, nothing is late: there it must not swing
    held = TABLE["leg of 40 m at 4 m/s, stop and hold"]
    assert outcome(late, held).rms_m < 0.05
    known = late._replace(ahead_s=late.ahead_s + 0.2)
    assert outcome(known, TABLE[CIRCLE_TASK]).rms_m < 0.08


@pytest.mark.parametrize("drag_per_s", [0.1, 1.5])
def test_the_air_is_learned(drag_per_s: float) -> None:
    found = outcome(altered(COPTERS["px4"], drag_per_s=drag_per_s), TABLE[CIRCLE_TASK])
    assert found.drag_per_s == pytest.approx(drag_per_s, abs=0.15)
    assert found.rms_m < 0.08


def blind(copter: Copter, **changes: Any) -> Copter:
    guide = copter.guide
    return copter._replace(guide=guide._replace(response=guide.response._replace(**changes)))


def test_each_part_of_the_answer_is_needed() -> None:
    px4 = COPTERS["px4"]
    circle = TABLE[CIRCLE_TASK]
    whole = outcome(px4, circle).rms_m
    level = px4.guide.response.level
    assert outcome(blind(px4, level=level._replace(lag_s=0.0)), circle).rms_m > 3.0 * whole
    assert outcome(blind(px4, level=level._replace(washout_s=0.0)), circle).rms_m > 3.0 * whole
    assert outcome(blind(px4, per_s=0.0), circle).rms_m > 2.0 * whole
    windy = TABLE[f"{CIRCLE_TASK}, 5 m/s wind"]
    assert outcome(blind(px4, kp=0.0), windy).rms_m > 1.5 * outcome(px4, windy).rms_m
    ardu = COPTERS["ardupilot"]
    level = ardu.guide.response.level
    assert (
        outcome(blind(ardu, level=level._replace(lag_s=0.0)), circle).rms_m
        > 5.0 * outcome(ardu, circle).rms_m
    )


@pytest.mark.parametrize("make", [copter_px4, copter_ardupilot])
def test_with_its_heading_held_it_flies_the_same_path(make: Callable[[Configured], Copter]) -> None:
    found_held = flown(make(Configured(follows=False)), TABLE[CIRCLE_TASK], 3, compiled(fly))
    assert figures(found_held, 20.0).rms_m < 0.1
    assert figures(found_held, 20.0).nose_off_rad < 0.1


@pytest.mark.parametrize("make", [copter_px4, copter_ardupilot])
def test_what_the_configuration_forbids_is_not_flown(make: Callable[[Configured], Copter]) -> None:
    slow = make(Configured(speed_max_m_s=1.5, acceleration_m_s2=0.5))
    speed = flown(slow, TABLE[CIRCLE_TASK], 1, compiled(fly))[:, COLUMNS.index("speed_m_s")]
    # what PX4 makes of it overshoots by what it is short of before
    assert speed.max() < 1.8


def test_waiting_helps_one_who_is_late() -> None:
    far = TABLE[CIRCLE_TASK]._replace(off_m=(30.0, 0.0, 0.0))
    punctual = outcome(COPTERS["px4"], far).converged_s
    waited = outcome(copter_px4(Configured(waits=True)), far).converged_s
    assert waited < punctual < 30.0


def test_compiled_it_is_the_same() -> None:
    windy = TABLE[f"{CIRCLE_TASK}, 5 m/s wind"]._replace(duration_s=4.0)
    plain, fast = flown(COPTERS["px4"], windy, 7), flown(COPTERS["px4"], windy, 7, compiled(fly))
    np.testing.assert_allclose(fast, plain, rtol=1e-6, atol=1e-6)
    assert plain.shape == (200, len(COLUMNS))


def test_the_same_seed_is_the_same_flight() -> None:
    short = TABLE[CIRCLE_TASK]._replace(duration_s=10.0)
    one, two, other = (flown(COPTERS["ardupilot"], short, seed, compiled(fly)) for seed in (4, 4, 5))
    assert (one == two).all()
    assert (one != other).any()


@pytest.mark.parametrize("kind", [CIRCLE, HELIX, EIGHT, LEG])
def test_a_plans_derivatives_are_its_own(kind: int) -> None:
    task = Task(kind, 12.0, 2.0, 0.4)
    h = 1e-4
    for t in (0.5, 3.0, 11.0):
        r, before, after = planned(task, t), planned(task, t - h), planned(task, t + h)
        change = (np.array(after.position) - np.array(before.position)) / (2.0 * h)
        assert r.velocity == pytest.approx(change, abs=1e-5)
        change = (np.array(after.velocity) - np.array(before.velocity)) / (2.0 * h)
        assert r.acceleration == pytest.approx(change, abs=1e-5)


def test_a_flight_that_never_converges_says_so() -> None:
    record = np.full((100, len(COLUMNS)), 5.0)
    assert figures(record, 1.0).converged_s == inf
