"""The asyncio shell around the core: socket, timer, signals, sinks, and the one clock that the core lives by.

Order matters in `_after`: packets are sent first, records are encoded and offered to the sinks after.
"""

from __future__ import annotations

import asyncio
import gc
import signal
import socket
import sys
import time
import uuid
from pathlib import Path
from typing import Any, Final, cast

import msgspec

from guidance import __version__
from guidance.config import Config, parse_connection, to_json
from guidance.core import Guide
from guidance.records import SCHEMA_VERSION, TOPICS, Command, InputKind, Record, Session
from guidance.telemetry import Sample, Sink
from guidance.telemetry.console import Console
from guidance.telemetry.recorder import Recorder
from guidance.telemetry.zenoh_sink import ZenohSink

#: The sinks' threads give the interpreter back at least this often (default 5 ms).
SWITCH_INTERVAL_S: Final = 0.0005
BACK_OFF_S: Final = (0.5, 1.0, 2.0, 5.0, 10.0)
#: All sinks together have this long to write what waits when the service stops.
CLOSE_S: Final = 0.4
_SINK_WATCH_S: Final = 1.0

Address = tuple[Any, ...]


class Shell(asyncio.DatagramProtocol):
    """One guide on one event loop."""

    def __init__(self, config: Config, sinks: dict[str, Sink], session: Session) -> None:
        self._guide = Guide(config)
        self._connection = parse_connection(config.link.connection)
        self._sinks = sinks
        self._problems = dict.fromkeys(sinks, "")
        self._encode = msgspec.json.Encoder().encode
        self._loop = asyncio.get_running_loop()
        self._transport: asyncio.DatagramTransport | None = None
        self._peer: Address | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._timer_ns = 0
        self._soon = False
        self._failures = 0
        self._send_problem = ""
        self._bug: BaseException | None = None
        self._closed = asyncio.Event()
        self._stopped = asyncio.Event()
        self._publish([session])

    async def run(self) -> None:
        """Until a shutdown is complete."""
        self._loop.set_exception_handler(self._failed)
        opening = self._loop.create_task(self._keep_open())
        watching = self._loop.create_task(self._watch_sinks())
        self._schedule()
        try:
            await self._stopped.wait()
        finally:
            opening.cancel()
            watching.cancel()
            await asyncio.gather(opening, watching, return_exceptions=True)
            if self._timer is not None:
                self._timer.cancel()
            if self._transport is not None:
                self._transport.close()
        if self._bug is not None:
            raise self._bug

    def _failed(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """A bug of ours: no setpoint may follow from what is left, so fall silent, be loud, and end."""
        self._bug = context.get("exception") or RuntimeError(context["message"])
        self._stopped.set()

    def command(self, command: Command) -> None:
        """An operator's command, from a signal."""
        self._guide.command(command, time.monotonic_ns())
        self._after()

    # The socket --------------------------------------------------------------------------------------

    async def _keep_open(self) -> None:
        """Open the socket, and open it again with back-off whenever it fails."""
        while True:
            self._closed.clear()
            try:
                await self._open()
            except OSError as error:
                delay_s = BACK_OFF_S[min(self._failures, len(BACK_OFF_S) - 1)]
                self._failures += 1
                self._note(
                    InputKind.LINK_DOWN,
                    f"{self._text()} cannot be opened: {error.strerror or error}; again in {delay_s:g} s",
                )
                await asyncio.sleep(delay_s)
                continue
            self._failures = 0
            await self._closed.wait()

    async def _open(self) -> None:
        address = (self._connection.host, self._connection.port)
        family = socket.AF_UNSPEC
        if self._connection.scheme == "udpin":
            await self._loop.create_datagram_endpoint(lambda: self, local_addr=address, family=family)
        else:
            await self._loop.create_datagram_endpoint(lambda: self, remote_addr=address, family=family)

    def _text(self) -> str:
        return f"{self._connection.scheme}://{self._connection.host}:{self._connection.port}"

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The socket is open."""
        self._transport = cast(asyncio.DatagramTransport, transport)  # uvloop's is one only in behaviour
        verb = "listening on" if self._connection.scheme == "udpin" else "sending to"
        host, port = transport.get_extra_info("sockname" if verb == "listening on" else "peername")[:2]
        self._note(InputKind.LINK_UP, f"{verb} {host}:{port} (UDP)")

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """Bytes came. Whoever speaks as the configured autopilot is who gets the answers."""
        before = self._guide.link.received
        self._guide.receive(data, time.monotonic_ns())
        if self._guide.link.received != before:
            self._peer = addr
        self._after()

    def error_received(self, exc: Exception) -> None:
        """The network refused a datagram, as when nobody listens at the other end."""
        if str(exc) != self._send_problem:  # once, not at 50 Hz
            self._send_problem = str(exc)
            self._note(InputKind.NOTE, f"{self._text()}: {exc}")

    def connection_lost(self, exc: Exception | None) -> None:
        """The socket failed (or was closed by us)."""
        self._transport = None
        if not self._stopped.is_set():
            self._note(InputKind.LINK_DOWN, f"{self._text()} failed: {exc}")
        self._closed.set()

    # The timer ---------------------------------------------------------------------------------------

    def _schedule(self) -> None:
        """Arrange for a tick at the guide's deadline; after the socket has been read if that is now."""
        due_ns = self._guide.deadline()
        now_ns = time.monotonic_ns()
        if due_ns <= now_ns:
            if not self._soon:
                self._soon = True
                self._loop.call_soon(self._tick)
            return
        if self._timer is not None:
            if self._timer_ns <= due_ns:
                return  # it fires first and arranges the rest
            self._timer.cancel()
        self._timer_ns = due_ns
        self._timer = self._loop.call_later((due_ns - now_ns) * 1e-9, self._timed)

    def _timed(self) -> None:
        self._timer = None
        self._schedule()

    def _tick(self) -> None:
        self._soon = False
        self._guide.tick(time.monotonic_ns())
        self._after()

    def _note(self, kind: InputKind, text: str) -> None:
        self._guide.note(kind, text, time.monotonic_ns())
        self._after()

    def _after(self) -> None:
        for packet in self._guide.packets():
            self._send(packet)
        self._publish(self._guide.records())
        if self._guide.finished:
            self._stopped.set()
        elif not self._stopped.is_set():
            self._schedule()

    def _send(self, packet: bytes) -> None:
        if self._transport is None:
            return
        if self._connection.scheme == "udpout":
            self._transport.sendto(packet)
        elif self._peer is not None:
            self._transport.sendto(packet, self._peer)

    # The sinks ---------------------------------------------------------------------------------------

    def _publish(self, made: list[Any] | list[Record]) -> None:
        for record in made:
            sample = Sample(TOPICS[type(record)], record.t_ns, self._encode(record))
            for sink in self._sinks.values():
                sink.offer(sample)

    async def _watch_sinks(self) -> None:
        """What is wrong with a sink is said once; nothing waits for it."""
        while True:
            await asyncio.sleep(_SINK_WATCH_S)
            self._guide.dropped_records = sum(sink.dropped for sink in self._sinks.values())
            for name, sink in self._sinks.items():
                problem = sink.problem
                if problem != self._problems[name]:
                    self._problems[name] = problem
                    self._note(InputKind.NOTE, f"{name}: {problem or 'well again'}")


def _sinks(config: Config, session: Session) -> dict[str, Sink]:
    """Every sink that the configuration wants, and the console; raises ValueError for bad zenoh settings."""
    sinks: dict[str, Sink] = {"console": Console(session.unix_offset_ns)}
    if config.log.enabled:
        sinks["log"] = Recorder(
            Path(config.log.directory),
            vehicle=config.vehicle.name,
            session_id=session.session_id,
            unix_offset_ns=session.unix_offset_ns,
            min_free_bytes=round(config.log.min_free_mb * 1e6),
        )
    if config.zenoh.enabled:
        zenoh = config.zenoh
        sinks["zenoh"] = ZenohSink(
            config.vehicle.name,
            mode=zenoh.mode,
            connect=zenoh.connect,
            listen=zenoh.listen,
            multicast_scouting=zenoh.multicast_scouting,
            config_file=Path(zenoh.config_file) if zenoh.config_file else None,
        )
    return sinks


def _close(sinks: dict[str, Sink]) -> None:
    """Close all within `CLOSE_S`; the log first, it is what must not be lost."""
    end = time.monotonic() + CLOSE_S
    for name in sorted(sinks, key=lambda name: name != "log"):
        if not sinks[name].close(max(end - time.monotonic(), 0.05)) and name == "log":
            sys.stderr.write(f"log: not everything was written: {sinks[name].problem}\n")


async def _serve(config: Config) -> None:
    now_ns = time.monotonic_ns()
    session = Session(
        t_ns=now_ns,
        schema_version=SCHEMA_VERSION,
        session_id=uuid.uuid4().hex,
        guidance_version=__version__,
        vehicle=config.vehicle.name,
        profile=config.vehicle.profile,
        unix_offset_ns=time.time_ns() - now_ns,
        config_json=to_json(config),
    )
    sinks = _sinks(config, session)
    shell = Shell(config, sinks, session)
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, shell.command, Command.SHUTDOWN)
    loop.add_signal_handler(signal.SIGUSR1, shell.command, Command.ENGAGE)
    for sink in sinks.values():
        sink.start()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.collect()
    gc.freeze()  # what stands now stands for good: later collections need not walk it
    try:
        await shell.run()
    finally:
        await loop.run_in_executor(None, _close, sinks)


def serve(config: Config) -> None:
    """Run the service until SIGTERM or SIGINT; SIGUSR1 commands to engage.

    Raises:
        ConfigError: no profile fits the configuration.
        ValueError: zenoh does not take its settings.
    """
    try:
        import uvloop
    except ImportError:  # not published for this platform
        asyncio.run(_serve(config))
    else:
        uvloop.run(_serve(config))
