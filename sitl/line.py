"""What connects the built-in vehicle: UDP, a TCP server, or a serial port made of a pseudo-terminal."""

from __future__ import annotations

import asyncio
import os
import time
import tty
from collections.abc import Hashable, Sequence
from contextlib import suppress
from typing import Any, Final, cast

from sitl.truth import TruthWriter, truth_line
from sitl.vehicle import Vehicle

Address = tuple[str, int]

#: What a client has not taken: beyond this it gets nothing more until it has.
MAX_BACKLOG: Final = 4096
#: How soon a port that nobody had open is looked at again.
LOOK_S: Final = 0.05


class Driver:
    """Hands bytes and deadlines to the vehicle, and what it says to the link."""

    def __init__(self, vehicle: Vehicle, writer: TruthWriter | None, truth_period_s: float) -> None:
        self._vehicle = vehicle
        self._writer = writer
        self._truth_period_ns = round(truth_period_s * 1e9)
        self._truth_ns = 0
        self._closed = False
        self._timer: asyncio.TimerHandle | None = None

    def start(self) -> None:
        """The link is open: start living."""
        self._loop = asyncio.get_running_loop()
        self._truth_ns = time.monotonic_ns()
        self._live()

    def hear(self, data: bytes, peer: Hashable) -> None:
        """Bytes act at the instant at which they were read."""
        now_ns = time.monotonic_ns()
        self._tell_truth(now_ns)
        self._vehicle.receive(data, now_ns, peer)
        self._live()

    def close(self) -> None:
        """Stop the timer."""
        self._closed = True
        if self._timer is not None:
            self._timer.cancel()

    def _live(self) -> None:
        now_ns = time.monotonic_ns()
        vehicle = self._vehicle
        self._tell_truth(now_ns)
        self._send(vehicle.advance(now_ns))
        deadline_ns = vehicle.deadline()
        if self._writer is not None:
            deadline_ns = min(deadline_ns, self._truth_ns)
        if self._timer is not None:
            self._timer.cancel()
        if not self._closed:
            delay_s = max(0.0, (deadline_ns - time.monotonic_ns()) * 1e-9)
            self._timer = self._loop.call_later(delay_s, self._live)

    def _tell_truth(self, now_ns: int) -> None:
        """Truth at its own exact instants: live up to each, then look."""
        if self._writer is None:
            return
        while self._truth_ns <= now_ns:
            self._send(self._vehicle.advance(self._truth_ns))
            self._writer.write(truth_line(self._vehicle.truth(self._truth_ns)))
            self._truth_ns += self._truth_period_ns
        self._writer.flush()

    def _send(self, datagrams: list[bytes]) -> None:
        raise NotImplementedError


class UdpDriver(Driver, asyncio.DatagramProtocol):
    """Over one socket, to every address of `to`, or, without any, to whoever wrote last."""

    def __init__(self, to: Sequence[Address], *arguments: Any) -> None:
        super().__init__(*arguments)
        self._targets = tuple(to)
        self._answer_last = not to
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The socket is open."""
        self._transport = cast(asyncio.DatagramTransport, transport)
        self.start()

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        """Hear it, and remember who said it."""
        if self._answer_last:
            self._targets = ((addr[0], addr[1]),)
        self.hear(data, addr)

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there yet: a vehicle keeps sending."""

    def close(self) -> None:
        """Close the socket."""
        super().close()
        if self._transport is not None:
            self._transport.close()

    def _send(self, datagrams: list[bytes]) -> None:
        if self._transport is None or self._closed:
            return
        for datagram in datagrams:
            for target in self._targets:
                self._transport.sendto(datagram, target)


class TcpDriver(Driver):
    """Tells everybody who is connected, and hears all of them."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.clients: set[asyncio.Transport] = set()

    def _send(self, datagrams: list[bytes]) -> None:
        for client in self.clients:
            if client.get_write_buffer_size() <= MAX_BACKLOG:
                client.write(b"".join(datagrams))


class Client(asyncio.Protocol):
    """One connection to a `TcpDriver`."""

    def __init__(self, driver: TcpDriver) -> None:
        self._driver = driver

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Somebody wants to hear the vehicle."""
        self._transport = cast(asyncio.Transport, transport)
        self._driver.clients.add(self._transport)

    def connection_lost(self, exc: Exception | None) -> None:
        """No more."""
        self._driver.clients.discard(self._transport)

    def data_received(self, data: bytes) -> None:
        """Bytes act at the instant at which they were read."""
        self._driver.hear(data, id(self))


class PtyDriver(Driver):
    """A pseudo-terminal, whose other end has the name `path` and can be opened like a serial port.

    It is a symbolic link, put there at the start and taken away at the end.

    Raises:
        OSError: there is something else of that name.
    """

    def __init__(self, path: str, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._path = path
        self._open = False  # whether somebody has the other end open
        self._master, slave = os.openpty()
        tty.setraw(slave)
        name = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self._master, False)
        if os.path.islink(path):  # of a vehicle that was killed
            os.unlink(path)
        os.symlink(name, path)

    def start(self) -> None:
        """Live, and look who is there."""
        super().start()
        self._look()

    def close(self) -> None:
        """Take the port away."""
        super().close()
        self._loop.remove_reader(self._master)
        os.close(self._master)
        with suppress(OSError):
            os.unlink(self._path)

    def _look(self) -> None:
        """Read what there is; while nobody has the other end open, reading fails and nothing is sent."""
        if self._closed:
            return
        try:
            data = os.read(self._master, 65536)
        except BlockingIOError:
            data = b""
        except OSError:
            self._open = False
            self._loop.remove_reader(self._master)
            self._loop.call_later(LOOK_S, self._look)
            return
        if not self._open:
            self._open = True
            self._loop.add_reader(self._master, self._look)
        if data:
            self.hear(data, 0)

    def _send(self, datagrams: list[bytes]) -> None:
        if self._open:
            with suppress(OSError):  # full, or nobody is there any more: lost
                for datagram in datagrams:
                    os.write(self._master, datagram)
