"""`sitl bench dashboard`: the fleet, the server and a page come up, and are measured."""

from __future__ import annotations

import pytest

from sitl import bench_dashboard
from sitl.bench_dashboard import VEHICLES, measure, rows


def test_every_vehicle_is_shown_and_the_server_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_dashboard, "_WARM_S", 2.0)
    report = measure(1.0)
    assert report["vehicles_shown"] == VEHICLES
    assert report["cpu_percent"] > 0.0
    assert report["rss_end_mb"] > 10.0
    assert report["page_rows_per_s"] > 5.0


def told(cpu_percent: float = 6.0, rss_end_mb: float = 110.0) -> list[str]:
    """What is said of such a measurement."""
    report = bench_dashboard.Report(
        vehicles=VEHICLES,
        rate_hz=50,
        seconds=30.0,
        cpu_percent=cpu_percent,
        rss_start_mb=100.0,
        rss_end_mb=rss_end_mb,
        page_bytes_per_s=5e4,
        page_rows_per_s=20.0,
        vehicles_shown=VEHICLES,
        met=True,
    )
    return [said for _, said in rows(report)]


def test_a_missed_goal_is_said() -> None:
    assert not any("MISSED" in said for said in told())
    assert sum("MISSED" in said for said in told(cpu_percent=26.0)) == 1
    assert sum("MISSED" in said for said in told(rss_end_mb=121.0)) == 1
