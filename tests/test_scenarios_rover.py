"""What a rover must reach, flown by the whole service on its model with noise; what the paper's gains do."""

from __future__ import annotations

import json
from dataclasses import replace
from math import inf, pi

import pytest
from typer.testing import CliRunner

from sitl.cli import app
from sitl.scenarios.flight import Task, fly
from sitl.scenarios.rover import CORNER_S, ON_A_CIRCLE, WAITS, rows, task
from sitl.scenarios.table import AS_IT_IS, Limits, Row, Variation, fly_row, in_words
from sitl.vehicle.estimator import SILENT

ROWS = rows()
CIRCLE = ROWS[0].task
QUIET = replace(CIRCLE, noise=SILENT)
#: The paper's law and gains (section 4), and nothing around them.
PAPER = (
    "law.name=paper",
    "law.rho2_per_s=10",
    "law.rho3_per_s=10",
    "law.error_function.name=quadratic",
    "limits.speed_min_m_s=-5",
    "limits.acceleration_max_m_s2=100",
    "limits.yaw_acceleration_max_rad_s2=100",
    "link.actuation_delay_s=0",
    "ground.enabled=false",
)


def with_settings(flown: Task, *settings: str) -> Task:
    return replace(flown, settings=(*flown.settings, *settings))


@pytest.mark.parametrize(
    ("row", "variation"),
    [
        pytest.param(row, variation, id=f"{row.name}, {variation.name}")
        for row in ROWS
        for variation in row.variations
    ],
)
def test_it_reaches_what_it_must(row: Row, variation: Variation) -> None:
    result = fly_row(row, variation, seeds=2 if variation is AS_IT_IS else 1)
    assert not result.missed, in_words(result)
    assert result.figures is not None
    assert not result.figures.stuck


def test_the_papers_gains_are_a_limit_cycle_of_metres() -> None:
    figures = fly(with_settings(QUIET, *PAPER))
    assert figures.rms_m > 1.0
    assert figures.converged_s == inf


def test_without_noise_it_is_exact() -> None:
    assert fly(QUIET).rms_m < 0.01


def test_each_part_around_the_law_is_needed() -> None:
    """Without it the same flight misses a figure that it reaches with it, or never leaves."""
    slow = replace(CIRCLE, speed_part=0.7)
    assert fly(with_settings(slow, "ground.speed_kp=0", "ground.speed_ki_per_s=0")).rms_m > 0.3
    assert fly(with_settings(CIRCLE, "ground.slip_max_deg=0")).rms_m > 1.5 * fly(CIRCLE).rms_m
    away = replace(ROWS[5].task, duration_s=10.0, noise=SILENT)
    still = fly(with_settings(away, "ground.crawl_m_s=0", "guards.effect_s=60"))
    assert still.converged_s == inf
    assert still.trace[-1][2:4] == pytest.approx(still.trace[0][2:4], abs=0.5)


def test_a_reference_that_waits_is_reached_earlier() -> None:
    away = task(ON_A_CIRCLE, (25.0, 0.0, 0.0), 25.0)
    assert fly(with_settings(away, *WAITS)).converged_s < 0.8 * fly(away).converged_s
    assert fly(with_settings(QUIET, *WAITS)).rms_m < 0.02


def test_a_corner_is_waited_for() -> None:
    plain, waits = (replace(row.task, duration_s=CORNER_S + 8.0, noise=SILENT) for row in ROWS[2:4])
    assert fly(waits).corner_m < 0.85 * fly(plain).corner_m


def test_at_the_end_of_its_way_it_stands_though_its_position_drifts() -> None:
    """It would drive a loop of two metres to come back by three decimetres."""
    line = ("trajectory.name=line", "trajectory.speed_m_s=2", "trajectory.stop_at_s=20")
    figures = fly(task(line, (0.0, -3.0, 0.0), 80.0), seed=3)
    assert figures.max_m < 0.35
    places = {(round(north, 2), round(east, 2)) for t, _, north, east, _ in figures.trace if t > 40.0}
    assert len(places) == 1


def test_a_delay_that_nobody_knows_of_is_no_limit_cycle() -> None:
    assert fly(with_settings(CIRCLE, "link.actuation_delay_s=0")).rms_m < 0.06


def test_a_slow_line_that_is_known_is_no_limit_cycle() -> None:
    """200 ms more there and back: the clock filter measures them."""
    figures = fly(replace(CIRCLE, link_delay_s=0.1))
    assert figures.converged_s < 6.0
    assert figures.max_m < 0.12


def test_a_flight_is_twice_the_same_and_another_with_another_seed() -> None:
    short = task(ON_A_CIRCLE, (9.0, 0.0, 0.5 * pi), 4.0)
    assert fly(short) == fly(short)
    assert fly(short) != fly(short, seed=1)


def test_the_command_prints_the_table() -> None:
    command = ("scenarios", "--profile", "ardupilot-rover", "--task", "circle r", "--plain", "--seeds", "1")
    found = CliRunner().invoke(app, [*command, "--json"])
    assert found.exit_code == 0, found.output
    (row,) = json.loads(found.stdout)
    assert (row["task"], row["missed"]) == (ROWS[0].name, [])
    assert 0.0 < row["figures"]["rms_m"] <= row["limits"]["rms_m"] == 0.03
    assert row["limits"]["corner_m"] is None
    nothing = CliRunner().invoke(app, ["scenarios", "--profile", "zeppelin"])
    assert nothing.exit_code == 2
    assert "profiles are ardupilot-copter, ardupilot-plane, ardupilot-rover" in nothing.output


def test_a_limit_that_is_missed_is_said() -> None:
    strict = replace(ROWS[0], limits=Limits(rms_m=0.001), task=replace(CIRCLE, duration_s=15.0))
    result = fly_row(strict, seeds=1)
    assert result.missed == ("rms_m",)
    assert "MISSED" in in_words(result)


def test_a_flight_that_does_not_come_about_is_said() -> None:
    far = task(ON_A_CIRCLE, (500.0, 0.0, 0.0), 5.0)
    result = fly_row(replace(ROWS[0], task=far), seeds=1)
    assert result.figures is None
    assert "engage_max_error_m" in in_words(result)
