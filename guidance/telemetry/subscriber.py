"""The newest record of each topic of one vehicle, as zenoh brings them: for a terminal or a test."""

from __future__ import annotations

import threading

import msgspec
import zenoh

from guidance.records import LOG_ONLY, TOPICS, Record
from guidance.telemetry.zenoh_sink import close_quietly, zenoh_config


class Subscriber:
    """Connects to `endpoint` (a zenoh locator) and keeps what comes; garbage on the keys is counted."""

    def __init__(self, vehicle: str, endpoint: str) -> None:
        self.garbage = 0
        self._decoders = {
            topic: msgspec.json.Decoder(record) for record, topic in TOPICS.items() if topic not in LOG_ONLY
        }
        self._latest: dict[str, Record] = {}
        self._lock = threading.Lock()
        self._session = zenoh.open(zenoh_config(mode="peer", connect=[endpoint]))
        self._subscriber = self._session.declare_subscriber(f"guidance/{vehicle}/*", self._take)

    def __enter__(self) -> Subscriber:
        return self

    def __exit__(self, *_: object) -> None:
        close_quietly(self._session)

    def latest(self, topic: str) -> Record | None:
        """The newest record of `topic`, None if none came yet."""
        with self._lock:
            return self._latest.get(topic)

    def _take(self, sample: zenoh.Sample) -> None:
        decoder = self._decoders.get(str(sample.key_expr).rpartition("/")[2])
        if decoder is None:
            return
        try:
            record = decoder.decode(sample.payload.to_bytes())
        except msgspec.MsgspecError:
            self.garbage += 1
            return
        with self._lock:
            self._latest[TOPICS[type(record)]] = record
