"""How far it is: a bar on a terminal, a line now and then elsewhere, never on stdout."""

from __future__ import annotations

import os
import pty
import subprocess
import sys

import pytest

from guidance.progress import LINE_EVERY_S, Steps, stepped, waiting

SCRIPT = """
import sys
from guidance.progress import Steps, waiting
with waiting("p", "looking"):
    pass
with Steps("p", "flights", 3) as steps:
    for number in range(3):
        print("result", number)
        steps.advance()
print("done")
"""


def test_elsewhere_it_is_a_line_now_and_then(capsys: pytest.CaptureFixture[str]) -> None:
    times_s = iter([0.0, 1.0, LINE_EVERY_S, LINE_EVERY_S + 1.0, 2 * LINE_EVERY_S])
    with Steps("sitl fuzz", "inputs", 4000, clock_s=lambda: next(times_s)) as steps:
        for words in ("", "", "", "9 a second"):
            steps.advance(1000, words)
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err == "sitl fuzz: 2,000 of 4,000 inputs\nsitl fuzz: 4,000 of 4,000 inputs: 9 a second\n"


def test_what_is_waited_for_is_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    with waiting("guidance check", "looking for at most 10 s"):
        assert capsys.readouterr().err == "guidance check: looking for at most 10 s\n"
    assert capsys.readouterr() == ("", "")


def test_items_come_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert list(stepped("p", "rows", "abc", 3)) == ["a", "b", "c"]
    assert capsys.readouterr() == ("", "")


def on_a_terminal(**environment: str) -> tuple[str, str]:
    """Stdout, which is a pipe, and stderr, which is a terminal."""
    ours, theirs = pty.openpty()
    plain = {name: value for name, value in os.environ.items() if name != "NO_COLOR"}
    with subprocess.Popen(
        [sys.executable, "-c", SCRIPT],
        stdout=subprocess.PIPE,
        stderr=theirs,
        text=True,
        env={**plain, "TERM": "xterm-256color", **environment},
    ) as process:
        os.close(theirs)
        out = process.communicate(timeout=50.0)[0]
    said = b""
    while True:
        try:
            chunk = os.read(ours, 65536)
        except OSError:  # Linux's end of a terminal
            break
        if not chunk:
            break
        said += chunk
    os.close(ours)
    return out, said.decode()


def test_on_a_terminal_it_is_a_bar_and_the_result_stays_where_it_was_sent() -> None:
    out, said = on_a_terminal()
    assert out == "result 0\nresult 1\nresult 2\ndone\n"
    assert "flights" in said
    assert "3/3" in said
    assert "looking" in said
    assert "\x1b[38;5;" in said  # colour


@pytest.mark.parametrize("environment", [{"NO_COLOR": "1"}])
def test_without_colours_where_nobody_wants_them(environment: dict[str, str]) -> None:
    _, said = on_a_terminal(**environment)
    assert "3/3" in said
    assert "\x1b[38;5;" not in said
    assert "\x1b[3" not in said


def test_a_dumb_terminal_gets_lines() -> None:
    _, said = on_a_terminal(TERM="dumb")
    assert said.replace("\r", "") == "p: looking\n"
