"""The directory of the logs: what was left open is closed, the oldest make room, nothing else is touched."""

from __future__ import annotations

import fcntl
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from guidance.config import Config
from guidance.service import new_session
from guidance.telemetry.log_keeper import NOTICE_NS, Keeper, log_name, next_number
from guidance.telemetry.log_repair import is_closed
from guidance.telemetry.recorder import Recorder, Rotation
from guidance.telemetry.sinks import configured_sinks
from tests.helpers import make_config
from tests.recorder_rig import CLOSE_S, Paced, readable, record_all, sample

DAY_NS = 86_400_000_000_000


@pytest.fixture(scope="module")
def logs_of(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """A short finished log of each of two vehicles."""
    return {
        vehicle: record_all(
            tmp_path_factory.mktemp("log"), [sample(0)], vehicle=vehicle, foxglove=False
        ).read_bytes()
        for vehicle in ("rover1", "rover2")
    }


def put(
    directory: Path, day: int, content: bytes, *, vehicle: str = "rover1", session: str = "", number: int = 1
) -> Path:
    """A log of that day."""
    path = directory / log_name(number, vehicle, session or f"{day:08x}", day * DAY_NS)
    path.write_bytes(content)
    return path


def keeper(directory: Path, **changes: Any) -> Keeper:
    settings: dict[str, Any] = {
        "vehicle": "rover1",
        "session_id": "f" * 32,
        "keep_files": 100,
        "keep_bytes": 1 << 40,
        "wait": lambda _: None,
    }
    return Keeper(directory, **(settings | changes))


def test_what_runs_left_open_is_closed_and_told_for_as_long_as_it_is_seen(
    tmp_path: Path, logs_of: dict[str, bytes]
) -> None:
    whole = logs_of["rover1"]
    kept = put(tmp_path, 1, whole)
    left = [put(tmp_path, 2, whole[:-300]), put(tmp_path, 3, b"")]
    now_ns = [5]
    one = keeper(tmp_path, clock_ns=lambda: now_ns[0])
    assert one.problem == ""
    one.tidy()
    assert all(is_closed(path) for path in left)
    assert kept.read_bytes() == whole
    assert one.problem.startswith("closed what an interrupted run left open")
    assert all(path.name in one.problem for path in left)
    assert kept.name not in one.problem
    now_ns[0] += NOTICE_NS + 1
    assert one.problem == ""


def test_the_oldest_logs_make_room_in_number(tmp_path: Path, logs_of: dict[str, bytes]) -> None:
    paths = [put(tmp_path, day, logs_of["rover1"]) for day in range(10)]
    others = [put(tmp_path, day, logs_of["rover2"], vehicle="rover2") for day in range(10)]
    one = keeper(tmp_path, keep_files=3)
    one.tidy()
    assert [path for path in paths if path.exists()] == paths[-3:]
    assert all(path.exists() for path in others)
    assert one.problem == ""


def test_the_oldest_logs_make_room_in_bytes(tmp_path: Path, logs_of: dict[str, bytes]) -> None:
    content = logs_of["rover1"]
    paths = [put(tmp_path, day, content) for day in range(10)]
    keeper(tmp_path, keep_bytes=4 * len(content)).tidy()
    assert [path for path in paths if path.exists()] == paths[-4:]


def test_this_run_is_the_last_to_go_even_with_a_clock_that_starts_in_1970(
    tmp_path: Path, logs_of: dict[str, bytes]
) -> None:
    mine = [put(tmp_path, day, logs_of["rover1"], session="f" * 32) for day in (0, 1)]
    others = [put(tmp_path, day, logs_of["rover1"]) for day in (2, 3)]
    keeper(tmp_path, keep_files=2).tidy()
    assert sorted(tmp_path.iterdir()) == mine
    assert not any(path.exists() for path in others)
    keeper(tmp_path, keep_files=1).tidy()
    assert sorted(tmp_path.iterdir()) == mine[1:]


def test_runs_make_room_in_the_order_in_which_they_began_whatever_the_clock_said(
    tmp_path: Path, logs_of: dict[str, bytes]
) -> None:
    content = logs_of["rover1"]
    unnumbered = tmp_path / "20301231T235959Z_rover1_0000000a.mcap"  # of before there were numbers
    unnumbered.write_bytes(content)
    paths = [put(tmp_path, day, content, number=number) for number, day in ((9, 900), (10, 0), (99_999, 5))]
    newest = put(tmp_path, 1, content, number=100_000)
    for kept in (4, 3, 2):
        keeper(tmp_path, keep_files=kept).tidy()
        assert sorted(tmp_path.iterdir()) == sorted([*paths[3 - kept + 1 :], newest])
    assert not unnumbered.exists()


def test_a_run_is_numbered_after_all_that_are_there(tmp_path: Path) -> None:
    names = []
    for clock_ns in (1_700_000_000_000_000_000, 0, 5_000_000_000):  # it lost its power twice
        path = record_all(tmp_path, [sample(0)], unix_offset_ns=clock_ns)
        names.append(path.name)
    assert [name[:6] for name in names] == ["00001_", "00002_", "00003_"]
    assert names == sorted(names)
    shutil.move(tmp_path / names[2], tmp_path / "00041_20200101T000000Z_rover2_00000000_002.mcap")
    (tmp_path / "99999_notes.txt").touch()
    assert next_number(tmp_path) == 42


def test_nothing_that_is_not_ours_or_not_finished_is_removed_or_changed(
    tmp_path: Path, logs_of: dict[str, bytes]
) -> None:
    ours, theirs = logs_of["rover1"], logs_of["rover2"]
    open_one = put(tmp_path, 5, ours)
    untouched = [
        put(tmp_path, 0, b"no log, but called like one"),
        put(tmp_path, 1, theirs),  # another vehicle's, under our name
        put(tmp_path, 2, theirs[:-300]),
        put(tmp_path, 3, ours[: ours.index(b"zstd") + 30] + bytes(9 << 20)),  # damaged
        put(tmp_path, 4, theirs, vehicle="rover1_00000000"),
        open_one,
        tmp_path / "notes.txt",
        tmp_path / "copy.mcap",
        tmp_path / "20250101T000000Z_rover1_short.mcap",
    ]
    for path in untouched[-3:]:
        path.write_bytes(ours[:-300])
    outside = tmp_path.with_suffix(".elsewhere")
    outside.write_bytes(ours)
    link = tmp_path / log_name(1, "rover1", "abcdef01", 0)
    link.symlink_to(outside)
    directory = tmp_path / log_name(1, "rover1", "abcdef02", 0)
    directory.mkdir()
    before = [path.read_bytes() for path in untouched]
    goes = put(tmp_path, 6, ours)
    descriptor = os.open(open_one, os.O_RDONLY)
    fcntl.flock(descriptor, fcntl.LOCK_SH)
    one = keeper(tmp_path, keep_files=1)
    one.tidy()
    os.close(descriptor)
    assert [path.read_bytes() for path in untouched] == before
    assert outside.read_bytes() == ours
    assert link.is_symlink()
    assert directory.is_dir()
    assert not goes.exists()
    assert one.problem.startswith(f"{untouched[3].name} is damaged and was left as it is: ")
    assert ";" not in one.problem


def test_a_directory_that_is_gone_is_told(tmp_path: Path) -> None:
    one = keeper(tmp_path / "gone")
    one.tidy()
    assert "No such file or directory" in one.problem


def test_a_log_that_cannot_be_closed_is_told(
    tmp_path: Path, logs_of: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = put(tmp_path, 1, logs_of["rover1"][:-300])

    def no_locks(*_: object) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr(fcntl, "flock", no_locks)
    one = keeper(tmp_path)
    one.tidy()
    assert one.problem == f"{path.name} is left open and cannot be closed: No locks available"


def test_it_ends_within_a_slice_and_leaves_the_rest(tmp_path: Path, logs_of: dict[str, bytes]) -> None:
    paths = [put(tmp_path, day, logs_of["rover1"][:-300]) for day in range(5)]

    def wait(_: float) -> None:
        if is_closed(paths[1]):
            one.stop()

    one = keeper(tmp_path, wait=wait)
    one.look()
    assert one._thread is not None
    one._thread.join(CLOSE_S)
    assert not one._thread.is_alive()
    assert [is_closed(path) for path in paths] == [True, True, False, False, False]


def test_each_rotation_makes_room_and_the_run_keeps_its_newest_files(tmp_path: Path) -> None:
    class Kept(Keeper):
        """Does in the recorder's thread what it does in its own."""

        def look(self) -> None:
            self.tidy()

    one = Kept(
        tmp_path,
        vehicle="rover1",
        session_id="0123456789abcdef",
        keep_files=3,
        keep_bytes=1 << 40,
        wait=lambda _: None,
    )
    old = tmp_path / "20200101T000000Z_rover1_00000000.mcap"
    shutil.copy(record_all(tmp_path / "other", [sample(0)]), old)
    samples = [sample(number * 20) for number in range(500)]
    paced = Paced(tmp_path, samples, rotation=Rotation(age_ns=1_100_000_000), keeper=one)
    paths = paced.run()
    assert not old.exists()
    assert [path.stem[-3:] for path in paths] == ["008", "009", "010"]
    assert all(readable(path)[1] is None for path in paths)


def test_the_configuration_reaches_recorder_and_keeper(tmp_path: Path) -> None:
    settings = ("rotate_mb=2", "rotate_min=3", "keep_files=4", "keep_mb=5")
    config: Config = make_config(f'log.directory="{tmp_path}"', *(f"log.{each}" for each in settings))
    sink = configured_sinks(config, new_session(config))["log"]
    assert isinstance(sink, Recorder)
    assert sink._rotation == (2e6, 180e9)
    assert sink._keeper is not None
    assert (sink._keeper._keep_files, sink._keeper._keep_bytes) == (4, 5_000_000)
