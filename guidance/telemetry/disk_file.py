"""A log's file: unbuffered, locked for as long as it is open, and put on the disk when asked."""

from __future__ import annotations

import errno
import fcntl
import io
import os
from contextlib import suppress
from pathlib import Path
from typing import Final, Protocol

#: Data and size, not the times: one journal commit less on most file systems. Not every system has it.
_SYNC: Final = getattr(os, "fdatasync", os.fsync)


class LogFile(Protocol):
    """The few calls made on a log's file; what a test replaces."""

    def write(self, data: bytes, /) -> int | None:
        """Write some of `data`, return how many bytes."""

    def truncate(self, size: int, /) -> int:
        """Cut the file to `size` bytes."""

    def seek(self, offset: int, /) -> int:
        """Go to `offset` for the next write."""

    def sync(self) -> None:
        """Have the disk hold what was written."""

    def close(self) -> None:
        """Close the file, which unlocks it."""


class DiskFile(io.FileIO):
    """A new file, unbuffered and locked; FileExistsError if there is one of that name."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "xb")
        # Another service that looks for unfinished logs may have come between and closed this one as empty:
        # it is waited for. A file system without locks has no such service, for it could not lock either.
        with suppress(OSError):
            fcntl.flock(self.fileno(), fcntl.LOCK_EX)
            self.truncate(0)
        sync_directory(path.parent)

    def sync(self) -> None:
        """Have the disk hold what was written."""
        _SYNC(self.fileno())


class FoundFile(io.FileIO):
    """A file that is there already, to be changed; BlockingIOError if a service has it open."""

    def __init__(self, path: Path) -> None:
        super().__init__(os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW), "rb+")
        try:
            fcntl.flock(self.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self.close()
            raise

    def sync(self) -> None:
        """Have the disk hold what was written."""
        _SYNC(self.fileno())


def sync_directory(directory: Path) -> None:
    """Have the disk hold the names in `directory`, as far as its file system can."""
    with suppress(OSError):
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def write_all(file: LogFile, data: bytes) -> None:
    """Write `data` whole; OSError if the disk does not take it."""
    rest = memoryview(data)
    while rest:
        # Unbuffered files may write less than they were given, last of all on a disk that is filling up.
        written = file.write(bytes(rest) if len(rest) < len(data) else data)
        if not written:
            raise OSError(errno.EIO, "the disk takes no more bytes")
        rest = rest[written:]
