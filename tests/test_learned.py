"""What flights have taught of an airplane goes from one process to the next, and never stands in the way."""

from __future__ import annotations

import asyncio
from pathlib import Path

import msgspec
import pytest

from guidance.config import Config, load
from guidance.core import Guide
from guidance.flying.airplane import Airplane, Kept
from guidance.handling.airplane import UNTRIMMED, Trims, unstarted
from guidance.kept_file import KeptFile, LearnedFile, open_learned
from guidance.records import Event, Input, InputKind, Level, Record
from guidance.service import new_session
from guidance.shell import Shell
from guidance.telemetry.sinks import Sinks
from tests.helpers import make_config
from tests.test_flying_airplane import DEPLOY

LEARNED = '{"effectiveness":0.75,"pitch_rad":-0.02,"throttle":0.1}'


def airplane(tmp_path: Path) -> Config:
    settings = [f"airplane.trims_file={tmp_path / 'state' / 'trims.json'}", "log.enabled=false"]
    return load(DEPLOY / "px4-plane.toml", [*settings, "link.connection=udpin://127.0.0.1:0"])


def handler_of(guide: Guide) -> Airplane:
    assert isinstance(guide.tracker.handler, Airplane)
    return guide.tracker.handler


def told(records: list[Record]) -> list[tuple[str, str]]:
    return [(one.level, one.text) for one in records if isinstance(one, Event) and one.code == "learned"]


def test_what_was_learned_before_is_an_input(tmp_path: Path) -> None:
    guide = Guide(airplane(tmp_path))
    guide.recall(LEARNED, 5)
    records = guide.records()
    first = records[0]
    assert isinstance(first, Input)
    assert (first.kind, first.text) == (InputKind.LEARNED, LEARNED)
    assert told(records) == [(Level.INFO, f"starts with what was learned before: {LEARNED}")]
    assert handler_of(guide).trims == Trims(0.75, -0.02, 0.1)
    again = Guide(airplane(tmp_path))
    again.handle(first)
    assert again.records() == records
    assert again.learned == guide.learned == LEARNED


@pytest.mark.parametrize("text", ["", "nonsense", LEARNED.replace("0.75", "7.5")])
def test_absurd_content_is_refused_aloud(text: str, tmp_path: Path) -> None:
    guide = Guide(airplane(tmp_path))
    guide.recall(text, 5)
    ((level, said),) = told(guide.records())
    assert level is Level.WARNING
    assert said.startswith("what was learned before is not used: ")
    assert handler_of(guide).trims == UNTRIMMED


def test_other_vehicles_learn_nothing() -> None:
    guide = Guide(make_config())
    assert guide.learned == ""
    guide.recall(LEARNED, 5)
    assert told(guide.records())[0][0] is Level.WARNING
    assert open_learned(make_config()) is None


def run(config: Config, learns: Trims | None = None) -> tuple[str, LearnedFile]:
    """A process that begins, perhaps learns this, and ends: what it knew at its start."""

    async def lives() -> tuple[str, LearnedFile]:
        file = open_learned(config)
        assert file is not None
        session = new_session(config)
        shell = Shell(config, Sinks({}), session, learned=file)
        began = shell.learned
        if learns is not None:
            handler_of(shell._guide)._memory = unstarted(learns)
        shell._look_at_learned(file)
        file.close(shell.learned, 5.0)
        return began, file

    return asyncio.run(lives())


def test_from_one_process_to_the_next(tmp_path: Path) -> None:
    config = airplane(tmp_path)
    path = Path(config.airplane.trims_file)
    assert msgspec.json.decode(run(config)[0], type=Kept) == Kept(*UNTRIMMED)
    assert not path.exists(), "nothing was learned"
    run(config, Trims(0.75, -0.02, 0.1))
    assert path.read_text() == LEARNED
    assert run(config)[0] == LEARNED
    path.write_text("nonsense")
    assert msgspec.json.decode(run(config)[0], type=Kept) == Kept(*UNTRIMMED)
    assert path.read_text() == "nonsense", "until something is learned, for whoever wants to look"
    run(config, Trims(0.8, 0.0, 0.0))
    assert "0.8" in path.read_text()


def test_a_file_that_cannot_be_read_is_told(tmp_path: Path) -> None:
    path = tmp_path / "trims.json"
    path.write_bytes(b"\xff\xfe")
    file = LearnedFile(path)
    assert file.begin() is None
    assert "trims.json cannot be read" in file.problem
    assert LearnedFile(tmp_path / "none.json").begin() is None
    assert LearnedFile(tmp_path).begin() is None


def test_a_file_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("no directory")
    file = KeptFile(tmp_path / "taken" / "trims.json")
    file.close(b"1", 5.0)
    assert "cannot be written" in file.problem
    assert file.kept is None
    well = KeptFile(tmp_path / "trims.json")
    well.close(b"1", 5.0)
    assert (well.kept, well.problem, well.read()) == (b"1", "", b"1")
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


def test_in_flight_nothing_is_kept(tmp_path: Path) -> None:
    guide = Guide(airplane(tmp_path))
    guide.tracker.start_ns = 1
    assert guide.learned is None
