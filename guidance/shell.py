"""The asyncio shell around the core: socket, timer, sinks, and the one clock that the core lives by.

Order matters in `_turn`: the socket is read to its end before a setpoint is computed from the newest state,
and what is to be sent is sent before records are encoded and offered to the sinks. The socket is the shell's
own: asyncio's transports keep what cannot be sent at once and send it later, and a late setpoint is a wrong
one.
"""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Callable
from typing import Any, Final

from guidance.config import Config, parse_connection
from guidance.core import Guide
from guidance.notify import Notifier
from guidance.records import Command, InputKind, Session
from guidance.telemetry.sinks import Sinks

BACK_OFF_S: Final = (0.5, 1.0, 2.0, 5.0, 10.0)
#: Reading stops for a turn of the rest, so that a flood of datagrams cannot hold up the setpoints.
READ_AT_MOST_NS: Final = 10_000_000
#: A problem of the network is told again when it has been away for so long.
FORGET_PROBLEM_NS: Final = 10_000_000_000
SINK_WATCH_S: Final = 1.0

_DATAGRAM_BYTES: Final = 65535

Address = tuple[Any, ...]


class Shell:
    """One guide on one event loop."""

    def __init__(
        self, config: Config, sinks: Sinks, session: Session, notifier: Notifier | None = None
    ) -> None:
        self._guide = Guide(config)
        self._connection = parse_connection(config.link.connection)
        self._listens = self._connection.scheme == "udpin"
        self._text = f"{self._connection.scheme}://{self._connection.host}:{self._connection.port}"
        self._sinks = sinks
        self._notifier = notifier or Notifier({}, 0)  # mute
        self._loop = asyncio.get_running_loop()
        self._socket: socket.socket | None = None
        self._peer: Address | None = None
        self._peer_ns = 0
        self._peer_silent_ns = round(config.link.heartbeat_timeout_s * 1e9)
        self._timer: asyncio.TimerHandle | None = None
        self._timer_ns = 0
        self._told_ns: dict[str, int] = {}
        self._notes: list[tuple[InputKind, str]] = []
        self._bug: BaseException | None = None
        self._closed = asyncio.Event()
        self._why_closed = ""
        self._stopped = asyncio.Event()
        self._sinks.publish([session])

    @property
    def finished(self) -> bool:
        """Whether a shutdown is complete: the vehicle is left, nothing more is sent."""
        return self._guide.finished

    @property
    def address(self) -> Address | None:
        """Where the socket is bound, None while it is not open."""
        return None if self._socket is None else self._socket.getsockname()

    async def run(self) -> None:
        """Until a shutdown is complete; raises what a bug of ours raised."""
        self._loop.set_exception_handler(self._unhandled)
        tasks = [self._loop.create_task(work) for work in (self._keep_open(), self._watch_sinks())]
        for task in tasks:
            task.add_done_callback(self._task_ended)
        try:
            await self._stopped.wait()
        finally:
            self._stopped.set()
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            if self._timer is not None:
                self._timer.cancel()
            self._close_socket()
        if self._bug is not None:
            raise self._bug

    def command(self, command: Command) -> None:
        """An operator's command, from a signal."""
        self._turn(lambda now_ns: self._guide.command(command, now_ns))

    # Bugs --------------------------------------------------------------------------------------------

    def _unhandled(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        self._fail(context.get("exception") or RuntimeError(context["message"]))

    def _task_ended(self, task: asyncio.Task[None]) -> None:
        if not task.cancelled() and (error := task.exception()) is not None:
            self._fail(error)

    def _fail(self, bug: BaseException) -> None:
        """A bug of ours: no setpoint may follow from what is left, so fall silent, be loud, and end."""
        if self._bug is None:
            self._bug = bug
            self._stopped.set()
            self._sinks.publish(self._guide.records())  # the input that did it is among them

    # One turn ----------------------------------------------------------------------------------------

    def _turn(self, enter: Callable[[int], None] | None = None) -> None:
        """What has come, then what is due, then the records of both; arranges for the next turn."""
        if self._stopped.is_set():
            return
        try:
            if enter is not None:
                enter(time.monotonic_ns())
            self._read()
            now_ns = time.monotonic_ns()
            if self._guide.deadline() <= now_ns:
                self._guide.tick(now_ns)
            self._send()
            while self._notes:
                self._guide.note(*self._notes.pop(0), time.monotonic_ns())
                self._send()
            records = self._guide.records()
            self._sinks.publish(records)
            self._notifier.turn(records, now_ns)
            if self._guide.finished:
                self._stopped.set()
            else:
                self._schedule()
        except Exception as bug:
            self._fail(bug)

    def _schedule(self) -> None:
        due_ns = self._guide.deadline()
        if self._timer is not None:
            if self._timer_ns <= due_ns:
                return  # it fires first and arranges the rest
            self._timer.cancel()
        self._timer_ns = due_ns
        self._timer = self._loop.call_later(max(due_ns - time.monotonic_ns(), 0) * 1e-9, self._timed)

    def _timed(self) -> None:
        self._timer = None
        if self._guide.deadline() <= time.monotonic_ns():
            self._turn()
        else:
            self._schedule()

    def _note(self, kind: InputKind, text: str) -> None:
        self._notes.append((kind, text))
        self._turn()

    # The socket --------------------------------------------------------------------------------------

    async def _keep_open(self) -> None:
        """Open the socket, and open it again with back-off whenever that or the socket fails."""
        failures = 0
        while True:
            self._closed.clear()
            try:
                self._socket = await self._open()
            except (OSError, UnicodeError) as error:  # UnicodeError: a host that cannot be a name
                what, why = "cannot be opened", getattr(error, "strerror", None) or str(error)
            else:
                verb = "listening on" if self._listens else "sending to"
                name = self._socket.getsockname() if self._listens else self._socket.getpeername()
                self._loop.add_reader(self._socket, self._turn)
                self._note(InputKind.LINK_UP, f"{verb} {_shown(name)} (UDP)")
                opened = self._loop.time()
                await self._closed.wait()
                what, why = "failed", self._why_closed
                if self._loop.time() - opened > BACK_OFF_S[-1]:
                    failures = 0
            delay_s = BACK_OFF_S[min(failures, len(BACK_OFF_S) - 1)]
            failures += 1
            self._note(InputKind.LINK_DOWN, f"{self._text} {what}: {why}; again in {delay_s:g} s")
            await asyncio.sleep(delay_s)

    async def _open(self) -> socket.socket:
        host, port = self._connection.host, self._connection.port
        found = await self._loop.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
        found.sort(key=lambda info: info[0] != socket.AF_INET)  # what autopilots speak
        problem: OSError | None = None
        for family, kind, protocol, _, address in found:
            opened = socket.socket(family, kind, protocol)
            try:
                opened.setblocking(False)
                (opened.bind if self._listens else opened.connect)(address)
            except OSError as error:
                opened.close()
                problem = problem or error
            else:
                return opened
        raise problem or OSError(f"{host} has no address")

    def _close_socket(self) -> None:
        opened, self._socket = self._socket, None
        if opened is not None:
            self._loop.remove_reader(opened)
            opened.close()

    def _read(self) -> None:
        """All datagrams that wait, in order. Whoever speaks as the configured autopilot gets the answers."""
        guide, end_ns = self._guide, time.monotonic_ns() + READ_AT_MOST_NS
        while self._socket is not None:
            try:
                data, address = self._socket.recvfrom(_DATAGRAM_BYTES)
            except (BlockingIOError, InterruptedError):
                return
            except ConnectionError as error:
                self._network(error)  # nobody listens at the other end yet
                continue
            except OSError as error:
                self._why_closed = error.strerror or str(error)
                self._close_socket()
                self._closed.set()
                return
            now_ns = time.monotonic_ns()
            before = guide.link.received
            guide.receive(data, now_ns)
            if guide.link.received != before:
                self._heard(address, now_ns)
            self._send()
            if now_ns >= end_ns:
                return

    def _heard(self, address: Address, now_ns: int) -> None:
        """The autopilot spoke from `address`; answers go there, unless they go to one that still speaks."""
        if address != self._peer:
            if self._peer is not None and now_ns - self._peer_ns <= self._peer_silent_ns:
                self._tell(
                    f"the autopilot's id is used from {_shown(address)} as well as from "
                    f"{_shown(self._peer)}, who gets the setpoints: are there two vehicles of one id?",
                )
                return
            self._peer = address
        self._peer_ns = now_ns

    def _send(self) -> None:
        packets = self._guide.packets()
        if self._socket is None:
            return
        for packet in packets:
            try:
                if not self._listens:
                    self._socket.send(packet)
                elif self._peer is not None:
                    self._socket.sendto(packet, self._peer)
            except OSError as error:  # lost, as on the way: what follows is newer
                self._network(error)

    def _network(self, error: OSError) -> None:
        self._tell(f"{self._text}: {error.strerror or error}")

    def _tell(self, problem: str) -> None:
        """Note a problem of the network once, not at 50 Hz."""
        now_ns = time.monotonic_ns()
        told_ns = self._told_ns.get(problem)
        if len(self._told_ns) < 100 or told_ns is not None:
            self._told_ns[problem] = now_ns
            if told_ns is None or now_ns - told_ns > FORGET_PROBLEM_NS:
                self._notes.append((InputKind.NOTE, problem))

    # The sinks ---------------------------------------------------------------------------------------

    async def _watch_sinks(self) -> None:
        """What is wrong with a sink is said once; nothing waits for it."""
        while True:
            await asyncio.sleep(SINK_WATCH_S)
            self.look_at_sinks()

    def look_at_sinks(self) -> None:
        """Note what has come to be wrong with a sink since the last look, and what is well again."""
        self._guide.dropped_records = self._sinks.dropped
        for news in self._sinks.news():
            self._note(InputKind.NOTE, news)


def _shown(address: Address) -> str:
    host, port = address[:2]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
