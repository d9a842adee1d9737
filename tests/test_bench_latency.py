"""The latency bench's report: figures beside goals, and what could not be measured is not met."""

from __future__ import annotations

import importlib.util
import json
import math
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from sitl import bench_latency
from sitl.bench_latency import (
    Report,
    Round,
    UnavailableError,
    at_rate,
    latency,
    mavsdk_command,
    measure,
    rows,
)
from sitl.cli import app


def round_of(*times_us: float) -> Round:
    return Round(list(times_us), [1000] * len(times_us))


def flown(ours: float, theirs: float | None) -> dict[str, list[Round]]:
    return {
        "service": [round_of(*[ours] * 100)],
        "mavsdk": [] if theirs is None else [round_of(*[theirs] * 100)],
        "echo": [round_of(*[30.0] * 100)],
    }


def report_of(ours: float, theirs: float | None) -> Report:
    rates = [at_rate(hz, flown(ours, theirs)) for hz in (50, 200)]
    return Report(rates=rates, notes=[], met=all(at["met"] for at in rates))


@pytest.mark.parametrize(("ours", "theirs", "met"), [(69.0, 100.0, True), (71.0, 100.0, False)])
def test_the_goal_is_a_part_of_mavsdks_time(ours: float, theirs: float, met: bool) -> None:
    found = at_rate(50, flown(ours, theirs))
    assert found["ratio_p50"] == found["ratio_p99"] == pytest.approx(ours / theirs)
    assert found["met"] is met


def test_the_slow_ones_have_a_goal_of_their_own() -> None:
    slow = flown(50.0, 100.0)
    slow["service"] = [round_of(*[50.0] * 98, 81.0, 81.0)]
    found = at_rate(50, slow)
    assert found["ratio_p50"] == 0.5
    assert found["ratio_p99"] == pytest.approx(0.81)
    assert not found["met"]


def test_what_could_not_be_measured_is_not_met() -> None:
    report = report_of(50.0, None)
    assert not report["met"]
    for at in report["rates"]:
        assert (at["mavsdk"], at["ratio_p50"], at["ratio_p99"]) == (None, None, None)
    text = "\n".join(" ".join(row) for row in rows(report))
    assert text.count("not measured") == 6
    assert text.count("MISSED") == 4


def test_states_that_are_never_answered_are_slower_than_any_goal() -> None:
    found = latency([[50.0, math.inf], [60.0, 70.0], [80.0, math.inf]])
    assert found is not None
    assert (found["p50_us"], found["p99_us"], found["worst_us"]) == (60.0, None, 80.0)
    assert (found["states"], found["unanswered"]) == (6, 2)
    lost = flown(50.0, 100.0)
    lost["service"] = [round_of(*[50.0] * 90, *[math.inf] * 10)]
    at = at_rate(50, lost)
    assert (at["ratio_p50"], at["ratio_p99"], at["met"]) == (0.5, None, False)
    lost["service"] = [*[round_of(*[50.0] * 100)] * 3, round_of(*[math.inf] * 100)]
    assert not at_rate(50, lost)["met"]
    text = "\n".join(" ".join(row) for row in rows(Report(rates=[at], notes=[], met=False)))
    assert "10 of 100 never answered" in text
    assert "never" in text


def test_a_candidate_that_is_missing_is_tried_once_and_named(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[tuple[str, int]] = []

    def fly_round(name: str, rate_hz: int) -> Round:
        tried.append((name, rate_hz))
        if name == "mavsdk":
            raise UnavailableError("it is not there")
        return round_of(50.0)

    monkeypatch.setattr(bench_latency, "fly_round", fly_round)
    report = measure(rounds=3)
    assert report["notes"] == [f"mavsdk not measured at {hz} Hz: it is not there" for hz in (50, 200)]
    assert [tried.count(("mavsdk", hz)) for hz in (50, 200)] == [1, 1]
    assert [tried.count(("service", hz)) for hz in (50, 200)] == [3, 3]
    assert not report["met"]


def test_without_mavsdk_it_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UnavailableError, match=r"pip install '\.\[bench\]'"):
        mavsdk_command(14540, 50, tmp_path)


@pytest.mark.parametrize(("theirs", "status"), [(100.0, 0), (60.0, 1), (None, 1)])
def test_the_command_prints_a_table_or_one_object_and_tells_by_its_status(
    theirs: float | None, status: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def measured(rounds: int, step: object) -> Any:
        assert rounds == 4
        return report_of(50.0, theirs)

    monkeypatch.setattr(bench_latency, "measure", measured)
    table = CliRunner().invoke(app, ["bench", "latency"])
    assert table.exit_code == status, table.output
    assert "at 200 Hz, us" in table.output
    printed = CliRunner().invoke(app, ["bench", "latency", "--json"])
    assert printed.exit_code == status
    assert json.loads(printed.output) == report_of(50.0, theirs)
