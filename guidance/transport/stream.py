"""A file descriptor that carries a stream of bytes: what a serial port and a TCP connection share."""

from __future__ import annotations

import fcntl
import os
import struct
import termios
from collections.abc import Callable
from typing import Final

from guidance.transport.base import Address, Lost
from guidance.transport.outgoing import Outgoing

_READ_BYTES: Final = 65536
_ZERO: Final = struct.pack("I", 0)


class ByteStream:
    """Non-blocking reads and writes; `lost` puts the end (None) or an error of the stream into words."""

    def __init__(
        self,
        descriptor: int,
        opened: str,
        *,
        close: Callable[[], None],
        lost: Callable[[OSError | None], str],
        waiting_max_bytes: float,
    ) -> None:
        self.opened = opened
        self.address: Address | None = None
        self._descriptor = descriptor
        self._close = close
        self._lost = lost
        self._outgoing = Outgoing(self._write, self._waiting, waiting_max_bytes)

    @property
    def dropped(self) -> int:
        """Packets that were not sent."""
        return self._outgoing.dropped

    def fileno(self) -> int:
        """The descriptor."""
        return self._descriptor

    def receive(self) -> tuple[bytes, Address] | None:
        """All that has come so far."""
        try:
            data = os.read(self._descriptor, _READ_BYTES)
        except BlockingIOError:
            return None
        except OSError as error:
            raise Lost(self._lost(error)) from None
        if not data:
            raise Lost(self._lost(None))
        return data, ()

    def heard(self, address: Address, now_ns: int) -> str:
        """There is only one at the other end."""
        return ""

    def perhaps(self, address: Address, now_ns: int) -> None:
        """There is only one at the other end."""

    def send(self, packet: bytes) -> None:
        """The whole packet, or nothing of it."""
        self._outgoing.send(packet)

    def close(self) -> None:
        """Give it back."""
        self._close()

    def _write(self, data: bytes) -> int:
        try:
            return os.write(self._descriptor, data)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise Lost(self._lost(error)) from None

    def _waiting(self) -> int:
        """Bytes that the system has taken and that are not sent (serial) or not acknowledged (TCP) yet."""
        try:
            (waiting,) = struct.unpack("I", fcntl.ioctl(self._descriptor, termios.TIOCOUTQ, _ZERO))
        except OSError:  # gone; the write will say so
            return 0
        return int(waiting)
