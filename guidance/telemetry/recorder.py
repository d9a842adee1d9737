"""The flight log: an MCAP file with one channel of JSON per topic.

Written so that a crash costs at most `flush_s` of flight: small chunks, each handed to the operating system
whole, the first one (which carries schemas and channels) at once. Written so that a log never lies: samples
appear in the order in which they were offered, and where some had to be dropped a `lost` record says how
many. Written so that viewers can draw it: after a record follows what Foxglove knows it by. A disk that is
nearly full or fails ends the log, says so, and costs nothing but the log; a reader finds that out too: only a
log that holds the whole run ends with the word that it does.
"""

from __future__ import annotations

import errno
import io
import os
import re
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, Protocol

import msgspec
from mcap.writer import CompressionType, Writer

from guidance.records import SCHEMA_VERSION, TOPICS, Lost
from guidance.telemetry.foxglove_view import View
from guidance.telemetry.log import END_NAME, ENDED_EARLY, METADATA_NAME
from guidance.telemetry.mcap_writer import McapWriter, Outbox, register_channels
from guidance.telemetry.queue import Sample
from guidance.telemetry.worker import ThreadedSink

_LOST_TOPIC: Final = TOPICS[Lost]
_CHECK_SPACE_NS: Final = 1_000_000_000


class LogFile(Protocol):
    """The few calls the recorder makes on its file; what a test replaces."""

    def write(self, data: bytes, /) -> int | None:
        """Write some of `data`, return how many bytes."""

    def truncate(self, size: int, /) -> int:
        """Cut the file to `size` bytes."""

    def sync(self) -> None:
        """Have the disk hold what was written."""

    def close(self) -> None:
        """Close the file."""


