"""The directory of the logs: what crashed runs left open is closed, and the oldest logs make room.

A thread of its own, for a log of hours takes seconds to close; it works in slices as short as the sinks'. It
touches only what this vehicle's recorder wrote, by name and by content, and nothing that a service has open
(a lock on the file says so).
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from guidance.telemetry.disk_file import FoundFile
from guidance.telemetry.log import LogDamaged, NotALog, read_metadata
from guidance.telemetry.log_repair import NotOurs, close_log, is_closed
from guidance.telemetry.worker import PAUSE_S

#: A notice stands so long that whoever looks once a second has seen it.
NOTICE_NS: Final = 3_000_000_000


_NUMBERED: Final = re.compile(r"(\d{5,})_\d{8}T\d{6}Z_.*\.mcap")


def log_name(number: int, vehicle: str, session_id: str, unix_ns: int, part: int = 1) -> str:
    """File name of a log: sorts by the run's number and part; odd characters become underscores.

    The date is what the clock said, which on a companion without a battery goes back.
    """
    when = datetime.fromtimestamp(unix_ns // 1_000_000_000, UTC).strftime("%Y%m%dT%H%M%SZ")
    suffix = "" if part == 1 else f"_{part:03d}"
    return f"{number:05d}_{when}_{_safe(vehicle)}_{_safe(session_id[:8])}{suffix}.mcap"


def next_number(directory: Path) -> int:
    """Of a run that begins now: behind all whose logs are in `directory`, of whatever vehicle."""
    names = (_NUMBERED.fullmatch(path.name) for path in directory.iterdir())
    return 1 + max((int(name[1]) for name in names if name is not None), default=0)


def _safe(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9.-]", "_", text)


class Keeper:
    """Keeps `directory` in order for one run of one vehicle, in a thread that `look` starts.

    Args:
        directory: of the logs; need not exist.
        vehicle: whose logs these are.
        session_id: of this run, whose parts are the last to be removed.
        keep_files: at most so many logs of this vehicle are kept, those that are open included.
        keep_bytes: and at most so many bytes.
        wait: pauses the thread for so many seconds; a parameter for tests, as is the clock.
    """

    def __init__(
        self,
        directory: Path,
        *,
        vehicle: str,
        session_id: str,
        keep_files: int,
        keep_bytes: int,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        wait: Callable[[float], object] = time.sleep,
    ) -> None:
        self._directory = directory
        self._vehicle = vehicle
        self._session_id = session_id
        self._keep_files = keep_files
        self._keep_bytes = keep_bytes
        self._clock_ns = clock_ns
        self._wait = wait
        self._name = re.compile(
            rf"(?:(?P<number>\d{{5,}})_)?\d{{8}}T\d{{6}}Z_{re.escape(_safe(vehicle))}"
            r"_(?P<session>[0-9a-f]{8})(?:_\d{3,})?\.mcap"
        )
        self._asked = threading.Event()
        self._stopping = False
        self._thread: threading.Thread | None = None
        self._trouble = ""
        self._notice = ""
        self._notice_ns = 0

    def look(self) -> None:
        """Have the directory looked through; returns at once."""
        self._asked.set()
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="log-keeper", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Have the thread end within a slice; what it leaves undone is done at the next start."""
        self._stopping = True
        self._asked.set()

    @property
    def problem(self) -> str:
        """What is wrong or was put right a moment ago, for an operator; empty if nothing is."""
        if self._trouble or not self._notice or self._clock_ns() - self._notice_ns > NOTICE_NS:
            return self._trouble
        return self._notice

    def _run(self) -> None:
        with suppress(_Stopped):
            while True:
                self._asked.wait()
                self._asked.clear()
                self.tidy()

    def tidy(self) -> None:
        """Look through the directory once: close logs, then remove the oldest."""
        troubles: list[str] = []
        try:
            logs = self._logs()
            self._close_all(logs, troubles)
            self._make_room(logs, troubles)
        except OSError as error:  # the directory went away
            troubles.append(f"{self._directory}: {error.strerror or error}")
        self._trouble = "; ".join(troubles)

    def _logs(self) -> list[Path]:
        """This vehicle's logs, oldest first, whatever the clock was: by run, this one's own last.

        Those without a number were written before there were any.
        """
        found = [
            (name["session"] == self._session_id[:8], int(name["number"] or 0), path.name, path)
            for path in self._directory.iterdir()
            if (name := self._name.fullmatch(path.name)) and path.is_file() and not path.is_symlink()
        ]
        return [path for *_, path in sorted(found)]

    def _pause(self) -> None:
        if self._stopping:
            raise _Stopped
        self._wait(PAUSE_S)

    def _close_all(self, logs: list[Path], troubles: list[str]) -> None:
        closed: list[str] = []
        for path in logs:
            self._pause()
            try:
                if close_log(path, self._vehicle, self._pause):
                    closed.append(path.name)
                    self._tell(closed)
            except (NotOurs, BlockingIOError, FileNotFoundError):
                continue
            except LogDamaged as error:
                troubles.append(f"{path.name} is damaged and was left as it is: {error.why}")
            except OSError as error:
                troubles.append(f"{path.name} is left open and cannot be closed: {error.strerror or error}")

    def _tell(self, closed: list[str]) -> None:
        self._notice = (
            "closed what an interrupted run left open (a crash, a kill, power loss or a full disk), "
            f"up to the last whole record: {', '.join(closed)}"
        )
        self._notice_ns = self._clock_ns()

    def _make_room(self, logs: list[Path], troubles: list[str]) -> None:
        sizes: dict[Path, int] = {}
        for path in logs:
            with suppress(FileNotFoundError):
                sizes[path] = path.lstat().st_size
        files, total = len(sizes), sum(sizes.values())
        for path, size in sizes.items():
            if files <= self._keep_files and total <= self._keep_bytes:
                return
            self._pause()
            try:
                if not self._may_go(path):
                    continue
                path.unlink()
            except OSError as error:
                troubles.append(f"{path.name} cannot be removed to make room: {error.strerror or error}")
                continue
            files, total = files - 1, total - size

    def _may_go(self, path: Path) -> bool:
        """Whether a log is ours, finished, and open nowhere; raises OSError if the disk cannot tell."""
        try:
            FoundFile(path).close()
            return is_closed(path) and read_metadata(path).get("vehicle") == self._vehicle
        except (BlockingIOError, NotALog, LogDamaged):
            return False


class _Stopped(Exception):  # noqa: N818
    """The run ends; not an error."""
