"""The counts of lateness and the intervals of the setpoints."""

from __future__ import annotations

import pytest

from guidance.timing import GAP_EVENT_S, LATENESS_EDGES_S, LoopTiming

MS = 1_000_000


def counts(timing: LoopTiming) -> tuple[int, ...]:
    return timing.record(0, 0).lateness_counts


@pytest.mark.parametrize("place", range(len(LATENESS_EDGES_S)))
def test_an_edge_belongs_to_the_bin_below_it(place: int) -> None:
    edge_ns = round(LATENESS_EDGES_S[place] * 1e9)
    for late_ns, expected in ((edge_ns, place), (edge_ns + 1, place + 1)):
        timing = LoopTiming()
        timing.sent(7, 7 + late_ns)
        assert [i for i, count in enumerate(counts(timing)) if count] == [expected]


def test_early_is_not_late() -> None:
    timing = LoopTiming()
    timing.sent(100, 50)
    assert counts(timing)[0] == 1
    assert timing.record(0, 0).lateness_max_s == 0.0


def test_the_record_has_rate_longest_gap_latest_tick_and_what_was_dropped() -> None:
    timing = LoopTiming()
    for t_ns, late_ns in ((0, 0), (20 * MS, 3 * MS), (60 * MS, 1 * MS)):
        timing.sent(t_ns - late_ns, t_ns)
    record = timing.record(99, 4)
    assert record.t_ns == 99
    assert record.ticks == 3
    assert record.lateness_edges_s == LATENESS_EDGES_S
    assert record.lateness_max_s == pytest.approx(0.003)
    assert record.setpoint_gap_max_s == pytest.approx(0.04)
    assert record.setpoint_rate_hz == pytest.approx(2 / 0.06)
    assert record.dropped_records == 4


def test_only_a_gap_over_the_limit_is_told() -> None:
    timing = LoopTiming()
    limit_ns = round(GAP_EVENT_S * 1e9)
    assert timing.sent(0, 0) is None
    assert timing.sent(0, limit_ns) is None
    assert timing.sent(0, 2 * limit_ns + 1) == pytest.approx(GAP_EVENT_S)


def test_a_pause_on_purpose_is_no_gap_and_does_not_lower_the_rate() -> None:
    timing = LoopTiming()
    timing.sent(0, 0)
    timing.sent(0, 20 * MS)
    timing.paused()
    assert timing.sent(0, 10_000 * MS) is None
    timing.sent(0, 10_020 * MS)
    record = timing.record(0, 0)
    assert record.setpoint_rate_hz == pytest.approx(50.0)
    assert record.setpoint_gap_max_s == pytest.approx(0.02)


def test_nothing_sent_is_no_rate() -> None:
    assert LoopTiming().record(0, 0).setpoint_rate_hz == 0.0
