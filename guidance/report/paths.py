"""Where it flew: reference, path and marks of a flight in east, north and height, thinned for display."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from guidance.records import Level
from guidance.report.columns import Floats
from guidance.report.flight import Flight
from guidance.report.panels import Shown, rows_of
from guidance.report.thin import thin_path

#: Events below this are told in the table alone.
_MARKED: Final = frozenset({Level.WARNING, Level.ERROR, Level.CRITICAL})
#: So many marks at most; a flight with more has them in the table.
MARKS_MOST: Final = 200


class Mark(NamedTuple):
    """Something happened here: east, north, up, m; `after_s` since tracking began."""

    place: tuple[float, float, float]
    after_s: float
    level: str
    text: str


class Path3(NamedTuple):
    """One log's paths, each (n, 3) east, north, up, m; NaN between flights."""

    label: str
    reference: Floats
    flown: Floats
    start: tuple[float, float, float]
    marks: list[Mark]


def paths_of(shown: Sequence[Shown]) -> list[Path3]:
    """The paths of each log."""
    return [_paths(one.label, one.flight) for one in shown]


def fence_outline(flight: Flight) -> Floats | None:
    """The fence's corners (n, 2) east, north, closed; None if there is no polygon in the local frame."""
    fence = flight.fence
    if fence is None or not fence.corners:
        return None
    corners = np.array([*fence.corners, fence.corners[0]], dtype=np.float64)
    return corners[:, ::-1]


def _paths(label: str, flight: Flight) -> Path3:
    columns = flight.columns
    references: list[Floats] = []
    flown: list[Floats] = []
    share = max(len(flight.stretches), 1)
    for start, stop in flight.stretches:
        for places, found in ((columns.reference_ned_m, references), (columns.position_ned_m, flown)):
            part = places[start:stop]
            known = part[np.isfinite(part).all(axis=1)]
            if len(known):
                found += [thin_path(_east_north_up(known), 600 // share + 1), np.full((1, 3), np.nan)]
    begin: Floats = flown[0][0] if flown else np.full(3, np.nan)
    return Path3(label, _joined(references), _joined(flown), _triple(begin), _marks(flight))


def _marks(flight: Flight) -> list[Mark]:
    columns, rows = flight.columns, rows_of(flight)
    sent, places = columns.sent_ns[rows], _east_north_up(columns.position_ned_m[rows])
    marks = []
    for event in flight.events:
        at = int(np.searchsorted(sent, event.t_ns))
        if event.level in _MARKED and 0 < at < len(sent) and np.isfinite(places[at]).all():
            after_s = (event.t_ns - flight.zero_ns) * 1e-9
            marks.append(Mark(_triple(places[at]), after_s, str(event.level), event.text))
    return marks[:MARKS_MOST]


def _east_north_up(ned: Floats) -> Floats:
    return np.column_stack((ned[:, 1], ned[:, 0], -ned[:, 2]))


def _joined(parts: list[Floats]) -> Floats:
    return np.concatenate(parts[:-1]) if parts else np.empty((0, 3))


def _triple(place: Floats) -> tuple[float, float, float]:
    east, north, up = place.tolist()
    return east, north, up
