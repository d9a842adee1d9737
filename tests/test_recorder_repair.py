"""What a crash left of a log, cut anywhere, is closed again: all that was whole is in it, and it says so."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader

from guidance.records import TOPICS
from guidance.replay import replay
from guidance.service import new_session
from guidance.telemetry import Sample
from guidance.telemetry.disk_file import FoundFile
from guidance.telemetry.log import MAGIC, PREFIX, LogDamaged, read_log, read_metadata
from guidance.telemetry.log_repair import INTERRUPTED, NotOurs, close_log
from guidance.telemetry.schema import RECORDS
from tests.helpers import make_config, make_flight
from tests.recorder_rig import Message, Paced, as_messages, readable, record_all, sample


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A log of several chunks, one of which declares a channel of its own."""
    # Instants go back and forth: the last chunk does not hold the latest one.
    samples = [sample(number ^ 16, "stranger" if number == 30 else "state", size=3) for number in range(44)]
    with pytest.MonkeyPatch.context() as patch:  # all the schemas are ten times as long
        patch.setattr("guidance.telemetry.mcap_writer.RECORDS", {"state": RECORDS["state"]})
        directory = tmp_path_factory.mktemp("small")
        return record_all(directory, samples, chunk_bytes=700, foxglove=False).read_bytes()


class Unsynced(FoundFile):
    """A file for tests that repair thousands of times."""

    def sync(self) -> None:
        """Nothing: there is no power loss here."""


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The log of a flight of five seconds."""
    flown = make_flight()
    flown.run(5.0)
    records = [new_session(make_config()), *flown.records]
    samples = [Sample(TOPICS[type(record)], record.t_ns, msgspec.json.encode(record)) for record in records]
    return record_all(tmp_path_factory.mktemp("flight"), samples).read_bytes()


def ends_of_chunks(log: bytes) -> list[int]:
    """Where each chunk of a log ends."""
    ends, position = [], len(MAGIC)
    while position + PREFIX.size < len(log):
        opcode, length = PREFIX.unpack_from(log, position)
        position += PREFIX.size + length
        if opcode == Opcode.CHUNK:
            ends.append(position)
        if opcode == Opcode.FOOTER:
            break
    return ends


def opens_everywhere(path: Path) -> list[Message]:
    """The messages by the library's indexed reader, its checks on; the summary counts them rightly."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        messages = [
            (message.sequence, channel.topic.removeprefix("/"), message.data)
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]
        times_ns = [message.log_time for _, _, message in reader.iter_messages()] or [0]
        metadata = {item.name for item in reader.iter_metadata()}
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(messages)
    assert sum(summary.statistics.channel_message_counts.values()) == len(messages)
    assert summary.statistics.message_start_time == min(times_ns)
    assert summary.statistics.message_end_time == max(times_ns)
    assert summary.statistics.chunk_count == len(summary.chunk_indexes)
    assert summary.statistics.metadata_count == 2
    assert metadata == {"guidance", "guidance.end"}
    assert [sequence for sequence, _, _ in messages] == list(range(1, len(messages) + 1))
    return [(topic, data) for _, topic, data in messages]


