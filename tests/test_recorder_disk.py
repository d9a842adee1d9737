"""A disk that hangs, fills up or is not there costs the log alone, and the log says what is missing."""

from __future__ import annotations

import errno
import itertools
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader

from guidance.records import Lost
from guidance.telemetry import Sample
from guidance.telemetry.disk_file import DiskFile, LogFile
from guidance.telemetry.log import read_log, read_records
from guidance.telemetry.recorder import Recorder
from tests.recorder_rig import (
    CLOSE_S,
    HungDisk,
    SmallDisk,
    as_messages,
    readable,
    record_all,
    recorder,
    sample,
)


def test_a_hanging_disk_neither_blocks_an_offer_nor_the_close_nor_fills_the_memory(tmp_path: Path) -> None:
    now_ns = [0]
    with HungDisk(tmp_path, capacity=50, capacity_bytes=2000, clock_ns=lambda: now_ns[0]) as disk:
        disk.hang()
        for number in range(1, 5001):
            disk.sink.offer(sample(number))  # a block here is a time-out of the test
        waiting = len(disk.sink._queue)
        assert 0 < waiting <= 50
        assert disk.sink._queue.payload_bytes <= 2000
        assert disk.sink.dropped == 5000 - waiting
        assert disk.sink.problem == ""
        now_ns[0] += 3_000_000_000
        assert "has not answered for 3 s" in disk.sink.problem
        before_s = time.monotonic()
        assert not disk.sink.close(0.05)
        assert time.monotonic() - before_s < 1.0


def test_a_gap_is_marked_where_it_is_with_its_size(tmp_path: Path) -> None:
    with HungDisk(tmp_path, capacity=10) as disk:
        disk.hang()
        for number in range(1, 36):
            disk.sink.offer(sample(number))
    assert disk.sink.dropped == 25
    kept = [sample(0), *(sample(number) for number in range(26, 36))]
    mark = msgspec.json.encode(Lost(t_ns=kept[1].t_ns, count=25))
    assert list(read_log(disk.sink.path)) == as_messages([kept[0], Sample("lost", 0, mark), *kept[1:]])
    assert list(read_records(disk.sink.path, "lost")) == [Lost(t_ns=26_000_000, count=25)]


def test_samples_dropped_at_the_very_end_are_marked_too(tmp_path: Path) -> None:
    sink = recorder(tmp_path, capacity_bytes=100, clock_ns=lambda: 7)
    sink.offer(sample(0, size=200))
    sink.start()
    assert not sink.close(CLOSE_S)  # not everything was written
    assert [msgspec.json.decode(data, type=Lost) for _, data in read_log(sink.path)] == [
        Lost(t_ns=7, count=1)
    ]


@pytest.mark.parametrize("room", [0, 10, 20_000, 40_000])
def test_a_full_disk_ends_the_log_which_stays_readable_up_to_the_cut(tmp_path: Path, room: int) -> None:
    class Disk(SmallDisk):
        pass

    Disk.room = room
    samples = [sample(number) for number in range(4000)]
    sink = recorder(tmp_path, open_file=Disk, chunk_bytes=2000)
    for item in samples:
        sink.offer(item)
    sink.start()
    assert not sink.close(CLOSE_S)
    assert "No space left on device" in sink.problem
    assert "free space" in sink.problem
    if room < 20_000:
        assert list(tmp_path.iterdir()) == []  # nothing but an empty file would be left
        assert sink.dropped == 4000
        return
    messages, damage = readable(sink.path)
    assert damage is not None
    assert messages == as_messages(samples)[: len(messages)]
    assert len(messages) > 100
    assert sink.dropped == 4000 - len(messages)  # every sample is in the file or counted


