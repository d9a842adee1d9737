"""The flight log: MCAP files with one channel of JSON per topic.

Written so that a kill costs at most `flush_s` of flight, and power loss the same and what the disk takes to
hold it: small chunks, each handed to the operating system whole and put on the disk at once, the first one
(which carries schemas and channels) before all others. Written so that a log never lies: samples appear in
the order in which they were offered, and where some had to be dropped a `lost` record says how many. Written
so that viewers can draw it: after a record follows what Foxglove knows it by. A disk that is nearly full or
fails ends the log, says so, and costs nothing but the log; a reader finds that out too: only a log that holds
the whole run ends with the word that it does. A long run goes on in further files, each of which opens alone;
so does one whose disk takes a log again, with a `lost` record for what is missing in between.
"""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from guidance.records import SCHEMA_VERSION, TOPICS, Lost, Session
from guidance.telemetry.disk_file import DiskFile, LogFile, sync_directory
from guidance.telemetry.foxglove_view import View
from guidance.telemetry.log import CONTINUED_IN, ENDED_EARLY, PART
from guidance.telemetry.log_keeper import Keeper, log_name, next_number
from guidance.telemetry.mcap_writer import LogWriter
from guidance.telemetry.queue import Sample
from guidance.telemetry.worker import ThreadedSink

_LOST_TOPIC: Final = TOPICS[Lost]
_SESSION_TOPIC: Final = TOPICS[Session]
_CHECK_SPACE_NS: Final = 1_000_000_000
#: Power loss costs what a disk takes to hold the newest samples; one that takes longer is told.
_SLOW_NS: Final = 500_000_000
#: A log that ended is begun anew so much later at the earliest; after each failure to write, twice as much.
_AGAIN_NS: Final = 10_000_000_000
_AGAIN_AT_MOST_NS: Final = 32 * _AGAIN_NS
#: And with so much more room than must stay free: no chain of files of a second each.
_AGAIN_BYTES: Final = 64 << 20


class Rotation(NamedTuple):
    """When the log goes on in another file: at a size in bytes or an age in ns; none if infinite."""

    size_bytes: float = math.inf
    age_ns: float = math.inf


NEVER: Final = Rotation()


