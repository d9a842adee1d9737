"""Several logs read and judged, each with a name that fits beside an axis."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from guidance.printable import printable
from guidance.report.flight import Flight, read_flight
from guidance.report.judged import judged
from guidance.report.panels import Shown
from guidance.telemetry.log import Passed

#: A name that fits beside an axis.
_SHORT = 20


def read_all(logs: Sequence[Path], converged_m: float | None, passed: Passed | None = None) -> list[Shown]:
    """Each log with its figures, in order; raises what `read_flight` does."""
    read = []
    for path in logs:
        flight = read_flight(path, passed)
        read.append((flight, [judged(flight, stretch, converged_m) for stretch in flight.stretches]))
    labels = labels_of([flight for flight, _ in read])
    return [Shown(label, *one) for label, one in zip(labels, read, strict=True)]


def labels_of(flights: Sequence[Flight]) -> list[str]:
    """The vehicle's name for one flight; for several the files' names where they are short, else letters."""
    if len(flights) == 1:
        return [printable(flights[0].session.vehicle)]
    names = [printable(flight.path.stem) for flight in flights]
    if len(set(names)) == len(names) and max(map(len, names)) <= _SHORT:
        return names
    return [
        f"{chr(ord('A') + i % 26)}{i // 26 or ''} {printable(flight.session.vehicle)}"
        for i, flight in enumerate(flights)
    ]