def ended_by(free_bytes: Callable[[Path], int], directory: Path) -> Recorder:
    """A recorder that has written one sample and ended its log by what `free_bytes` said; closed."""
    ticks = itertools.count(0, 400_000_000)
    sink = recorder(directory, min_free_bytes=400 << 20, free_bytes=free_bytes, clock_ns=lambda: next(ticks))
    ended = threading.Event()
    sink._wait = lambda _: ended.set() if sink._log is None and sink._opened else None
    sink.offer(sample(0))
    sink.start()
    assert ended.wait(CLOSE_S)
    sink.offer(sample(1))
    assert not sink.close(CLOSE_S)
    assert sink.dropped == 1
    return sink


def test_a_log_ended_before_the_disk_is_full_has_a_summary_and_says_that_it_ended_early(
    tmp_path: Path,
) -> None:
    free = iter([500 << 20, 500 << 20, 300 << 20])
    sink = ended_by(lambda _: next(free, 300 << 20), tmp_path)
    assert "must stay free; delete old logs" in sink.problem
    messages, damage = readable(sink.path)
    assert messages == as_messages([sample(0)])
    assert damage is not None
    assert damage.why == f"the recorder ended it here: 300 MiB free on {tmp_path}, 400 MiB must stay free"
    with sink.path.open("rb") as file:  # other tools find their summary
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 1


def test_a_disk_that_cannot_tell_its_free_space_any_more_ends_the_log_in_words(tmp_path: Path) -> None:
    free = iter([500 << 20])

    def vanishing(_: Path) -> int:
        for left in free:
            return left
        raise FileNotFoundError(errno.ENOENT, "No such file or directory")

    sink = ended_by(vanishing, tmp_path)
    assert "ends early: No such file or directory" in sink.problem
    assert readable(sink.path)[1] is not None


def test_an_end_that_is_cut_back_is_no_end(tmp_path: Path) -> None:
    """The disk fills up within the very last write, which holds the end mark and the summary."""
    whole = record_all(tmp_path / "whole", [sample(0)], clock_ns=lambda: 0).stat().st_size

    class Disk(SmallDisk):
        room = whole - 1

    sink = recorder(tmp_path, open_file=Disk, clock_ns=lambda: 0)
    sink.offer(sample(0))
    sink.start()
    assert not sink.close(CLOSE_S)
    assert "No space left on device" in sink.problem
    messages, damage = readable(sink.path)
    assert messages == as_messages([sample(0)])
    assert damage is not None
    assert "not closed" in damage.why


def test_a_directory_is_made_and_one_that_cannot_be_is_a_problem_in_words(tmp_path: Path) -> None:
    assert record_all(tmp_path / "new" / "deep", [sample(0)]).exists()
    (tmp_path / "file").write_bytes(b"")
    sink = recorder(tmp_path / "file" / "logs")
    sink.offer(sample(0))
    sink.start()
    assert not sink.close(CLOSE_S)
    assert "cannot create" in sink.problem
    assert "Not a directory" in sink.problem
    assert sink.dropped == 1


def test_a_crash_after_the_first_sample_loses_nothing_written_before(tmp_path: Path) -> None:
    written = threading.Event()

    class Told(DiskFile):
        def write(self, data: Any, /) -> int:
            count = super().write(data)
            written.set()
            return count

    sink = recorder(tmp_path, open_file=Told)
    sink.start()
    sink.offer(sample(0))
    assert written.wait(CLOSE_S)
    messages, damage = readable(sink.path)  # while the recorder still has it open, as after a crash
    assert messages == as_messages([sample(0)])
    assert damage is not None
    assert "not closed" in damage.why
    assert sink.close(CLOSE_S)


def test_a_bug_in_the_worker_is_loud_and_leaves_the_queue_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[BaseException | None] = []
    monkeypatch.setattr(threading, "excepthook", lambda args: heard.append(args.exc_value))

    def broken(_: Path) -> LogFile:
        raise ZeroDivisionError

    fault: Callable[[Path], LogFile] = broken
    sink = recorder(tmp_path, open_file=fault, capacity=10)
    sink.start()
    for number in range(100):
        sink.offer(sample(number))
    assert not sink.close(CLOSE_S)
    assert [type(error) for error in heard] == [ZeroDivisionError]
    assert "internal error" in sink.problem
    assert len(sink._queue) == 10
