"""The log holds what was offered, in order, or says what is missing; no disk holds up the control thread."""

from __future__ import annotations

import errno
import itertools
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from guidance.records import (
    SCHEMA_VERSION,
    TOPICS,
    Event,
    Input,
    InputKind,
    Level,
    Link,
    Lost,
    Record,
    Status,
)
from guidance.telemetry import Sample
from guidance.telemetry.log import LogDamaged, NotALog, read_log, read_metadata, read_records
from guidance.telemetry.recorder import DiskFile, LogFile, Recorder, log_name
from guidance.telemetry.schema import RECORDS, json_schema

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


def test_what_was_offered_is_read_back_in_order_and_byte_for_byte(tmp_path: Path) -> None:
    topics = itertools.cycle(RECORDS)
    # Instants go back and forth on purpose: the order of a log is that of the offers.
    samples = [sample(number ^ 5, topic) for number, topic in zip(range(3000), topics, strict=False)]
    path = record_all(tmp_path, samples, chunk_bytes=4096)
    assert list(read_log(path)) == as_messages(samples)


@settings(max_examples=25)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([*RECORDS, "stranger"]), st.integers(-(2**62), 2**62), st.binary(max_size=300)
        )
    ),
    st.integers(1, 2000),
)
def test_any_payload_at_any_instant_survives(
    tmp_path_factory: pytest.TempPathFactory, items: list[tuple[str, int, bytes]], chunk_bytes: int
) -> None:
    samples = list(itertools.starmap(Sample, items))
    path = record_all(tmp_path_factory.mktemp("log"), samples, chunk_bytes=chunk_bytes)
    assert list(read_log(path)) == as_messages(samples)


def test_the_library_reads_the_log_with_its_schemas_times_and_metadata(tmp_path: Path) -> None:
    samples = [sample(number, "setpoint") for number in range(100)]
    path = record_all(tmp_path, samples, chunk_bytes=1000)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        found = list(reader.iter_messages(log_time_order=False))
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 100
    assert {channel.topic for channel in summary.channels.values()} == {
        f"/{topic}" for topic in TOPICS.values()
    }
    assert {channel.message_encoding for channel in summary.channels.values()} == {"json"}
    assert {schema.encoding for schema in summary.schemas.values()} == {"jsonschema"}
    assert {schema.name for schema in summary.schemas.values()} == {f"guidance.{r.__name__}" for r in TOPICS}
    for item, (schema, channel, message) in zip(samples, found, strict=True):
        assert schema is not None
        assert (schema.name, channel.topic, message.data) == ("guidance.Setpoint", "/setpoint", item.payload)
        assert message.log_time == message.publish_time == item.t_ns + OFFSET_NS
    assert read_metadata(path) == {
        "session_id": "0123456789abcdef",
        "schema_version": str(SCHEMA_VERSION),
        "vehicle": "rover1",
        "unix_offset_ns": str(OFFSET_NS),
    }


def test_the_file_name_sorts_by_time_and_never_leaves_the_directory() -> None:
    earlier = log_name("b", "0123456789", 1_700_000_000_000_000_000)
    assert earlier == "20231114T221320Z_b_01234567.mcap"
    assert earlier < log_name("a", "0", 1_700_000_001_000_000_000)
    assert "/" not in log_name("../x", "/etc/passwd", 0)


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
        assert not disk.sink.healthy
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
    assert not sink.healthy
    assert "No space left on device" in sink.problem
    assert "free space" in sink.problem
    if room < 20_000:
        assert sink.path.stat().st_size == 0
        assert sink.dropped == 4000
        return
    messages, damage = readable(sink.path)
    assert damage is not None
    assert messages == as_messages(samples)[: len(messages)]
    assert len(messages) > 100
    assert sink.dropped == 4000 - len(messages)  # every sample is in the file or counted


def test_the_log_is_closed_in_good_order_before_the_disk_is_full(tmp_path: Path) -> None:
    free = iter([500, 500, 300])
    ticks = itertools.count(0, 400_000_000)
    sink = recorder(
        tmp_path, min_free_bytes=400, free_bytes=lambda _: next(free, 300), clock_ns=lambda: next(ticks)
    )
    written = threading.Event()
    sink._wait = lambda _: written.set() if sink._writer is None and sink._opened else None
    sink.offer(sample(0))
    sink.start()
    assert written.wait(CLOSE_S)
    sink.offer(sample(1))
    assert not sink.close(CLOSE_S)
    assert list(read_log(sink.path)) == as_messages([sample(0)])  # no LogDamaged: it has its end
    assert "must stay free; delete old logs" in sink.problem
    assert sink.dropped == 1


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


@pytest.fixture(name="log")
def a_log(tmp_path: Path) -> tuple[Path, list[Message]]:
    samples = [sample(number, size=number % 90) for number in range(300)]
    return record_all(tmp_path, samples, chunk_bytes=1500), as_messages(samples)


