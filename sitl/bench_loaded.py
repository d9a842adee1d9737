"""The service with its sinks under load, for `sitl bench loop`, which starts it with settings.

Each record goes to log and zenoh ten times, as if there were ten times as many; and to one more sink, written
in Python, that parses and formats it so often that it never comes to an end: it computes as much as a sink's
slices let it, and drops the rest. Nothing else differs from `guidance run`, but for the console: it would say
all ten times, and is left out.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from typing import Final

from guidance.config import Config, load
from guidance.demo import CONFIG_FILE
from guidance.records import TOPICS, Record, Session
from guidance.service import serve
from guidance.telemetry import Sample
from guidance.telemetry.sinks import Sinks, configured_sinks
from guidance.telemetry.worker import ThreadedSink

TIMES: Final = 10
_PARSED: Final = 20


class Computing(ThreadedSink):
    """Computes in Python, about 0.1 ms for a record, without an end."""

    def __init__(self) -> None:
        super().__init__("computing", capacity=1000, capacity_bytes=4 << 20)

    def _take(self, lost: int, sample: Sample) -> None:
        for _ in range(_PARSED):
            json.dumps(json.loads(sample.payload))

    def _turn(self) -> None:
        """Nothing is periodic."""

    def _finish(self) -> bool:
        return True

    def _describe_stall(self, seconds: float) -> str:
        return f"computing for {seconds:.0f} s"


class LoadedSinks(Sinks):
    """Each record is encoded once and offered ten times."""

    def publish(self, records: Iterable[Record]) -> None:
        """To all of them."""
        for record in records:
            sample = Sample(TOPICS[type(record)], record.t_ns, self._encode(record))
            for sink in self._sinks.values():
                for _ in range(TIMES):
                    sink.offer(sample)


def loaded(config: Config, session: Session) -> Sinks:
    """The configured sinks but the console, and the one that computes."""
    sinks = configured_sinks(config, session)
    del sinks["console"]
    return LoadedSinks({**sinks, "computing": Computing()})


if __name__ == "__main__":
    sys.exit(serve(load(CONFIG_FILE, sys.argv[1:]), loaded))
