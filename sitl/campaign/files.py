"""Files that are there whole or not at all, and are refused before the work that fills them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

Fill = Callable[[Callable[[Path], object]], None]


@contextmanager
def replacing(path: Path) -> Iterator[Fill]:
    """Yield what fills `path`, given what writes to a path: it takes the place of an older one when whole.

    Raises:
        ValueError: nothing can be written there, said before anything else is done.
        OSError: from filling it, such as of a full disk; the older one is as it was.
    """
    target = path.resolve()
    part = target.with_name(f".{target.stem}.{os.getpid()}{target.suffix}")
    if target.is_dir():
        raise ValueError(f"{path}: is a directory, and must be a file")
    try:
        part.open("wb").close()
    except OSError as error:
        raise ValueError(f"{path}: cannot be written: {error.strerror}") from None

    def fill(write: Callable[[Path], object]) -> None:
        try:
            write(part)
            part.replace(target)
        except OSError as error:
            raise OSError(f"{path}: cannot be written: {error.strerror or error}") from None

    try:
        yield fill
    finally:
        part.unlink(missing_ok=True)
