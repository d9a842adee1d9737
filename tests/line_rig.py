"""The built-in vehicle at the other end of a stream of bytes: a pseudo-terminal's, or a TCP connection's."""

from __future__ import annotations

import asyncio
import os
import socket
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from tests.service_rig import VehicleEnd


class LineEnd(VehicleEnd):
    """Speaks over whatever `speak_over` gives it, until that ends; the same vehicle may get another line."""

    def __init__(self, ring: Callable[[], None]) -> None:
        super().__init__(("", 0), ring)
        self._descriptor: int | None = None

    def speak_over(self, descriptor: int) -> None:
        self._loop = asyncio.get_running_loop()
        os.set_blocking(descriptor, False)
        self._descriptor = descriptor
        self._loop.add_reader(descriptor, self._read)
        self.live()

    def stop_reading(self) -> None:
        """Go on speaking; what comes waits in the receive buffer until `speak_over`."""
        assert self._descriptor is not None
        self._loop.remove_reader(self._descriptor)

    def hang_up(self) -> None:
        """Say no more; does not close the descriptor."""
        if self._descriptor is not None:
            self._loop.remove_reader(self._descriptor)
            self._descriptor = None

    def close(self) -> None:
        self.hang_up()
        if self._timer is not None:
            self._timer.cancel()

    def say(self, datagram: bytes, to: tuple[str, int]) -> None:
        if self._descriptor is not None:
            with suppress(OSError):
                os.write(self._descriptor, datagram)

    def _read(self) -> None:
        assert self._descriptor is not None
        try:
            data = os.read(self._descriptor, 65536)
        except OSError:
            data = b""
        if data:
            self.datagram_received(data, ("", 0))
        else:
            self.hang_up()


class PseudoPort:
    """A serial port that can be unplugged: a pseudo-terminal behind a lasting name.

    This process keeps it open as well, so that it does not hang up while the service is away.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.master = self.slave = -1
        self.plug()

    def plug(self) -> None:
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.path.symlink_to(os.ttyname(self.slave))

    def unplug(self) -> None:
        self.path.unlink()
        os.close(self.slave)
        os.close(self.master)

    def __enter__(self) -> PseudoPort:
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()


def a_server(receive_bytes: int | None = None) -> socket.socket:
    """Listens on a free port; those who connect may be kept to a small receive buffer."""
    server = socket.socket()
    if receive_bytes is not None:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
    server.bind(("127.0.0.1", 0))
    server.listen()
    server.setblocking(False)
    return server
