"""Reports on logs that nobody sane wrote: they end in a page or in one line, never in a traceback."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from msgspec.structs import replace

from guidance.cli import main
from guidance.records import Link, Record, Setpoint, State, Status, Timing, TrackingError
from guidance.report.panels import _lateness
from guidance.telemetry.log import read_records
from tests.flight_asset import ASSET, configuration
from tests.hand_made_flight import flown, log_of, with_session
from tests.helpers import make_config
from tests.test_report_page import read_page, track

#: What a page, plotly.js (which knows some tags) and matplotlib (which knows formulas) might take amiss.
NAME = '<b>a</b><a href="http://x.y">$\\frac{$ %{x}\x1b[2J'


def run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: str
) -> tuple[int, str, str]:
    monkeypatch.setattr(sys, "argv", ["guidance", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr()
    assert isinstance(ended.value.code, int)
    return ended.value.code, said.out, said.err


def without(kind: type[Record]) -> Callable[[list[Record]], list[Record]]:
    return lambda records: [one for one in records if not isinstance(one, kind)]


def with_fields(kind: type[Record], **fields: Any) -> Callable[[list[Record]], list[Record]]:
    return lambda records: [replace(one, **fields) if isinstance(one, kind) else one for one in records]


def one_setpoint(records: list[Record]) -> list[Record]:
    last = next(i for i, one in enumerate(records) if isinstance(one, Setpoint))
    return records[: last + 1]


@pytest.mark.parametrize(
    "change",
    [
        one_setpoint,
        without(State),
        without(Link),
        with_fields(State, position_ned_m=(1e300, -1e300, 1e200), velocity_ned_m_s=(1e300, 0.0, 0.0)),
        with_fields(TrackingError, error_ned_m=(1e200, 1e200, 1e200)),
        with_fields(Setpoint, speed_m_s=1e300),
        with_fields(Timing, lateness_edges_s=(), lateness_counts=(1, 2, 3)),
        with_fields(Timing, lateness_edges_s=(0.001,), lateness_counts=(-5, 1)),
        with_fields(Timing, lateness_edges_s=(0.001,), lateness_counts=(1, -1)),
        with_fields(Timing, lateness_edges_s=(0.001,), lateness_counts=(-(10**400), 10**400)),
        with_fields(Timing, lateness_edges_s=(1e308,), lateness_counts=(1, 1), lateness_max_s=1e308),
        with_fields(Timing, lateness_edges_s=(0.002, 0.001), lateness_counts=(1, 1, 1)),
        with_fields(Link, round_trip_s=1e306, received_bytes_per_s=1e308),
        with_fields(Link, lost=10**400, received=1 - 10**400),
    ],
    ids=[
        "one setpoint", "no state", "no link", "far away", "far off", "fast", "odd timing", "fewer than none",
        "less than none", "no end", "late for ever", "edges fall", "slow light", "lost more than sent",
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("error")
def test_odd_flights_make_a_page(
    change: Callable[[list[Record]], list[Record]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    log, output = log_of(tmp_path, make_config(), change(flown(2.0, track))), tmp_path / "x.html"
    arguments = ("report", str(log), "-o", str(output), "--png", str(tmp_path / "png"), "--json")
    status, out, err = run(monkeypatch, capsys, *arguments)
    assert status == 0, err
    json.loads(out, parse_constant=pytest.fail)
    assert read_page(output)[1].json["charts"]["plan"]["data"]


def test_an_instant_beyond_all_clocks_ends_the_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    records = flown(2.0, track)
    last = max(i for i, one in enumerate(records) if isinstance(one, Setpoint))
    records[last] = replace(records[last], t_ns=2**64 - 1)
    log = log_of(tmp_path, make_config(), records)
    status, out, err = run(monkeypatch, capsys, "report", str(log), "-o", str(tmp_path / "x.html"), "--json")
    assert status == 0, err
    assert "cannot be read" in json.loads(out)["logs"][0]["incomplete"]


@pytest.mark.parametrize("length", [8, 9, 20, 200, 1000])
@pytest.mark.parametrize("verb", [["report"], ["replay"], ["replay", "--set", "law.k=0.5"]])
def test_a_log_cut_before_its_flight_is_refused_in_one_line(
    length: int,
    verb: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(ASSET.read_bytes()[:length])
    status, out, err = run(monkeypatch, capsys, *verb, str(cut))
    assert (status, out) == (2, "")
    assert err.startswith("guidance: ")
    assert err.count("\n") == 1
    assert not (tmp_path / "report.html").exists()


def test_the_lateness_of_a_run_is_drawn_as_it_was_counted() -> None:
    (timing,) = (one for one in flown(1.0, track) if isinstance(one, Timing))
    edges, counts = _lateness(timing)
    assert (edges.tolist(), counts.tolist()) == ([0.0, 1.0, 2.0, 4.0], [90.0, 9.0, 1.0])
    edges, counts = _lateness(replace(timing, lateness_counts=(90, 9, 0)))
    assert (edges.tolist(), counts.tolist()) == ([0.0, 1.0, 2.0], [90.0, 9.0])


@pytest.mark.parametrize("converged", ["inf", "nan"])
def test_converged_is_a_number_of_metres(
    converged: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "x.html"
    status, out, err = run(
        monkeypatch, capsys, "report", str(ASSET), "-o", str(output), "--converged", converged
    )
    assert (status, out) == (2, "")
    assert "'--converged'" in err


def test_a_part_whose_number_no_run_reaches_is_the_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    odd = tmp_path / "odd.mcap"
    with odd.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_metadata("guidance", {"session_id": "s", "part": "9" * 5000})
        writer.finish()  # type: ignore[no-untyped-call]
    status, _, err = run(monkeypatch, capsys, "report", str(odd), "-o", str(tmp_path / "x.html"))
    assert status == 2
    assert "it does not say how it ended" in err
    # and it does not stand in the way of a neighbour whose first part is looked for
    later = tmp_path / "z.mcap"
    with later.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_metadata("guidance", {"session_id": "t", "part": "2"})
        writer.finish()  # type: ignore[no-untyped-call]
    status, _, err = run(monkeypatch, capsys, "replay", str(later))
    assert status == 2
    assert "part 2 of its run" in err


@pytest.mark.parametrize(
    "verb", [["report"], ["replay"], ["replay", "--set", "law.k=0.5"]], ids=["report", "replay", "compared"]
)
def test_a_name_that_is_no_utf_8_may_end_early(
    verb: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    cut = tmp_path / os.fsdecode(b"caf\xe9.mcap")
    cut.write_bytes(ASSET.read_bytes()[:180_000])
    status, out, err = run(monkeypatch, capsys, *verb, str(cut), "--json")
    assert status == (1 if verb == ["replay"] else 0), err
    assert "caf" in json.dumps(json.loads(out.splitlines()[-1]))
    assert "incomplete" in err


@pytest.mark.parametrize("verb", [["report"], ["replay"], ["replay", "--set", "law.k=0.5"]])
def test_a_log_that_is_damaged_at_its_beginning_says_so(
    verb: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.mcap"
    for length in (100, 1000):
        cut.write_bytes(ASSET.read_bytes()[:length])
        _, _, err = run(monkeypatch, capsys, *verb, str(cut))
        assert "incomplete from byte" in err


@pytest.mark.parametrize("verb", [["replay"], ["replay", "--set", "law.k=0.5"]])
def test_words_of_a_log_steer_no_terminal(
    verb: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said = "\x1b]0;PWNED\x07"
    reasons = with_fields(Status, reason=said, state=said)(list(read_records(ASSET))[1:])
    told = log_of(tmp_path, configuration(), reasons)
    ended = tmp_path / "ended.mcap"
    with ASSET.open("rb") as source, ended.open("wb") as target:
        writer = Writer(target)
        writer.start()
        writer.add_metadata("guidance", {"session_id": "s"})
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channels: dict[str, int] = {}
        for n, (_, channel, message) in enumerate(make_reader(source).iter_messages(log_time_order=False), 1):
            topic = channel.topic
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", schema)
            writer.add_message(channels[topic], n, message.data, n, n)
        writer.add_metadata("guidance.end", {"ended_early": said})
        writer.finish()  # type: ignore[no-untyped-call]
    for log in (told, ended):
        _, out, err = run(monkeypatch, capsys, *verb, str(log))
        assert "PWNED" in out + err
        assert "\x1b" not in out + err
        assert "\x07" not in out + err


@pytest.mark.filterwarnings("error")
def test_names_of_vehicles_are_words_everywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log = log_of(tmp_path, make_config(), flown(2.0, track))
    named = [with_session(log, tmp_path / f"{n}{'x' * 30}.mcap", vehicle=NAME) for n in "ab"]
    for logs in (named[:1], named):
        output = tmp_path / "x.html"
        arguments = ("report", *map(str, logs), "-o", str(output), "--png", str(tmp_path / "png"))
        status, _, err = run(monkeypatch, capsys, *arguments)
        assert status == 0, err
        text, page = read_page(output)
        assert "<b>a</b>" not in text
        assert "<b>a</b>" in page.text
        charts = page.json["charts"]
        assert "<b>" not in json.dumps(charts)
        assert "<a " not in json.dumps(charts)
        assert "\x1b" not in text
