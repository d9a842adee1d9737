"""A log that had to end goes on by itself when the disk takes it again, and says how much it missed."""

from __future__ import annotations

import errno
import shutil
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import pytest

from guidance.records import Lost
from guidance.telemetry.disk_file import DiskFile
from guidance.telemetry.log import read_metadata
from guidance.telemetry.recorder import Rotation
from tests.recorder_rig import Paced, as_messages, readable, sample

SESSION = sample(0, "session")
MIB = 1 << 20


def test_when_there_is_room_again_it_goes_on_in_another_file(tmp_path: Path) -> None:
    samples = [SESSION, *(sample(number * 10) for number in range(1, 4000))]  # 40 s
    paced = Paced(tmp_path, samples, min_free_bytes=200 * MIB, free_bytes=lambda _: free_bytes())

    def free_bytes() -> int:
        now_s = paced.now_ns * 1e-9
        return 100 * MIB if 5.0 < now_s < 12.0 else 210 * MIB if now_s < 24.0 else 300 * MIB

    first, second = paced.run(complete=False)
    assert second.name == first.name.replace(".mcap", "_002.mcap")
    assert read_metadata(second)["part"] == "2"
    before, damage = readable(first)
    assert damage is not None
    assert "200 MiB must stay free" in damage.why
    after, damage = readable(second)
    assert damage is None
    session, lost, *rest = after
    assert [session] == as_messages([SESSION])
    assert rest == as_messages(samples)[-len(rest) :]
    missed = msgspec.json.decode(lost[1], type=Lost).count
    assert missed == paced.sink.dropped == len(samples) - len(before) - len(rest)
    # Not at once where there is only just room again, which one file would take; nor long after.
    assert 24.0 < int(msgspec.json.decode(rest[0][1])["t_ns"]) * 1e-9 < 36.0
    well, told, again = paced.problems
    assert (well, again) == ("", "")
    assert "delete old logs, and it goes on" in told


def test_a_directory_that_was_removed_is_made_again(tmp_path: Path) -> None:
    directory = tmp_path / "logs"

    class Removed(Paced):
        def waited(self) -> None:
            if 2.0 < self.now_ns * 1e-9 < 2.1 and directory.exists():
                shutil.rmtree(directory)

    samples = [SESSION, *(sample(number * 10) for number in range(1, 2000))]
    removed = Removed(directory, samples, free_bytes=lambda path: shutil.disk_usage(path).free)
    (path,) = removed.run(complete=False)
    messages, damage = readable(path)
    assert damage is None
    assert messages[2:] == as_messages(samples)[-len(messages[2:]) :]
    assert len(messages) > 500
    assert removed.sink.problem == ""


def test_a_log_that_was_removed_in_flight_goes_on_in_another_file(tmp_path: Path) -> None:
    """An operator makes room, and takes the open one with the others."""

    class Removed(Paced):
        def waited(self) -> None:
            if 2.0 < self.now_ns * 1e-9 < 2.1:
                self.sink.path.unlink(missing_ok=True)

    samples = [SESSION, *(sample(number * 10) for number in range(1, 2000))]
    removed = Removed(tmp_path, samples)
    (path,) = removed.run(complete=False)
    messages, damage = readable(path)
    assert damage is None
    assert len(messages) > 500
    assert any("ends early: No such file" in text for text in removed.problems)
    assert removed.sink.problem == ""


class Failing(DiskFile):
    """A disk that takes nothing from the second file on."""

    def write(self, data: Any, /) -> int:
        if "_00" in str(self.name):
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data)


def test_a_disk_that_is_full_as_the_next_file_begins_leaves_the_whole_first_one(tmp_path: Path) -> None:
    samples = [SESSION, *(sample(number * 10) for number in range(1, 400))]
    paced = Paced(tmp_path, samples, rotation=Rotation(age_ns=2_000_000_000), open_file=Failing)
    (path,) = paced.run(complete=False)
    assert "No space left on device" in paced.sink.problem
    assert "internal error" not in paced.sink.problem
    messages, damage = readable(path)
    assert damage is None
    assert len(messages) + paced.sink.dropped == 400


def test_a_disk_that_fails_again_and_again_is_tried_less_and_less_and_leaves_no_empty_files(
    tmp_path: Path,
) -> None:
    tried: list[int] = []

    def open_file(path: Path) -> DiskFile:
        tried.append(paced.now_ns)
        return Failing(path)

    samples = [SESSION, *(sample(number * 500) for number in range(1, 1200))]  # ten minutes
    paced = Paced(tmp_path, samples, rotation=Rotation(age_ns=2_000_000_000), open_file=open_file)
    assert len(paced.run(complete=False)) == 1
    pauses_s = [(b - a) * 1e-9 for a, b in pairwise(tried[1:])]
    assert pauses_s == pytest.approx([10.0, 20.0, 40.0, 80.0, 160.0], abs=0.2)
