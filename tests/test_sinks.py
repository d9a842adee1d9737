"""Sinks that hang or fail keep within their bounds and say so once; the records are the same without them.

Time is virtual here, so nothing is learnt about delays: that is for test_service_sinks.py, in real time.
"""

from __future__ import annotations

import errno
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from guidance.records import Record
from guidance.telemetry.console import Console
from guidance.telemetry.disk_file import DiskFile
from guidance.telemetry.queue import DropOldestQueue
from guidance.telemetry.recorder import Recorder
from guidance.telemetry.sinks import Sinks
from guidance.telemetry.worker import Sink
from guidance.telemetry.zenoh_sink import ZenohSink
from tests.helpers import make_flight

PATIENCE_S = 20.0


class StuckFile(DiskFile):
    """A disk that does not answer until it is told to."""

    def __init__(self, path: Path, writing: threading.Event, go_on: threading.Event) -> None:
        super().__init__(path)
        self._writing, self._go_on = writing, go_on

    def write(self, data: bytes, /) -> int:  # type: ignore[override]
        self._writing.set()
        assert self._go_on.wait(PATIENCE_S)
        return super().write(data)


class FullFile(DiskFile):
    """A disk that has no more room."""

    def write(self, data: bytes, /) -> int:  # type: ignore[override]
        raise OSError(errno.ENOSPC, "No space left on device")


def recorder(directory: Path, open_file: Callable[[Path], DiskFile], capacity: int = 300) -> Recorder:
    return Recorder(
        directory,
        vehicle="v",
        session_id="0123456789",
        unix_offset_ns=0,
        capacity=capacity,
        open_file=open_file,
        free_bytes=lambda _: 1 << 40,
    )


@contextmanager
def stuck_disk(tmp_path: Path) -> Iterator[Recorder]:
    writing, go_on = threading.Event(), threading.Event()
    sink = recorder(tmp_path, lambda path: StuckFile(path, writing, go_on))
    try:
        yield sink
    finally:
        go_on.set()
        sink.close(PATIENCE_S)


@contextmanager
def full_disk(tmp_path: Path) -> Iterator[Recorder]:
    sink = recorder(tmp_path, FullFile)
    yield sink
    sink.close(PATIENCE_S)


@contextmanager
def absent_router(tmp_path: Path) -> Iterator[ZenohSink]:
    sink = ZenohSink("v", mode="client", connect=["tcp/127.0.0.1:9"], capacity=300)
    yield sink
    sink.close(PATIENCE_S)


@contextmanager
def unread_terminal(tmp_path: Path) -> Iterator[Console]:
    go_on = threading.Event()
    with (tmp_path / "terminal").open("w") as stream:

        class Unread:
            def write(self, text: str) -> int:
                assert go_on.wait(PATIENCE_S)
                return stream.write(text)

            def __getattr__(self, name: str) -> object:
                return getattr(stream, name)

        sink = Console(0, stream=Unread())  # type: ignore[arg-type]
        try:
            yield sink
        finally:
            go_on.set()
            sink.close(PATIENCE_S)


def fly(sinks: Sinks | None) -> tuple[list[int], int]:
    """Twelve seconds: when setpoints were sent, and how many records there were."""
    flight = make_flight()
    records: list[Record] = []

    def take(record: Record) -> None:
        records.append(record)
        if sinks is not None:
            sinks.publish([record])

    flight.on_record = take
    flight.run(12.0)
    return flight.setpoint_times_ns, len(records)


@pytest.mark.parametrize("trouble", [stuck_disk, full_disk, absent_router, unread_terminal])
def test_a_sink_in_trouble_changes_nothing_that_the_core_decides_and_keeps_within_its_bounds(
    trouble: Callable[[Path], object], tmp_path: Path
) -> None:
    undisturbed, count = fly(None)
    assert len(undisturbed) > 500
    with trouble(tmp_path) as sink:  # type: ignore[attr-defined]
        sinks = Sinks({"log": sink})
        sinks.start()
        assert fly(sinks) == (undisturbed, count)
        queue = sink._queue
        assert isinstance(queue, DropOldestQueue)
        assert len(queue) <= queue._capacity
        assert queue.payload_bytes <= queue._capacity_bytes


def test_a_full_disk_is_said_once(tmp_path: Path) -> None:
    with full_disk(tmp_path) as sink:
        sinks = Sinks({"log": sink})
        sinks.start()
        fly(sinks)
        assert list(sinks.close(PATIENCE_S)) == ["log"]
        (said,) = sinks.news()
        assert said.startswith("log: the log ")
        assert "No space left on device" in said
        assert sinks.news() == []
        assert sinks.dropped > 1000


def test_a_disk_that_does_not_answer_is_said_once_and_once_when_it_is_well_again(tmp_path: Path) -> None:
    now_ns = [0]
    writing, go_on = threading.Event(), threading.Event()
    sink = Recorder(
        tmp_path,
        vehicle="v",
        session_id="0123456789",
        unix_offset_ns=0,
        open_file=lambda path: StuckFile(path, writing, go_on),
        free_bytes=lambda _: 1 << 40,
        clock_ns=lambda: now_ns[0],
    )
    sinks = Sinks({"log": sink})
    sinks.start()
    fly(sinks)
    assert writing.wait(PATIENCE_S)
    said = []
    for now_ns[0] in (1_000_000_000, 3_000_000_000, 4_000_000_000, 5_000_000_000):
        said += sinks.news()
    assert len(said) == 1
    assert "has not answered for 3 s" in said[0]
    go_on.set()
    assert sinks.close(PATIENCE_S) == {}
    assert sinks.news() == ["log: well again"]
    assert sinks.news() == []


def test_all_begin_to_close_at_once_and_what_hangs_is_named(tmp_path: Path) -> None:
    with stuck_disk(tmp_path) as stuck:
        well = recorder(tmp_path / "other", DiskFile, capacity=20_000)
        named: dict[str, Sink] = {"log": stuck, "other": well}
        sinks = Sinks(named)
        sinks.start()
        fly(sinks)
        assert list(sinks.close(0.5)) == ["log"]
