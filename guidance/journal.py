"""Lines for journald: where systemd reads stderr, each begins with syslog's priority, `<3>` for an error."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import Final, TextIO

from guidance.printable import printable
from guidance.records import Level

#: syslog's priorities, as journald reads them from the start of a line (sd-daemon of systemd).
PRIORITIES: Final = {
    Level.INFO: 6,
    Level.NOTICE: 5,
    Level.WARNING: 4,
    Level.ERROR: 3,
    Level.CRITICAL: 2,
}


def is_journal(stream: TextIO) -> bool:
    """Whether systemd connected this very stream to its journal; the variable is inherited by others too."""
    try:
        status = os.fstat(stream.fileno())
    except (OSError, ValueError):
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{status.st_dev}:{status.st_ino}"


def marked(level: Level, text: str) -> str:
    """The text with its priority before every line; nothing is journald's business elsewhere."""
    priority = f"<{PRIORITIES[level]}>"
    return "".join(priority + line for line in text.splitlines(keepends=True))


def say(level: Level, text: str) -> None:
    """Write to stderr, whole lines; raises OSError or ValueError if nobody listens."""
    sys.stderr.write(marked(level, text) if is_journal(sys.stderr) else text)
    sys.stderr.flush()


def tell(level: Level, program: str, text: object) -> None:
    """One line of a program's, fit for a terminal; it is no matter if nobody listens."""
    with suppress(OSError, ValueError):
        say(level, f"{program}: {printable(str(text))}\n")
