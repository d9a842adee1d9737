"""The figures of a flight, from all of its samples. Keys and units are those of `--json`."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from guidance.figures import CONVERGED_M, SETTLED_TIME_CONSTANTS, tracking_figures
from guidance.mavlink.profiles import Handling
from guidance.report.columns import Columns, Floats
from guidance.report.flight import Flight, law_streams

#: Converged means below this for good, m, unless it is said otherwise: what each class is held against.
CONVERGED_BY_CLASS_M: Final = {
    Handling.RATES: CONVERGED_M,
    Handling.GROUND: 0.3,
    Handling.VELOCITY: 0.5,
    Handling.AIRPLANE: 3.0,
}
#: Slower than this over ground, the reference has no course: the last one holds, m/s.
_COURSE_M_S: Final = 1e-6


class Figures(msgspec.Struct, frozen=True, kw_only=True):
    """One stretch of tracking, judged; None where there was nothing to judge.

    `settled_*` count from five time constants beta/k after convergence; `all_*` from the first setpoint.
    """

    tracked_s: float
    flown_m: float
    converged_within_m: float
    converged_s: float | None
    settled_rms_m: float | None
    settled_p95_m: float | None
    settled_max_m: float | None
    settled_along_rms_m: float | None
    settled_along_p95_m: float | None
    settled_along_max_m: float | None
    settled_cross_rms_m: float | None
    settled_cross_p95_m: float | None
    settled_cross_max_m: float | None
    settled_vertical_rms_m: float | None
    settled_vertical_p95_m: float | None
    settled_vertical_max_m: float | None
    all_rms_m: float | None
    all_p95_m: float | None
    all_max_m: float | None
    setpoints: int
    setpoint_rate_hz: float | None
    setpoint_gap_max_s: float | None
    setpoint_gap_p95_s: float | None
    saturated_part: float | None
    settled_saturated_part: float | None
    singular_part: float | None
    waited_s: float | None
    attitude_age_median_s: float | None
    attitude_age_p95_s: float | None
    position_age_median_s: float | None
    position_age_p95_s: float | None
    round_trip_median_s: float | None
    round_trip_p95_s: float | None
    loop_late_max_s: float | None
    packets_lost_part: float | None
    records_dropped: int


class Row(NamedTuple):
    """How a figure is shown: its label and unit, and what a value is multiplied by for that unit."""

    key: str
    label: str
    unit: str
    factor: float = 1.0


GROUPS: Final[dict[str, tuple[Row, ...]]] = {
    "Flight": (
        Row("tracked_s", "tracked for", "s"),
        Row("flown_m", "length flown", "m"),
        Row("waited_s", "reference waited", "s"),
    ),
    "Convergence": (
        Row("converged_within_m", "converged means below, for good", "m"),
        Row("converged_s", "converged after", "s"),
    ),
    "Error, settled": (
        Row("settled_rms_m", "RMS", "m"),
        Row("settled_p95_m", "95th percentile", "m"),
        Row("settled_max_m", "maximum", "m"),
        Row("settled_along_rms_m", "along track, RMS", "m"),
        Row("settled_along_p95_m", "along track, 95th percentile", "m"),
        Row("settled_along_max_m", "along track, maximum", "m"),
        Row("settled_cross_rms_m", "cross track, RMS", "m"),
        Row("settled_cross_p95_m", "cross track, 95th percentile", "m"),
        Row("settled_cross_max_m", "cross track, maximum", "m"),
        Row("settled_vertical_rms_m", "vertical, RMS", "m"),
        Row("settled_vertical_p95_m", "vertical, 95th percentile", "m"),
        Row("settled_vertical_max_m", "vertical, maximum", "m"),
    ),
    "Error, from the first setpoint on": (
        Row("all_rms_m", "RMS", "m"),
        Row("all_p95_m", "95th percentile", "m"),
        Row("all_max_m", "maximum", "m"),
    ),
    "Setpoints": (
        Row("setpoints", "sent while tracking", ""),
        Row("setpoint_rate_hz", "rate", "Hz"),
        Row("setpoint_gap_p95_s", "interval, 95th percentile", "ms", 1e3),
        Row("setpoint_gap_max_s", "longest gap", "ms", 1e3),
        Row("saturated_part", "at a limit", "%", 100.0),
        Row("settled_saturated_part", "at a limit, settled", "%", 100.0),
        Row("singular_part", "field without a direction", "%", 100.0),
    ),
    "Delays and link": (
        Row("attitude_age_median_s", "age of the attitude, median", "ms", 1e3),
        Row("attitude_age_p95_s", "age of the attitude, 95th percentile", "ms", 1e3),
        Row("position_age_median_s", "age of the position, median", "ms", 1e3),
        Row("position_age_p95_s", "age of the position, 95th percentile", "ms", 1e3),
        Row("round_trip_median_s", "round trip, median", "ms", 1e3),
        Row("round_trip_p95_s", "round trip, 95th percentile", "ms", 1e3),
        Row("loop_late_max_s", "control loop late, maximum (run)", "ms", 1e3),
        Row("packets_lost_part", "packets lost (run)", "%", 100.0),
        Row("records_dropped", "records dropped (run)", ""),
    ),
}


def judged(flight: Flight, stretch: tuple[int, int], converged_m: float | None = None) -> Figures:
    """The figures of one stretch of the flight; `converged_m` is the class's own unless given."""
    within_m = CONVERGED_BY_CLASS_M[flight.handling] if converged_m is None else converged_m
    columns = flight.columns
    rows = np.arange(*stretch)[np.isfinite(columns.norm_m[slice(*stretch)])]
    norm = columns.norm_m[rows]
    since_s = (columns.acts_ns[rows] - columns.acts_ns[rows[0]]) * 1e-9
    time_constant_s = flight.config.law.beta / flight.config.law.k
    tracking = tracking_figures(
        list(zip(since_s.tolist(), norm.tolist(), strict=True)), time_constant_s, within_m
    )
    settled = np.zeros(len(rows), dtype=bool)
    if tracking.converged_s is not None:
        settled = since_s >= tracking.converged_s + SETTLED_TIME_CONSTANTS * time_constant_s
    track = along_cross_up(columns.error_ned_m[rows], columns.reference_velocity_ned_m_s[rows])[settled]
    gaps_s = intervals_s(flight, stretch)
    saturated = columns.saturated[rows]
    around = flight.links.t_ns
    during = (around >= columns.sent_ns[rows[0]]) & (around <= columns.sent_ns[rows[-1]])
    link, timing = flight.last_link, flight.timing
    waited = columns.handling.get("waited_s")
    return Figures(
        tracked_s=float(columns.sent_ns[rows[-1]] - columns.sent_ns[rows[0]]) * 1e-9,
        flown_m=_length_m(columns, rows),
        converged_within_m=within_m,
        converged_s=tracking.converged_s,
        settled_rms_m=tracking.rms_error_m,
        settled_p95_m=_percentile(norm[settled], 95.0),
        settled_max_m=tracking.max_error_m,
        settled_along_rms_m=_rms(track[:, 0]),
        settled_along_p95_m=_percentile(abs(track[:, 0]), 95.0),
        settled_along_max_m=_percentile(abs(track[:, 0]), 100.0),
        settled_cross_rms_m=_rms(track[:, 1]),
        settled_cross_p95_m=_percentile(abs(track[:, 1]), 95.0),
        settled_cross_max_m=_percentile(abs(track[:, 1]), 100.0),
        settled_vertical_rms_m=_rms(track[:, 2]),
        settled_vertical_p95_m=_percentile(abs(track[:, 2]), 95.0),
        settled_vertical_max_m=_percentile(abs(track[:, 2]), 100.0),
        all_rms_m=_rms(norm),
        all_p95_m=_percentile(norm, 95.0),
        all_max_m=_percentile(norm, 100.0),
        setpoints=len(rows),
        setpoint_rate_hz=float(len(gaps_s) / gaps_s.sum()) if gaps_s.sum() > 0.0 else None,
        setpoint_gap_max_s=_percentile(gaps_s, 100.0),
        setpoint_gap_p95_s=_percentile(gaps_s, 95.0),
        saturated_part=_mean(saturated),
        settled_saturated_part=_mean(saturated[settled]),
        singular_part=_mean(columns.singular[rows]),
        waited_s=None if waited is None else _last(waited[rows]),
        attitude_age_median_s=_percentile(columns.attitude_age_s[rows], 50.0),
        attitude_age_p95_s=_percentile(columns.attitude_age_s[rows], 95.0),
        position_age_median_s=_percentile(columns.position_age_s[rows], 50.0),
        position_age_p95_s=_percentile(columns.position_age_s[rows], 95.0),
        round_trip_median_s=_percentile(flight.links.round_trip_s[during], 50.0),
        round_trip_p95_s=_percentile(flight.links.round_trip_s[during], 95.0),
        loop_late_max_s=None if timing is None else timing.lateness_max_s,
        packets_lost_part=None if link is None else _part(link.lost, link.lost + link.received),
        records_dropped=flight.dropped,
    )