class DiskFile(io.FileIO):
    """A new file, unbuffered; FileExistsError if there is one of that name."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "xb")

    def sync(self) -> None:
        """Have the disk hold what was written."""
        os.fsync(self.fileno())


def log_name(vehicle: str, session_id: str, unix_ns: int) -> str:
    """File name of a log: sorts by UTC time; odd characters of vehicle and session become underscores."""
    when = datetime.fromtimestamp(unix_ns // 1_000_000_000, UTC).strftime("%Y%m%dT%H%M%SZ")
    safe_vehicle, safe_session = (re.sub(r"[^A-Za-z0-9.-]", "_", part) for part in (vehicle, session_id[:8]))
    return f"{when}_{safe_vehicle}_{safe_session}.mcap"


class Recorder(ThreadedSink):
    """Writes every sample it is offered to one new MCAP file in `directory`; see `worker.Sink`.

    Args:
        directory: created if missing; problems with it show in `problem`, never as an exception.
        vehicle: name of the vehicle, part of the file name.
        session_id: names this run; its first eight characters are part of the file name.
        unix_offset_ns: added to the monotonic time of a sample gives its log time, Unix ns.
        capacity: samples that may wait for the disk (at 600 a second the default is half a minute).
        capacity_bytes: bytes of payload that may wait for the disk.
        chunk_bytes: size of a chunk before compression; bounds the time of the slice that closes it.
        flush_s: a chunk is closed and written after this time at the latest, s.
        min_free_bytes: the log is closed, marked as ended early, when the disk has less room than this.
        foxglove: also write what viewers draw (`foxglove_view.SHOWN`).
    """

    def __init__(
        self,
        directory: Path,
        *,
        vehicle: str,
        session_id: str,
        unix_offset_ns: int,
        capacity: int = 20_000,
        capacity_bytes: int = 32 << 20,
        chunk_bytes: int = 64 << 10,
        flush_s: float = 0.5,
        min_free_bytes: int = 100 << 20,
        foxglove: bool = True,
        open_file: Callable[[Path], LogFile] = DiskFile,
        free_bytes: Callable[[Path], int] = lambda directory: shutil.disk_usage(directory).free,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        wait: Callable[[float], object] | None = None,
    ) -> None:
        super().__init__(
            "recorder", capacity=capacity, capacity_bytes=capacity_bytes, clock_ns=clock_ns, wait=wait
        )
        self._directory = directory
        self._path = directory / log_name(vehicle, session_id, clock_ns() + unix_offset_ns)
        self._metadata = {
            "session_id": session_id,
            "schema_version": str(SCHEMA_VERSION),
            "vehicle": vehicle,
            "unix_offset_ns": str(unix_offset_ns),
        }
        self._unix_offset_ns = unix_offset_ns
        self._chunk_bytes = chunk_bytes
        self._flush_ns = int(flush_s * 1e9)
        self._min_free_bytes = min_free_bytes
        self._open_file = open_file
        self._free_bytes = free_bytes
        self._view = View(unix_offset_ns) if foxglove else None
        # Of the worker's thread only. `_writer` is None before the log is opened and after it has ended.
        self._opened = False
        self._file: LogFile | None = None
        self._writer: McapWriter | None = None
        self._outbox = Outbox()
        self._channels: dict[str, int] = {}
        self._sequence = 0
        self._readable = False  # schemas and channels are in the file
        self._unwritten = 0  # samples that are in the writer, not yet in the file
        self._good_bytes = 0  # the file is whole up to here
        self._flushed_ns = 0
        self._space_checked_ns = 0

    @property
    def path(self) -> Path:
        """The log file; it exists once the recorder's thread has opened it."""
        return self._path

    def _ready(self) -> bool:
        if not self._opened:
            self._opened = True
            self._open()
        return True

    def _open(self) -> None:
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
            short = self._short_of_space()
            if short:
                self._stop_for_space(short)
                return
            self._file = self._open_file(self._path)
        except OSError as error:
            self._trouble = (
                f"no log is written: cannot create {self._path}: {error.strerror or error}; "
                "make the directory writable for this user or configure another one"
            )
            return
        writer = Writer(self._outbox, chunk_size=self._chunk_bytes, compression=CompressionType.ZSTD)
        writer.start(profile="", library=f"guidance schema {SCHEMA_VERSION}")
        writer.add_metadata(METADATA_NAME, self._metadata)
        self._channels = register_channels(writer, foxglove=self._view is not None)
        self._writer = writer
        self._space_checked_ns = self._clock_ns()

    def _take(self, lost: int, sample: Sample) -> None:
        if self._writer is None:
            self._discarded += 1
            return
        if lost:
            self._mark_lost(sample.t_ns, lost)
        self._unwritten += 1
        self._add(sample)
        if self._view is not None:
            for derived in self._view.of(sample):
                self._add(derived)

    def _mark_lost(self, t_ns: int, count: int) -> None:
        self._add(Sample(_LOST_TOPIC, t_ns, msgspec.json.encode(Lost(t_ns=t_ns, count=count))))

    def _add(self, sample: Sample) -> None:
        if self._writer is None:
            self._give_up_pending()
            return
        channel = self._channels.get(sample.topic)
        if channel is None:  # no record of ours, but recorded all the same
            channel = self._writer.register_channel(f"/{sample.topic}", "json", 0)
            self._channels[sample.topic] = channel
        self._sequence += 1
        time_ns = max(0, sample.t_ns + self._unix_offset_ns)
        # The sequence is the place in the file: readers that sort by time can restore the order.
        self._writer.add_message(channel, time_ns, sample.payload, time_ns, self._sequence & 0xFFFFFFFF)
        if not self._readable:
            self._readable = True
            self._writer.flush()  # the chunk with schemas and channels: without it nothing can be read
        if not self._outbox.empty():
            self._write_out()

    def _turn(self) -> None:
        if self._writer is None:
            return
        now_ns = self._clock_ns()
        if self._unwritten and now_ns - self._flushed_ns >= self._flush_ns:
            self._writer.flush()
            self._write_out()
        if now_ns - self._space_checked_ns >= _CHECK_SPACE_NS:
            self._space_checked_ns = now_ns
            self._check_space()

    def _check_space(self) -> None:
        """End the log while there is still room for its end."""
        try:
            short = self._short_of_space()
        except OSError as error:  # the directory was removed or the disk was taken out
            self._give_up(f"{error.strerror or error}")
            return
        if short:
            self._stop_for_space(short)
            self._end(short)

    def _write_out(self) -> None:
        """Hand the closed chunks to the operating system; ends the log if it refuses them."""
        if self._file is None:
            return
        data = self._outbox.take()
        try:
            _write_all(self._file, data)
        except OSError as error:
            self._give_up(f"{error.strerror or error}")
            return
        self._good_bytes += len(data)
        self._unwritten = 0
        self._flushed_ns = self._clock_ns()

    def _give_up(self, why: str) -> None:
        self._trouble = (
            f"the log {self._path.name} ends early: {why}; "
            f"free space on {self._directory} or replace the disk, then restart the service"
        )
        self._writer = None
        self._give_up_pending()
        if self._file is not None:
            # Half a chunk is of no use to a reader. A disk that fails here has said enough already.
            with suppress(OSError):
                self._file.truncate(self._good_bytes)
            with suppress(OSError):
                self._file.close()
            self._file = None

    def _give_up_pending(self) -> None:
        self._discarded += self._unwritten
        self._unwritten = 0

    def _short_of_space(self) -> str:
        """What is wrong with the free space, empty if nothing is; raises OSError if the disk cannot tell."""
        free = self._free_bytes(self._directory)
        if free >= self._min_free_bytes:
            return ""
        return f"{free >> 20} MiB free on {self._directory}, {self._min_free_bytes >> 20} MiB must stay free"

    def _stop_for_space(self, short: str) -> None:
        self._trouble = f"no log is written any more: {short}; delete old logs, then restart the service"

    def _finish(self) -> bool:
        if self._writer is None:
            return False
        lost = self._queue.lost_at_end()
        if lost:
            self._mark_lost(self._clock_ns(), lost)
        return self._end()

    def _end(self, ended_early: str = "") -> bool:
        """Close the log in good order: last chunk, the word how it ended, summary, footer."""
        if self._writer is None:
            return False
        self._writer.flush()
        self._writer.add_metadata(END_NAME, {ENDED_EARLY: ended_early})
        self._writer.finish()
        self._writer = None
        self._write_out()
        if self._file is None:
            return False
        try:
            self._file.sync()
            self._file.close()
        except OSError as error:
            self._give_up(f"{error.strerror or error}")
            return False
        self._file = None
        return True

    def _describe_stall(self, seconds: float) -> str:
        return (
            f"the disk of {self._directory} has not answered for {seconds:.0f} s; {self.dropped} records lost"
        )


def _write_all(file: LogFile, data: bytes) -> None:
    rest = memoryview(data)
    while rest:
        # Unbuffered files may write less than they were given, last of all on a disk that is filling up.
        written = file.write(bytes(rest) if len(rest) < len(data) else data)
        if not written:
            raise OSError(errno.EIO, "the disk takes no more bytes")
        rest = rest[written:]
