"""A process of the demo's: its lines read as they come, ended in order, and never left behind."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Final

_STOP_S: Final = 5.0


class Child:
    """A process of its own session: Ctrl-C reaches only the demo, which ends its children in order."""

    def __init__(self, command: Sequence[str], name: str, line: Callable[[str, str], None]) -> None:
        self.name = name
        self._last_line = "it said nothing"
        self._line = line
        self._threads: list[threading.Thread] = []
        self.process = subprocess.Popen(  # noqa: S603 - our own interpreter and modules
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=_end_with_parent(),
        )

    def __enter__(self) -> Child:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        for pipe in (self.process.stdin, self.process.stdout, self.process.stderr):
            if pipe is not None:
                pipe.close()

    def listen(self, take: Callable[[str], None] | None) -> None:
        """Read what it writes: stderr line by line for people, stdout for `take`."""
        works: list[Callable[[], None]] = [self._read]
        if take is not None:
            works.append(lambda: self._hand_over(take))
        for work in works:
            self._threads.append(threading.Thread(target=work, daemon=True))
            self._threads[-1].start()

    @property
    def ended(self) -> bool:
        """Whether the process is gone."""
        return self.process.poll() is not None

    def obituary(self) -> str:
        """Of what it died: the status and its last words."""
        self.stop()
        status = self.process.returncode
        how = f"was ended by {signal.Signals(-status).name}" if status < 0 else f"ended with status {status}"
        return f"the {self.name} {how}: {self._last_line}"

    def stop(self) -> None:
        """SIGTERM, and SIGKILL if that is not enough; all that it wrote is read."""
        if not self.ended:
            self.process.terminate()
            try:
                self.process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        for thread in self._threads:
            thread.join(1.0)

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self._last_line = line.rstrip()
            self._line(self.name, self._last_line)

    def _hand_over(self, take: Callable[[str], None]) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            take(line)


def _end_with_parent() -> Callable[[], None] | None:
    """Linux: a demo that is killed leaves no process behind (PR_SET_PDEATHSIG)."""
    if sys.platform != "linux":
        return None
    prctl, parent = ctypes.CDLL(None).prctl, os.getpid()

    def prepare() -> None:
        prctl(1, signal.SIGTERM)
        if os.getppid() != parent:  # it was killed before the call
            os._exit(1)

    return prepare