def along_cross_up(error_ned_m: Floats, reference_velocity_ned_m_s: Floats) -> Floats:
    """The error (n, 3) in m ahead of the reference, right of its track and above it; they add up to its norm.

    Ahead and right are level, by the reference's course over ground. Where it has none (it climbs straight
    up, or stands) the course before holds, at first the next; without any it is north.
    """
    course = reference_velocity_ned_m_s[:, :2]
    speed = np.hypot(course[:, 0], course[:, 1])
    moving = np.flatnonzero(speed > _COURSE_M_S)
    if len(moving):
        last = np.searchsorted(moving, np.arange(len(course)), side="right") - 1
        which = moving[np.maximum(last, 0)]
        north, east = (course[which] / speed[which, None]).T
    else:
        north, east = np.ones(len(course)), np.zeros(len(course))
    e_north, e_east, e_down = error_ned_m.T
    return np.column_stack((e_north * north + e_east * east, e_east * north - e_north * east, -e_down))


def intervals_s(flight: Flight, stretch: tuple[int, int]) -> Floats:
    """The times between the setpoints of a stretch, s; none across a time in which the law was not to fly."""
    sent = flight.columns.sent_ns[slice(*stretch)]
    left = np.array([span.start_ns for span in flight.spans if not law_streams(span.state)], dtype=np.int64)
    between = np.searchsorted(left, sent[1:], side="right") - np.searchsorted(left, sent[:-1], side="right")
    found: Floats = np.diff(sent)[between == 0] * 1e-9
    return found


