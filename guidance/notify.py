"""What the service manager is told: ready, alive, how it is, and that it ends (sd_notify of systemd).

All of it follows from the records of the control loop's turns, so that a loop that stalls falls silent. One
datagram at most leaves in a turn, nothing waits for it, and one that is not taken is sent again in a later
turn. Not under a service manager, nothing is done at all.

READY=1 is sent after the first try to open the link, whether it worked: the boot waits neither for a vehicle
nor for a port that is not plugged in yet. STATUS says which of these is missing.
"""

from __future__ import annotations

import socket
from collections.abc import Mapping, Sequence
from typing import Final

from guidance.printable import printable
from guidance.records import Answer, Event, InputKind, Record, Status
from guidance.supervisor import State

#: WATCHDOG=1 goes out so many times in WATCHDOG_USEC: one that is lost does not end a sound service.
WATCHDOG_PARTS: Final = 4
#: A datagram that was not taken is sent again after this time.
RETRY_NS: Final = 50_000_000
#: A datagram of systemd's holds 4096 bytes; a status that nobody can read on a line is of no use.
STATUS_CHARACTERS: Final = 300


class Notifier:
    """Speaks to the socket that `environment` names; mute if it names none. Never raises, never waits.

    Args:
        environment: NOTIFY_SOCKET (a path, or an abstract name after @), WATCHDOG_USEC and WATCHDOG_PID, as
            the service manager set them.
        pid: this process; the watchdog of another one is not ours to feed.
    """

    def __init__(self, environment: Mapping[str, str], pid: int) -> None:
        self._address = _address(environment.get("NOTIFY_SOCKET", ""))
        self._watchdog_ns = _watchdog_ns(environment, pid) // WATCHDOG_PARTS
        self._watchdog_due_ns = 0
        self._retry_ns = 0
        self._untold: dict[str, str] = {}
        self._tried = False
        self._closed_because = ""
        self._state = self._reason = ""
        self._status = ""

    def turn(self, records: Sequence[Record], now_ns: int) -> None:
        """The control loop came round and made these records."""
        if not self._address:
            return
        for record in records:
            self._look(record)
        if self._watchdog_ns and now_ns >= self._watchdog_due_ns:
            self._untold["WATCHDOG"] = "1"
        if self._untold and now_ns >= self._retry_ns:
            self._tell(now_ns)

    def failed(self, why: str) -> None:
        """The service ends by an error of its own."""
        if self._address:
            self._untold.update(STOPPING="1", STATUS=_line(why))
            self._tell(0)

    def _look(self, record: Record) -> None:
        if isinstance(record, Answer):
            if record.order == "shutdown":
                self._untold["STOPPING"] = "1"
            return
        if isinstance(record, Event) and record.code in (InputKind.LINK_UP, InputKind.LINK_DOWN):
            if not self._tried:
                self._untold["READY"] = "1"
            self._tried = True
            self._closed_because = record.text if record.code == InputKind.LINK_DOWN else ""
        elif isinstance(record, Status):
            self._state, self._reason = record.state, record.reason
        else:
            return
        # At the end the port is no matter any more.
        closed_because = "" if self._state == State.FINISHED else self._closed_because
        status = _line(": ".join(filter(None, (self._state, closed_because or self._reason))))
        if self._tried and status != self._status:
            self._status = self._untold["STATUS"] = status

    def _tell(self, now_ns: int) -> None:
        lines = "\n".join(f"{name}={value}" for name, value in self._untold.items())
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
                manager.setblocking(False)
                manager.sendto(lines.encode("utf-8", "replace"), self._address)
        except OSError:  # full, gone or forbidden: its own concern, not the flight's
            self._retry_ns = now_ns + RETRY_NS
            return
        if "WATCHDOG" in self._untold:
            self._watchdog_due_ns = now_ns + self._watchdog_ns
        self._untold.clear()


def _address(named: str) -> str:
    """As the kernel wants it; empty for none, and for what is no socket of this machine (vsock)."""
    if named.startswith("/"):
        return named
    return f"\0{named[1:]}" if named.startswith("@") else ""


def _watchdog_ns(environment: Mapping[str, str], pid: int) -> int:
    """How long the watchdog waits, 0 if there is none for this process."""
    if environment.get("WATCHDOG_PID", str(pid)) != str(pid):
        return 0
    try:
        return max(int(environment.get("WATCHDOG_USEC", "0")), 0) * 1000
    except ValueError:
        return 0


def _line(text: str) -> str:
    """Words of the autopilot are in it: a line of their own would be an order."""
    return printable(text)[:STATUS_CHARACTERS]
