"""The goals on a link that loses and delays, on a few seeds; what ends a flight; the command around them."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Final

import pytest
from typer.testing import CliRunner

from guidance.config import load
from sitl import bench_link
from sitl.bench_link import GOALS_M, LINKS, TRAJECTORIES, Tracked, Watched, gives_up, rows, track, watch
from sitl.cli import app
from tests.helpers import fly_until_tracking, make_flight
from tests.test_flights import fly

DEPLOY: Final = Path(__file__).parents[1] / "deploy"


@pytest.mark.parametrize("name", TRAJECTORIES)
@pytest.mark.parametrize("way", LINKS)
def test_the_goals_are_met_with_a_margin(way: str, name: str) -> None:
    for seed in (10, 11):
        flown = track(TRAJECTORIES[name], LINKS[way], seed, 26.0)
        assert flown.flying
        assert flown.error_m is not None
        assert flown.error_m < 0.5 * GOALS_M[name]
        assert flown.predicted_m < GOALS_M[name]
        assert flown.converged_s is not None
        assert flown.converged_s < 14.0


@pytest.mark.parametrize("way", LINKS)
@pytest.mark.parametrize("file", ["px4-uuv.toml", "ardupilot-rover.toml"])
def test_the_configurations_shipped_bear_the_same_links(file: str, way: str) -> None:
    engage = ("supervisor.engage=auto", "supervisor.arm=true", "supervisor.engage_max_error_m=100")
    config = load(DEPLOY / file, engage)
    flight = make_flight(config=config, to_guide=LINKS[way], to_vehicle=LINKS[way], seed=1)
    fly_until_tracking(flight, 20.0)  # what is said once a second and lost takes its time
    figures = fly(flight, 25.0)
    assert figures.max_error_m is not None
    assert figures.max_error_m < 0.03


def test_at_rate_bears_30_percent_of_loss() -> None:
    seen = watch(0.3, 1, 20.0)
    assert seen.at_rate > 0.98
    assert seen.not_at_rate_s < 0.6
    assert seen.gave_up_s is None


def test_beyond_50_percent_of_loss_control_is_given_up() -> None:
    seen = watch(0.6, 1, 40.0)
    assert seen.at_rate < 0.3
    assert seen.gave_up_s is not None


@pytest.mark.parametrize(("gap_s", "acted"), [(0.4, False), (0.6, True), (1.0, True)])
def test_a_short_gap_is_bridged_and_a_long_one_ends_the_flight(gap_s: float, acted: bool) -> None:
    assert [gives_up(gap_s, seed) for seed in (0, 1)] == [acted, acted]


GOOD: Final = Tracked(converged_s=10.0, error_m=0.01, predicted_m=0.01, flying=True)
CALM: Final = Watched(at_rate=1.0, not_at_rate_s=0.0, gave_up_s=None)
ACTED: Final = Watched(at_rate=0.1, not_at_rate_s=5.0, gave_up_s=3.0)


class Now:
    """A pool that does the work at once, in this process."""

    def __enter__(self) -> Now:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def submit(self, work: Any, *arguments: Any) -> Now:
        self._result = work(*arguments)
        done = Now()
        done._result = self._result
        return done

    def result(self) -> Any:
        return self._result


def measured(
    monkeypatch: pytest.MonkeyPatch,
    flown: Tracked = GOOD,
    borne: Watched = CALM,
    acted: Watched = ACTED,
    gave_up: bool = True,
) -> tuple[int, dict[str, Any]]:
    """Exit status and report of the command, where all flights are these."""
    monkeypatch.setattr(bench_link, "workers", Now)
    monkeypatch.setattr(bench_link, "track", lambda *_: flown)
    monkeypatch.setattr(bench_link, "watch", lambda loss, *_: borne if loss < 0.5 else acted)
    monkeypatch.setattr(bench_link, "gives_up", lambda gap_s, _: gave_up and gap_s > 0.5)
    outcome = CliRunner().invoke(app, ["bench", "link", "--flights", "2", "--seconds", "20", "--json"])
    return outcome.exit_code, json.loads(outcome.stdout)


def test_the_command_prints_every_figure_and_its_goal(monkeypatch: pytest.MonkeyPatch) -> None:
    status, report = measured(monkeypatch)
    assert status == 0
    assert report["met"] is True
    assert (report["flights"], report["seconds"], report["loss_each_way"]) == (2, 20.0, 0.3)
    assert [row["goal_m"] for row in report["tracking"]] == [0.03, 0.3, 0.03, 0.3]
    lines = rows(report)
    assert len(lines) == len(report["tracking"]) + len(report["losses"]) + len(report["gaps"])
    assert not any("MISSED" in figures for _, figures in lines)
    text = CliRunner().invoke(app, ["bench", "link", "--flights", "1", "--seconds", "20"]).stdout
    assert "bounded helix, 50 to 150 ms" in text
    assert "gap of 1.0 s" in text


@pytest.mark.parametrize(
    "wrong",
    [
        {"flown": GOOD._replace(error_m=0.031)},
        {"flown": GOOD._replace(error_m=None)},
        {"flown": GOOD._replace(flying=False)},
        {"borne": CALM._replace(at_rate=0.98)},
        {"borne": CALM._replace(gave_up_s=50.0)},
        {"acted": CALM},
        {"gave_up": False},
    ],
    ids=str,
)
def test_a_goal_that_is_missed_is_the_exit_status(wrong: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    status, report = measured(monkeypatch, **wrong)
    assert status == 1
    assert report["met"] is False
    assert any("MISSED" in figures for _, figures in rows(report))


def test_the_same_seed_is_the_same_flight() -> None:
    first, second = (track((), LINKS["0 to 100 ms"], 3, 14.0) for _ in range(2))
    assert first == second
    assert not math.isnan(first.predicted_m)
