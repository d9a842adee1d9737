"""Reports on logs that nobody sane wrote: they end in a page or in one line, never in a traceback."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from guidance.cli import main
from guidance.records import Link, Record, Setpoint, State, Timing, TrackingError
from tests.flight_asset import ASSET
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
    ],
    ids=["one setpoint", "no state", "no link", "far away", "far off", "fast", "odd timing"],
)
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
