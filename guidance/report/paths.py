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
#: Of events of one kind the next is marked this part of the flight later: a row of them would hide the path.
_MARKS_APART: Final = 20
_MARGIN: Final = 0.06
#: No side of the box is shorter than this part of the longest.
_FLATTEST: Final = 0.25
#: Nor holds it less than this part of the longest, so that noise on a flat flight does not fill it.
_THINNEST: Final = 0.1


class Mark(NamedTuple):
    """Something happened here: east, north, up, m; `after_s` since tracking began."""

    place: tuple[float, float, float]
    after_s: float
    level: str
    text: str


class Box(NamedTuple):
    """From and to of east, north and height, m, and the sides of the box that is drawn, the longest 1.

    To scale, but for a side that would be too flat to see.
    """

    ranges: list[list[float]]
    sides: list[float]


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


def fences_of(shown: Sequence[Shown]) -> Floats | None:
    """The outlines of all logs' fences that differ, NaN between them; None if there is none."""
    outlines = [fence_outline(one.flight) for one in shown]
    apart = {outline.tobytes(): outline for outline in outlines if outline is not None}
    parts = [part for outline in apart.values() for part in (outline, np.full((1, 2), np.nan))]
    return np.concatenate(parts[:-1]) if parts else None


def lowest_m(paths: Sequence[Path3]) -> float:
    """The least height that was flown, 0 if none is known."""
    heights = [float(np.nanmin(path.flown[:, 2])) for path in paths if len(path.flown)]
    return min(heights, default=0.0)


def box_of(places: Sequence[Floats], fence: Floats | None) -> Box:
    """What holds these places (n, 3) and the fence's corners, with a margin."""
    seen = [place for place in places if len(place)]
    least = np.nanmin([np.nanmin(place, axis=0) for place in seen], axis=0) if seen else -np.ones(3)
    most = np.nanmax([np.nanmax(place, axis=0) for place in seen], axis=0) if seen else np.ones(3)
    if fence is not None:
        least[:2] = np.minimum(least[:2], np.nanmin(fence, axis=0))
        most[:2] = np.maximum(most[:2], np.nanmax(fence, axis=0))
    middle, half = 0.5 * (least + most), 0.5 * (most - least)
    half = (1.0 + 2.0 * _MARGIN) * np.maximum(half, max(_THINNEST * half.max(), 0.5))
    least, most = middle - half, middle + half
    sides = np.maximum((most - least) / (most - least).max(), _FLATTEST)
    ranges = [[low, high] for low, high in zip(least.tolist(), most.tolist(), strict=True)]
    return Box(ranges, sides.tolist())


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
    apart_ns = int(sent[-1] - sent[0]) // _MARKS_APART
    last_ns: dict[str, int] = {}
    marks = []
    for event in flight.events:
        at = int(np.searchsorted(sent, event.t_ns))
        if event.level in _MARKED and 0 < at < len(sent) and np.isfinite(places[at]).all():
            if event.code in last_ns and event.t_ns - last_ns[event.code] < apart_ns:
                continue
            last_ns[event.code] = event.t_ns
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