class Recorder(ThreadedSink):
    """Writes every sample it is offered to new MCAP files in `directory`; see `worker.Sink`.

    Args:
        directory: created if missing; problems with it show in `problem`, never as an exception.
        vehicle: name of the vehicle, part of the file name.
        session_id: names this run; its first eight characters are part of the file name.
        unix_offset_ns: added to the monotonic time of a sample gives its log time, Unix ns.
        capacity: samples that may wait for the disk (at 600 a second the default is half a minute).
        capacity_bytes: bytes of payload that may wait for the disk.
        chunk_bytes: size of a chunk before compression; bounds the time of the slice that closes it.
        flush_s: the disk is told to hold all samples after this time at the latest, s.
        min_free_bytes: the log is closed, marked as ended early, when the disk has less room than this.
        foxglove: also write what viewers draw (`foxglove_view.SHOWN`).
        rotation: when the log goes on in another file; never unless given.
        keeper: looks after the other logs of the directory, at the start and after each rotation.
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
        rotation: Rotation = NEVER,
        keeper: Keeper | None = None,
        open_file: Callable[[Path], LogFile] = DiskFile,
        free_bytes: Callable[[Path], int] = lambda directory: shutil.disk_usage(directory).free,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        wait: Callable[[float], object] | None = None,
    ) -> None:
        super().__init__(
            "recorder", capacity=capacity, capacity_bytes=capacity_bytes, clock_ns=clock_ns, wait=wait
        )
        self._directory = directory
        self._vehicle = vehicle
        self._session_id = session_id
        self._unix_offset_ns = unix_offset_ns
        self._started_unix_ns = clock_ns() + unix_offset_ns
        self._chunk_bytes = chunk_bytes
        self._flush_ns = int(flush_s * 1e9)
        self._min_free_bytes = min_free_bytes
        self._rotation = rotation
        self._keeper = keeper
        self._open_file = open_file
        self._free_bytes = free_bytes
        self._view = View(unix_offset_ns) if foxglove else None
        self._number = 0  # of the run, known when the directory is
        self._part = 1
        self._path = self._path_of(1)
        self._slow = ""
        # Of the worker's thread only. `_log` is None before the log is opened and after it has ended.
        # `_begun`: the file at `_path` was; `_missed`: so many samples have come to no log since.
        self._opened = self._begun = False
        self._missed = 0
        self._again_ns = 0
        self._pause_ns = _AGAIN_NS
        self._log: LogWriter | None = None
        self._session: Sample | None = None
        self._flushed_ns = 0
        self._space_checked_ns = 0
        self._begun_bytes = 0
        self._rotate_bytes = self._rotate_ns = math.inf

    @property
    def path(self) -> Path:
        """The newest file of the log; the first one exists once the recorder's thread has opened it."""
        return self._path

    @property
    def problem(self) -> str:
        """What is wrong and what to do about it, for an operator; empty if nothing is."""
        return super().problem or self._slow or ("" if self._keeper is None else self._keeper.problem)

    def _path_of(self, part: int) -> Path:
        number = self._number or 1
        name = log_name(number, self._vehicle, self._session_id, self._started_unix_ns, part)
        return self._directory / name

    def _ready(self) -> bool:
        if not self._opened:
            self._opened = True
            self._open()
        return True

    def _open(self) -> None:
        """Begin a file; what is in the way is told, and tried again later."""
        now_ns = self._clock_ns()
        self._again_ns = now_ns + self._pause_ns
        part = self._part + self._begun
        path = self._path_of(part)
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
            sync_directory(self._directory.parent)
            self._number = self._number or next_number(self._directory)
            path = self._path_of(part)
            if self._keeper is not None:
                self._keeper.look()
            short = self._short_of_space(_AGAIN_BYTES if self._trouble else 0)
            if short:
                self._trouble = self._trouble or _full(short)
                return
            file = self._open_file(path)
        except OSError as error:
            self._trouble = self._trouble or (
                f"no log is written: cannot create {path}: {error.strerror or error}; "
                "make the directory writable for this user or configure another one"
            )
            return
        self._part, self._path, self._space_checked_ns = part, path, now_ns
        self._begin(file)

    def _begin(self, file: LogFile) -> None:
        """Go on in a new file, which opens alone."""
        metadata = {
            "session_id": self._session_id,
            "schema_version": str(SCHEMA_VERSION),
            "vehicle": self._vehicle,
            "unix_offset_ns": str(self._unix_offset_ns),
            PART: str(self._part),
        }
        self._log = LogWriter(
            file,
            metadata,
            unix_offset_ns=self._unix_offset_ns,
            chunk_bytes=self._chunk_bytes,
            foxglove=self._view is not None,
        )
        if self._view is not None:
            self._view.repeat_static()
        self._begun = True
        self._trouble = ""
        self._rotate_bytes = self._rotation.size_bytes
        self._rotate_ns = self._clock_ns() + self._rotation.age_ns
        try:
            if self._session is not None:
                self._log.add(self._session)
        except OSError as error:
            self._give_up(self._log, error)
            return
        self._begun_bytes = self._log.size

    def _take(self, lost: int, sample: Sample) -> None:
        log = self._log
        if sample.topic == _SESSION_TOPIC:
            self._session = sample
        if log is None:
            self._discarded += 1
            self._missed += lost + 1
            return
        lost, self._missed = lost + self._missed, 0
        log.unwritten += 1
        try:
            if lost:
                log.add(_lost(sample.t_ns, lost))
            log.add(sample)
            for derived in () if self._view is None else self._view.of(sample):
                log.add(derived)
        except OSError as error:
            self._give_up(log, error)

    def _turn(self) -> None:
        log, now_ns = self._log, self._clock_ns()
        if log is None:
            if now_ns >= self._again_ns and not self._stopping.is_set():
                self._open()
            return
        try:
            if now_ns - self._flushed_ns >= self._flush_ns and not log.safe:
                self._flush(log, now_ns)
            due = log.size >= self._rotate_bytes or now_ns >= self._rotate_ns
            if due and log.size > self._begun_bytes:
                self._rotate(log)
        except OSError as error:
            self._give_up(log, error)
        if now_ns - self._space_checked_ns >= _CHECK_SPACE_NS:
            self._space_checked_ns = now_ns
            self._check_space()

    def _flush(self, log: LogWriter, now_ns: int) -> None:
        self._flushed_ns = now_ns
        log.flush()
        took_ns = self._clock_ns() - now_ns
        self._slow = (
            f"the disk of {self._directory} takes {took_ns * 1e-9:.1f} s to hold what is written; "
            "a crash or power loss now costs as much of the log more"
            if took_ns > _SLOW_NS
            else ""
        )

    def _rotate(self, log: LogWriter) -> None:
        """Go on in the next file; raises OSError if this one cannot be ended."""
        following = self._path_of(self._part + 1)
        try:
            file = self._open_file(following)
        except OSError as error:
            self._trouble = (
                f"the log goes on in {self._path.name}: cannot create {following}: {error.strerror or error}"
            )
            self._rotate_bytes += self._rotation.size_bytes
            self._rotate_ns += self._rotation.age_ns
            return
        try:
            log.end({ENDED_EARLY: "", CONTINUED_IN: following.name})
        except OSError:
            with suppress(OSError):
                file.close()
                following.unlink()
            raise
        self._part, self._path = self._part + 1, following
        self._begin(file)
        if self._keeper is not None:
            self._keeper.look()

    def _check_space(self) -> None:
        """End the log while there is still room for its end."""
        log = self._log
        if log is None:
            return
        try:
            self._path.stat()  # a file that was removed takes on what nobody will ever read
            short = self._short_of_space()
            if short:
                self._trouble = _full(short)
                self._log = None
                log.end({ENDED_EARLY: short})
        except OSError as error:  # the directory was removed or the disk was taken out
            self._give_up(log, error)

    def _give_up(self, log: LogWriter, error: OSError) -> None:
        """Leave a file that takes no more as far as it is whole."""
        self._trouble = (
            f"the log {self._path.name} ends early: {error.strerror or error}; "
            f"free space on {self._directory} or replace the disk, and it goes on in another file"
        )
        self._log = None
        self._discarded += log.unwritten
        self._missed += log.unwritten
        self._again_ns = self._clock_ns() + self._pause_ns
        self._pause_ns = min(2 * self._pause_ns, _AGAIN_AT_MOST_NS)
        log.abandon()
        if not log.size:
            self._begun = False
            with suppress(OSError):
                self._path.unlink()

    def _short_of_space(self, more_bytes: int = 0) -> str:
        """What is wrong with the free space, empty if nothing is; raises OSError if the disk cannot tell."""
        free = self._free_bytes(self._directory)
        if free >= self._min_free_bytes + more_bytes:
            return ""
        return f"{free >> 20} MiB free on {self._directory}, {self._min_free_bytes >> 20} MiB must stay free"

    def _finish(self) -> bool:
        if self._keeper is not None:
            self._keeper.stop()
        log, self._log = self._log, None
        if log is None:
            return False
        lost = self._queue.lost_at_end() + self._missed
        try:
            if lost:
                log.add(_lost(self._clock_ns(), lost))
            log.end({ENDED_EARLY: ""})
        except OSError as error:
            self._give_up(log, error)
            return False
        return True

    def _describe_stall(self, seconds: float) -> str:
        return (
            f"the disk of {self._directory} has not answered for {seconds:.0f} s; {self.dropped} records lost"
        )


def _full(short: str) -> str:
    return f"no log is written any more: {short}; delete old logs, and it goes on in another file"


def _lost(t_ns: int, count: int) -> Sample:
    return Sample(_LOST_TOPIC, t_ns, msgspec.json.encode(Lost(t_ns=t_ns, count=count)))
