"""The plant's truth as lines of JSON, for whoever scores the flight; nothing waits for the reader."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

from sitl.vehicle import Truth

#: Truth that the reader has not taken: beyond this the newest lines are dropped, the vehicle never waits.
MAX_TRUTH_BACKLOG: Final = 1 << 20


def truth_line(truth: Truth) -> bytes:
    """One line of JSON: the keys are the fields of `Truth`."""
    return json.dumps(truth._asdict(), separators=(",", ":")).encode() + b"\n"


class TruthWriter:
    """Lines to a file descriptor that never block: what the reader does not take in time is dropped."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._buffer = bytearray()
        self._broken = False
        self.dropped = 0

    def write(self, line: bytes) -> None:
        """Queue one whole line, or drop it."""
        if self._broken or len(self._buffer) + len(line) > MAX_TRUTH_BACKLOG:
            self.dropped += 1
        else:
            self._buffer += line

    def flush(self) -> None:
        """Give the system what it takes now."""
        if not self._buffer or self._broken:
            return
        try:
            written = os.write(self._descriptor, self._buffer)
        except BlockingIOError:
            return
        except OSError:
            # The reader has gone or the disk is full; the vehicle flies on without a chronicler.
            self._broken = True
            self._buffer.clear()
            return
        del self._buffer[:written]


@contextmanager
def truth_writer(name: str | None) -> Iterator[TruthWriter | None]:
    if name is None:
        yield None
        return
    if name == "-":
        descriptor = os.dup(sys.stdout.fileno())
    else:
        descriptor = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NONBLOCK, 0o644)
    was_blocking = os.get_blocking(descriptor)
    os.set_blocking(descriptor, False)
    writer = TruthWriter(descriptor)
    try:
        yield writer
    finally:
        writer.flush()
        with suppress(OSError):
            # stdout may be shared with the parent: leave it as it was found.
            os.set_blocking(descriptor, was_blocking)
        os.close(descriptor)
