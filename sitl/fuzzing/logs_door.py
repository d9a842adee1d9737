"""The log's door: files that were cut and flipped, and whole ones that hold what no service has written.

Files are made with the service's own writer and read by all that reads logs: replay, records, metadata, and
the repair of what a crash left. Only the errors that these state may come out.
"""

from __future__ import annotations

import hashlib
import tempfile
import weakref
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any, Final

import msgspec

from guidance.records import SCHEMA_VERSION, TOPICS, Input
from guidance.replay import ReplayError, replay
from guidance.telemetry.disk_file import DiskFile
from guidance.telemetry.log import (
    ENDED_EARLY,
    PART,
    LogDamaged,
    NotALog,
    read_log,
    read_metadata,
    read_records,
)
from guidance.telemetry.log_repair import NotOurs, close_log, is_closed
from guidance.telemetry.mcap_writer import LogWriter
from guidance.telemetry.queue import Sample
from sitl.fuzzing.corpus import SESSION_ID, flight_records
from sitl.fuzzing.dice import Dice
from sitl.fuzzing.oracle import Broken

_VEHICLE: Final = "demo"
_CHUNK_BYTES: Final = 8 << 10
_REFUSALS: Final = (NotALog, LogDamaged, ReplayError, NotOurs)
#: So much of a flight is enough for every record there is; the replay of more takes its time.
_TRACKING_S: Final = 0.1


@cache
def samples(signed: bool) -> tuple[Sample, ...]:
    """A short flight as the recorder is offered it."""
    encode = msgspec.json.Encoder().encode
    records = flight_records(_TRACKING_S, signed=signed)
    return tuple(Sample(TOPICS[type(record)], record.t_ns, encode(record)) for record in records)


def written(path: Path, content: Iterable[Sample], metadata: dict[str, str] | None = None) -> bytes:
    """A log of these, closed in good order, as bytes; it is not left behind."""
    told = {"session_id": SESSION_ID, "vehicle": _VEHICLE, "schema_version": str(SCHEMA_VERSION), PART: "1"}
    told |= {"unix_offset_ns": "0"} | (metadata or {})
    log = LogWriter(DiskFile(path), told, unix_offset_ns=0, chunk_bytes=_CHUNK_BYTES, foxglove=False)
    for sample in content:
        log.add(sample)
        log.unwritten += 1
    log.end({ENDED_EARLY: ""})
    data = path.read_bytes()
    path.unlink()
    return data


@cache
def whole_log() -> bytes:
    """The log of `samples`."""
    with tempfile.TemporaryDirectory() as directory:
        return written(Path(directory, "whole.mcap"), samples(signed=False))


class LogsDoor:
    """One file after the other; `newest` says how it was made."""

    inputs = 60
    scene = "log files"

    def __init__(self, dice: Dice) -> None:
        self.newest = ""
        self._dice = dice
        self._digest = hashlib.sha256()
        self._files = 0
        directory = tempfile.TemporaryDirectory(prefix="sitl-fuzz-")
        self._directory = Path(directory.name)
        self._clean = weakref.finalize(self, directory.cleanup)

    def feed(self) -> None:
        """One file, read in one way."""
        dice = self._dice
        self._files += 1
        path = self._directory / "fuzzed.mcap"
        data = self._damaged() if dice.chance(0.6) else self._impossible(path)
        path.write_bytes(data)
        reader = dice.choice((self._replay, self._records, self._close))
        self.newest = f"{self.newest}, read by {reader.__name__.strip('_')}: {len(data)} bytes, SHA-256 " + (
            hashlib.sha256(data).hexdigest()
        )
        try:
            outcome = reader(path)
        except _REFUSALS as error:
            outcome = str(error)
            if not outcome:
                raise Broken(f"{type(error).__name__} without a word") from None
        outcome = outcome.replace(str(self._directory), "")  # another one in each run
        self._digest.update(outcome.encode("utf-8", "backslashreplace"))

    def finish(self) -> bytes:
        """What came of the files."""
        left = sorted(path.name for path in self._directory.iterdir() if path.name != "fuzzed.mcap")
        self._clean()
        if left:
            raise Broken(f"files were left behind: {left}")
        return self._digest.digest()

    def _damaged(self) -> bytes:
        dice, data = self._dice, whole_log()
        kind = dice.randrange(4)
        if kind == 0:
            cut = dice.randrange(len(data))
            self.newest = f"cut at byte {cut}"
            return data[:cut]
        if kind == 1:
            cut = dice.randrange(len(data))
            zeros = dice.choice((1, 100, 5000))
            self.newest = f"cut at byte {cut}, then {zeros} zeros"
            return data[:cut] + bytes(zeros)
        if kind == 2:
            self.newest = "noise"
            return data[: dice.choice((0, 8))] + dice.randbytes(dice.choice((0, 9, 4000)))
        self.newest = "bytes changed"
        return dice.mutated(data, dice.choice((1, 2, 8)))

    def _impossible(self, path: Path) -> bytes:
        """A log without a fault, but for what is in it."""
        dice = self._dice
        whole = samples(dice.chance(0.3))
        content = list(whole)
        made = []
        for _ in range(dice.choice((1, 1, 2, 5))):
            if len(content) < 2:
                break
            # Early ones often: a replay stops at the first difference.
            at = dice.choice((0, 1, min(dice.randrange(30), len(content) - 1), dice.randrange(len(content))))
            kind = dice.randrange(6)
            if kind == 0:
                del content[at]
            elif kind == 1:
                other = dice.randrange(len(content))
                content[at], content[other] = content[other], content[at]
            elif kind == 2:
                content[at] = content[at]._replace(payload=dice.mutated(content[at].payload))
            elif kind == 3:
                content[at] = content[at]._replace(topic=dice.choice([*TOPICS.values(), dice.text()]))
            else:
                original = whole[at]
                foreign = original.topic == TOPICS[Input] and dice.chance(0.3)
                payload = self._input(original.payload) if foreign else self._changed(original.payload)
                content[at] = original._replace(payload=payload)
            made.append(f"{at} ({kind})")
        metadata = {dice.choice((PART, "schema_version", "session_id", "vehicle")): dice.text()}
        self.newest = f"a log with messages {', '.join(made)} changed"
        return written(path.with_name("made.mcap"), content, metadata if dice.chance(0.1) else None)

    def _changed(self, payload: bytes) -> bytes:
        made: bytes = msgspec.json.encode(self._dice.changed(msgspec.json.decode(payload)))
        return made

    def _input(self, payload: bytes) -> bytes:
        """An input of another kind, with a text for it or none."""
        dice = self._dice
        value: dict[str, Any] = msgspec.json.decode(payload)
        value["kind"] = dice.choice(("command", "signing_clock", "tick", "note", "link_up", "datagram"))
        value["text"] = dice.choice(("engage", '{"timestamp":5}', "", '{"timestamp":-1}', dice.text()))
        made: bytes = msgspec.json.encode(value)
        return made

    def _replay(self, path: Path) -> str:
        found = replay(path)
        return repr(found)

    def _records(self, path: Path) -> str:
        count = 0
        for _ in read_records(path):
            count += 1
        return f"{count} {read_metadata(path)}"

    def _close(self, path: Path) -> str:
        closed = close_log(path, _VEHICLE)
        if closed and not is_closed(path):
            raise Broken("a log was closed and is open")
        if close_log(path, _VEHICLE):
            raise Broken("a closed log was closed again")
        count, told = 0, ""
        try:
            for _ in read_log(path):
                count += 1
        except LogDamaged as error:  # it says so, having been interrupted
            told = str(error)
        return f"{closed} {count} {told}"
