"""The bench of reports measures the real commands on a real log; how fast they are depends on the machine."""

from __future__ import annotations

import pytest

from sitl import bench_report


@pytest.mark.timeout(300)
def test_it_measures_report_and_replay_in_processes_of_their_own() -> None:
    found = bench_report.measure(3.0)
    assert found["flight_s"] == 3.0
    assert 0.1 < found["log_mb"] < 5.0
    assert 4.0 < found["page_mb"] < 10.0
    assert 20.0 < found["report_peak_mib"] < bench_report.GOAL_MIB
    assert found["report_cpu_s"] > 0.0
    assert found["replay_cpu_factor"] >= 0.5 * found["replay_factor"]
    assert isinstance(found["met"], bool)
    assert len(bench_report.rows(found)) == 7


def test_a_command_that_fails_is_no_figure() -> None:
    with pytest.raises(RuntimeError, match="exit status 2"):
        bench_report._spent("report", "no-such-log.mcap")
