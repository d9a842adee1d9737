"""Every vehicle on the network as zenoh brings it, handed over in order: for a terminal or a dashboard.

All of zenoh happens in a thread of the subscriber's own, which opens the session, empties zenoh's rings
(they drop the oldest) and reads what is in them; `take` never waits for any of it. When a vehicle's
liveliness token appears its last records are asked for, so that who comes late also learns what is published
only once. What else is asked of them on demand, their last minutes and orders, comes out of `take` as well.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Final

import zenoh

from guidance.telemetry.arrivals import VEHICLE, Arrival, Presence, read, vehicle_of
from guidance.telemetry.asking import Histories, Orders
from guidance.telemetry.zenoh_sink import FIRST_RETRY_S, LAST_RETRY_S, brief, close_quietly

#: Between looks into the rings: how late an arrival may be noted.
TURN_S: Final = 0.05
_LOOK_NS: Final = 500_000_000  # between looks at the neighbours
_ASK_TIMEOUT_S: Final = 3.0
_RING: Final = 8192  # ten vehicles at 50 Hz fill it in 4 s
_TOKENS: Final = 1024

Ring = zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]]


class Subscriber:
    """What is published under `guidance/<vehicle>/<topic>`, who is there, and how the connection does.

    Args:
        config: of the session, see `zenoh_sink.zenoh_config`.
        vehicle: its name; `*` for all.
        capacity: arrivals that may wait for `take`; the oldest give way.
    """

    def __init__(
        self,
        config: zenoh.Config,
        vehicle: str = "*",
        *,
        capacity: int = 20_000,
        open_session: Callable[[zenoh.Config], zenoh.Session] = zenoh.open,
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        #: Why there is no session, in words; empty if there is one.
        self.trouble = "opening a session"
        #: Peers and routers that the session is connected to.
        self.neighbours = 0
        self._config = config
        self._root = f"guidance/{vehicle}"
        self._open_session = open_session
        self._clock_ns = clock_ns
        self._arrivals: deque[Arrival] = deque(maxlen=capacity)
        self._stopping = threading.Event()
        self._histories = Histories()
        self._orders = Orders()
        self._thread = threading.Thread(target=self._run, name="subscriber", daemon=True)
        # Of the thread only, but for the replies, which zenoh appends.
        self._session: zenoh.Session | None = None
        self._records: Ring
        self._tokens: Ring
        self._replies: deque[zenoh.Reply] = deque(maxlen=_RING)
        self._retry_s = FIRST_RETRY_S
        self._retry_ns = self._look_ns = clock_ns()

    def __enter__(self) -> Subscriber:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close(12.0)

    def start(self) -> None:
        """Start the thread and return at once."""
        self._thread.start()

    def close(self, timeout_s: float) -> bool:
        """Close the session; False if it takes longer (zenoh waits 10 s for a frozen neighbour)."""
        self._stopping.set()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def take(self) -> list[Arrival]:
        """What has arrived since the last call, in order; never blocks."""
        taken: list[Arrival] = []
        while self._arrivals:
            taken.append(self._arrivals.popleft())
        return taken

    def history(self, vehicle: str) -> None:
        """Ask for the last minutes of `vehicle`, one vehicle after the other; a `History` will arrive.

        Raises:
            ValueError: no name of a vehicle.
        """
        self._histories.want(vehicle)

    def ask(self, vehicle: str, verb: str, fields: Mapping[str, Any], source: str = "") -> str:
        """Give an order, whose `Answered` will arrive, within some 6 s also if nobody answers; its id.

        `fields` are the order's (`guidance.commands`). It is asked again until it is answered, under one id,
        so that it is obeyed once.

        Raises:
            ValueError: a wrong name or order, or too many at once, in words.
        """
        return self._orders.give(vehicle, verb, fields, source)

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                self._turn()
                self._stopping.wait(TURN_S)
        except Exception as error:
            self.trouble = f"stopped by an internal error, please report it: {error!r}"
            raise
        finally:
            if self._session is not None:
                close_quietly(self._session)

    def _turn(self) -> None:
        now_ns = self._clock_ns()
        try:
            if self._session is None:
                if now_ns >= self._retry_ns:
                    self._open()
            else:
                self._drain(self._session, now_ns)
                self._arrivals.extend(self._histories.turn(self._session, now_ns))
                if now_ns >= self._look_ns:
                    self._look_ns = now_ns + _LOOK_NS
                    self._look(self._session)
            self._arrivals.extend(self._orders.turn(self._session, now_ns, self.trouble))
        except zenoh.ZError as error:
            self._abandon(brief(error))

    def _open(self) -> None:
        session = self._session = self._open_session(self._config)
        self._records = session.declare_subscriber(f"{self._root}/*", zenoh.handlers.RingChannel(_RING))
        self._tokens = session.liveliness().declare_subscriber(
            f"{self._root}/alive", zenoh.handlers.RingChannel(_TOKENS), history=True
        )
        self.trouble = ""
        self._retry_s = FIRST_RETRY_S

    def _abandon(self, why: str) -> None:
        """Leave the session behind, if there is one, and try again later."""
        self.trouble = f"no session: {why}; trying again every {self._retry_s:g} s"
        self.neighbours = 0
        self._retry_ns = self._clock_ns() + int(self._retry_s * 1e9)
        self._retry_s = min(2 * self._retry_s, LAST_RETRY_S)
        session, self._session = self._session, None
        self._replies.clear()
        self._histories.forget()
        self._orders.forget()
        if session is not None:
            close_quietly(session)

    def _drain(self, session: zenoh.Session, now_ns: int) -> None:
        """Records before tokens: a service withdraws its token after its last record."""
        for _ in range(_RING):
            sample = self._records.try_recv()
            if sample is None:
                break
            self._read(sample, now_ns)
        for _ in range(_TOKENS):
            token = self._tokens.try_recv()
            if token is None:
                break
            vehicle, here = vehicle_of(str(token.key_expr)), token.kind == zenoh.SampleKind.PUT
            if VEHICLE.fullmatch(vehicle) is not None:
                self._arrivals.append(Presence(now_ns, vehicle, here))
                if here:
                    self._ask(session, vehicle)
        while self._replies:
            reply = self._replies.popleft().ok
            if reply is not None:
                self._read(reply, now_ns, answered=True)

    def _ask(self, session: zenoh.Session, vehicle: str) -> None:
        """For the last record of each topic, of everybody who has one: two may use one name."""
        session.get(
            f"guidance/{vehicle}/*",
            self._replies.append,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=_ASK_TIMEOUT_S,
        )

    def _read(self, sample: zenoh.Sample, now_ns: int, answered: bool = False) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            key, encoding = str(sample.key_expr), str(sample.encoding)
            self._arrivals.append(read(now_ns, key, encoding, sample.payload.to_bytes(), answered))

    def _look(self, session: zenoh.Session) -> None:
        if session.is_closed():
            self._abandon("it was closed")
        else:
            self.neighbours = len(session.info.peers_zid()) + len(session.info.routers_zid())
