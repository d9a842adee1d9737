"""The built-in vehicle as a process: UDP, asyncio and the monotonic clock around the sans-IO vehicle."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Final, cast

from sitl.vehicle import Truth, Vehicle, VehicleOptions

#: Truth that the reader has not taken: beyond this the newest lines are dropped, the vehicle never waits.
MAX_TRUTH_BACKLOG: Final = 1 << 20
Address = tuple[str, int]


@dataclass(frozen=True, kw_only=True)
class ShellOptions:
    """Where the process listens and sends, and what it tells besides MAVLink.

    Without `to`, the vehicle answers whoever wrote last. `truth` is a file name, or "-" for stdout.
    """

    host: str = "127.0.0.1"
    port: int = 14580
    to: Address | None = None
    truth: str | None = None
    truth_period_s: float = 0.02
    exit_with_stdin: bool = False


def truth_line(truth: Truth) -> bytes:
    """One line of JSON: the keys are the fields of `Truth`."""
    return json.dumps(truth._asdict(), separators=(",", ":")).encode() + b"\n"


async def run(options: ShellOptions, vehicle_options: VehicleOptions) -> None:
    """Fly until SIGTERM, SIGINT, or (if asked) the end of stdin.

    Raises:
        OSError: the port cannot be bound, or the truth file cannot be opened.
        ValueError: the vehicle's options name an unknown mode or parameter.
    """
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    vehicle = Vehicle(vehicle_options, time.monotonic_ns())
    with _truth_writer(options.truth) as writer:
        transport, driver = await loop.create_datagram_endpoint(
            lambda: Driver(vehicle, options, writer), local_addr=(options.host, options.port)
        )
        host, port = transport.get_extra_info("sockname")[:2]
        target = f"sends to {options.to[0]}:{options.to[1]}" if options.to else "answers whoever writes"
        # The line that a parent process waits for.
        sys.stderr.write(f"sitl vehicle: {vehicle_options.firmware} on {host}:{port}, {target}\n")
        sys.stderr.flush()
        if options.exit_with_stdin:
            await _watch_stdin(loop, stop)
        try:
            await stop.wait()
        finally:
            driver.close()
            transport.close()


class Driver(asyncio.DatagramProtocol):
    """Hands datagrams and deadlines to the vehicle, and its datagrams to the socket."""

    def __init__(self, vehicle: Vehicle, options: ShellOptions, writer: TruthWriter | None) -> None:
        self._vehicle = vehicle
        self._target = options.to
        self._answer_last = options.to is None
        self._writer = writer
        self._truth_period_ns = round(options.truth_period_s * 1e9)
        self._truth_ns = 0
        self._transport: asyncio.DatagramTransport | None = None
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The socket is open: start living."""
        self._transport = cast(asyncio.DatagramTransport, transport)
        self._loop = asyncio.get_running_loop()
        self._truth_ns = time.monotonic_ns()
        self._live()

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        """A datagram acts at the instant at which it was read."""
        if self._answer_last:
            self._target = (addr[0], addr[1])
        now_ns = time.monotonic_ns()
        self._tell_truth(now_ns)
        self._vehicle.receive(data, now_ns, addr)
        self._live()

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there yet: a vehicle keeps sending."""

    def close(self) -> None:
        """Stop the timer."""
        if self._timer is not None:
            self._timer.cancel()

    def _live(self) -> None:
        now_ns = time.monotonic_ns()
        vehicle, transport = self._vehicle, self._transport
        self._tell_truth(now_ns)
        self._send(vehicle.advance(now_ns))
        deadline_ns = vehicle.deadline()
        if self._writer is not None:
            deadline_ns = min(deadline_ns, self._truth_ns)
        if self._timer is not None:
            self._timer.cancel()
        if transport is not None and not transport.is_closing():
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
        if self._transport is None or self._target is None:
            return
        for datagram in datagrams:
            self._transport.sendto(datagram, self._target)


class TruthWriter:
    """Lines to a file descriptor that never block: what the reader does not take in time is dropped."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._buffer = bytearray()
        self._broken = False
        self.dropped = 0

    def write(self, line: bytes) -> None:
        """Queue one whole line, or drop it."""
        if self._broken or len(self._buffer) + len(line) > MAX_TRUTH_BACKLOG:
            self.dropped += 1
        else:
            self._buffer += line

    def flush(self) -> None:
        """Give the system what it takes now."""
        if not self._buffer or self._broken:
            return
        try:
            written = os.write(self._descriptor, self._buffer)
        except BlockingIOError:
            return
        except OSError:
            # The reader has gone or the disk is full; the vehicle flies on without a chronicler.
            self._broken = True
            self._buffer.clear()
            return
        del self._buffer[:written]


@contextmanager
def _truth_writer(name: str | None) -> Iterator[TruthWriter | None]:
    if name is None:
        yield None
        return
    if name == "-":
        descriptor = os.dup(sys.stdout.fileno())
    else:
        descriptor = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NONBLOCK, 0o644)
    was_blocking = os.get_blocking(descriptor)
    os.set_blocking(descriptor, False)
    writer = TruthWriter(descriptor)
    try:
        yield writer
    finally:
        writer.flush()
        with suppress(OSError):
            # stdout may be shared with the parent: leave it as it was found.
            os.set_blocking(descriptor, was_blocking)
        os.close(descriptor)


async def _watch_stdin(loop: asyncio.AbstractEventLoop, stop: asyncio.Event) -> None:
    """Set `stop` when stdin ends: a parent that dies leaves no orphan."""

    class Watcher(asyncio.Protocol):
        def eof_received(self) -> bool:
            stop.set()
            return False

        def connection_lost(self, exc: Exception | None) -> None:
            stop.set()

    await loop.connect_read_pipe(Watcher, sys.stdin)
