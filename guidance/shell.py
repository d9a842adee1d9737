"""The asyncio shell around the core: transport, timer, sinks, and the one clock that the core lives by.

Order matters in `_turn`: the transport is read to its end before a setpoint is computed from the newest
state, and what is to be sent is sent before records are encoded and offered to the sinks. The transports are
our own: asyncio's keep what cannot be sent at once and send it later, and a late setpoint is a wrong one.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

from guidance.commands import Order, verb_of
from guidance.config import Config, parse_connection
from guidance.core import Guide
from guidance.kept_file import LearnedFile
from guidance.mavlink.signing import Refusal
from guidance.notify import Notifier
from guidance.records import InputKind, Session
from guidance.signing_files import ClockKeeper
from guidance.telemetry.sinks import Sinks
from guidance.transport import Address, Lost, Transport, open_transport, said

BACK_OFF_S: Final = (0.5, 1.0, 2.0, 5.0, 10.0)
#: Reading stops for a turn of the rest, so that a flood of bytes cannot hold up the setpoints.
READ_AT_MOST_NS: Final = 10_000_000
#: A problem of the network is told again when it has been away for so long.
FORGET_PROBLEM_NS: Final = 10_000_000_000
WATCH_S: Final = 1.0


class Shell:
    """One guide on one event loop."""

    def __init__(
        self,
        config: Config,
        sinks: Sinks,
        session: Session,
        notifier: Notifier | None = None,
        keeper: ClockKeeper | None = None,
        learned: LearnedFile | None = None,
    ) -> None:
        self._guide = Guide(config, None if keeper is None else keeper.signing)
        self._keeper = keeper
        self._learned = learned
        self._connection = parse_connection(config.link.connection)
        self._peer_silent_s = config.link.heartbeat_timeout_s
        self._sinks = sinks
        self._notifier = notifier or Notifier({}, 0)  # mute
        self._loop = asyncio.get_running_loop()
        self._transport: Transport | None = None
        self._dropped = 0
        self._timer: asyncio.TimerHandle | None = None
        self._timer_ns = 0
        self._told_ns: dict[str, int] = {}
        self._notes: list[tuple[InputKind, str]] = []
        self._bug: BaseException | None = None
        self._closed = asyncio.Event()
        self._why_closed = ""
        self._stopped = asyncio.Event()
        self._sinks.publish([session])
        if keeper is not None:
            self._guide.signing_clock(keeper.begin(time.time_ns()), time.monotonic_ns())
        if learned is not None:
            if (before := learned.begin()) is not None:
                self._guide.recall(before, time.monotonic_ns())
            learned.began(self._guide.learned or "")

    @property
    def finished(self) -> bool:
        """Whether a shutdown is complete: the vehicle is left, nothing more is sent."""
        return self._guide.finished

    @property
    def learned(self) -> str:
        """What flights have taught of the vehicle, for the next process."""
        return self._guide.tracker.handler.learned

    @property
    def address(self) -> Address | None:
        """Where the socket is bound, None while it is not open."""
        return None if self._transport is None else self._transport.address

    async def run(self) -> None:
        """Until a shutdown is complete; raises what a bug of ours raised."""
        self._loop.set_exception_handler(self._unhandled)
        tasks = [self._loop.create_task(work) for work in (self._keep_open(), self._watch())]
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
            self._close_transport()
        if self._bug is not None:
            raise self._bug

    def command(self, order: Order) -> None:
        """An operator's order, on the loop's own thread."""
        self._turn(lambda now_ns: self._guide.command(order, now_ns))

    def hand_over(self, order: Order, until_ns: int) -> None:
        """An operator's order, from any thread: obeyed at once, or never if it is later than `until_ns`."""
        with suppress(RuntimeError):  # the loop has ended: nobody answers
            self._loop.call_soon_threadsafe(self._handed_over, order, until_ns)

    def _handed_over(self, order: Order, until_ns: int) -> None:
        if time.monotonic_ns() <= until_ns:
            self.command(order)
        else:
            self._note(InputKind.NOTE, f"{verb_of(order)} of {order.source} came too late and is not obeyed")

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
            due_ns = self._guide.deadline()
            if due_ns <= now_ns:
                self._guide.tick(now_ns)
                due_ns = self._guide.deadline()
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
                self._schedule(due_ns)
        except Exception as bug:
            self._fail(bug)

    def _schedule(self, due_ns: int) -> None:
        if self._timer is not None:
            if self._timer_ns <= due_ns:
                return  # it fires first and arranges the rest
            self._timer.cancel()
        self._timer_ns = due_ns
        self._timer = self._loop.call_later(max(due_ns - time.monotonic_ns(), 0) * 1e-9, self._timed)

    def _timed(self) -> None:
        self._timer = None
        due_ns = self._guide.deadline()
        if due_ns <= time.monotonic_ns():
            self._turn()
        else:
            self._schedule(due_ns)

    def _note(self, kind: InputKind, text: str) -> None:
        self._notes.append((kind, text))
        self._turn()

    # The transport -----------------------------------------------------------------------------------

    async def _keep_open(self) -> None:
        """Open the transport, and open it again with back-off whenever that or the transport fails."""
        failures = 0
        while True:
            self._closed.clear()
            try:
                transport = await open_transport(self._connection, self._peer_silent_s)
            except Lost as lost:
                what, why = "cannot be opened", str(lost)
            else:
                self._transport, self._dropped = transport, 0
                self._listen()
                self._note(InputKind.LINK_UP, transport.opened)
                opened = self._loop.time()
                await self._closed.wait()
                what, why = "failed", self._why_closed
                if self._loop.time() - opened > BACK_OFF_S[-1]:
                    failures = 0
            delay_s = BACK_OFF_S[min(failures, len(BACK_OFF_S) - 1)]
            failures += 1
            self._note(InputKind.LINK_DOWN, f"{self._connection} {what}: {why}; again in {delay_s:g} s")
            await asyncio.sleep(delay_s)

    def _listen(self) -> None:
        """Wait for bytes. After an error uvloop stops waiting on a descriptor, so it must be told anew."""
        if self._transport is not None:
            self._loop.remove_reader(self._transport.fileno())
            self._loop.add_reader(self._transport.fileno(), self._turn)

    def _close_transport(self) -> None:
        transport, self._transport = self._transport, None
        if transport is not None:
            self._loop.remove_reader(transport.fileno())
            transport.close()

    def _failed(self, lost: Lost) -> None:
        self._why_closed = str(lost)
        self._close_transport()
        self._closed.set()

    def _read(self) -> None:
        """All that waits, in order. Whoever speaks as the configured autopilot gets the answers."""
        guide, link, end_ns = self._guide, self._guide.link, time.monotonic_ns() + READ_AT_MOST_NS
        while (transport := self._transport) is not None:
            try:
                came = transport.receive()
            except Lost as lost:
                self._failed(lost)
                return
            except OSError as error:
                self._trouble(error)
                continue
            if came is None:
                return
            now_ns = time.monotonic_ns()
            before, stale = link.received, link.counters[Refusal.REPLAYED]
            guide.receive(came[0], now_ns)
            if link.received != before and (problem := transport.heard(came[1], now_ns)):
                self._tell(problem)
            elif link.refusal is Refusal.REPLAYED and link.counters[Refusal.REPLAYED] != stale:
                # Its clock may only be behind. It goes by ours as soon as it hears us.
                transport.perhaps(came[1], now_ns)
            self._send()
            if now_ns >= end_ns:
                return

    def _send(self) -> None:
        for packet in self._guide.packets():
            if self._transport is None:
                return
            try:
                self._transport.send(packet)
            except Lost as lost:
                self._failed(lost)
            except OSError as error:  # lost, as on the way: what follows is newer
                self._trouble(error)

    def _trouble(self, error: OSError) -> None:
        self._loop.call_soon(self._listen)
        self._tell(f"{self._connection}: {said(error)}")

    def _tell(self, problem: str) -> None:
        """Note a problem of the network once, not at 50 Hz."""
        now_ns = time.monotonic_ns()
        told_ns = self._told_ns.get(problem)
        if len(self._told_ns) < 100 or told_ns is not None:
            self._told_ns[problem] = now_ns
            if told_ns is None or now_ns - told_ns > FORGET_PROBLEM_NS:
                self._notes.append((InputKind.NOTE, problem))

    # Once a second -----------------------------------------------------------------------------------

    async def _watch(self) -> None:
        """What is wrong with a sink or with the way out is said once; nothing waits for it."""
        while True:
            await asyncio.sleep(WATCH_S)
            self.look_at_sinks()
            self._look_at_transport()
            if self._keeper is not None:
                self._look_at_signing(self._keeper)
            if self._learned is not None:
                self._look_at_learned(self._learned)

    def look_at_sinks(self) -> None:
        """Note what has come to be wrong with a sink since the last look, and what is well again."""
        self._guide.dropped_records = self._sinks.dropped
        for news in self._sinks.news():
            self._note(InputKind.NOTE, news)

    def _look_at_signing(self, keeper: ClockKeeper) -> None:
        """Keep the signing clock, and set it when the wall clock was."""
        clock = keeper.set_anew(time.time_ns())
        if clock is not None:
            self._turn(lambda now_ns: self._guide.signing_clock(clock, now_ns))
        if keeper.problem:
            self._tell(f"signing: {keeper.problem}")
        keeper.keep()

    def _look_at_learned(self, file: LearnedFile) -> None:
        """Keep what a flight has taught when it is over."""
        if (learned := self._guide.learned) is not None:
            file.keep(learned)
        if file.problem:
            self._tell(f"airplane.trims_file: {file.problem}")

    def _look_at_transport(self) -> None:
        """Note packets that could not be sent."""
        dropped = 0 if self._transport is None else self._transport.dropped
        if dropped > self._dropped:
            self._guide.dropped_packets += dropped - self._dropped
            self._dropped = dropped
            problem = (
                "packets are dropped, as the line does not take them in time: too slow, or is nobody reading?"
            )
            self._tell(f"{self._connection}: {problem}")
