"""Telemetry over zenoh: each record as JSON under `guidance/<vehicle>/<topic>`.

All of zenoh happens in the sink's own thread, queries included: they wait in a ring until the thread comes
round, so that no zenoh call is ever made inside a zenoh callback. A session that cannot be opened or has died
is opened anew with a growing pause; meanwhile the newest samples wait in the bounded queue. Zenoh itself
restores a lost connection of a session that lives.

Keys:
    guidance/<vehicle>/<topic>  publications, and the last record of each topic in answer to a query; with
                                `?history=SECONDS` those of the last minutes: see `zenoh_history`
    guidance/<vehicle>/alive    liveliness token: there while the service is connected
    guidance/<vehicle>/command/<verb>  an order, as a query: see `zenoh_orders`
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import ClassVar, Final, Literal, Protocol

import zenoh

from guidance.records import LOG_ONLY, TOPICS, Answer, Event, Session, Status
from guidance.telemetry.arrivals import VEHICLE
from guidance.telemetry.queue import Sample
from guidance.telemetry.schema import RECORDS, encoding_schema
from guidance.telemetry.worker import ThreadedSink
from guidance.telemetry.zenoh_history import HistoryQueries
from guidance.telemetry.zenoh_orders import HandOver, OrderQueries

Mode = Literal["peer", "client"]

FIRST_RETRY_S: Final = 0.5
LAST_RETRY_S: Final = 10.0
_LOOK_NS: Final = 1_000_000_000  # between looks at the state of the session
_WAITING_QUERIES: Final = 64
#: Rare and telling: these overtake the streams when the link is congested.
_URGENT: Final = frozenset({TOPICS[Session], TOPICS[Status], TOPICS[Event], TOPICS[Answer]})
_ANSWERS: Final = TOPICS[Answer]
#: Protocols whose address ends with a port. Zenoh takes one without and tries it for ever.
_PORTLESS: Final = re.compile(r"(tcp|udp|tls|quic|ws)/(?![^?#]*:\d{1,5}([?#]|$))")


def zenoh_config(
    *,
    mode: Mode = "peer",
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    multicast_scouting: bool = False,
    config_file: Path | None = None,
) -> zenoh.Config:
    """The session's configuration; nothing is opened, so it also serves to check settings before a flight.

    Endpoints are pinned: without `listen` a peer accepts no connections (zenoh's own default is a random port
    on all interfaces), and neighbours are not searched for by multicast unless that is asked for.
    `config_file` (json5, for TLS and access control) replaces all the other settings.

    Raises:
        ValueError: what is wrong, in words.
    """
    if config_file is not None:
        if mode != "peer" or connect or listen or multicast_scouting:
            raise ValueError("zenoh: a configuration file replaces mode, endpoints and scouting; set either")
        try:
            return zenoh.Config.from_file(str(config_file))
        except Exception as error:  # zenoh raises whatever its parser met
            raise ValueError(f"zenoh: cannot use the file {config_file}: {brief(error)}") from error
    for locator in (*connect, *listen):
        if _PORTLESS.match(locator):
            raise ValueError(
                f"zenoh: {locator!r} names no port: PROTOCOL/HOST:PORT, as in tcp/192.168.1.2:7447"
            )
    config = zenoh.Config()
    settings = {
        "mode": mode,
        "connect/endpoints": list(connect),
        "listen/endpoints": list(listen),
        "scouting/multicast/enabled": multicast_scouting,
    }
    for key, value in settings.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise ValueError(f"zenoh: {key} = {value!r} is not accepted: {brief(error)}") from error
    return config


class ZenohSink(ThreadedSink):
    """Publishes every sample but the raw traffic; see `worker.Sink`.

    Args:
        vehicle: one chunk of the key, letters, digits and `_.-`.
        mode: `peer`, or `client` of a router.
        connect: endpoints to connect to, such as `tcp/192.168.1.2:7447`.
        listen: endpoints to listen on.
        multicast_scouting: look for peers and routers on the local network.
        config_file: a zenoh configuration (json5) in place of the four settings above.
        commands: whether orders are handed over; if not, they are refused.
        capacity: samples that may wait while zenoh is opened or busy (at 300 a second: some 7 s).
        capacity_bytes: bytes of payload that may wait.

    Raises:
        ValueError: a vehicle name or settings that zenoh does not take.
    """

    #: Closing a session whose neighbour is frozen takes zenoh's own time-out of 10 s, and a thread that
    #: returns from zenoh into an interpreter that is being taken down aborts the process.
    LINGER_S: ClassVar[float] = 11.0

    def __init__(
        self,
        vehicle: str,
        *,
        mode: Mode = "peer",
        connect: Sequence[str] = (),
        listen: Sequence[str] = (),
        multicast_scouting: bool = False,
        config_file: Path | None = None,
        commands: bool = False,
        capacity: int = 2_000,
        capacity_bytes: int = 4 << 20,
        open_session: Callable[[zenoh.Config], zenoh.Session] = zenoh.open,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        wait: Callable[[float], object] | None = None,
    ) -> None:
        super().__init__(
            "zenoh", capacity=capacity, capacity_bytes=capacity_bytes, clock_ns=clock_ns, wait=wait
        )
        if VEHICLE.fullmatch(vehicle) is None:
            raise ValueError(
                f"vehicle = {vehicle!r}: only letters, digits and _.- can be part of a zenoh key"
            )
        self._root = f"guidance/{vehicle}"
        self._config = zenoh_config(
            mode=mode,
            connect=connect,
            listen=listen,
            multicast_scouting=multicast_scouting,
            config_file=config_file,
        )
        self._expects_neighbours = config_file is None and bool(connect)
        self._where = ", ".join(connect) or "its configured endpoints"
        self._open_session = open_session
        self._orders = OrderQueries(f"{self._root}/command/", enabled=commands, clock_ns=clock_ns)
        self._histories = HistoryQueries(f"{self._root}/")
        # Of the worker's thread only.
        self._session: zenoh.Session | None = None
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._queryable: zenoh.Queryable[zenoh.handlers.Handler[zenoh.Query]] | None = None
        self._token: zenoh.LivelinessToken | None = None
        self._last: dict[str, bytes] = {}
        self._retry_s = FIRST_RETRY_S
        self._retry_ns = clock_ns()
        self._look_ns = clock_ns()

    @property
    def liveliness_key(self) -> str:
        """Key of the liveliness token."""
        return f"{self._root}/alive"

    def orders_to(self, hand_over: HandOver) -> None:
        """Whom orders are handed to, before the start; called in the sink's thread."""
        self._orders.hand_over = hand_over

    def offer(self, sample: Sample) -> None:
        """Take `sample` unless only the log gets it; never blocks, never raises, O(1)."""
        if sample.topic not in LOG_ONLY:
            self._queue.push(sample)

    def _ready(self) -> bool:
        if self._session is None and not self._stopping.is_set() and self._clock_ns() >= self._retry_ns:
            self._open()
        return self._session is not None

    def _open(self) -> None:
        try:
            self._session = self._open_session(self._config)
            for topic in RECORDS:
                if topic not in LOG_ONLY:
                    self._publishers[topic] = self._declare(self._session, topic)
            self._queryable = self._session.declare_queryable(
                f"{self._root}/**", zenoh.handlers.RingChannel(_WAITING_QUERIES)
            )
            self._token = self._session.liveliness().declare_token(self.liveliness_key)
        except zenoh.ZError as error:
            self._abandon(f"cannot open a session: {brief(error)}")
            return
        self._orders.opened()
        self._trouble = ""
        self._retry_s = FIRST_RETRY_S
        self._look_ns = self._clock_ns() + _LOOK_NS

    def _declare(self, session: zenoh.Session, topic: str) -> zenoh.Publisher:
        return session.declare_publisher(
            f"{self._root}/{topic}",
            encoding=_encoding(topic),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.DATA_HIGH if topic in _URGENT else zenoh.Priority.DATA,
        )

    def _abandon(self, why: str) -> None:
        """Leave the session behind, if there is one, and try again later."""
        self._trouble = f"zenoh: {why}; trying again every {self._retry_s:g} s"
        self._retry_ns = self._clock_ns() + int(self._retry_s * 1e9)
        self._retry_s = min(2 * self._retry_s, LAST_RETRY_S)
        session, self._session = self._session, None
        self._publishers.clear()
        self._queryable = self._token = None
        self._orders.forget()
        self._histories.forget()
        if session is not None:
            close_quietly(session)

    def _take(self, lost: int, sample: Sample) -> None:
        self._last[sample.topic] = sample.payload
        self._histories.history.keep(sample)
        publisher = self._publishers.get(sample.topic)
        if publisher is None:  # the session died within this slice, or the topic is no record of ours
            self._discarded += 1
            return
        try:
            publisher.put(sample.payload)
            if sample.topic == _ANSWERS:
                self._orders.answered(sample.payload)
        except zenoh.ZError as error:
            self._discarded += 1
            self._abandon(f"cannot publish: {brief(error)}")

    def _turn(self) -> None:
        if self._session is None:
            return
        try:
            self._answer_queries()
            self._histories.turn()
            self._orders.expire()
            if self._clock_ns() >= self._look_ns:
                self._look_ns = self._clock_ns() + _LOOK_NS
                self._look(self._session)
        except zenoh.ZError as error:
            self._abandon(f"the session failed: {brief(error)}")

    def _answer_queries(self) -> None:
        assert self._queryable is not None
        self._orders.come_round()
        for _ in range(_WAITING_QUERIES):
            query = self._queryable.try_recv()
            if query is None:
                return
            if self._orders.take(query) or self._histories.take(query):
                continue
            with query:
                for topic, payload in self._last.items():
                    key = zenoh.KeyExpr(f"{self._root}/{topic}")
                    if query.key_expr.intersects(key):
                        query.reply(key, payload, encoding=_encoding(topic))

    def _look(self, session: zenoh.Session) -> None:
        if session.is_closed():
            self._abandon("the session was closed")
        elif self._expects_neighbours and not session.info.routers_zid() and not session.info.peers_zid():
            self._trouble = (
                f"zenoh: nobody answers at {self._where}; is the router up? trying again all the time"
            )
        else:
            self._trouble = ""

    def _finish(self) -> bool:
        session, self._session = self._session, None
        if session is None:
            return False
        with suppress(zenoh.ZError):  # it died just now, and who asked with it
            self._answer_queries()
            self._histories.forget()
            self._orders.finish()
        close_quietly(session)
        return True

    def _describe_stall(self, seconds: float) -> str:
        return f"zenoh: a call has not returned for {seconds:.0f} s; {self.dropped} records lost"


def _encoding(topic: str) -> zenoh.Encoding:
    if topic not in RECORDS:
        return zenoh.Encoding.APPLICATION_JSON
    return zenoh.Encoding.APPLICATION_JSON.with_schema(encoding_schema(topic))


class _Closable(Protocol):
    """A session, whose `close` comes without types."""

    def close(self) -> None: ...


def close_quietly(session: _Closable) -> None:
    with suppress(zenoh.ZError):  # beyond closing, then
        session.close()


def brief(error: Exception) -> str:
    """Zenoh's own words without its types and the places in its source, which tell an operator nothing."""
    text = str(error)
    if wrapped := re.search(r'Message \{ msg: "((?:[^"\\]|\\.)*)"', text):
        text = re.sub(r"\\(.)", r"\1", wrapped[1])
    return re.sub(r"\s+at \S+\.rs:\d+\.?", "", text).strip()
