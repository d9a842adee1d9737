"""Which setpoint answers which state, and the figures that are made of it."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sitl.stopwatch import Flight, Stamp, answer_times_ns, answered_us, never, percentile, typical, worst

PERIOD_NS = 5_000_000


def sent(count: int) -> list[Stamp]:
    """States every 5 ms, eight headings in turn."""
    return [Stamp(i * PERIOD_NS, i % 8) for i in range(count)]


def test_each_state_is_answered_by_the_setpoint_of_its_heading() -> None:
    came = [Stamp(i * PERIOD_NS + 1000 * (i + 1), i % 8) for i in range(20)]
    assert answer_times_ns(sent(20), came) == [1000 * (i + 1) for i in range(20)]


def test_an_answer_that_comes_after_the_next_state_is_still_that_of_its_own() -> None:
    came = [Stamp(PERIOD_NS + 100, 0), Stamp(PERIOD_NS + 900, 1)]
    assert answer_times_ns(sent(2), came) == [PERIOD_NS + 100, 900]


def test_repetitions_and_setpoints_filled_in_by_a_timer_are_passed_over() -> None:
    came = [Stamp(700, 0), Stamp(2_500_000, 0), Stamp(PERIOD_NS + 10, 0), Stamp(PERIOD_NS + 800, 1)]
    assert answer_times_ns(sent(2), came) == [700, 800]


def test_a_state_that_was_overtaken_is_answered_by_the_setpoint_of_the_newer_one() -> None:
    assert answer_times_ns(sent(3), [Stamp(2 * PERIOD_NS + 300, 2)]) == [
        2 * PERIOD_NS + 300,
        PERIOD_NS + 300,
        300,
    ]


def test_what_is_never_answered_is_none_and_counts_as_infinite() -> None:
    flight = Flight([b"", b""], sent(2), [Stamp(1000, 0)], [0, 0])
    assert answer_times_ns(flight.sent, flight.came) == [1000, None]
    assert answered_us(flight) == [1.0, math.inf]
    assert never([answered_us(flight), [1.0]]) == 1


def test_a_setpoint_before_any_state_answers_nothing() -> None:
    assert answer_times_ns([Stamp(1000, 0)], [Stamp(999, 0)]) == [None]
    assert answer_times_ns([], [Stamp(999, 0)]) == []


@given(st.lists(st.integers(1, 7 * PERIOD_NS), min_size=1, max_size=40))
def test_answers_later_than_the_next_states_are_told_apart(delays_ns: list[int]) -> None:
    """An answer may take nearly eight periods; one overtaken by a newer one's ends with that."""
    states = sent(len(delays_ns))
    came = sorted(Stamp(s.t_ns + delay_ns, s.heading) for s, delay_ns in zip(states, delays_ns, strict=True))
    ends_ns = [s.t_ns + delay_ns for s, delay_ns in zip(states, delays_ns, strict=True)]
    expected = [min(ends_ns[i:]) - s.t_ns for i, s in enumerate(states)]
    assert answer_times_ns(states, came) == expected


@pytest.mark.parametrize(
    ("percent", "value"), [(50.0, 5.0), (90.0, 9.0), (91.0, 10.0), (99.9, 10.0), (0.0, 1.0)]
)
def test_percentiles_are_values_that_were_measured(percent: float, value: float) -> None:
    assert percentile([float(i) for i in range(10, 0, -1)], percent) == value


def test_a_figure_is_the_median_of_the_rounds_and_none_if_that_is_infinite() -> None:
    assert typical([[1.0], [100.0], [3.0]], 50.0) == 3.0
    assert typical([[1.0], [math.inf], [3.0]], 50.0) == 3.0
    assert typical([[1.0, math.inf], [math.inf], [3.0]], 99.0) is None
    assert worst([[1.0, math.inf], [7.0]]) == 7.0
    assert worst([[math.inf]]) is None


def test_a_round_without_answers_is_not_outvoted_by_the_others() -> None:
    rounds = [[1.0] * 100] * 3 + [[math.inf] * 100]
    assert typical(rounds, 50.0) == 1.0
    assert typical(rounds, 99.0) is None
    assert typical([[1.0] * 100] * 3 + [[1.0] * 98 + [math.inf] * 2], 99.0) == 1.0  # 2 of 400
