"""Events as lines on stderr: for an operator at a terminal, for journald under systemd.

A sink like the others, because a terminal that scrolls or a pipe that nobody reads may block for ever.
"""

from __future__ import annotations

import sys
import time
from typing import TextIO

import msgspec

from guidance.journal import is_journal, marked
from guidance.printable import printable
from guidance.records import Event, Level
from guidance.telemetry.queue import Sample
from guidance.telemetry.worker import ThreadedSink


class Console(ThreadedSink):
    """Prints every event record with its local time and level."""

    def __init__(self, unix_offset_ns: int, *, stream: TextIO | None = None) -> None:
        super().__init__("console", capacity=1000, capacity_bytes=1 << 20)
        self._unix_offset_ns = unix_offset_ns
        self._stream = sys.stderr if stream is None else stream
        self._journal = is_journal(self._stream)
        self._decode = msgspec.json.Decoder(Event).decode

    def offer(self, sample: Sample) -> None:
        """Take the sample if it is an event."""
        if sample.topic == "event":
            super().offer(sample)

    def _take(self, lost: int, sample: Sample) -> None:
        if lost:
            text = f"({lost} lines lost)"
            self._print(marked(Level.WARNING, text) if self._journal else text)
        event = self._decode(sample.payload)
        text = printable(event.text)
        if self._journal:
            self._print(marked(event.level, text))
        else:
            seconds, ns = divmod(event.t_ns + self._unix_offset_ns, 1_000_000_000)
            clock = time.strftime("%H:%M:%S", time.localtime(seconds))
            self._print(f"{clock}.{ns // 1_000_000:03d} {event.level:<8} {text}")

    def _turn(self) -> None:
        """Nothing is periodic."""

    def _finish(self) -> bool:
        return True

    def _describe_stall(self, seconds: float) -> str:
        return f"nobody has read stderr for {seconds:.0f} s"

    def _print(self, line: str) -> None:
        try:
            self._stream.write(line + "\n")
            self._stream.flush()
        except (OSError, ValueError) as error:  # the reader of the pipe has gone, the terminal was closed
            self._discarded += 1
            self._trouble = f"cannot write to stderr: {getattr(error, 'strerror', None) or error}"
        else:
            self._trouble = ""
