"""The figures by which a flight is judged."""

from __future__ import annotations

import math

import pytest

from guidance.figures import (
    Goals,
    StreamFigures,
    TrackingFigures,
    missed,
    stream_figures,
    tracking_figures,
)

NONE = TrackingFigures(None, None, None)


def errors_of(*values: float, step_s: float = 1.0) -> list[tuple[float, float]]:
    return [(i * step_s, value) for i, value in enumerate(values)]


def test_converged_is_the_first_instant_from_which_on_it_stayed_inside() -> None:
    figures = tracking_figures(errors_of(5.0, 0.2, 0.05, 0.03, 0.02, 0.04), time_constant_s=0.2)
    assert figures.converged_s == 2.0
    assert figures.max_error_m == 0.04
    assert figures.rms_error_m == pytest.approx(math.sqrt((0.03**2 + 0.02**2 + 0.04**2) / 3))


def test_what_leaves_again_has_converged_only_after_its_return() -> None:
    assert tracking_figures(errors_of(5, 0.01, 0.01, 0.2, 0.01, 0.01), 0.1).converged_s == 4.0


@pytest.mark.parametrize(
    "values",
    [(5.0, 4.0, 3.0), (0.01, 0.01, 0.2), (), (0.01,), (5.0, 5.0, 0.01), (0.01, 0.01, math.nan)],
    ids=["never", "leaves at the end", "nothing", "one look", "no time to show it", "not a number"],
)
def test_not_for_good_is_not_converged(values: tuple[float, ...]) -> None:
    assert tracking_figures(errors_of(*values), 1.0) == NONE


def test_the_edge_is_outside_and_just_below_it_is_inside() -> None:
    assert tracking_figures(errors_of(0.1, 0.1, 0.1), 1.0) == NONE
    below = math.nextafter(0.1, 0.0)
    assert tracking_figures(errors_of(below, below, below), 1.0).converged_s == 0.0


def test_an_error_that_is_not_a_number_counts_as_outside() -> None:
    figures = tracking_figures(errors_of(0.01, 0.01, math.nan, 0.01, 0.01), 0.1)
    assert figures.converged_s == 3.0


def test_rms_and_maximum_begin_five_time_constants_later_and_are_not_made_up_before() -> None:
    values = (0.09, 0.09, 0.09, 0.09, 0.09, 0.01, 0.01)
    figures = tracking_figures(errors_of(*values), 1.0)
    assert (figures.converged_s, figures.max_error_m) == (0.0, 0.01)
    assert figures.rms_error_m == pytest.approx(0.01)
    assert tracking_figures(errors_of(*values), 2.0) == TrackingFigures(0.0, None, None)


def test_a_stream_has_the_mean_rate_and_the_longest_gap() -> None:
    figures = stream_figures([0, 20_000_000, 70_000_000, 90_000_000])
    assert tuple(figures) == pytest.approx((3 / 0.09, 0.05))
    assert stream_figures([5]) == stream_figures([]) == StreamFigures(None, None)


def test_every_missed_goal_is_named_and_what_was_not_measured_or_asked_is_not() -> None:
    goals = Goals(12.0, 0.003, 0.01, 50.0, 0.05)
    good = TrackingFigures(12.0, 0.003, 0.01), StreamFigures(49.0, 0.05)
    assert missed(*good, goals) == []
    bad = TrackingFigures(12.1, 0.0031, 0.011), StreamFigures(48.9, 0.051)
    found = missed(*bad, goals)
    assert found == ["convergence", "RMS error", "largest error", "longest gap", "rate"]
    assert missed(NONE, StreamFigures(None, None), goals) == []
    assert missed(bad[0], good[1], Goals(None, None, None, 50.0, 0.05)) == []
