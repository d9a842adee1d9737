"""One file of a log, by the MCAP library's writer: its types, its file in memory, the channels, the end."""

from __future__ import annotations

import io
from contextlib import suppress
from typing import Final, Protocol

from mcap.writer import CompressionType, IndexType, Writer

from guidance.records import SCHEMA_VERSION
from guidance.telemetry.disk_file import LogFile, write_all
from guidance.telemetry.foxglove_view import SHOWN
from guidance.telemetry.log import DERIVED, MAGIC, METADATA_NAME
from guidance.telemetry.mcap_summary import FOOTER_BYTES, Summary
from guidance.telemetry.queue import Sample
from guidance.telemetry.schema import RECORDS, json_schema, schema_name, schema_of, well_known_name

#: Begins the name by which a log says what wrote it.
LIBRARY: Final = "guidance schema"


class McapWriter(Protocol):
    """`mcap.writer.Writer`, which comes with only some of its types."""

    def add_message(
        self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int
    ) -> None: ...

    def add_metadata(self, name: str, data: dict[str, str]) -> None: ...

    def register_schema(self, name: str, encoding: str, data: bytes) -> int: ...

    def register_channel(
        self, topic: str, message_encoding: str, schema_id: int, metadata: dict[str, str] = ...
    ) -> int: ...

    def flush(self) -> None: ...

    def start(self, profile: str, library: str) -> None: ...


class Outbox(io.BytesIO):
    """What the MCAP writer takes for its file: keeps the bytes until they are written out together."""

    def __init__(self) -> None:
        super().__init__()
        self._before = 0

    def tell(self) -> int:
        """Offset in the file of the next byte."""
        return self._before + super().tell()

    def empty(self) -> bool:
        return super().tell() == 0

    def take(self) -> bytes:
        data = self.getvalue()
        self.seek(0)
        self.truncate()
        self._before += len(data)
        return data


class LogWriter:
    """One file of a log: samples in, whole chunks out, and an end that says how it ended.

    Every call may raise OSError: the file then ends at `size` and takes no more, `abandon` it.

    Args:
        file: new and empty.
        metadata: of the run, see `log.read_metadata`.
        unix_offset_ns: added to the time of a sample gives its log time.
        chunk_bytes: a chunk is written when it is so large, before compression.
        foxglove: also have the channels of what viewers draw.
    """

    def __init__(
        self,
        file: LogFile,
        metadata: dict[str, str],
        *,
        unix_offset_ns: int,
        chunk_bytes: int,
        foxglove: bool,
    ) -> None:
        self._file = file
        self._outbox = Outbox()
        self._writer = _start(self._outbox, metadata, chunk_bytes)
        self._channels = register_channels(self._writer, foxglove=foxglove)
        self._unix_offset_ns = unix_offset_ns
        self._summary = Summary()
        self._sequence = 0
        self._synced = 0
        #: The file is whole up to here.
        self.size = 0
        #: Samples that were `taken` and are not in the file yet.
        self.unwritten = 0

    def add(self, sample: Sample) -> None:
        """Write `sample`, or keep it for the chunk that is being filled."""
        channel = self._channels.get(sample.topic)
        if channel is None:  # no record of ours, but recorded all the same
            channel = self._writer.register_channel(f"/{sample.topic}", "json", 0)
            self._channels[sample.topic] = channel
        self._sequence += 1
        time_ns = max(0, sample.t_ns + self._unix_offset_ns)
        # The sequence is the place in the file: readers that sort by time can restore the order.
        self._writer.add_message(channel, time_ns, sample.payload, time_ns, self._sequence & 0xFFFFFFFF)
        if self.size == 0:
            self._writer.flush()  # the chunk with schemas and channels: without it nothing can be read
        if not self._outbox.empty():
            self._write_out()

    def flush(self) -> None:
        """Have the disk hold all samples; kill and power loss take none of them any more."""
        if self.unwritten:
            self._writer.flush()
            self._write_out()
        if self._synced != self.size:
            self._file.sync()
            self._synced = self.size

    @property
    def safe(self) -> bool:
        """Whether the disk holds all samples."""
        return not self.unwritten and self._synced == self.size

    def _write_out(self) -> None:
        """Hand the closed chunks to the operating system."""
        data = self._outbox.take()
        write_all(self._file, data)
        self._summary.take_all(data if self.size else data[len(MAGIC) :])
        self.size += len(data)
        self.unwritten = 0

    def end(self, mark: dict[str, str]) -> None:
        """Close the file in good order: last chunk, mark, summary; these being safe, the footer."""
        self._writer.flush()
        self._write_out()
        ending = self._summary.ending(mark)
        write_all(self._file, ending[:-FOOTER_BYTES])
        self._file.sync()
        write_all(self._file, ending[-FOOTER_BYTES:])
        self._file.sync()
        self._file.close()

    def abandon(self) -> None:
        """Leave the file as far as it is whole."""
        # Half a chunk is of no use to a reader. A disk that fails here has said enough already.
        with suppress(OSError):
            self._file.truncate(self.size)
        with suppress(OSError):
            self._file.close()


def empty_log(metadata: dict[str, str], mark: dict[str, str]) -> bytes:
    """A log without messages that ended with `mark`."""
    outbox, summary = Outbox(), Summary()
    _start(outbox, metadata, 0)
    data = outbox.take()
    summary.take_all(data[len(MAGIC) :])
    return data + summary.ending(mark)


def _start(outbox: Outbox, metadata: dict[str, str], chunk_bytes: int) -> McapWriter:
    # Chunks and their message indexes are the library's; the end is ours.
    writer: McapWriter = Writer(
        outbox, chunk_size=chunk_bytes, compression=CompressionType.ZSTD, index_types=IndexType.MESSAGE
    )
    writer.start(profile="", library=f"{LIBRARY} {SCHEMA_VERSION}")
    writer.add_metadata(METADATA_NAME, metadata)
    return writer


def register_channels(writer: McapWriter, *, foxglove: bool) -> dict[str, int]:
    """Topic (no slash) -> channel id: every record and, with `foxglove`, all that viewers draw."""
    channels = {}
    for topic in RECORDS:
        schema_id = writer.register_schema(schema_name(topic), "jsonschema", json_schema(topic))
        channels[topic] = writer.register_channel(f"/{topic}", "json", schema_id)
    if foxglove:
        schema_ids = {
            kind: writer.register_schema(well_known_name(kind), "jsonschema", schema_of(kind))
            for kind in dict.fromkeys(SHOWN.values())
        }
        for topic, kind in SHOWN.items():
            channels[topic] = writer.register_channel(f"/{topic}", "json", schema_ids[kind], DERIVED)
    return channels
