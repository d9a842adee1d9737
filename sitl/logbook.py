"""A lockstep flight's records into a log, by the service's own recorder and in the service's own format."""

from __future__ import annotations

import uuid
from pathlib import Path
from types import TracebackType
from typing import Final

import msgspec

from guidance import __version__
from guidance.config import Config, to_json
from guidance.records import SCHEMA_VERSION, TOPICS, Record, Session
from guidance.telemetry import Sample
from guidance.telemetry.recorder import Recorder

#: Virtual time outruns every disk: all of a flight waits in memory, nothing is dropped.
_CAPACITY: Final = 10_000_000
_CAPACITY_BYTES: Final = 4 << 30
_CLOSE_S: Final = 600.0


class LogBook:
    """`with LogBook(config, directory) as book: Lockstep(..., on_record=book.add)`; `book.path` is the log.

    Raises:
        OSError: leaving the block, if the log could not be written.
    """

    def __init__(self, config: Config, directory: Path, *, start_ns: int = 0) -> None:
        session_id = uuid.uuid4().hex
        self._recorder = Recorder(
            directory,
            vehicle=config.vehicle.name,
            session_id=session_id,
            unix_offset_ns=0,
            capacity=_CAPACITY,
            capacity_bytes=_CAPACITY_BYTES,
            foxglove=config.log.foxglove,
        )
        self._encode = msgspec.json.Encoder().encode
        self.add(
            Session(
                t_ns=start_ns,
                schema_version=SCHEMA_VERSION,
                session_id=session_id,
                guidance_version=__version__,
                vehicle=config.vehicle.name,
                profile=config.vehicle.profile,
                unix_offset_ns=0,
                config_json=to_json(config),
            )
        )

    @property
    def path(self) -> Path:
        """The log's file."""
        return self._recorder.path

    def add(self, record: Record) -> None:
        """Log one record."""
        self._recorder.offer(Sample(TOPICS[type(record)], record.t_ns, self._encode(record)))

    def __enter__(self) -> LogBook:
        self._recorder.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._recorder.close(_CLOSE_S):
            raise OSError(f"the log could not be written: {self._recorder.problem}")
