"""What an hour in front of the dashboard is judged by."""

from __future__ import annotations

from dataclasses import replace

from tests.dashboard_soak import FULL_MIN, Figures, faults

STEADY = Figures(
    server_mb=90.0, page_mb=12.0, elements=500, cpu_percent=6.0, frames_per_s=20.0, worst_ms=30.0
)


def test_what_fills_at_first_and_stays_is_no_fault() -> None:
    assert faults([replace(STEADY, server_mb=60.0, page_mb=4.0)] * 5 + [STEADY] * 55) == []


def test_what_grows_to_the_end_is_told() -> None:
    hour = [replace(STEADY, server_mb=90.0 + 0.2 * k, page_mb=12.0 + 0.3 * k) for k in range(60)]
    grown, drew = faults(hour), f"{0.2 * (59 - FULL_MIN):.1f} MB"
    assert [fault.split()[1] for fault in grown] == ["server", "page"]
    assert drew in grown[0]


def test_one_slow_minute_is_told() -> None:
    assert faults([STEADY, replace(STEADY, frames_per_s=9.0), STEADY]) == [
        "minute 2: 9.0 frames a second, at least 10 wanted"
    ]
