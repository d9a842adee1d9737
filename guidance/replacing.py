"""Files that are there whole or not at all, refused before the work; never in place of a log."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import copymode

from guidance.telemetry.log import MAGIC

#: To be called once with what writes to the path that it is given.
Fill = Callable[[Callable[[Path], object]], None]


class LogInTheWayError(ValueError):
    """A flight log, or whatever else is an MCAP file, stands where something else was to be written."""


@contextmanager
def replacing(path: Path) -> Iterator[Fill]:
    """Yield what fills `path`, given what writes to a path: it takes the place of an older one when whole.

    A pipe or a device is written to as it is.

    Raises:
        LogInTheWayError: `path` is a log; said before anything else is done, as are these:
        ValueError: nothing can be written there.
        OSError: from filling it, such as of a full disk; the older one is as it was.
    """
    try:
        refuse_log(path)
        target = part = path
        if path.is_file() or not path.exists():
            target = path.resolve()
            part = target.with_name(f".{target.stem}.{os.getpid()}{target.suffix}")
            part.open("wb").close()
            if target.exists():
                copymode(target, part)
    except OSError as error:
        raise ValueError(f"{path}: cannot be written: {error.strerror}") from None

    def fill(write: Callable[[Path], object]) -> None:
        try:
            write(part)
            if part != target:
                part.replace(target)
        except OSError as error:
            raise OSError(f"{path}: cannot be written: {error.strerror or error}") from None

    try:
        yield fill
    finally:
        if part != target:
            part.unlink(missing_ok=True)


def refuse_log(path: Path) -> None:
    """Raises LogInTheWayError if an MCAP file stands there, ValueError for a directory, OSError for what
    cannot be looked at."""
    if path.is_dir():
        raise ValueError(f"{path}: is a directory, and must be a file")
    if path.is_file():
        with path.open("rb") as file:
            if file.read(len(MAGIC)) == MAGIC:
                raise LogInTheWayError(f"{path}: is a flight log and is not overwritten: name another file")
