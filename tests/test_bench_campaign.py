"""The throughput benchmark's verdict: a goal not measured is not met; and no process is left behind."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from sitl import bench_campaign, cli
from sitl.bench_campaign import UnavailableError, c_loop, crazyflow, measure, rows
from sitl.campaign.flight import Rows
from sitl.campaign.plan import Plan

pytestmark = pytest.mark.timeout(120)  # the first of these compiles, and other work may keep the machine busy


def as_quick_as(c: float | None, crazyflow_: float | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """One round of few flights, beside sides that reach these steps per second, or are not there."""
    small = replace(bench_campaign.PLAN, flights=8, duration_s=0.5)
    monkeypatch.setattr(bench_campaign, "PLAN", small)
    monkeypatch.setattr(bench_campaign, "TOGETHER", small)
    monkeypatch.setattr(bench_campaign, "ROUNDS", 1)
    monkeypatch.setattr(bench_campaign, "_flights_per_s", lambda plan, threads: plan.flights)
    monkeypatch.setattr(bench_campaign, "_first_flights", lambda: (1.0, 0.1))

    def rate(fly_all: Callable[[], object]) -> float:
        flown = fly_all()
        return flown if isinstance(flown, float) else 10.0

    monkeypatch.setattr(bench_campaign, "_rate", rate)

    def loop() -> Callable[[Plan, Rows, int], Any]:
        if c is None:
            raise UnavailableError("no C compiler")
        return lambda plan, starts, threads: c

    @contextmanager
    def other() -> Iterator[Callable[[], float]]:
        if crazyflow_ is None:
            raise UnavailableError("crazyflow is not installed")
        yield lambda: crazyflow_

    monkeypatch.setattr(bench_campaign, "c_loop", loop)
    monkeypatch.setattr(bench_campaign, "crazyflow", other)
    monkeypatch.setattr(bench_campaign, "difference", lambda ours, c: 0.0)


@pytest.mark.parametrize(
    ("c", "other", "met", "unmeasured"),
    [
        (14.0, 2.0, True, []),
        (15.0, 2.0, False, []),
        (14.0, 2.1, False, []),
        (None, 2.0, False, ["C"]),
        (14.0, None, False, ["crazyflow"]),
        (None, None, False, ["C", "crazyflow"]),
    ],
)
def test_a_goal_that_was_missed_or_not_measured_is_not_met_and_the_exit_status_says_so(
    c: float | None,
    other: float | None,
    met: bool,
    unmeasured: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    as_quick_as(c, other, monkeypatch)
    monkeypatch.setattr("sys.argv", ["sitl", "bench", "campaign", "--json"])
    with pytest.raises(SystemExit) as exit_:
        cli.main()
    report = json.loads(capsys.readouterr().out)
    assert exit_.value.code == (0 if met else 1)
    assert report["met"] is met
    assert report["ratio_to_c"] == (None if c is None else 10.0 / c)
    assert report["ratio_to_crazyflow"] == (None if other is None else 10.0 / other)
    assert [note.partition(",")[0] for note in report["notes"]] == [f"no ratio to {it}" for it in unmeasured]
    printed = {what: (value, goal) for what, value, goal in rows(report)}
    for side in ("C", "crazyflow"):
        value, goal = printed[f"ratio to {side}"]
        assert (value == "not measured") == (side in unmeasured)
        assert side not in unmeasured or goal.endswith("MISSED")


def test_a_compilation_that_takes_too_long_misses_its_goal(monkeypatch: pytest.MonkeyPatch) -> None:
    as_quick_as(10.0, 1.0, monkeypatch)
    monkeypatch.setattr(bench_campaign, "_first_flights", lambda: (16.0, 0.1))
    assert not measure()["met"]


def test_without_a_compiler_or_a_place_to_build_in_there_is_no_c_loop_and_a_reason(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("CC", str(tmp_path / "nothing"))
    with pytest.raises(UnavailableError, match="no C compiler"):
        c_loop()
    monkeypatch.setenv("CC", sys.executable)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(UnavailableError, match="failed: "):
        c_loop()
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.raises(UnavailableError, match="no place to build the C loop in"):
        c_loop()


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[subprocess.Popen[str]]:
    """The processes that are started."""
    found: list[subprocess.Popen[str]] = []

    class Recorded(subprocess.Popen[str]):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            found.append(self)

    monkeypatch.setattr(subprocess, "Popen", Recorded)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    return found


def speaks(monkeypatch: pytest.MonkeyPatch, program: str) -> None:
    """Take this program for crazyflow."""
    monkeypatch.setattr(bench_campaign, "_CRAZYFLOW", (sys.executable, "-u", "-c", program))


def test_crazyflow_is_asked_once_for_each_figure_and_ends_with_the_context(
    monkeypatch: pytest.MonkeyPatch, started: list[subprocess.Popen[str]]
) -> None:
    speaks(
        monkeypatch,
        "print('its say\\nsteps_per_s 1')\nfor n in (2, 3): input(); print('steps_per_s', n)\ninput()",
    )
    with crazyflow() as steps_per_s:
        assert (steps_per_s(), steps_per_s()) == (2.0, 3.0)
    assert started[0].returncode is not None


def test_crazyflow_ends_with_an_error_in_its_context(
    monkeypatch: pytest.MonkeyPatch, started: list[subprocess.Popen[str]]
) -> None:
    speaks(monkeypatch, "print('steps_per_s 1')\nimport time\ntime.sleep(1000)")
    with pytest.raises(KeyboardInterrupt), crazyflow():
        raise KeyboardInterrupt
    assert started[0].returncode is not None


@pytest.mark.parametrize(
    ("program", "answers"),
    [
        ("raise ValueError('no worlds')", 0),
        ("print('steps_per_s 1')\ninput()\nprint('steps_per_s 2')\nraise ValueError('no worlds')", 1),
        # It hears no more before it answers.
        (
            "print('steps_per_s 1')\ninput()\nimport os\nos.close(0)\n"
            "print('steps_per_s 2')\nprint('no worlds')",
            1,
        ),
    ],
)
def test_a_crazyflow_that_fails_is_unavailable_with_its_last_words(
    program: str, answers: int, monkeypatch: pytest.MonkeyPatch, started: list[subprocess.Popen[str]]
) -> None:
    speaks(monkeypatch, program)
    given: list[float] = []
    with pytest.raises(UnavailableError, match="no worlds"), crazyflow() as steps_per_s:
        given.extend(steps_per_s() for _ in range(2))
    assert len(given) == answers
    assert started[0].returncode is not None


def test_a_crazyflow_that_fails_between_two_rounds_is_not_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    as_quick_as(10.0, 1.0, monkeypatch)
    monkeypatch.setattr(bench_campaign, "ROUNDS", 3)

    @contextmanager
    def fails() -> Iterator[Callable[[], float]]:
        figures = iter([1.0])

        def once() -> float:
            for figure in figures:
                return figure
            raise UnavailableError("out of worlds")

        yield once

    monkeypatch.setattr(bench_campaign, "crazyflow", fails)
    report = measure()
    assert report["ratio_to_crazyflow"] is None
    assert report["ratio_to_c"] == 1.0
    assert report["notes"] == ["no ratio to crazyflow, and its goal not met: out of worlds"]
    assert not report["met"]