def test_a_log_cut_anywhere_is_read_up_to_the_cut(log: tuple[Path, list[Message]]) -> None:
    path, messages = log
    whole = path.read_bytes()
    lengths = []
    for size in range(len(whole) - 1, 8, -61):
        path.write_bytes(whole[:size])
        found, damage = readable(path)
        assert found == messages[: len(found)]
        assert damage is not None or found == messages
        lengths.append(len(found))
    assert lengths[0] == len(messages)
    assert lengths == sorted(lengths, reverse=True)
    assert len(set(lengths)) > 5


def test_a_flipped_bit_is_noticed_and_nothing_false_is_delivered(log: tuple[Path, list[Message]]) -> None:
    path, messages = log
    whole = path.read_bytes()
    noticed = 0
    for position, flip in itertools.product(range(8, len(whole), 37), (0x02, 0x10, 0x80)):
        path.write_bytes(whole[:position] + bytes([whole[position] ^ flip]) + whole[position + 1 :])
        try:
            found, damage = readable(path)
        except NotALog:
            noticed += 1
            continue
        noticed += damage is not None
        # A flip in an index or the summary does no harm; one in a message never passes.
        assert found == messages[: len(found)]
        assert damage is not None or found == messages
    assert noticed > 10


@pytest.mark.parametrize(
    ("content", "why"),
    [(b"", "is empty"), (b"\x7fELF" + bytes(100), "does not begin"), (b"\x89MCAP", "does not begin")],
)
def test_what_is_no_log_is_refused_at_once(tmp_path: Path, content: bytes, why: str) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(NotALog, match=why) as refusal:
        read_log(path)
    assert refusal.value.path == path


def test_a_missing_file_is_no_log(tmp_path: Path) -> None:
    with pytest.raises(NotALog, match="No such file"):
        read_metadata(tmp_path / "none.mcap")


def test_records_come_back_as_they_were(tmp_path: Path) -> None:
    records: list[Record] = [
        Input(t_ns=1, seq=0, kind=InputKind.DATAGRAM, data=bytes(range(256))),
        Event(t_ns=2, level=Level.WARNING, code="x", text="ä"),
        Input(t_ns=3, seq=1, kind=InputKind.TICK),
    ]
    samples = [Sample(TOPICS[type(r)], r.t_ns, msgspec.json.encode(r)) for r in records]
    path = record_all(tmp_path, samples)
    assert list(read_records(path)) == records
    assert list(read_records(path, "input")) == [records[0], records[2]]
    with pytest.raises(ValueError, match="no such topic: inputs"):
        next(read_records(path, "inputs"))


def test_a_payload_that_is_not_its_record_is_damage(tmp_path: Path) -> None:
    path = record_all(tmp_path, [Sample("event", 1, b'{"t_ns":1}')])
    with pytest.raises(LogDamaged, match="message 1, topic event"):
        list(read_records(path))


def test_a_log_of_another_schema_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("guidance.telemetry.recorder.SCHEMA_VERSION", 99)
    path = record_all(tmp_path, [sample(0)])
    with pytest.raises(NotALog, match="schema version is 99"):
        read_records(path)


def fields_of(schema: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Every schema that a viewer looks at, from the top down."""
    yield schema
    for field in schema.get("properties", {}).values():
        yield from fields_of(field)
    if "items" in schema:
        yield from fields_of(schema["items"])


@pytest.mark.parametrize("topic", RECORDS)
def test_schemas_stay_within_what_viewers_read(topic: str) -> None:
    schema = msgspec.json.decode(json_schema(topic))
    assert schema["type"] == "object"
    for field in fields_of(schema):
        assert field["type"] in {"object", "array", "string", "number", "integer", "boolean"}
        assert not {"$ref", "anyOf", "oneOf", "prefixItems", "$defs"} & set(field)
        assert field["type"] != "array" or isinstance(field["items"], dict)
        assert field["type"] != "object" or isinstance(field["properties"], dict)
    for field in schema.get("patternProperties", {}).values():
        assert "$ref" not in str(field)


def test_a_field_that_may_be_null_is_still_described() -> None:
    status = msgspec.json.decode(json_schema("status"))
    assert status["patternProperties"]["^armed$"] == {"anyOf": [{"type": "boolean"}, {"type": "null"}]}
    assert "armed" in status["required"]
    triple = {"type": "array", "minItems": 3, "maxItems": 3, "items": {"type": "number"}}
    assert status["patternProperties"]["^origin_ned_m$"] == {"anyOf": [triple, {"type": "null"}]}
    described = set(status["properties"]) | {name[1:-1] for name in status["patternProperties"]}
    assert described == set(Status.__struct_fields__)
    link = msgspec.json.decode(json_schema("link"))
    assert link["properties"]["streams"]["items"]["patternProperties"].keys() == {"^age_s$"}
    assert set(link["required"]) == set(Link.__struct_fields__)


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
