"""The loop bench: lateness from what was sent and what the log holds, and a load that is one."""

from __future__ import annotations

import json
import math
from collections.abc import Callable

import pytest
from typer.testing import CliRunner

from guidance.records import Event, Level
from guidance.telemetry import Sample
from sitl import bench_loop
from sitl.bench_latency import UnavailableError
from sitl.bench_loaded import TIMES, Computing, LoadedSinks
from sitl.bench_loop import Report, Round, measure, read_us, report, rows
from sitl.cli import app
from sitl.stopwatch import Flight, Stamp


def lateness(*late_us: float) -> list[Round]:
    return [Round(list(late_us), [300.0] * len(late_us))]


def test_a_state_is_late_by_the_time_until_it_was_read() -> None:
    flight = Flight([b"a", b"b", b"c"], [Stamp(1000, 0), Stamp(2000, 1), Stamp(3000, 2)], [], [0, 0, 0])
    assert read_us(flight, {b"a": 51_000, b"c": 3500, b"x": 1}) == [50.0, math.inf, 0.5]


@pytest.mark.parametrize(
    ("idle_us", "loaded_us", "met"),
    [(1999.0, 2999.0, True), (2001.0, 2001.0, False), (100.0, 1101.0, False), (100.0, math.inf, False)],
)
def test_both_goals_are_held(idle_us: float, loaded_us: float, met: bool) -> None:
    found = report({"idle": lateness(idle_us), "loaded": lateness(loaded_us)}, [])
    assert found["met"] is met
    assert ("MISSED" in "".join(text for _, text in rows(found))) is not met


def test_what_could_not_be_measured_is_not_met(monkeypatch: pytest.MonkeyPatch) -> None:
    def fly_round(*, loaded: bool) -> Round:
        if loaded:
            raise UnavailableError("no log")
        return lateness(100.0)[0]

    monkeypatch.setattr(bench_loop, "_fly_round", fly_round)
    found = measure(rounds=2)
    assert found["notes"] == ["loaded not measured: no log"]
    assert (found["loaded"], found["added_p99_us"], found["met"]) == (None, None, False)
    assert found["idle"] is not None
    assert any("not measured" in text for _, text in rows(found))


def test_states_that_the_log_does_not_hold_are_counted() -> None:
    found = report({"idle": lateness(100.0, math.inf), "loaded": lateness(100.0)}, [])
    assert found["idle"] is not None
    assert (found["idle"]["unread"], found["idle"]["p999_us"]) == (1, None)
    assert not found["met"]
    assert any("1 of 2 never read" in text for _, text in rows(found))
    rounds = lateness(100.0) * 3 + lateness(math.inf)
    assert not report({"idle": rounds, "loaded": lateness(100.0)}, [])["met"]


class Watch:
    """A `guidance watch` that saw a vehicle for some seconds, and may have ended."""

    def __init__(self, lines: int, ended: bool) -> None:
        self.lines, self.ended = lines, ended

    def __enter__(self) -> Watch:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing."""

    def listen(self, take: Callable[[str], None]) -> None:
        for _ in range(self.lines):
            take("{}")

    def obituary(self) -> str:
        return "the watch ended"


@pytest.mark.parametrize(
    ("lines", "ended", "why"), [(5, False, None), (5, True, "the watch ended"), (1, False, "in 1 of 5 s")]
)
def test_a_load_that_is_not_there_is_not_measured(
    lines: int, ended: bool, why: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    flight = Flight([b"a"], [Stamp(1000, 0)], [Stamp(2000, 0)], [0])
    monkeypatch.setattr(bench_loop, "Child", lambda *_: Watch(lines, ended))
    monkeypatch.setattr(bench_loop, "fly", lambda *_: flight)
    monkeypatch.setattr(bench_loop, "_read", lambda _: {b"a": 2000})
    found = measure(rounds=1)
    assert (found["loaded"] is None) is (why is not None)
    assert found["notes"] == [] if why is None else why in found["notes"][0]


class Counting:
    """A sink that only counts."""

    dropped, problem = 0, ""

    def __init__(self) -> None:
        self.samples: list[Sample] = []

    def offer(self, sample: Sample) -> None:
        self.samples.append(sample)

    def start(self) -> None:
        """Nothing."""

    def close(self, timeout_s: float) -> bool:
        return True


def test_the_load_is_every_record_ten_times_for_every_sink() -> None:
    sinks = {"log": Counting(), "zenoh": Counting()}
    LoadedSinks(sinks).publish([Event(t_ns=i, level=Level.INFO, code="x", text="") for i in range(3)])
    for sink in sinks.values():
        assert [sample.t_ns for sample in sink.samples] == [i for i in range(3) for _ in range(TIMES)]


def test_the_computing_sink_writes_all_that_it_is_given_time_for() -> None:
    sink = Computing()
    for i in range(20):
        sink.offer(Sample("event", i, b'{"a": 1}'))
    sink.start()
    assert sink.close(20.0)
    assert sink.dropped == 0


@pytest.mark.parametrize(("loaded_us", "status"), [(500.0, 0), (5000.0, 1)])
def test_the_command_prints_a_table_or_one_object_and_tells_by_its_status(
    loaded_us: float, status: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def measured(rounds: int, step: object = None) -> Report:
        assert rounds == 4
        return report({"idle": lateness(100.0), "loaded": lateness(loaded_us)}, [])

    monkeypatch.setattr(bench_loop, "measure", measured)
    table = CliRunner().invoke(app, ["bench", "loop"])
    assert table.exit_code == status, table.output
    assert "sinks under load" in table.output
    printed = CliRunner().invoke(app, ["bench", "loop", "--json"])
    assert printed.exit_code == status
    assert json.loads(printed.output) == measured(4)
