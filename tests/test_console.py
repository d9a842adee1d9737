"""Events as lines on stderr, at a terminal and under systemd."""

from __future__ import annotations

import io
import os
import re
import threading
from pathlib import Path

import msgspec
import pytest

from guidance.entry import complain
from guidance.journal import say, tell
from guidance.records import Event, Level, Record, Status
from guidance.telemetry import Sample
from guidance.telemetry.console import Console

PATIENCE_S = 20.0


def event(text: str, level: Level = Level.NOTICE) -> Sample:
    record = Event(t_ns=1_500_000_000, level=level, code="c", text=text)
    return Sample("event", record.t_ns, msgspec.json.encode(record))


def printed(console: Console, stream: io.StringIO, *samples: Sample) -> list[str]:
    for sample in samples:
        console.offer(sample)
    console.start()
    assert console.close(PATIENCE_S)
    return stream.getvalue().splitlines()


def test_an_event_is_one_line_with_local_time_and_level() -> None:
    stream = io.StringIO()
    lines = printed(Console(0, stream=stream), stream, event("ready"), event("lost", Level.WARNING))
    assert [re.fullmatch(r"\d\d:\d\d:01\.500 (notice  |warning ) (ready|lost)", line) for line in lines]
    assert [line.split()[1:] for line in lines] == [["notice", "ready"], ["warning", "lost"]]


def test_only_events_are_printed() -> None:
    stream = io.StringIO()
    record: Record = Status(
        t_ns=0,
        state="ready",
        reason="",
        since_ns=0,
        armed=None,
        mode="",
        intended_mode="",
        trajectory_start_ns=None,
        origin_ned_m=None,
        setpoints_sent=0,
    )
    sample = Sample("status", 0, msgspec.json.encode(record))
    assert printed(Console(0, stream=stream), stream, sample) == []


def test_a_text_of_several_lines_is_one_line() -> None:
    stream = io.StringIO()
    (line,) = printed(Console(0, stream=stream), stream, event("it failed:\n  at line 3\r\n"))
    assert line.endswith("it failed: at line 3")


#: syslog's, as sd-daemon(3) has them.
PRIORITIES = {
    Level.CRITICAL: 2,
    Level.ERROR: 3,
    Level.WARNING: 4,
    Level.NOTICE: 5,
    Level.INFO: 6,
}


@pytest.mark.parametrize("level", Level)
@pytest.mark.parametrize("same", [True, False])
def test_priorities_are_for_the_journal_only(
    same: bool, level: Level, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The variable is inherited by processes whose stderr goes elsewhere."""
    with (tmp_path / "stderr").open("w+") as stream:
        status = os.fstat(stream.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", f"{status.st_dev}:{status.st_ino + (not same)}")
        console = Console(0, stream=stream)
        console.offer(event("lost", level))
        console.start()
        assert console.close(PATIENCE_S)
        stream.seek(0)
        line = stream.read()
    assert (line == f"<{PRIORITIES[level]}>lost\n") is same
    assert bool(re.fullmatch(rf"[\d:.]+ {level} +lost\n", line)) is not same


def test_whatever_is_said_has_its_priority_in_the_journal_line_by_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (tmp_path / "stderr").open("w+") as stream:
        status = os.fstat(stream.fileno())
        monkeypatch.setattr("sys.stderr", stream)
        complain("guidance", "at a terminal")
        monkeypatch.setenv("JOURNAL_STREAM", f"{status.st_dev}:{status.st_ino}")
        complain("guidance", "law.k = 0: must be more")
        say(Level.CRITICAL, "internal error\nTraceback:\n")
        stream.seek(0)
        assert stream.read().splitlines() == [
            "guidance: at a terminal",
            "<3>guidance: law.k = 0: must be more",
            "<2>internal error",
            "<2>Traceback:",
        ]


def test_a_line_of_a_program_steers_no_terminal_and_nobody_need_listen(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    tell(Level.NOTICE, "guidance foxglove", "\x1b]0;x\a is\nhere")
    assert (
        capsys.readouterr().err
        == "guidance foxglove: \N{REPLACEMENT CHARACTER}]0;x\N{REPLACEMENT CHARACTER} is here\n"
    )
    closed = io.StringIO()
    closed.close()
    monkeypatch.setattr("sys.stderr", closed)
    tell(Level.NOTICE, "guidance foxglove", "gone")


def test_lines_that_were_lost_are_a_warning_in_the_journal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (tmp_path / "stderr").open("w+") as stream:
        status = os.fstat(stream.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", f"{status.st_dev}:{status.st_ino}")
        console = Console(0, stream=stream)
        for number in range(1001):
            console.offer(event(f"line {number}"))
        console.start()
        assert not console.close(PATIENCE_S)
        stream.seek(0)
        assert stream.readline() == "<4>(1 lines lost)\n"


def test_a_pipe_whose_reader_has_gone_is_a_problem_and_no_crash() -> None:
    read_end, write_end = os.pipe()
    os.close(read_end)
    with os.fdopen(write_end, "w", closefd=False) as stream:
        console = Console(0, stream=stream)
        console.offer(event("nobody reads this"))
        console.start()
        assert not console.close(PATIENCE_S)
        assert console.problem == "cannot write to stderr: Broken pipe"
        assert console.dropped == 1
        os.dup2(os.open(os.devnull, os.O_WRONLY), write_end)  # what is buffered must go somewhere


def test_a_terminal_that_does_not_scroll_is_a_problem_that_passes_and_costs_the_oldest_lines() -> None:
    writing, go_on = threading.Event(), threading.Event()

    class Stuck(io.StringIO):
        def write(self, text: str) -> int:
            writing.set()
            assert go_on.wait(PATIENCE_S)
            return super().write(text)

    stream = Stuck()
    console = Console(0, stream=stream)
    console.offer(event("first"))
    console.start()
    assert writing.wait(PATIENCE_S)
    for number in range(3000):
        console.offer(event(f"line {number}"))
    assert console.dropped == 2000
    console._turn_ns -= 3_000_000_000  # 3 s later
    assert console.problem == "nobody has read stderr for 3 s"
    go_on.set()
    assert not console.close(PATIENCE_S)  # not all was written
    assert console.problem == ""
    lines = stream.getvalue().splitlines()
    assert lines[1] == "(2000 lines lost)"
    assert lines[2].endswith("line 2000")
    assert lines[-1].endswith("line 2999")


def test_what_the_autopilot_says_does_not_steer_the_terminal() -> None:
    stream = io.StringIO()
    (line,) = printed(Console(0, stream=stream), stream, event("autopilot: \x1b[2Jcleared\x07"))
    assert line.endswith("autopilot: \ufffd[2Jcleared\ufffd")
