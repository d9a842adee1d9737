"""A log is read back up to where it is whole; what is wrong with it is said, nothing false is delivered."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.writer import Writer

from guidance.records import TOPICS, Event, Input, InputKind, Level, Record
from guidance.telemetry import Sample
from guidance.telemetry.log import LogDamaged, NotALog, read_log, read_metadata, read_records
from tests.recorder_rig import Message, as_messages, readable, record_all, sample


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


def test_a_log_that_does_not_say_how_it_ended_is_not_taken_for_whole(tmp_path: Path) -> None:
    """Closed by another tool (a recovery, say), it has a footer but not our word that all is in it."""
    path = tmp_path / "recovered.mcap"
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        writer.add_metadata("guidance", {"schema_version": "1"})
        channel = writer.register_channel("/state", "json", 0)
        writer.add_message(channel, 0, b"{}", 0, 1)
        writer.finish()
    messages, damage = readable(path)
    assert messages == [("state", b"{}")]
    assert damage is not None
    assert "does not say" in damage.why


def test_a_log_of_another_recorder_needs_no_end_of_ours(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        writer.add_message(writer.register_channel("/x", "json", 0), 0, b"{}", 0)
        writer.finish()
    assert readable(path) == ([("x", b"{}")], None)