def test_a_log_cut_at_any_byte_is_closed_after_its_last_whole_chunk(small: bytes, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(small)
    messages = list(read_log(path))
    chunks = ends_of_chunks(small)
    assert len(chunks) > 4
    results: dict[bytes, list[Message]] = {}
    for size in range(len(small)):
        path.write_bytes(small[:size])
        before = readable(path)[0] if size >= len(MAGIC) else []
        assert close_log(path, "rover1", open_file=Unsynced)
        repaired = path.read_bytes()
        if repaired not in results:
            results[repaired] = opens_everywhere(path)
        found, damage = readable(path)
        assert found == before == messages[: len(found)] == results[repaired]
        assert sum(end <= size for end in chunks) == len(ends_of_chunks(repaired))
        if damage is None:  # the end mark was whole: nothing of the run is missing
            assert found == messages
            assert size > chunks[-1]
        else:
            assert damage.why == f"the recorder ended it here: {INTERRUPTED}"
        assert read_metadata(path)["vehicle"] == "rover1"
    # Before the first chunk and after each one; with the recorder's end mark in it, and whole.
    assert len(results) == 1 + 1 + len(chunks) + 1


def test_to_close_a_log_twice_changes_nothing(small: bytes, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(small)
    assert not close_log(path, "rover1")
    assert path.read_bytes() == small
    path.write_bytes(small[:-900])
    assert close_log(path, "rover1")
    once = path.read_bytes()
    assert not close_log(path, "rover1")
    assert path.read_bytes() == once


@pytest.mark.parametrize("behind", [b"", bytes(3000)], ids=["cut", "zeros"])
def test_a_repair_that_is_interrupted_at_any_byte_is_done_again_with_the_same_result(
    small: bytes, tmp_path: Path, behind: bytes
) -> None:
    """After power loss a file may have its length but not its bytes."""
    path = tmp_path / "cut.mcap"
    size = ends_of_chunks(small)[-1] - 1
    path.write_bytes(small[:size])
    assert close_log(path, "rover1")
    repaired = path.read_bytes()
    kept = next(at for at in range(size) if small[at] != repaired[at])
    for written in range(kept, len(repaired)):
        path.write_bytes(repaired[:written] + behind)
        assert close_log(path, "rover1", open_file=Unsynced)
        assert path.read_bytes() == repaired


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**31), st.binary(max_size=200), st.integers(0, 60_000))
def test_a_flight_cut_at_random_with_anything_behind_is_closed_and_replays_to_there(
    flight: bytes, tmp_path_factory: pytest.TempPathFactory, place: int, noise: bytes, zeros: int
) -> None:
    path = tmp_path_factory.mktemp("cut") / "cut.mcap"
    size = 30 + place % (len(flight) - 30)
    path.write_bytes(flight[:size] + bytes(zeros) + noise)
    before, _ = readable(path)
    try:
        if not close_log(path, "rover1", open_file=Unsynced):
            assert zeros == 0
            return
    except NotOurs:  # cut within what says whose it is
        assert size < 250
        return
    found, damage = readable(path)
    assert found == before
    assert damage is not None or size > ends_of_chunks(flight)[-1]
    shown = [message for message in opens_everywhere(path) if message[0] in RECORDS]
    assert shown == found


