"""The last minutes of a flight, for who comes late: kept by the service, asked for by zenoh queries.

    guidance/<vehicle>/*?history=180   the last 180 s, as one reply for each record that was kept
    guidance/<vehicle>/error?history=60

Kept are, oldest first, two records a second of the streams that charts are drawn from, one of the status,
fewer of the long ones, and the newest events however old. Who asks must not let zenoh consolidate the
replies (`ConsolidationMode.NONE`), which would leave one of each key.

Everything here runs in the sink's own thread, and a few replies at a time: a history must not hold up what is
published.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Final

import zenoh

from guidance.printable import printable
from guidance.records import (
    TOPICS,
    AirplaneHandling,
    Event,
    GroundHandling,
    Link,
    Reference,
    Setpoint,
    State,
    Status,
    Timing,
    TrackingError,
    VelocityHandling,
)
from guidance.telemetry.queue import Sample
from guidance.telemetry.schema import encoding_schema

KEPT_NS: Final = 180_000_000_000
#: Some 0.8 MB in an airplane's flight; this is for records that nobody thought of.
KEPT_BYTES_MAX: Final = 2 << 20
EVENTS_MAX: Final = 100
#: A reply costs some 5 us: so many are a slice of the worker's.
REPLIES_PER_TURN: Final = 64
#: So many may wait for their history at once.
WAITING_MAX: Final = 8

_PARAMETER: Final = "history"
_EVENT: Final = TOPICS[Event]
#: One of each topic in so many ns.
_EVERY_NS: Final = {
    TOPICS[kind]: period_ns
    for period_ns, kinds in {
        500_000_000: (
            State,
            Reference,
            TrackingError,
            Setpoint,
            GroundHandling,
            AirplaneHandling,
            VelocityHandling,
        ),
        1_000_000_000: (Status,),
        2_000_000_000: (Link, Timing),
    }.items()
    for kind in kinds
}
_ENCODINGS: Final = {
    topic: zenoh.Encoding.APPLICATION_JSON.with_schema(encoding_schema(topic))
    for topic in (_EVENT, *_EVERY_NS)
}


class History:
    """What is kept; memory has a limit."""

    def __init__(self) -> None:
        self._streams: deque[Sample] = deque()
        self._events: deque[Sample] = deque(maxlen=EVENTS_MAX)
        self._bytes = 0
        self._slots: dict[str, int] = {}  # of the newest that was kept

    def keep(self, sample: Sample) -> None:
        """Take in what is published, in order; most of it is not kept. Amortised O(1).

        The first of each slot of a fixed grid is kept, so that records of one instant stay together.
        """
        period_ns = _EVERY_NS.get(sample.topic)
        if period_ns is None:
            if sample.topic == _EVENT:
                self._events.append(sample)
            return
        slot = sample.t_ns // period_ns
        if self._slots.get(sample.topic) == slot:
            return
        self._slots[sample.topic] = slot
        self._streams.append(sample)
        self._bytes += len(sample.payload)
        since_ns, streams = sample.t_ns - KEPT_NS, self._streams
        while streams and (self._bytes > KEPT_BYTES_MAX or streams[0].t_ns < since_ns):
            self._bytes -= len(streams.popleft().payload)

    def last(self, seconds: float) -> list[Sample]:
        """The events, and of the streams the last `seconds` before their newest, oldest first."""
        if not self._streams:
            return list(self._events)
        since_ns = self._streams[-1].t_ns - min(seconds * 1e9, KEPT_NS)
        return [*self._events, *(sample for sample in self._streams if sample.t_ns >= since_ns)]


class HistoryQueries:
    """The queries that are answered with the history. `root` is the part of the key before the topic."""

    def __init__(self, root: str) -> None:
        self.history = History()
        self._keys = {topic: zenoh.KeyExpr(f"{root}{topic}") for topic in _ENCODINGS}
        self._waiting: deque[tuple[zenoh.Query, Iterator[Sample]]] = deque()

    def take(self, query: zenoh.Query) -> bool:
        """Whether the query asks for a history; if so it is answered, from the next turn on."""
        asked = query.parameters.get(_PARAMETER)
        if asked is None:
            return False
        seconds = _seconds(asked)
        if seconds is None or len(self._waiting) >= WAITING_MAX:
            words = (
                f"history={printable(asked[:40])}: expected seconds, as in history=180"
                if seconds is None
                else f"{WAITING_MAX} wait for their history already: ask again"
            )
            with query:
                query.reply_err(words)
            return True
        wanted = {topic for topic, key in self._keys.items() if query.key_expr.intersects(key)}
        samples = [sample for sample in self.history.last(seconds) if sample.topic in wanted]
        self._waiting.append((query, iter(samples)))
        return True

    def turn(self) -> None:
        """Answer with the next few, first come, first served."""
        for _ in range(REPLIES_PER_TURN):
            if not self._waiting:
                return
            query, samples = self._waiting[0]
            sample = next(samples, None)
            if sample is None:
                with query:
                    self._waiting.popleft()
            else:
                query.reply(self._keys[sample.topic], sample.payload, encoding=_ENCODINGS[sample.topic])

    def forget(self) -> None:
        """The session is gone or ends, and who asked with it."""
        for query, _ in self._waiting:
            with query:
                pass
        self._waiting.clear()


def _seconds(text: str) -> float | None:
    """None unless it is a positive number."""
    try:
        seconds = float(text)
    except ValueError:
        return None
    return seconds if seconds > 0.0 else None
