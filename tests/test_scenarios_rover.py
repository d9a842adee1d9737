"""What the rover must reach, on its model with noise, and what the paper's gains do there."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import pytest

from guidance.handling.rover import Autopilot, handling
from sitl.models.files import load_rover
from sitl.scenarios.ground import SILENT, Setting, Task, fly
from sitl.scenarios.tasks import (
    KNOWN_DELAY_S,
    ROVER,
    VARIATIONS,
    Row,
    Variation,
    fly_row,
    in_words,
    paper_handling,
)

CIRCLE = ROVER[0]
DEFAULT = Setting(load_rover("rover"), handling(Autopilot(), KNOWN_DELAY_S), KNOWN_DELAY_S)


@pytest.mark.parametrize("row", ROVER, ids=lambda row: row.name)
@pytest.mark.parametrize("variation", VARIATIONS, ids=lambda variation: variation.name)
def test_it_reaches_what_it_must(row: Row, variation: Variation) -> None:
    result = fly_row(row, variation, seeds=3 if variation is VARIATIONS[0] else 1)
    assert not result.missed, in_words(result)
    assert result.figures.reverse_m_s == 0.0
    assert not result.figures.stuck


def test_the_papers_gains_are_a_limit_cycle_of_metres() -> None:
    figures = fly(CIRCLE.task, replace(DEFAULT, handling=paper_handling(), predicts=False, noise=SILENT))
    assert figures.rms_m > 1.0
    assert figures.converged_s == float("inf")
    assert figures.saturated_part > 0.5


def test_without_noise_it_is_exact() -> None:
    figures = fly(CIRCLE.task, replace(DEFAULT, noise=SILENT))
    assert figures.rms_m < 0.005


def test_each_part_around_the_law_is_needed() -> None:
    """Without it the same flight misses a figure that it reaches with it, or never leaves."""
    whole = DEFAULT.handling
    flat = whole.speed_loop._replace(kp=0.0, ki=0.0)
    less = replace(DEFAULT, thrust_part=0.7)
    assert fly(CIRCLE.task, replace(less, handling=whole._replace(speed_loop=flat))).rms_m > 0.3
    blind = whole._replace(slip=whole.slip._replace(bound_rad=0.0))
    assert fly(CIRCLE.task, replace(DEFAULT, handling=blind)).rms_m > 0.04
    away = ROVER[5].task
    still = fly(
        replace(away, duration_s=10.0, settled_s=5.0),
        replace(DEFAULT, handling=whole._replace(crawl_m_s=0.0)),
    )
    assert still.converged_s == float("inf")
    assert max(row[4] for row in still.trace) < 0.1
    assert still.stuck is False  # it is not asked for anything: that is a deadlock, not a ditch


def test_a_reference_that_waits_halves_nothing_it_need_not() -> None:
    waits = replace(DEFAULT, handling=handling(Autopilot(), KNOWN_DELAY_S, waits=True))
    assert fly(ROVER[4].task, waits).converged_s < 0.8 * fly(ROVER[4].task, DEFAULT).converged_s
    on_time = fly(CIRCLE.task, replace(waits, noise=SILENT)).trace[-1]
    assert on_time[5] == pytest.approx(1.0, abs=0.02)


def test_a_boat_in_a_current_and_wind_stays_on_its_circle() -> None:
    boat = Autopilot(
        WP_SPEED=3.0,
        ATC_ACCEL_MAX=0.7,
        ATC_STR_ACC_MAX=57.0,
        ATC_STR_RAT_MAX=60.0,
        ATC_TURN_MAX_G=0.3,
        TURN_RADIUS=2.0,
        yaw_gain=0.9,
    )
    setting = replace(DEFAULT, model=load_rover("boat"), handling=handling(boat, 0.2), known_delay_s=0.2)
    figures = fly(CIRCLE.task, replace(setting, wind_ne_m_s=(3.0, -3.0)))
    assert figures.rms_m < 0.12
    assert figures.max_m < 0.3


def test_a_vehicle_in_a_ditch_is_found() -> None:
    ditch = load_rover("rover")._replace(speed_max_m_s=1e-3)
    figures = fly(replace(CIRCLE.task, duration_s=8.0, settled_s=4.0), replace(DEFAULT, model=ditch))
    assert figures.stuck


def test_a_flight_is_twice_the_same_and_another_with_another_seed() -> None:
    short = Task(CIRCLE.task.trajectory, (9.0, 0.0, 0.5 * pi), 4.0, 2.0)
    assert fly(short, DEFAULT) == fly(short, DEFAULT)
    assert fly(short, DEFAULT) != fly(short, replace(DEFAULT, seed=1))


def test_a_delay_that_nobody_knows_of_is_no_limit_cycle() -> None:
    late = replace(DEFAULT, extra_delay_s=0.16, extra_is_known=False)
    assert fly(CIRCLE.task, late).rms_m < 0.06
    stiff = DEFAULT.handling.law
    stiff = stiff._replace(gains=stiff.gains._replace(k=1.2))
    assert fly(CIRCLE.task, replace(late, handling=DEFAULT.handling._replace(law=stiff))).rms_m > 0.5
