"""A log that its run left open (crash, kill, power loss, full disk) is closed after its last whole record.

In place, as a copy of a long log may not fit the disk: what can be read is never touched, the rest is cut
off, and what a closed log ends with is written behind. The footer comes last and only once the disk holds all
before it; so a file that has one is whole, and a repair that is interrupted itself leaves another unfinished
log, to be repaired the same way. A file is walked record by record, in bounded memory, with a pause after
each chunk.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, Final

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, Header, Metadata
from mcap.stream_reader import CRCValidationError
from zstandard import ZstdError

from guidance.records import SCHEMA_VERSION
from guidance.telemetry.disk_file import FoundFile, LogFile, write_all
from guidance.telemetry.log import (
    CONTINUED_IN,
    END_NAME,
    ENDED_EARLY,
    MAGIC,
    METADATA_NAME,
    PREFIX,
    LogDamaged,
    unpack_chunk,
)
from guidance.telemetry.mcap_summary import FOOTER_BYTES, Summary, message_indexes, stream_of
from guidance.telemetry.mcap_writer import LIBRARY, empty_log

#: The end mark of a log that was closed later.
INTERRUPTED: Final = (
    "it was interrupted (a crash, a kill, power loss or a full disk) and the log closed at a later start"
)
#: No more than this is cut off: a second of log is far less. Damage before that is no end that a crash has
#: left, and the flight behind it may still be saved by hand.
CUT_AT_MOST_BYTES: Final = 8 << 20
#: No record of ours comes near this; a length beyond it is no length.
_RECORD_AT_MOST_BYTES: Final = 64 << 20
#: What the recorder writes before the end of the data.
_WRITTEN: Final = frozenset({Opcode.HEADER, Opcode.METADATA, Opcode.CHUNK, Opcode.MESSAGE_INDEX})
_MARK: Final = {ENDED_EARLY: INTERRUPTED}
#: What a record that is not what was written raises: the library's, each compression has its own.
_NOT_WHOLE: Final = (
    McapError,
    CRCValidationError,
    ZstdError,
    struct.error,
    UnicodeDecodeError,
    OverflowError,
    MemoryError,
)


class NotOurs(Exception):  # noqa: N818
    """The file was not written by the recorder of this vehicle."""


def is_closed(path: Path) -> bool:
    """Whether the log at `path` has its footer; raises OSError if it cannot be read."""
    with path.open("rb") as file:
        return _has_footer(file)


def close_log(
    path: Path,
    vehicle: str,
    pause: Callable[[], object] = lambda: None,
    open_file: Callable[[Path], LogFile] = FoundFile,
) -> bool:
    """Close the log at `path` if a run of `vehicle` left it open; whether that was so.

    Args:
        path: the log.
        vehicle: as the log's metadata has it.
        pause: called after each chunk; what it raises ends the work, with nothing changed.
        open_file: opens and locks; what a test replaces.

    Raises:
        NotOurs: another program or vehicle wrote it; untouched.
        BlockingIOError: a service writes it now; untouched.
        LogDamaged: too much would have to be cut off; untouched.
        OSError: the disk does not take the end (it is cut off again) or does not answer.
    """
    if is_closed(path):
        return False
    file = open_file(path)
    try:
        with path.open("rb") as reader:
            if _has_footer(reader):  # closed between the look and the lock
                return False
            cut, ending = _survey(path, reader, vehicle, pause)
        _write(file, cut, ending)
    finally:
        file.close()
    return True


def _has_footer(file: BinaryIO) -> bool:
    size = file.seek(0, 2)
    if size < len(MAGIC) + FOOTER_BYTES:
        return False
    file.seek(size - FOOTER_BYTES)
    footer = file.read(FOOTER_BYTES)
    return footer.endswith(MAGIC) and PREFIX.unpack_from(footer) == (
        Opcode.FOOTER,
        FOOTER_BYTES - PREFIX.size - len(MAGIC),
    )


def _write(file: LogFile, cut: int, ending: bytes) -> None:
    file.truncate(cut)
    file.seek(cut)
    try:
        write_all(file, ending[:-FOOTER_BYTES])
        file.sync()
        write_all(file, ending[-FOOTER_BYTES:])
        file.sync()
    except OSError:
        with suppress(OSError):
            file.truncate(cut)
        raise


def _survey(path: Path, file: BinaryIO, vehicle: str, pause: Callable[[], object]) -> tuple[int, bytes]:
    """Where the file is to be cut, and what is to be written there."""
    size = file.seek(0, 2)
    file.seek(0)
    start = file.read(len(MAGIC))
    if not MAGIC.startswith(start.rstrip(b"\0")):
        raise NotOurs(f"{path} does not begin as an MCAP file does")
    summary = Summary()
    ours = False
    for opcode, body in _records(file, size) if start == MAGIC else ():
        try:
            if not ours:
                ours = _is_ours(opcode, body, vehicle, path)
            elif opcode == Opcode.METADATA and not _is_end(body):
                break
            if opcode == Opcode.CHUNK:
                unpack_chunk(Chunk.read(stream_of(body)))
                pause()
            summary.take(opcode, body)
        except _NOT_WHOLE:
            break
        if summary.ended:
            break
    if not summary.ended and size - summary.end > CUT_AT_MOST_BYTES:
        raise LogDamaged(path, summary.end, f"{size - summary.end} bytes after that would have to be cut off")
    if not ours:
        return 0, empty_log({"schema_version": str(SCHEMA_VERSION), "vehicle": vehicle}, _MARK)
    indexes = b"" if summary.ended else message_indexes(summary.drop_indexes())
    cut = summary.end
    summary.take_all(indexes)
    return cut, indexes + summary.ending(_MARK)


def _records(file: BinaryIO, size: int) -> Iterator[tuple[int, bytes]]:
    """Opcode and body of each record of the data section that is in the file whole."""
    while len(head := file.read(PREFIX.size)) == PREFIX.size:
        opcode, length = PREFIX.unpack(head)
        if opcode not in _WRITTEN or length > min(size - file.tell(), _RECORD_AT_MOST_BYTES):
            return
        yield opcode, file.read(length)


def _is_end(body: bytes) -> bool:
    """Whether metadata is the end mark, as it was written: power loss may leave zeros in place of bytes."""
    metadata = Metadata.read(stream_of(body))
    fields = metadata.metadata
    known = ENDED_EARLY in fields and set(fields) <= {ENDED_EARLY, CONTINUED_IN}
    return metadata.name == END_NAME and known and not any("\0" in value for value in fields.values())


def _is_ours(opcode: int, body: bytes, vehicle: str, path: Path) -> bool:
    """Whether a record shows that the recorder of `vehicle` wrote the file; NotOurs if it shows another."""
    if opcode == Opcode.HEADER and Header.read(stream_of(body)).library.startswith(LIBRARY):
        return False  # a recorder, but of which vehicle?
    if opcode == Opcode.METADATA:
        metadata = Metadata.read(stream_of(body))
        if metadata.name == METADATA_NAME and metadata.metadata.get("vehicle") == vehicle:
            return True
    raise NotOurs(f"{path} is not of the recorder of {vehicle}")