def test_a_closed_log_replays_to_the_bit_up_to_the_cut(flight: bytes, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(flight[: len(flight) * 2 // 3])
    assert close_log(path, "rover1")
    found = replay(path)
    assert found.difference is None
    assert found.tracked > 0
    assert not found.identical
    assert INTERRUPTED in found.stopped


def test_no_cut_costs_more_than_a_second(flight: bytes, tmp_path: Path) -> None:
    """What is in the file of a crash ends at most one chunk before the cut, and no chunk spans a second."""
    path = tmp_path / "whole.mcap"
    path.write_bytes(flight)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    indexes = summary.chunk_indexes
    assert len(indexes) > 5
    assert all(index.message_end_time - index.message_start_time < 1e9 for index in indexes)


def test_a_chunk_damaged_at_the_end_is_cut_off(small: bytes, tmp_path: Path) -> None:
    """Power loss may tear what was not on the disk yet anywhere, not only at the end."""
    *_, before, last = ends_of_chunks(small)
    path = tmp_path / "torn.mcap"
    path.write_bytes(small[: last - 20] + bytes(20) + small[last : last + 40])
    assert close_log(path, "rover1")
    assert ends_of_chunks(path.read_bytes())[-1] == before
    assert opens_everywhere(path) == readable(path)[0]


def test_a_chunk_whose_checksum_does_not_hold_is_cut_off(small: bytes, tmp_path: Path) -> None:
    *_, before, last = ends_of_chunks(small)
    checksum = before + small[before:].index(b"zstd") - 4 - 4  # the name's length stands between
    path = tmp_path / "flipped.mcap"
    path.write_bytes(small[:checksum] + bytes([small[checksum] ^ 1]) + small[checksum + 1 : last])
    assert close_log(path, "rover1")
    assert ends_of_chunks(path.read_bytes())[-1] == before
    assert opens_everywhere(path) == readable(path)[0]


def test_a_log_damaged_in_its_middle_is_left_as_it_is(small: bytes, tmp_path: Path) -> None:
    path = tmp_path / "broken.mcap"
    content = small[: ends_of_chunks(small)[2] - 9] + bytes(9 << 20)  # more than a crash can leave behind
    path.write_bytes(content)
    with pytest.raises(LogDamaged, match="would have to be cut off"):
        close_log(path, "rover1")
    assert path.read_bytes() == content


def foreign(header: bytes) -> bytes:
    return MAGIC + PREFIX.pack(Opcode.HEADER, len(header)) + header


@pytest.mark.parametrize(
    "content",
    [
        b"not a log at all",
        b"\x7fELF" + bytes(100),
        foreign(b"\0\0\0\0\x05\0\0\0other"),
        foreign(b"\0\0\0\0\x05\0\0\0other") + b"\x03",
        MAGIC + PREFIX.pack(Opcode.METADATA, 13) + b"\x05\0\0\0other\0\0\0\0",
    ],
)
def test_what_another_program_writes_is_not_touched(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(NotOurs):
        close_log(path, "rover1")
    assert path.read_bytes() == content


def test_another_vehicles_log_is_not_touched(small: bytes, tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(small[:-500])
    with pytest.raises(NotOurs, match="not of the recorder of rover2"):
        close_log(path, "rover2")
    assert path.read_bytes() == small[:-500]


def test_a_log_that_is_being_written_is_not_touched(tmp_path: Path) -> None:
    seen = []

    class Watched(Paced):
        def waited(self) -> None:
            if self.sink.path.exists() and self.sink._log is not None:
                before = self.sink.path.read_bytes()
                with pytest.raises(BlockingIOError):
                    close_log(self.sink.path, "rover1")
                assert self.sink.path.read_bytes() == before
                seen.append(len(before))

    samples = [sample(number * 100) for number in range(20)]
    (path,) = Watched(tmp_path, samples).run()
    assert max(seen) > 0
    assert readable(path) == (as_messages(samples), None)


@pytest.mark.parametrize("room", [0, 1, 200, 2000])
def test_a_repair_on_a_full_disk_leaves_the_log_as_it_can_be_read(
    small: bytes, tmp_path: Path, room: int
) -> None:
    class Full(FoundFile):
        left = room

        def write(self, data: bytes, /) -> int:  # type: ignore[override]
            if not self.left:
                raise OSError(errno.ENOSPC, "No space left on device")
            count = super().write(data[: self.left])
            self.left -= count
            return count

    path = tmp_path / "cut.mcap"
    path.write_bytes(small[: ends_of_chunks(small)[3] + 10])
    before, _ = readable(path)
    with pytest.raises(OSError, match="No space left"):
        close_log(path, "rover1", open_file=Full)
    assert path.read_bytes() == small[: ends_of_chunks(small)[3]]
    assert readable(path)[0] == before
    assert close_log(path, "rover1")
    assert opens_everywhere(path) == before


def test_the_footer_comes_when_the_disk_holds_the_rest(small: bytes, tmp_path: Path) -> None:
    done: list[str] = []

    class Told(FoundFile):
        def write(self, data: bytes, /) -> int:  # type: ignore[override]
            done.append("footer" if data.endswith(MAGIC) else "rest")
            return super().write(data)

        def sync(self) -> None:
            done.append("sync")

    path = tmp_path / "cut.mcap"
    path.write_bytes(small[:-900])
    assert close_log(path, "rover1", open_file=Told)
    assert done == ["rest", "sync", "footer", "sync"]


def test_the_work_can_be_stopped_after_any_chunk_with_nothing_changed(small: bytes, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    cut = small[: ends_of_chunks(small)[-1]]
    path.write_bytes(cut)
    turns = len(ends_of_chunks(cut))
    for stop_at in range(turns):
        with pytest.raises(KeyboardInterrupt):
            close_log(path, "rover1", pause=_stopping_after(stop_at))
        assert path.read_bytes() == cut
    assert close_log(path, "rover1", pause=_stopping_after(turns))


def _stopping_after(turns: int) -> Callable[[], None]:
    left = iter(range(turns))

    def pause() -> None:
        if next(left, None) is None:
            raise KeyboardInterrupt

    return pause
