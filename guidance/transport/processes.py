"""The other programs of this machine, as far as this user may see them (Linux: /proc)."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from pathlib import Path
from typing import NamedTuple


class Process(NamedTuple):
    """A running program: the kernel's short name for it, and how it was started."""

    name: str
    pid: int
    command: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.name} (pid {self.pid})"


class Processes:
    """Every process but our own; `root` is where the machine's /proc is found."""

    def __init__(self, root: Path = Path("/")) -> None:
        self._proc = root / "proc"

    def holding(self, device: str) -> list[Process]:
        """Those that have `device` open, which must be a path without symbolic links."""
        return self._holding({device})

    def on_udp_port(self, port: int) -> list[Process]:
        """Those that have a UDP port."""
        sockets = set()
        for table in ("udp", "udp6"):
            try:
                rows = (self._proc / "net" / table).read_text(encoding="ascii").splitlines()[1:]
            except OSError:  # not Linux
                continue
            fields = [row.split() for row in rows]
            sockets |= {f"socket:[{f[9]}]" for f in fields if int(f[1].rpartition(":")[2], 16) == port}
        return self._holding(sockets)

    def named(self, name: str) -> list[Process]:
        """Those of that name; the kernel keeps its first 15 characters."""
        return self._all(lambda folder: _text(folder / "comm").strip() == name[:15])

    def _holding(self, targets: Collection[str]) -> list[Process]:
        def holds(folder: Path) -> bool:
            numbers = _listed(folder / "fd")
            return any(_target(folder / "fd" / number) in targets for number in numbers)

        return self._all(holds)

    def _all(self, wanted: Callable[[Path], bool]) -> list[Process]:
        found = []
        for number in _listed(self._proc):
            folder = self._proc / number
            if number.isdigit() and int(number) != os.getpid() and wanted(folder):
                name = _text(folder / "comm").strip()
                if name:  # else it has just ended
                    found.append(Process(name, int(number), tuple(_text(folder / "cmdline").split("\0"))))
        return found


def _listed(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:  # another user's, or gone
        return []


def _target(link: Path) -> str:
    try:
        return os.readlink(link)
    except OSError:
        return ""


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
