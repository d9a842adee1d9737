"""A small file that outlives the process, written by a thread of its own and whole or not at all.

So a disk that hangs holds up nothing, and a process that is killed leaves what stood before.
"""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from pathlib import Path
from typing import Final

from guidance.config import Config

#: More than this of a file is not read: nothing of ours is as long.
MOST_BYTES: Final = 1 << 20


class KeptFile:
    """`kept` is what stands in it, as far as is known; `problem` why it cannot be written, or empty."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.problem = ""
        self.kept: bytes | None = None
        self._writer: threading.Thread | None = None

    def read(self) -> bytes | None:
        """What it holds, None if there is none; raises OSError."""
        try:
            with open(self.path, "rb") as file:
                return file.read(MOST_BYTES)
        except FileNotFoundError:
            return None

    def keep(self, content: bytes) -> None:
        """Have it written, unless it stands there or the last time is not over yet; returns at once."""
        if content != self.kept and (self._writer is None or not self._writer.is_alive()):
            self._writer = threading.Thread(target=self._write, args=(content,), daemon=True)
            self._writer.start()

    def close(self, content: bytes, timeout_s: float) -> None:
        """Keep the last of it, if that is possible within so long, twice."""
        if self._writer is not None:
            self._writer.join(timeout_s)
        self.keep(content)
        if self._writer is not None:
            self._writer.join(timeout_s)

    def _write(self, content: bytes) -> None:
        fresh = self.path.with_name(f".{self.path.name}.{os.getpid()}")
        try:
            self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            with open(fresh, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            fresh.replace(self.path)
        except OSError as error:
            with suppress(OSError):
                fresh.unlink(missing_ok=True)
            self.problem = f"{self.path} cannot be written: {said(error)}"
        else:
            self.kept, self.problem = content, ""


def said(error: Exception) -> str:
    """In words."""
    return error.strerror or str(error) if isinstance(error, OSError) else str(error)


class LearnedFile:
    """What flights have taught of a vehicle, from one process to the next (`airplane.trims_file`,
    `copter.hover_file`)."""

    def __init__(self, path: Path) -> None:
        self._file = KeptFile(path)
        self._unread = ""

    @property
    def problem(self) -> str:
        """Why the next process will not know, or why this one does not; empty if all is well."""
        return self._file.problem or self._unread

    def begin(self) -> str | None:
        """What was learned before, None if nothing is known."""
        try:
            content = self._file.read()
            return None if content is None else content.decode()
        except (OSError, ValueError) as error:
            self._unread = f"{self._file.path} cannot be read: {said(error)}"
            return None

    def began(self, learned: str) -> None:
        """The process goes on from this: it is written again only when it has changed."""
        self._file.kept = learned.encode()

    def keep(self, learned: str) -> None:
        """As `KeptFile.keep`."""
        self._file.keep(learned.encode())

    def close(self, learned: str, timeout_s: float) -> None:
        """As `KeptFile.close`."""
        self._file.close(learned.encode(), timeout_s)


def open_learned(config: Config) -> LearnedFile | None:
    """The file that the configuration names, None if it names none."""
    name = config.airplane.trims_file or config.copter.hover_file
    return LearnedFile(Path(name)) if name else None
