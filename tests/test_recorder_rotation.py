"""A long run goes on in further files: none loses a record, each opens alone, together they replay."""

from __future__ import annotations

import errno
from pathlib import Path

import msgspec
import pytest
from mcap.reader import make_reader

from guidance.records import TOPICS, Record, Session
from guidance.replay import ReplayError, replay
from guidance.service import new_session
from guidance.telemetry import Sample
from guidance.telemetry.disk_file import DiskFile, LogFile
from guidance.telemetry.log import read_log, read_metadata, read_part, read_records
from guidance.telemetry.log_parts import PartMissing, read_run
from guidance.telemetry.recorder import Rotation
from tests.helpers import make_config, make_flight
from tests.recorder_rig import Paced, as_messages, readable, sample

FLIGHT_S = 6.0


@pytest.fixture(scope="module")
def flown() -> list[Sample]:
    """A flight's records as the service offers them, the session first."""
    flight = make_flight()
    flight.run(FLIGHT_S)
    first = flight.records[0].t_ns
    session = msgspec.structs.replace(new_session(make_config()), t_ns=first)
    return [_sample(record) for record in [session, *flight.records]]


def _sample(record: Record) -> Sample:
    return Sample(TOPICS[type(record)], record.t_ns, msgspec.json.encode(record))


def test_a_flight_in_parts_by_time_replays_to_the_bit_from_whichever_part(
    flown: list[Sample], tmp_path: Path
) -> None:
    paths = Paced(tmp_path, flown, rotation=Rotation(age_ns=1_100_000_000)).run()
    assert len(paths) == 6
    whole = Paced(tmp_path / "whole", flown).run()
    expected = replay(whole[0])
    assert expected.identical
    for path in (paths[0], paths[3], paths[-1]):
        assert replay(path) == expected


def test_parts_hold_every_record_once_and_each_the_session(flown: list[Sample], tmp_path: Path) -> None:
    paths = Paced(tmp_path, flown, rotation=Rotation(size_bytes=100_000)).run()
    assert len(paths) > 3
    assert paths == sorted(paths)
    messages = []
    for number, path in enumerate(paths, start=1):
        part, damage = readable(path)
        assert damage is None
        assert part[0] == as_messages(flown[:1])[0]
        messages += part[number > 1 :]
        assert read_metadata(path)["part"] == str(number)
        assert isinstance(next(read_records(path, "session")), Session)
    assert messages == as_messages(flown)
    # All but the last are as large as they should be, within a chunk and what stands at the end.
    assert all(100_000 <= path.stat().st_size < 190_000 for path in paths[:-1])


def test_each_part_opens_alone_in_other_programs(flown: list[Sample], tmp_path: Path) -> None:
    for path in Paced(tmp_path, flown, rotation=Rotation(age_ns=2_200_000_000)).run():
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            summary = reader.get_summary()
            topics = {channel.topic for _, channel, _ in reader.iter_messages()}
        assert summary is not None
        assert summary.statistics is not None
        assert {"/session", "/state", "/tf", "/tf_static", "/vehicle/pose"} <= topics
        assert all(channel.schema_id in summary.schemas for channel in summary.channels.values())


def test_a_part_tells_in_which_file_the_run_goes_on(flown: list[Sample], tmp_path: Path) -> None:
    first, second = Paced(tmp_path, flown, rotation=Rotation(age_ns=4_000_000_000)).run()
    assert [_following(path) for path in (first, second)] == [second.name, ""]
    assert second.name == first.name.replace(".mcap", "_002.mcap")


def _following(path: Path) -> str:
    part = read_part(path)
    while True:
        try:
            next(part)
        except StopIteration as stop:
            return str(stop.value)


def test_a_part_whose_beginning_is_gone_is_refused_in_words(flown: list[Sample], tmp_path: Path) -> None:
    first, *_, last = Paced(tmp_path, flown, rotation=Rotation(age_ns=1_600_000_000)).run()
    first.unlink()
    with pytest.raises(ReplayError, match="part 4 of its run, which begins in the middle of the flight"):
        replay(last)
    with pytest.raises(PartMissing):
        read_run(last)


def test_a_part_that_is_gone_ends_the_replay_there(flown: list[Sample], tmp_path: Path) -> None:
    first, second, *_ = Paced(tmp_path, flown, rotation=Rotation(age_ns=1_600_000_000)).run()
    second.unlink()
    found = replay(first)
    assert not found.identical
    assert found.difference is None
    assert f"the run goes on in {second.name}, which is not there" in found.stopped


def test_parts_are_known_by_their_content_however_they_are_called(
    flown: list[Sample], tmp_path: Path
) -> None:
    first, second = Paced(tmp_path, flown, rotation=Rotation(age_ns=4_000_000_000)).run()
    other = Paced(tmp_path, flown[:50], session_id="fedcba9876543210").run()
    second.rename(tmp_path / "a.mcap")
    first.rename(tmp_path / "b.mcap")
    assert replay(tmp_path / "a.mcap").identical
    assert list(read_run(other[0])) == as_messages(flown[:50])


def test_when_the_next_file_cannot_be_made_the_log_goes_on_in_this_one_and_tries_again(
    flown: list[Sample], tmp_path: Path
) -> None:
    refused: list[Path] = []

    def open_file(path: Path) -> LogFile:
        if "_002" in path.name and len(refused) < 2:
            refused.append(path)
            raise OSError(errno.EMFILE, "Too many open files")
        return DiskFile(path)

    paced = Paced(tmp_path, flown, rotation=Rotation(age_ns=1_100_000_000), open_file=open_file)
    first, *others = paced.run()
    assert len(refused) == 2
    assert len(others) == 3
    assert any("the log goes on in" in text and "Too many open files" in text for text in paced.problems)
    assert paced.sink.problem == ""
    assert 3.2e9 < _span_ns(first) < 3.5e9
    assert replay(first).identical


def _span_ns(path: Path) -> int:
    times = [record.t_ns for record in read_records(path, "input")]
    return times[-1] - times[0]


def test_a_disk_that_fails_as_the_log_goes_on_leaves_one_readable_file(tmp_path: Path) -> None:
    samples = [sample(number * 10) for number in range(400)]

    class NoEnd(DiskFile):
        """The disk is full when the first file is to be ended."""

        def write(self, data: object, /) -> int:
            if b"guidance.end" in bytes(data):  # type: ignore[call-overload]
                raise OSError(errno.ENOSPC, "No space left on device")
            return super().write(data)  # type: ignore[arg-type]

    paced = Paced(tmp_path, samples, rotation=Rotation(age_ns=2_000_000_000), open_file=NoEnd)
    (path,) = paced.run(complete=False)
    assert "No space left on device" in paced.sink.problem
    messages, damage = readable(path)
    assert damage is not None
    assert messages == as_messages(samples)[: len(messages)]
    assert len(messages) + paced.sink.dropped == 400


def test_a_log_that_waits_for_records_does_not_go_on_in_files_without_any(tmp_path: Path) -> None:
    late = [sample(0, "session"), sample(10_000), sample(14_000)]
    paths = Paced(tmp_path, late, rotation=Rotation(age_ns=1_100_000_000)).run()
    first, middle, last = as_messages(late)
    assert [list(read_log(path)) for path in paths] == [[first], [first, middle], [first, last], [first]]
