"""Kill and power loss take at most a second of log, at any time; a disk too slow for that is told."""

from __future__ import annotations

import fcntl
import os
import signal
import stat
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from guidance.telemetry.disk_file import DiskFile, FoundFile, LogFile
from guidance.telemetry.log import MAGIC
from guidance.telemetry.log_keeper import Keeper
from guidance.telemetry.recorder import Rotation
from tests.recorder_rig import CLOSE_S, Paced, readable, record_all, recorder, sample

KILLED = """
import sys, time
from pathlib import Path
from guidance.telemetry import Sample
from guidance.telemetry.recorder import Recorder
sink = Recorder(Path(sys.argv[1]), vehicle="rover1", session_id="0123456789abcdef", unix_offset_ns=0)
sink.start()
while True:
    now_ns = time.monotonic_ns()
    sink.offer(Sample("state", now_ns, b'{"t_ns":%d}' % now_ns))
    print(now_ns, flush=True)
    time.sleep(0.002)
"""


class Disk(DiskFile):
    """Knows what it would still hold after power loss, and takes its time in `clock`."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.safe_bytes = 0
        self.takes_s = 0.0
        self.paced: Paced | None = None

    def sync(self) -> None:
        if self.paced is not None:
            self.paced.now_ns += int(self.takes_s * 1e9)
        self.safe_bytes = self.tell()


class Losing(Paced):
    """Looks ten times a second what a kill and what power loss would cost at this very moment."""

    def __init__(self, directory: Path, **changes: Any) -> None:
        self.disks: list[Disk] = []
        self.killed_s: list[float] = []
        self.cut_s: list[float] = []
        self._looked_ns = 0
        self._scratch = directory.with_suffix(".cut")
        samples = [sample(number * 3) for number in range(2000)]
        super().__init__(directory, samples, open_file=self._open, **changes)

    def _open(self, path: Path) -> LogFile:
        self.disks.append(Disk(path))
        self.disks[-1].paced = self
        return self.disks[-1]

    def waited(self) -> None:
        if self.now_ns - self._looked_ns < 100_000_000 or not self.disks:
            return
        self._looked_ns = self.now_ns
        paths = sorted(self.sink.path.parent.glob("*.mcap"))
        self.killed_s.append(self._lost_s([path.read_bytes() for path in paths]))
        files = zip(paths, self.disks, strict=True)
        self.cut_s.append(self._lost_s([path.read_bytes()[: disk.safe_bytes] for path, disk in files]))

    def _lost_s(self, files: list[bytes]) -> float:
        newest_ns = 0
        for content in files:
            self._scratch.write_bytes(content)
            messages = readable(self._scratch)[0] if content else []
            newest_ns = max([newest_ns, *(int(data[8 : data.index(b",")]) for _, data in messages)])
        return (self.now_ns - newest_ns) * 1e-9


@pytest.mark.parametrize("rotation", [Rotation(), Rotation(age_ns=900_000_000)], ids=["one file", "parts"])
def test_at_no_moment_is_more_than_a_second_at_stake(tmp_path: Path, rotation: Rotation) -> None:
    losing = Losing(tmp_path / "logs", rotation=rotation)
    losing.run()
    assert len(losing.killed_s) > 50
    assert max(losing.killed_s) < 0.53
    assert max(losing.cut_s) < 0.53
    assert max(losing.cut_s) > 0.3  # it is not written out for each sample either


def test_a_disk_that_takes_its_time_is_told_and_when_it_is_well_again(tmp_path: Path) -> None:
    class Slow(Losing):
        def waited(self) -> None:
            if self.disks:
                self.disks[0].takes_s = 0.8 if 2.0 < self.now_ns * 1e-9 < 4.0 else 0.0

    slow = Slow(tmp_path / "logs")
    slow.run()
    well, told, again = slow.problems
    assert (well, again) == ("", "")
    assert "takes 0.8 s to hold what is written" in told


def test_a_killed_process_loses_less_than_a_second_and_its_log_is_closed_at_the_next_start(
    tmp_path: Path,
) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path)], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        first_ns = last_ns = int(process.stdout.readline())
        while last_ns < first_ns + 1_400_000_000:
            last_ns = int(process.stdout.readline())
        os.kill(process.pid, signal.SIGKILL)
        last_ns = int([str(last_ns), *process.stdout.read().splitlines()][-1])
    (left,) = tmp_path.glob("*.mcap")
    messages, damage = readable(left)
    assert damage is not None
    written_ns = int(messages[-1][1][8:-1])
    assert 0 <= last_ns - written_ns < 1_000_000_000

    tidied = threading.Event()

    class Told(Keeper):
        def tidy(self) -> None:
            super().tidy()
            tidied.set()

    keeper = Told(tmp_path, vehicle="rover1", session_id="f" * 32, keep_files=10, keep_bytes=1 << 40)
    sink = recorder(tmp_path, session_id="f" * 32, keeper=keeper)
    sink.start()
    assert tidied.wait(CLOSE_S)
    assert left.name in sink.problem
    assert sink.close(CLOSE_S)
    closed, damage = readable(left)
    assert closed == messages
    assert damage is not None
    assert "the recorder ended it here: it was interrupted" in damage.why


def test_a_new_file_is_locked_empty_and_its_name_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "new.mcap"
    flock, fsync, synced = fcntl.flock, os.fsync, []

    def late(descriptor: int, how: int) -> None:
        if how == fcntl.LOCK_EX:  # another service took it for an unfinished log, before it was locked
            path.write_bytes(b"closed as an empty log")
        flock(descriptor, how)

    def told(descriptor: int) -> None:
        synced.append(stat.S_ISDIR(os.fstat(descriptor).st_mode))
        fsync(descriptor)

    monkeypatch.setattr(fcntl, "flock", late)
    monkeypatch.setattr(os, "fsync", told)
    with DiskFile(path) as file:
        file.write(b"log")
        with pytest.raises(BlockingIOError):
            FoundFile(path)
    assert path.read_bytes() == b"log"
    assert synced == [True]


def test_the_recorder_too_writes_its_footer_last(tmp_path: Path) -> None:
    done: list[str] = []

    class Told(DiskFile):
        def write(self, data: bytes, /) -> int:  # type: ignore[override]
            done.append("footer" if data.endswith(MAGIC) else "rest")
            return super().write(data)

        def sync(self) -> None:
            done.append("sync")

    record_all(tmp_path, [sample(0)], open_file=Told)
    assert done[-4:] == ["rest", "sync", "footer", "sync"]
