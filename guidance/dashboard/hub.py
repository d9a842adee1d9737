"""What arrives, as what pages show: a row for each vehicle that is heard and, less often, words.

Pure: arrivals and the time are arguments. The server turns it 20 times a second.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from math import nan
from typing import Final

from guidance.dashboard.planned import Planner
from guidance.dashboard.rows import (
    FRESH_NS,
    FRESH_OTHERS_NS,
    KEPT_S,
    Lateness,
    Ring,
    nothing,
    of_history,
    row,
)
from guidance.dashboard.said import Watched, told, trajectory
from guidance.fleet import Contact, Fleet, Seen
from guidance.records import Event, Record, Reference, State, Status, Timing, TrackingError
from guidance.telemetry.arrivals import Answered, Arrival, Heard, History, Presence

#: So many vehicles' rows are kept (1.1 MB each); of more, those unheard for longest give way.
RINGS_MAX: Final = 50
#: Of what happened before somebody looked, so many events of each vehicle are told.
EVENTS_MAX: Final = 20
#: For the last minutes of a vehicle it is asked so often, as long as they do not come.
ASKED_MAX: Final = 3
ASK_AGAIN_NS: Final = 10_000_000_000
#: Who was quiet for longer may have done something that nobody heard.
MISSED_S: Final = 5.0


class _Rows:
    """The rows of one vehicle, and what makes the next."""

    def __init__(self) -> None:
        self.ring = Ring()
        self.lateness = Lateness()
        self.peak_m = nan
        self.offset_ns: int | None = None  # from its instants to those of arrival
        self.first_ns: int | None = None  # of the rows that were made here
        self.last_ns: int | None = None
        self.live = False
        self.recalled = False  # its last minutes have come


class Hub:
    """All vehicles.

    Args:
        want_history: asks for the last minutes of a vehicle, which then arrive.
    """

    def __init__(self, want_history: Callable[[str], None]) -> None:
        self.fleet = Fleet()
        self.seen: list[Seen] = []
        self.watched = Watched()
        #: The rows of the last turn by vehicle, and whose older rows have changed in it.
        self.rows: dict[str, bytes] = {}
        self.renewed: set[str] = set()
        self._vehicles: dict[str, _Rows] = {}
        self._want_history = want_history
        self._asked: dict[str, tuple[int, int]] = {}  # when for whose, and how often
        self._planner = Planner()
        self._now_ns = 0

    def ring(self, vehicle: str) -> bytes:
        """Every row of a vehicle, oldest first; none of one that is not known."""
        known = self._vehicles.get(vehicle)
        return b"" if known is None else known.ring.all()

    def age_s(self, vehicle: str) -> float:
        """How old the newest of them is, at the last turn."""
        known = self._vehicles.get(vehicle)
        return 0.0 if known is None or known.last_ns is None else (self._now_ns - known.last_ns) * 1e-9

    def turn(self, arrivals: Iterable[Arrival], now_ns: int) -> list[Answered]:
        """Take in what arrived and make the rows of now; the answers to orders among it are handed back."""
        taken = list(arrivals)
        self._now_ns = now_ns
        self.rows.clear()
        self.renewed.clear()
        for vehicle in self._vehicles.values():
            vehicle.peak_m = nan
        self.fleet.take(taken)
        for arrival in taken:
            if isinstance(arrival, Heard):
                self._heard(arrival)
            elif isinstance(arrival, History):
                self._history(arrival, now_ns)
            elif isinstance(arrival, Presence) and arrival.here and not self._recalled(arrival.vehicle):
                self._ask(arrival.vehicle, now_ns, 1)
        self.seen = self.fleet.look(now_ns)
        for seen in self.seen:
            self._row(seen, now_ns)
        return [arrival for arrival in taken if isinstance(arrival, Answered)]

    def recall(self, vehicle: str, now_ns: int) -> None:
        """A page shows it: ask for its last minutes if they have not come, but only so often."""
        known = self._vehicles.get(vehicle)
        if known is None or not known.live or known.recalled:
            return
        asked_ns, times = self._asked.get(vehicle, (now_ns - ASK_AGAIN_NS, 0))
        if times < ASKED_MAX and now_ns - asked_ns >= ASK_AGAIN_NS:
            self._ask(vehicle, now_ns, times + 1)

    def _recalled(self, vehicle: str) -> bool:
        """Whether its last minutes are known: a token that comes and goes, as links do, asks for nothing."""
        known = self._vehicles.get(vehicle)
        return known is not None and known.recalled

    def _ask(self, vehicle: str, now_ns: int, times: int) -> None:
        if len(self._asked) >= 2 * RINGS_MAX:
            self._asked.pop(next(iter(self._asked)))
        self._asked[vehicle] = now_ns, times
        self._want_history(vehicle)

    def plan(self, vehicle: str) -> bytes:
        """The path that is planned for a vehicle, as a page is told; another object when it is another."""
        status, reference = self.fleet.newest(vehicle, Status), self.fleet.newest(vehicle, Reference)
        flown = status is not None and status.origin_ned_m is not None and reference is not None
        keys = trajectory(self.fleet, self.watched, vehicle)
        return self._planner.told(vehicle, keys, reference.trajectory_s if flown and reference else 0.0)

    def about(self, vehicle: str, now_ns: int) -> dict[str, object]:
        """What a page that shows this vehicle is told of it."""
        return told(self.fleet, self.watched, vehicle, now_ns)

    def _heard(self, heard: Heard) -> None:
        record = heard.record
        if heard.answered or not isinstance(record, State | TrackingError | Timing):
            return
        vehicle = self._vehicle(heard.vehicle)
        if isinstance(record, TrackingError):
            if not vehicle.peak_m >= record.norm_m:
                vehicle.peak_m = record.norm_m
        elif isinstance(record, Timing):
            vehicle.lateness.take(record)
        else:
            vehicle.offset_ns = heard.arrived_ns - record.t_ns

    def _row(self, seen: Seen, now_ns: int) -> None:
        vehicle = self._vehicles.get(seen.vehicle)
        live = seen.contact is Contact.LIVE
        if vehicle is None:
            return
        if seen.quiet_s >= MISSED_S:
            vehicle.recalled = False  # its events of meanwhile are asked for when it is back
        if not live and not vehicle.live:
            return

        def newest(kind: type[Record]) -> Record | None:
            return self.fleet.fresh(seen.vehicle, kind, now_ns, FRESH_NS.get(kind, FRESH_OTHERS_NS))

        late_s = nan if newest(Timing) is None else vehicle.lateness.lately_s
        made = row(now_ns, newest, vehicle.peak_m, late_s) if live else nothing(now_ns)
        self._drop_old(seen.vehicle, vehicle, now_ns)
        vehicle.live, vehicle.last_ns = live, now_ns
        vehicle.first_ns = now_ns if vehicle.first_ns is None else vehicle.first_ns
        vehicle.ring.add(made)
        self.rows[seen.vehicle] = made

    def _drop_old(self, name: str, vehicle: _Rows, now_ns: int) -> None:
        """What was kept of a vehicle that is back after longer than rows are kept."""
        if vehicle.last_ns is not None and now_ns - vehicle.last_ns > KEPT_S * 1_000_000_000:
            vehicle.ring.clear()
            vehicle.first_ns = vehicle.last_ns = None
            self.renewed.add(name)

    def _history(self, history: History, now_ns: int) -> None:
        """Older rows, once; a vehicle that comes back has those of its absence from nobody."""
        if not history.records:
            return
        vehicle = self._vehicle(history.vehicle)
        vehicle.recalled = True
        self._asked.pop(history.vehicle, None)
        self._drop_old(history.vehicle, vehicle, now_ns)
        events = [record for record in history.records if isinstance(record, Event)]
        self.fleet.recall(history.vehicle, events[-EVENTS_MAX:], history.arrived_ns)
        before_ns = now_ns if vehicle.first_ns is None else vehicle.first_ns
        if now_ns - before_ns > KEPT_S * 1_000_000_000:
            return
        last_ns = history.records[-1].t_ns
        offset_ns = history.arrived_ns - last_ns if vehicle.offset_ns is None else vehicle.offset_ns
        rows = of_history(history.records, offset_ns, before_ns, Lateness())
        if rows:
            vehicle.ring.precede(rows)
            vehicle.first_ns = before_ns - KEPT_S * 1_000_000_000  # nothing goes before them
            self.renewed.add(history.vehicle)

    def _vehicle(self, name: str) -> _Rows:
        known = self._vehicles.pop(name, None)
        if known is None:
            if len(self._vehicles) >= RINGS_MAX:
                del self._vehicles[next(iter(self._vehicles))]
            known = _Rows()
        self._vehicles[name] = known  # the one unheard for longest is first
        return known
