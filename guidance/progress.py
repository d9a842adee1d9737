"""How far a long command is: a bar on a terminal, a line now and then elsewhere, always on stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Final, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from guidance.journal import tell
from guidance.records import Level

#: Without a terminal, a line every so many seconds: for the log of a build that somebody follows.
LINE_EVERY_S: Final = 10.0

_Item = TypeVar("_Item")


class Steps:
    """So many steps of some work; a context.

    Args:
        program: who says it, such as `sitl fuzz`.
        what: what the steps are, in the plural.
        total: how many.
        steady: whether the bar moves with the steps only, by no thread of its own: for what measures,
            or starts processes.
        clock_s: monotonic.
    """

    def __init__(
        self,
        program: str,
        what: str,
        total: int,
        *,
        steady: bool = False,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        console = Console(stderr=True)
        self._watched = console.is_terminal and not console.is_dumb_terminal
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=console,
            transient=True,
            auto_refresh=not steady,
            redirect_stdout=sys.stdout.isatty(),  # else rich takes what goes to a file to the terminal
            disable=not self._watched,
        )
        self._task = self._bar.add_task(what, total=total)
        self._program, self._what, self._total = program, what, total
        self._steady, self._clock_s = steady, clock_s
        self._done = 0
        self._said_s = clock_s()

    def __enter__(self) -> Steps:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def expect(self, more: int) -> None:
        """So many more than was known are to be done."""
        self._total += more
        self._bar.update(self._task, total=self._total)

    def advance(self, steps: int = 1, words: str = "") -> None:
        """So many more are done; `words` say what is done now, or how fast."""
        self._done += steps
        self._bar.update(self._task, advance=steps, description=words or self._what, refresh=self._steady)
        now_s = self._clock_s()
        if not self._watched and now_s - self._said_s >= LINE_EVERY_S:
            self._said_s = now_s
            self._say(f": {words}" if words else "")

    def _say(self, words: str) -> None:
        tell(Level.INFO, self._program, f"{self._done:,} of {self._total:,} {self._what}{words}")


@contextmanager
def waiting(program: str, words: str) -> Iterator[None]:
    """Say what is waited for: as long as it takes on a terminal, as one line elsewhere."""
    console = Console(stderr=True)
    if console.is_terminal and not console.is_dumb_terminal:
        with console.status(words):
            yield
    else:
        tell(Level.INFO, program, words)
        yield


@contextmanager
def reading(program: str) -> Iterator[Callable[[Path, int], None]]:
    """Tells how far files are read; to be called with a file and how many of its bytes are done."""
    done_mb: dict[Path, int] = {}
    with Steps(program, "MB read", 0, steady=True) as steps:

        def passed(path: Path, done: int) -> None:
            if path not in done_mb:
                done_mb[path] = 0
                steps.expect(_megabytes(path.stat().st_size))
            fresh = _megabytes(done) - done_mb[path]
            if fresh > 0:
                done_mb[path] += fresh
                steps.advance(fresh)

        yield passed


def _megabytes(size: int) -> int:
    return size // 1_000_000


def stepped(program: str, what: str, items: Iterable[_Item], total: int) -> Iterator[_Item]:
    """The items one after the other, each a step that is done when the next one is asked for.

    No thread runs beside them: they may start processes.
    """
    with Steps(program, what, total, steady=True) as steps:
        for item in items:
            yield item
            steps.advance()
