"""What stands at the end of a log: the word how it ended, the summary, the footer.

Gathered record by record, for logs that are closed in time and for logs that are closed later. The library's
writer would build the summary of an hour in 60 ms of Python, in flight, when the log goes on in another file;
this one is ready in a tenth of that, and serves files that another process wrote.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections import Counter
from typing import Any, Final

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from guidance.telemetry.log import END_NAME, MAGIC, MESSAGE, PREFIX, unpack_chunk

#: The footer and the magic that ends a file.
FOOTER_BYTES: Final = PREFIX.size + 8 + 8 + 4 + len(MAGIC)
_INDEX: Final = struct.Struct("<HI")  # channel, bytes of entries
_ENTRY_BYTES: Final = 16


class Summary:
    """Take every record of the data section with its place; then `ending` is what the file still lacks.

    `take` raises what the library raises for a record that does not parse; it is then not taken.
    """

    def __init__(self) -> None:
        #: Place of the first byte after the last record taken.
        self.end = len(MAGIC)
        #: Whether the log has said how it ended.
        self.ended = False
        self._schemas: dict[int, bytes] = {}
        self._channels: dict[int, bytes] = {}
        self._newest: Chunk | None = None
        self._chunk: ChunkIndex | None = None  # of the newest one, while its message indexes may still follow
        self._chunk_indexes: list[bytes] = []
        self._metadata_indexes: list[bytes] = []
        self._counts: Counter[int] = Counter()
        self._counted: dict[int, int] = {}  # in the newest chunk
        self._times_ns: tuple[int, int] | None = None

    def take(self, opcode: int, body: bytes) -> None:
        """The next record of the file."""
        length = PREFIX.size + len(body)
        if opcode == Opcode.MESSAGE_INDEX and self._chunk is not None:
            self._take_index(self._chunk, body, length)
        elif opcode == Opcode.CHUNK:
            self._take_chunk(body, length)
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(stream_of(body))
            self._metadata_indexes.append(_bytes(MetadataIndex(self.end, length, metadata.name)))
            self.ended = metadata.name == END_NAME
        self.end += length

    def take_all(self, data: bytes) -> None:
        """Records one after another, all of them whole."""
        position = 0
        while position < len(data):
            opcode, length = PREFIX.unpack_from(data, position)
            position += PREFIX.size
            self.take(opcode, data[position : position + length])
            position += length

    def _take_chunk(self, body: bytes, length: int) -> None:
        chunk = Chunk.read(stream_of(body))
        if not self._channels:
            self._declare(chunk)
        self._close_chunk()
        self._newest = chunk
        self._chunk = ChunkIndex(
            chunk_length=length,
            chunk_start_offset=self.end,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            message_end_time=chunk.message_end_time,
            message_index_length=0,
            message_index_offsets={},
            message_start_time=chunk.message_start_time,
            uncompressed_size=chunk.uncompressed_size,
        )
        first_ns, last_ns = self._times_ns or (chunk.message_start_time, 0)
        self._times_ns = min(first_ns, chunk.message_start_time), max(last_ns, chunk.message_end_time)

    def _take_index(self, chunk: ChunkIndex, body: bytes, length: int) -> None:
        channel_id, entries_bytes = _INDEX.unpack_from(body)
        if channel_id == 0:
            raise McapError("a message index of no channel")
        chunk.message_index_offsets[channel_id] = self.end
        chunk.message_index_length += length
        self._counted[channel_id] = entries_bytes // _ENTRY_BYTES
        if channel_id not in self._channels and self._newest is not None:
            self._declare(self._newest)

    def _close_chunk(self) -> None:
        if self._chunk is not None:
            self._chunk_indexes.append(_bytes(self._chunk))
            self._counts.update(self._counted)
            self._counted = {}
            self._chunk = None

    def drop_indexes(self) -> bytes:
        """Forget the message indexes after the last chunk, which may be cut; returns the chunk's content."""
        if self._chunk is None or self._newest is None:
            return b""
        self._chunk.message_index_offsets.clear()
        self._chunk.message_index_length = 0
        self._counted = {}
        self.end = self._chunk.chunk_start_offset + self._chunk.chunk_length
        return unpack_chunk(self._newest)

    def _declare(self, chunk: Chunk) -> None:
        """Keep the schemas and channels in a chunk: the first, and each that uses an unknown channel."""
        data, position = unpack_chunk(chunk), 0
        while position < len(data):
            opcode, length = PREFIX.unpack_from(data, position)
            end = position + PREFIX.size + length
            body = data[position + PREFIX.size : end]
            if opcode == Opcode.SCHEMA:
                self._schemas[Schema.read(stream_of(body)).id] = data[position:end]
            elif opcode == Opcode.CHANNEL:
                self._channels[Channel.read(stream_of(body)).id] = data[position:end]
            position = end

    def ending(self, end_mark: dict[str, str]) -> bytes:
        """What makes the file whole; the mark only if it has none yet. Nothing can be taken after it."""
        builder: Any = RecordBuilder()
        if not self.ended:
            mark = _bytes(Metadata(END_NAME, end_mark))
            builder.write(mark)
            self.take_all(mark)
        self._close_chunk()
        DataEnd(0).write(builder)
        data: bytes = builder.end()
        start = self.end + PREFIX.size + 4  # of the data end's record, its one field being of 4 bytes
        return data + self._summary(start)

    def _summary(self, start: int) -> bytes:
        first_ns, last_ns = self._times_ns or (0, 0)
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunk_indexes),
            message_count=sum(self._counts.values()),
            message_end_time=last_ns,
            message_start_time=first_ns,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )
        groups = {
            Opcode.SCHEMA: b"".join(self._schemas.values()),
            Opcode.CHANNEL: b"".join(self._channels.values()),
            Opcode.STATISTICS: _bytes(statistics),
            Opcode.CHUNK_INDEX: b"".join(self._chunk_indexes),
            Opcode.METADATA_INDEX: b"".join(self._metadata_indexes),
        }
        offsets, place = [], start
        for opcode, group in groups.items():
            if group:
                offsets.append(_bytes(SummaryOffset(opcode, place, len(group))))
            place += len(group)
        summary = b"".join([*groups.values(), *offsets])
        footer = _bytes(Footer(start, place, 0))[:-4]  # the checksum covers the summary and all before itself
        return summary + footer + struct.pack("<I", zlib.crc32(footer, zlib.crc32(summary))) + MAGIC


def message_indexes(chunk: bytes) -> bytes:
    """The index records that follow an unpacked chunk; ValueError if it does not consist of whole records."""
    entries: dict[int, list[tuple[int, int]]] = {}
    position, end = 0, len(chunk)
    while position < end:
        if end - position < PREFIX.size:
            raise ValueError("a chunk ends within a record")
        opcode, length = PREFIX.unpack_from(chunk, position)
        if length > end - position - PREFIX.size or (opcode == Opcode.MESSAGE and length < MESSAGE.size):
            raise ValueError("a record does not fit its chunk")
        if opcode == Opcode.MESSAGE:
            channel_id, _, log_time, _ = MESSAGE.unpack_from(chunk, position + PREFIX.size)
            entries.setdefault(channel_id, []).append((log_time, position))
        position += PREFIX.size + length
    return b"".join(_bytes(MessageIndex(channel_id, rows)) for channel_id, rows in entries.items())


def stream_of(body: bytes) -> ReadDataStream:
    """What the library reads the fields of a record from."""
    return ReadDataStream(io.BytesIO(body))


def _bytes(record: McapRecord) -> bytes:
    builder: Any = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()
    return data
