"""A tuning flight by the service: it runs as `guidance run` does, ends by itself, and keeps what it measured.

The end comes as an order, as any operator's: it is in the log, and a replay obeys it again.
"""

from __future__ import annotations

import re
import time
from typing import Final

import msgspec

from guidance.commands import Shutdown
from guidance.config import Config
from guidance.flying.around import Phase
from guidance.records import TOPICS, Answer, Event, Level, Record, Session, Status, Stepping
from guidance.requests import ENGAGING
from guidance.service import serve
from guidance.steps_log import NEEDED
from guidance.supervisor import State
from guidance.telemetry.queue import Sample
from guidance.telemetry.schema import RECORDS
from guidance.telemetry.sinks import Sinks, configured_sinks
from guidance.telemetry.worker import Sink
from guidance.telemetry.zenoh_orders import HandOver

SOURCE: Final = "guidance tune"
#: The order is obeyed at once or never.
OBEY_NS: Final = 1_000_000_000
#: Somebody or something else has ended the flight.
_ENDED: Final = frozenset({State.HANDED_OVER, State.ABORTED})
_NUMBERS: Final = re.compile(r"[\d.]+")
_LOOKED_AT: Final = (TOPICS[Status], TOPICS[Answer])
_STEPPING: Final = TOPICS[Stepping]
_phase: Final = msgspec.json.Decoder(Stepping).decode


class Conductor:
    """A sink that ends the flight when its steps are done, or cannot be.

    `ended` says why they were not all flown, empty if they were; `flew` that it was in control at all, and
    `stopped` that the operator stopped it.
    """

    dropped = 0
    problem = ""

    def __init__(self, wait_s: float) -> None:
        self.ended = ""
        self.stopped = False
        self.flew = False
        self._wait_s = wait_s
        self._kept: list[Sample] = []
        self._begun_ns: int | None = None
        self._over = False
        self._hand_over: HandOver | None = None
        self._console: Sink | None = None
        self._said = ""

    def orders_to(self, hand_over: HandOver) -> None:
        """Whom to tell that it is over."""
        self._hand_over = hand_over

    def says_by(self, console: Sink) -> None:
        """Who prints what it waits for."""
        self._console = console

    def offer(self, sample: Sample) -> None:
        """As `Sink` says."""
        if sample.topic in NEEDED:
            self._kept.append(sample)
            if sample.topic == _STEPPING and _phase(sample.payload).phase == Phase.DONE:
                self._end("")
        elif sample.topic in _LOOKED_AT:
            record = msgspec.json.decode(sample.payload, type=RECORDS[sample.topic])
            if isinstance(record, Status):
                self._look(record)
            elif isinstance(record, Answer):
                self.stopped |= record.order == "shutdown" and record.source != SOURCE

    def start(self) -> None:
        """It has no thread."""

    def close(self, timeout_s: float) -> bool:
        """Nothing waits."""
        return True

    def records(self) -> list[Record]:
        """What the identification needs."""
        return [msgspec.json.decode(s.payload, type=RECORDS[s.topic]) for s in self._kept]

    def _look(self, status: Status) -> None:
        if self._begun_ns is None:
            self._begun_ns = status.t_ns
        self.flew |= status.state == State.TRACKING
        if status.state in _ENDED:
            self._end(f"{status.state}: {status.reason}")
        elif not self.flew and (status.t_ns - self._begun_ns) * 1e-9 > self._wait_s:
            self._end(f"not engaged within {self._wait_s:g} s; {status.state}: {status.reason}")
        elif not self.flew and status.state not in ENGAGING:
            self._say(f"waiting, {status.state}: {status.reason}", status.t_ns)

    def _say(self, text: str, now_ns: int) -> None:
        """To the console alone, as no event of the core's; the same but for its numbers only once."""
        kind = _NUMBERS.sub("", text)
        if self._console is not None and kind != self._said:
            self._said = kind
            event = Event(t_ns=now_ns, level=Level.INFO, code="waiting", text=text)
            self._console.offer(Sample(TOPICS[Event], now_ns, msgspec.json.encode(event)))

    def _end(self, why: str) -> None:
        if self._over or self._hand_over is None:
            return
        self._over, self.ended = True, why
        self._hand_over(Shutdown(source=SOURCE), time.monotonic_ns() + OBEY_NS)


def fly(config: Config, wait_s: float) -> tuple[int, Conductor]:
    """Until the steps are flown or cannot be; the service's exit status, and what was measured.

    Raises:
        ConfigError: as `service.serve`.
    """
    conductor = Conductor(wait_s)

    def gather(config: Config, session: Session) -> Sinks:
        sinks = configured_sinks(config, session)
        conductor.says_by(sinks["console"])
        return Sinks({**sinks, "steps": conductor})

    return serve(config, gather), conductor
