"""What the tests of the service share: something to wait on, a shell whose records are kept, a vehicle."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from typing import Any, Final

import msgspec
from pymavlink.dialects.v20 import all as mavlink

from guidance.commands import Shutdown
from guidance.config import Config
from guidance.records import TOPICS, Event, Record, Setpoint
from guidance.service import new_session
from guidance.shell import Shell
from guidance.signing_files import open_signing
from guidance.telemetry import Sample, Sink
from guidance.telemetry.sinks import Sinks
from sitl.vehicle import Vehicle, VehicleOptions
from tests.helpers import make_config

PATIENCE_S: Final = 20.0
_RECORDS: Final = {topic: record for record, topic in TOPICS.items()}


class Bell:
    """Rung whenever something happened; whoever waits looks again."""

    def __init__(self) -> None:
        self._event = asyncio.Event()

    def ring(self) -> None:
        self._event.set()

    async def until(self, holds: Callable[[], object], what: str) -> None:
        """Return as soon as `holds()`; AssertionError naming `what` if it does not in time."""
        end = time.monotonic() + PATIENCE_S
        while not holds():
            self._event.clear()
            try:
                await asyncio.wait_for(self._event.wait(), end - time.monotonic())
            except TimeoutError:
                raise AssertionError(f"waited in vain for: {what}") from None


class Memory:
    """A sink that keeps everything."""

    def __init__(self, ring: Callable[[], None]) -> None:
        self.records: list[Record] = []
        self.dropped = 0
        self.problem = ""
        self._ring = ring

    def offer(self, sample: Sample) -> None:
        self.records.append(msgspec.json.decode(sample.payload, type=_RECORDS[sample.topic]))
        self._ring()

    def start(self) -> None:
        raise NotImplementedError

    def close(self, timeout_s: float) -> bool:
        raise NotImplementedError

    def events(self, code: str) -> list[str]:
        return [r.text for r in self.records if isinstance(r, Event) and r.code == code]

    def setpoints(self) -> list[Setpoint]:
        return [r for r in self.records if isinstance(r, Setpoint)]


class VehicleEnd(asyncio.DatagramProtocol):
    """The built-in vehicle on a socket of the test's own loop; `deaf_to` drops what it must not hear."""

    def __init__(self, to: tuple[str, int] | None, ring: Callable[[], None], **options: Any) -> None:
        self.heard: list[Any] = []
        self.heard_ns: list[int] = []
        self.sent: list[Any] = []
        self.deaf_to: Callable[[Any], bool] = lambda message: False
        self._to = to
        self._ring = ring
        self.vehicle = Vehicle(VehicleOptions(**options), time.monotonic_ns())
        self._in, self._out = mavlink.MAVLink(None), mavlink.MAVLink(None)
        self._timer: asyncio.TimerHandle | None = None

    async def open(self, port: int = 0, sock: socket.socket | None = None) -> None:
        self._loop = asyncio.get_running_loop()
        local = None if sock else ("127.0.0.1", port)
        self._transport, _ = await self._loop.create_datagram_endpoint(
            lambda: self, local_addr=local, sock=sock
        )
        self.live()

    def close(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._transport.close()

    def live(self) -> None:
        """Send all that the vehicle has to say until now."""
        for datagram in self.vehicle.advance(time.monotonic_ns()):
            if self._to is not None:
                self.sent += self._out.parse_buffer(datagram) or []
                self.say(datagram, self._to)
        if self._timer is not None:
            self._timer.cancel()
        delay_s = (self.vehicle.deadline() - time.monotonic_ns()) * 1e-9
        self._timer = self._loop.call_later(max(delay_s, 0.0), self.live)

    def say(self, datagram: bytes, to: tuple[str, int]) -> None:
        self._transport.sendto(datagram, to)

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        self._to = self._to or (addr[0], addr[1])
        now_ns = time.monotonic_ns()
        for message in self._in.parse_buffer(data) or []:
            self.heard.append(message)
            self.heard_ns.append(now_ns)
            if not self.deaf_to(message):
                self.vehicle.receive(message.get_msgbuf(), now_ns, addr)
        self._ring()
        self.live()

    def count(self, name: str) -> int:
        return sum(message.get_type() == name for message in self.heard)


class Rig:
    """A shell on a free port, and the records that it publishes; `others` are sinks beside the memory."""

    def __init__(self, config: Config, others: Mapping[str, Sink] | None = None) -> None:
        self.bell = Bell()
        self.memory = Memory(self.bell.ring)
        sinks = Sinks({"memory": self.memory, **(others or {})})
        self.keeper = open_signing(config)
        self.shell = Shell(config, sinks, new_session(config), keeper=self.keeper)
        self.run = asyncio.get_running_loop().create_task(self.shell.run())
        self.run.add_done_callback(lambda _: self.bell.ring())

    async def address(self) -> tuple[str, int]:
        await self.bell.until(lambda: self.memory.events("link_up"), "an open socket")
        assert self.shell.address is not None
        host, port = self.shell.address[:2]
        return host, port


@asynccontextmanager
async def running(*overrides: str, others: Mapping[str, Sink] | None = None) -> AsyncIterator[Rig]:
    """The service until the end of the block; whatever a bug of it raised is raised here."""
    listen = 'link.connection="udpin://127.0.0.1:0"'
    rig = Rig(make_config(listen, *overrides), others)
    try:
        yield rig
    finally:
        rig.shell.command(Shutdown())
        await asyncio.wait_for(rig.run, PATIENCE_S)
        if rig.keeper is not None:
            rig.keeper.close(PATIENCE_S)


@asynccontextmanager
async def vehicle_for(rig: Rig, **options: Any) -> AsyncIterator[VehicleEnd]:
    vehicle = VehicleEnd(await rig.address(), rig.bell.ring, **options)
    await vehicle.open()
    try:
        yield vehicle
    finally:
        vehicle.close()


def a_socket(port: int = 0) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", port))
    sock.setblocking(False)
    return sock


def received(sock: socket.socket) -> list[bytes]:
    """All that waits in a socket."""
    got = []
    while True:
        try:
            got.append(sock.recv(2048))
        except BlockingIOError:
            return got