def as_json(flights: list[tuple[Flight, list[Figures]]]) -> dict[str, Any]:
    """What `--json` prints: each log with its flights and their figures, in SI units."""
    return {
        "logs": [
            {
                "log": str(flight.path),
                "vehicle": flight.session.vehicle,
                "profile": flight.session.profile,
                "guidance_version": flight.session.guidance_version,
                "session_id": flight.session.session_id,
                "unix_start_s": (flight.zero_ns + flight.session.unix_offset_ns) * 1e-9,
                "incomplete": flight.incomplete,
                "flights": [msgspec.to_builtins(one) for one in figures],
            }
            for flight, figures in flights
        ]
    }


def shown(value: float | None, row: Row) -> str:
    """A figure as it stands in the table: four digits that count, a dash for none."""
    if value is None:
        return "\N{EN DASH}"
    if isinstance(value, int):
        return str(value)
    return f"{value * row.factor:.4g}"


def _length_m(columns: Columns, rows: NDArray[np.int64]) -> float:
    """The way that was flown, of the speeds: of noisy positions the sum of steps would be of the noise."""
    speed = np.linalg.norm(columns.velocity_ned_m_s[rows], axis=1)
    elapsed_s = np.diff(columns.sent_ns[rows]) * 1e-9
    return float(np.nansum(0.5 * (speed[1:] + speed[:-1]) * elapsed_s))


def _part(some: int, of: int) -> float | None:
    """None for counts that no service has."""
    return some / max(of, 1) if 0 <= some <= of else None


def _finite(values: Floats) -> Floats:
    return values[np.isfinite(values)]


def _rms(values: Floats) -> float | None:
    values = _finite(values)
    return float(np.sqrt(np.mean(values * values))) if len(values) else None


def _percentile(values: Floats, percent: float) -> float | None:
    """The smallest of the values that so many percent of all do not exceed."""
    values = _finite(values)
    return float(np.percentile(values, percent, method="inverted_cdf")) if len(values) else None


def _mean(flags: NDArray[np.bool_]) -> float | None:
    return float(flags.mean()) if len(flags) else None


def _last(values: Floats) -> float | None:
    values = _finite(values)
    return float(values[-1]) if len(values) else None
