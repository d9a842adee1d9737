"""What copters and PX4's rover must reach, flown by the whole service on their models with noise."""

from __future__ import annotations

from dataclasses import replace
from math import hypot

import pytest

from sitl.scenarios import copter, px4_rover
from sitl.scenarios.flight import fly
from sitl.scenarios.table import AS_IT_IS, Row, Variation, fly_row, in_words
from sitl.vehicle.estimator import SILENT

COPTERS = copter.rows()
ROVER = px4_rover.rows()
#: Every task as it is; what may be wrong, on the first.
FLIGHTS = [
    (row, variation)
    for row in (*COPTERS, *ROVER)
    for variation in row.variations
    if variation is AS_IT_IS or row.name.startswith("circle")
]


@pytest.mark.parametrize(
    ("row", "variation"),
    [
        pytest.param(row, variation, id=f"{row.task.profile}, {row.name}, {variation.name}")
        for row, variation in FLIGHTS
    ],
)
def test_it_reaches_what_it_must(row: Row, variation: Variation) -> None:
    result = fly_row(row, variation, seeds=1)
    assert not result.missed, in_words(result)
    assert result.figures is not None
    assert not result.figures.stuck


@pytest.mark.parametrize("row", [row for row in COPTERS if "hold" in row.name], ids=lambda r: r.task.profile)
def test_a_copter_stands_where_its_trajectory_stops(row: Row) -> None:
    figures = fly(replace(row.task, noise=SILENT))
    late = figures.trace[-100:]
    assert max(error for _, error, *_ in late) < 0.02
    (_, _, *first), (_, _, *last) = late[0], late[-1]
    assert hypot(*(b - a for a, b in zip(first, last, strict=True))) < 0.02


@pytest.mark.parametrize("profile", copter.COPTERS)
def test_each_part_of_the_answer_is_needed(profile: str) -> None:
    row = next(row for row in COPTERS if row.task.profile == profile)
    quiet = replace(row.task, noise=SILENT, duration_s=30.0)
    whole = fly(quiet).rms_m
    late = replace(quiet, settings=(*quiet.settings, "link.actuation_delay_s=0"))
    assert fly(late).rms_m > 1.3 * whole
    if profile == "px4-copter":
        blind = replace(quiet, settings=(*quiet.settings, "copter.learns=false"))
        assert fly(blind).rms_m > 1.5 * whole
