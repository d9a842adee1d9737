"""The built-in vehicle as a process: a link, asyncio and the monotonic clock around the sans-IO vehicle."""

from __future__ import annotations

import asyncio
import signal
import sys
import time
from dataclasses import dataclass

from sitl.line import Address, Client, Driver, PtyDriver, TcpDriver, UdpDriver
from sitl.truth import TruthWriter, truth_writer
from sitl.vehicle import Vehicle, VehicleOptions


@dataclass(frozen=True, kw_only=True)
class ShellOptions:
    """Where the process listens and sends, and what it tells besides MAVLink.

    Everything goes to every address of `to`; without one, to whoever wrote last. Instead of UDP, `pty` makes
    a serial port of that name, and `tcp` a TCP server. `truth` is a file name, or "-" for stdout.
    """

    host: str = "127.0.0.1"
    port: int = 14580
    to: tuple[Address, ...] = ()
    tcp: bool = False
    pty: str | None = None
    truth: str | None = None
    truth_period_s: float = 0.02
    exit_with_stdin: bool = False


async def run(options: ShellOptions, vehicle_options: VehicleOptions) -> None:
    """Fly until SIGTERM, SIGINT, or (if asked) the end of stdin.

    Raises:
        OSError: the port cannot be bound or made, or the truth file cannot be opened.
        ValueError: the vehicle's options name an unknown mode or parameter.
    """
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    vehicle = Vehicle(vehicle_options, time.monotonic_ns())
    with truth_writer(options.truth) as writer:
        driver, where = await _open(options, vehicle, writer)
        # The line that a parent process waits for.
        sys.stderr.write(f"sitl vehicle: {vehicle_options.firmware} on {where}\n")
        sys.stderr.flush()
        if options.exit_with_stdin:
            await _watch_stdin(loop, stop)
        try:
            await stop.wait()
        finally:
            driver.close()


async def _open(options: ShellOptions, vehicle: Vehicle, writer: TruthWriter | None) -> tuple[Driver, str]:
    """The link as it is wanted, and where it is in words."""
    loop = asyncio.get_running_loop()
    if options.pty is not None:
        pty = PtyDriver(options.pty, vehicle, writer, options.truth_period_s)
        pty.start()
        return pty, f"{options.pty}, a serial port"
    if options.tcp:
        tcp = TcpDriver(vehicle, writer, options.truth_period_s)
        server = await loop.create_server(lambda: Client(tcp), options.host, options.port)
        tcp.start()
        host, port = server.sockets[0].getsockname()[:2]
        return tcp, f"{host}:{port} (TCP), serves whoever connects"
    udp = UdpDriver(options.to, vehicle, writer, options.truth_period_s)
    transport, _ = await loop.create_datagram_endpoint(lambda: udp, local_addr=(options.host, options.port))
    host, port = transport.get_extra_info("sockname")[:2]
    names = [f"{name}:{number}" for name, number in options.to]
    target = f"sends to {' and '.join(names)}" if names else "answers whoever writes"
    return udp, f"{host}:{port}, {target}"


async def _watch_stdin(loop: asyncio.AbstractEventLoop, stop: asyncio.Event) -> None:
    """Set `stop` when stdin ends: a parent that dies leaves no orphan."""

    class Watcher(asyncio.Protocol):
        def eof_received(self) -> bool:
            stop.set()
            return False

        def connection_lost(self, exc: Exception | None) -> None:
            stop.set()

    await loop.connect_read_pipe(Watcher, sys.stdin)
