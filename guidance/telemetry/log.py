"""Reading a flight log back, in the order in which it was written.

The outer records of MCAP are walked here instead of with the library's stream reader, which neither notices
a record that ends early nor keeps up: a replay must run 50 times as fast as the flight. Chunks, channels and
metadata are still decoded by the library. Order is file order, never log time: a replay feeds the core what
it was fed, in that order.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Final, TypeVar

import msgspec
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Statistics
from mcap.stream_reader import get_chunk_data_stream

from guidance.records import NOT_A_RECORD, SCHEMA_VERSION, Record
from guidance.telemetry.schema import RECORDS

_T = TypeVar("_T")

#: Told how far a file was read: its path and the bytes of it that are done.
Passed = Callable[[Path, int], object]

#: Name of the metadata record that every log of ours carries.
METADATA_NAME: Final = "guidance"
#: Name of the last metadata record, by which the recorder says that it closed the log. Its one field says why
#: the log had to end before the run did; empty if it did not.
END_NAME: Final = "guidance.end"
ENDED_EARLY: Final = "ended_early"
#: Field of the end: the file in which the same run goes on. A log without it holds the run to its end.
CONTINUED_IN: Final = "continued_in"
#: Field of the first metadata: which part of its run the file is, from 1 on.
PART: Final = "part"
#: Metadata of a channel whose messages were made of the records, for viewers; readers of ours pass them over.
DERIVED: Final = {"derived": "from the records, for viewers"}

MAGIC: Final = b"\x89MCAP0\r\n"
PREFIX: Final = struct.Struct("<BQ")  # opcode, length
MESSAGE: Final = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time; the payload follows
_DATA_END_BYTES: Final = 4


class NotALog(Exception):  # noqa: N818
    """`path` is not a log that this version can read; the text says what it is instead."""

    def __init__(self, path: Path, why: str) -> None:
        super().__init__(f"{path}: not a readable flight log: {why}")
        self.path = path


class LogDamaged(Exception):  # noqa: N818
    """`path` is a log, but ends early or is broken at byte `offset`; everything before was delivered."""

    def __init__(self, path: Path, offset: int, why: str) -> None:
        super().__init__(f"{path}: incomplete from byte {offset} on: {why}")
        self.path = path
        self.offset = offset
        self.why = why


def read_log(path: Path) -> Iterator[tuple[str, bytes]]:
    """Every message of the log at `path` in file order: topic (without a slash) and payload (JSON).

    What the recorder made of the records for viewers is passed over.

    Raises:
        NotALog: at once, when there is no such file or it is no MCAP file.
        LogDamaged: in place of the first message that cannot be read. A log that was not closed (crash, power
            cut, full disk), or was closed before the run ended (disk nearly full), delivers all that reached
            the disk and then raises this; so does one that does not say how it ended. A log that goes on in
            another file is whole; see `read_part`.
    """
    _check_magic(path)
    return _messages(path)


def read_part(path: Path, passed: Passed | None = None) -> Generator[tuple[str, bytes], None, str]:
    """As `read_log`; when it is through, returns the name of the file in which the run goes on, or "".

    `passed` is told after each chunk.

    Raises:
        NotALog: as `read_log`.
        LogDamaged: as `read_log`.
    """
    _check_magic(path)
    return _messages(path, passed)


def read_records(path: Path, *topics: str) -> Iterator[Record]:
    """The records of `topics` (of all if none is named) in file order; unknown topics are skipped.

    Raises:
        ValueError: a topic that does not exist.
        NotALog: as `read_log`, or the log was not written by guidance, or with another schema version.
        LogDamaged: as `read_log`, or a payload does not decode.
    """
    unknown = sorted(set(topics) - set(RECORDS))
    if unknown:
        raise ValueError(f"no such topic: {', '.join(unknown)}; there are {', '.join(RECORDS)}")
    version = read_metadata(path).get("schema_version", "")
    if version != str(SCHEMA_VERSION):
        why = f"its schema version is {version}" if version else "it was not written by guidance"
        raise NotALog(path, f"{why}; this version reads schema version {SCHEMA_VERSION}")
    wanted = topics or tuple(RECORDS)
    return _records(path, {topic: msgspec.json.Decoder(RECORDS[topic]) for topic in wanted})


def read_metadata(path: Path) -> dict[str, str]:
    """What the recorder says of the run, {} if nothing.

    That is session_id, vehicle, schema_version, unix_offset_ns, and which part of the run this is (`PART`).

    Raises:
        NotALog: as `read_log`.
        LogDamaged: the log is broken before its first message.
    """
    _check_magic(path)
    for opcode, offset, body in _outer_records(path):
        if opcode == Opcode.METADATA:
            metadata = _parse(path, offset, Metadata.read, body)
            if metadata.name == METADATA_NAME:
                return dict(metadata.metadata)
        elif opcode in (Opcode.CHUNK, Opcode.MESSAGE):
            break
    return {}


def _check_magic(path: Path) -> None:
    try:
        with path.open("rb") as file:
            magic = file.read(len(MAGIC))
    except OSError as error:
        raise NotALog(path, error.strerror or str(error)) from error
    if magic != MAGIC:
        raise NotALog(path, "the file is empty" if not magic else "it does not begin as an MCAP file does")


def _records(path: Path, decoders: dict[str, msgspec.json.Decoder[Record]]) -> Iterator[Record]:
    for count, (topic, payload) in enumerate(_messages(path), start=1):
        decoder = decoders.get(topic)
        if decoder is not None:
            try:
                record = decoder.decode(payload)
            except NOT_A_RECORD as error:
                raise LogDamaged(path, 0, f"message {count}, topic {topic}: {error}") from error
            yield record


def _messages(path: Path, passed: Passed | None = None) -> Generator[tuple[str, bytes], None, str]:
    reader = _ChunkReader(path)
    ended_early: str | None = None
    continued_in = ""
    offset = 0
    for opcode, offset, body in _outer_records(path):
        if opcode == Opcode.CHUNK:
            yield from reader.messages(offset, _unpack_chunk(path, offset, body))
            if passed is not None:
                passed(path, offset + len(body))
        elif opcode in (Opcode.MESSAGE, Opcode.CHANNEL):
            yield from reader.messages(offset, PREFIX.pack(opcode, len(body)) + body)
        elif opcode == Opcode.METADATA:
            metadata = _parse(path, offset, Metadata.read, body)
            reader.numbered |= metadata.name == METADATA_NAME
            if metadata.name == END_NAME:
                ended_early = metadata.metadata.get(ENDED_EARLY)
                continued_in = metadata.metadata.get(CONTINUED_IN, "")
        elif opcode == Opcode.STATISTICS and reader.numbered:
            missing = _parse(path, offset, Statistics.read, body).message_count - reader.count
            if missing:
                raise LogDamaged(path, offset, f"the last {missing} messages are missing")
    if reader.numbered and ended_early is None:
        raise LogDamaged(path, offset, "it does not say how it ended: our recorder did not close it")
    if ended_early:
        raise LogDamaged(path, offset, f"the recorder ended it here: {ended_early}")
    return continued_in


class _ChunkReader:
    """Takes messages out of unpacked chunks and remembers from one to the next what it needs for that."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._channels: dict[int, str | None] = {}  # id -> topic, None if its messages are passed over
        self.count = 0
        #: Our recorder numbers the messages of a file; a number that is missing betrays a chunk that is.
        self.numbered = False

    def messages(self, offset: int, data: bytes) -> Iterator[tuple[str, bytes]]:
        # The hot loop of every replay: a hundred seconds of flight are some 60 000 turns.
        prefix, head, message = PREFIX.unpack_from, MESSAGE.unpack_from, int(Opcode.MESSAGE)
        channels, path, numbered = self._channels, self._path, self.numbered
        position, end = 0, len(data)
        while position < end:
            try:
                opcode, length = prefix(data, position)
                body = position + PREFIX.size
                position = body + length
                if position > end:
                    raise LogDamaged(path, offset, "a record is longer than the chunk around it")
                if opcode == Opcode.CHANNEL:
                    channel = _parse(path, offset, Channel.read, data[body:position])
                    derived = channel.metadata == DERIVED
                    channels[channel.id] = None if derived else channel.topic.removeprefix("/")
                if opcode != message:
                    continue
                channel_id, sequence, _, _ = head(data, body)
                topic = channels[channel_id]
            except struct.error as error:
                raise LogDamaged(path, offset, "a record is shorter than its kind must be") from error
            except KeyError as error:
                raise LogDamaged(path, offset, f"channel {error} was never declared") from error
            self.count += 1
            if numbered and sequence != self.count & 0xFFFFFFFF:
                raise LogDamaged(path, offset, f"message {self.count} is missing")
            if topic is not None:
                yield topic, data[body + MESSAGE.size : position]


