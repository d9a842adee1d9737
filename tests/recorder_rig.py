"""What the tests of the flight log share: samples, recorders, reading back, disks that hang or fill up."""

from __future__ import annotations

import errno
import threading
from collections import deque
from pathlib import Path
from typing import Any

from guidance.telemetry import Sample
from guidance.telemetry.disk_file import DiskFile, LogFile
from guidance.telemetry.log import LogDamaged, read_log
from guidance.telemetry.recorder import Recorder

CLOSE_S = 20.0  # a deadline that a healthy disk never comes near
OFFSET_NS = 1_700_000_000_000_000_000

Message = tuple[str, bytes]


def sample(number: int, topic: str = "state", size: int = 40) -> Sample:
    return Sample(topic, number * 1_000_000, b'{"t_ns":%d,"pad":"%s"}' % (number * 1_000_000, b"x" * size))


def recorder(directory: Path, **changes: Any) -> Recorder:
    settings: dict[str, Any] = {
        "vehicle": "rover1",
        "session_id": "0123456789abcdef",
        "unix_offset_ns": OFFSET_NS,
    }
    return Recorder(directory, **(settings | changes))


def record_all(directory: Path, samples: list[Sample], **changes: Any) -> Path:
    sink = recorder(directory, **changes)
    for item in samples:
        sink.offer(item)
    sink.start()
    assert sink.close(CLOSE_S), sink.problem
    return sink.path


def readable(path: Path) -> tuple[list[Message], LogDamaged | None]:
    messages: list[Message] = []
    try:
        messages.extend(read_log(path))
    except LogDamaged as damage:
        # `extend` keeps what it got before the exception
        return messages, damage
    return messages, None


def as_messages(samples: list[Sample]) -> list[Message]:
    return [(item.topic, item.payload) for item in samples]


class Paced:
    """A recorder in virtual time: samples are offered as they fall due, whenever its worker waits."""

    def __init__(
        self, directory: Path, samples: list[Sample], *, start_ns: int | None = None, **changes: Any
    ) -> None:
        self.now_ns = samples[0].t_ns if start_ns is None else start_ns
        self.problems: list[str] = []
        self._directory = directory
        self._due = deque(samples)
        self._end_ns = samples[-1].t_ns + 1_000_000
        self._over = threading.Event()
        settings = {"clock_ns": lambda: self.now_ns, "wait": self._wait, "free_bytes": lambda _: 1 << 40}
        self.sink = recorder(directory, **(settings | changes))

    def _wait(self, seconds: float) -> None:
        if self._over.is_set():
            self.sink._stopping.wait(CLOSE_S)
            return
        self.now_ns += int(seconds * 1e9)
        while self._due and self._due[0].t_ns <= self.now_ns:
            self.sink.offer(self._due.popleft())
        self.waited()
        if self.sink.problem not in self.problems[-1:]:
            self.problems.append(self.sink.problem)
        if self.now_ns > self._end_ns:
            self._over.set()

    def waited(self) -> None:
        """After each wait; for what a test looks at."""

    def run(self, *, complete: bool = True) -> list[Path]:
        """Live through all samples and close; the files of the run."""
        self.sink.start()
        assert self._over.wait(CLOSE_S)
        assert self.sink.close(CLOSE_S) is complete, self.sink.problem
        session = self.sink._session_id[:8]
        return sorted(path for path in self._directory.glob("*.mcap") if session in path.name)


class GatedFile(DiskFile):
    """A disk that hangs: the first write waits for `gate`, and `reached` tells that it does."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.gate = threading.Event()
        self.reached = threading.Event()

    def write(self, data: Any, /) -> int:
        self.reached.set()
        self.gate.wait()
        return super().write(data)


class SmallDisk(DiskFile):
    """A disk of `room` bytes that takes half a write at its end, as real ones do."""

    room = 0

    def write(self, data: Any, /) -> int:
        left = self.room - self.tell()
        if left <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data[:left])


class HungDisk:
    """A recorder whose file is a `GatedFile`; the gate opens when the block ends."""

    def __init__(self, directory: Path, **changes: Any) -> None:
        self.files: list[GatedFile] = []
        self.opened = threading.Event()
        self.sink = recorder(directory, open_file=self._open, **changes)

    def _open(self, path: Path) -> LogFile:
        self.files.append(GatedFile(path))
        self.opened.set()
        return self.files[0]

    def hang(self) -> None:
        """Start, offer one sample and return when its write hangs."""
        self.sink.start()
        self.sink.offer(sample(0))
        assert self.opened.wait(CLOSE_S)
        assert self.files[0].reached.wait(CLOSE_S)

    def __enter__(self) -> HungDisk:
        return self

    def __exit__(self, *_: object) -> None:
        for file in self.files:
            file.gate.set()
        self.sink.close(CLOSE_S)
