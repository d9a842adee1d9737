"""What the core tells: records in order, and those that can wait until the packets are out."""

from __future__ import annotations

from collections.abc import Callable

from guidance.records import Event, GroundHandling, Input, Level, Record, VelocityHandling
from guidance.reporting import Cadence


class Telling:
    """The records that nobody has taken yet."""

    def __init__(self) -> None:
        self.cadence = Cadence()
        self._records: list[Record] = []
        self._put_off: list[Callable[[], None]] = []
        self._silent_because = ""
        self._stuck = False

    def add(self, *records: Record) -> None:
        """These come next."""
        self._records += records

    def amend(self, newest: Input) -> None:
        """In place of the newest record: the same input, of which more is known now."""
        self._records[-1] = newest

    def event(self, level: Level, code: str, text: str, now_ns: int) -> None:
        """Something happened."""
        self._records.append(Event(t_ns=now_ns, level=level, code=code, text=text))

    def tell(self, event: Event | None) -> None:
        """What came of something, if anything did; the status shows it at once."""
        if event is not None:
            self._records.append(event)
            self.cadence.now("status")

    def later(self, work: Callable[[], None]) -> None:
        """Work that makes records when there is time: after sending, and before anything else enters."""
        self._put_off.append(work)

    def catch_up(self) -> None:
        """Do what was put off."""
        works, self._put_off = self._put_off, []
        for work in works:
            work()

    def taken(self) -> list[Record]:
        """All records, in order; none are left."""
        self.catch_up()
        records, self._records = self._records, []
        return records

    def silent(self, reason: str, now_ns: int) -> None:
        """No setpoint is sent, and why: once per silence, not at 50 Hz; "" when one was sent."""
        if reason and not self._silent_because:
            self.event(Level.WARNING, "silent", f"no setpoint: {reason}", now_ns)
        self._silent_because = reason

    def stuck(self, record: Record | None, now_ns: int) -> None:
        """A handling's record says that the vehicle is asked to move and does not: said once each time."""
        stuck = isinstance(record, GroundHandling | VelocityHandling) and record.stuck
        if stuck and not self._stuck:
            text = "asked to move and does not: wheels, motors, a ditch, or the mode?"
            self.event(Level.WARNING, "stuck", text, now_ns)
        self._stuck = stuck
