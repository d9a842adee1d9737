"""A run whose log went on in further files, put together again by session and part number."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

from guidance.telemetry.log import PART, LogDamaged, NotALog, Passed, read_metadata, read_part

#: No run has more digits of parts.
_DIGITS_MOST: Final = 9


class PartMissing(Exception):  # noqa: N818
    """The log begins in the middle of its run, and the part before it is not in its directory."""


def read_run(path: Path, passed: Passed | None = None) -> Iterator[tuple[str, bytes]]:
    """Every message of the run that the log at `path` is a part of, from the first part on; see `read_log`.

    `passed` is told after each chunk how far which part was read.

    Raises:
        NotALog: as `read_log`.
        PartMissing: at once, when the first part is not in the directory of `path`.
        LogDamaged: as `read_log`; also in place of a later part that is not there.
    """
    metadata = read_metadata(path)
    session_id, number = metadata.get("session_id", ""), _number(metadata)
    first = path if number == 1 else _part(path.parent, session_id, 1)
    if first is None:
        raise PartMissing(
            f"{path}: part {number} of its run, which begins in the middle of the flight; "
            f"the parts before it are not in {path.parent.absolute()}"
        )
    return _messages(first, session_id, passed)


def _messages(path: Path, session_id: str, passed: Passed | None) -> Iterator[tuple[str, bytes]]:
    number, current = 1, path
    while following := (yield from read_part(current, passed)):
        number += 1
        found = _part(path.parent, session_id, number)
        if found is None:
            why = f"the run goes on in {following}, which is not there or cannot be read"
            raise LogDamaged(current, current.stat().st_size, why)
        current = found


def _part(directory: Path, session_id: str, number: int) -> Path | None:
    for path in sorted(directory.glob("*.mcap")):
        with suppress(NotALog, LogDamaged):
            metadata = read_metadata(path)
            if metadata.get("session_id") == session_id and _number(metadata) == number:
                return path
    return None


def _number(metadata: dict[str, str]) -> int:
    text = metadata.get(PART, "1")  # logs were of one part before there were several
    return int(text) if text.isdecimal() and len(text) <= _DIGITS_MOST else 1