def unpack_chunk(chunk: Chunk) -> bytes:
    """The records in a chunk, its checksum being right; raises whatever its compression raises."""
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    return stream.read(length)


def _unpack_chunk(path: Path, offset: int, body: bytes) -> bytes:
    chunk = _parse(path, offset, Chunk.read, body)
    try:
        return unpack_chunk(chunk)
    except Exception as error:  # each compression has exceptions of its own
        raise LogDamaged(path, offset, f"a chunk does not unpack: {error}") from error


def _outer_records(path: Path) -> Iterator[tuple[int, int, bytes]]:
    """Opcode, offset and body of each record up to the statistics; a summary that is cut does no harm."""
    size = path.stat().st_size
    offset = len(MAGIC)
    data_ended = False
    with path.open("rb") as file:
        file.seek(offset)
        while True:
            head = file.read(PREFIX.size)
            if len(head) < PREFIX.size:
                if data_ended:
                    return
                raise LogDamaged(path, offset, "it was not closed: the recorder was interrupted here")
            opcode, length = PREFIX.unpack(head)
            if opcode == Opcode.DATA_END and length == _DATA_END_BYTES:
                data_ended = True
            if opcode == 0:
                raise LogDamaged(path, offset, "no record begins here")
            if length > size - offset - PREFIX.size:
                if data_ended:
                    return
                raise LogDamaged(
                    path, offset, "the file ends within a record: the recorder was interrupted here"
                )
            yield opcode, offset, file.read(length)
            if data_ended and opcode in (Opcode.STATISTICS, Opcode.FOOTER):
                return
            offset += PREFIX.size + length


def _parse(path: Path, offset: int, read: Callable[[ReadDataStream], _T], body: bytes) -> _T:
    try:
        return read(ReadDataStream(io.BytesIO(body)))
    except (McapError, struct.error, UnicodeDecodeError, OverflowError, MemoryError) as error:
        raise LogDamaged(path, offset, f"a record does not parse: {error!r}") from error
