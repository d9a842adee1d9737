"""What is drawn, whoever draws it: panels of lines over time and of histograms, units on every axis."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from guidance.config import profile_of
from guidance.mavlink.profiles import Asked, Handling, Profile
from guidance.records import Timing
from guidance.report.columns import Columns, Floats, known
from guidance.report.flight import Flight
from guidance.report.judged import Figures, along_cross_up, intervals_s
from guidance.report.thin import thin

TIME: Final = "time since tracking began, s"
_SATURATION_S: Final = 1.0
_BINS: Final = 60
#: A histogram is at least so wide.
_LEAST_MS: Final = 1.0
#: More often no loop turns.
_COUNT_MOST: Final = 10**15
_MS: Final = 1e3


class Shown(NamedTuple):
    """A flight of the report: its label, and the figures of each of its stretches."""

    label: str
    flight: Flight
    figures: list[Figures]


class Line(NamedTuple):
    """`role` gives its colour: demanded, sent, measured, other, or the number of its log."""

    name: str
    x: Floats
    y: Floats
    role: str | int


class Panel(NamedTuple):
    """One pair of axes."""

    title: str
    x_label: str
    y_label: str
    lines: list[Line]
    log_y: bool = False
    #: The lowest value shown on a logarithmic axis; free unless given.
    floor: float | None = None


class Section(NamedTuple):
    """Panels that belong together: those in one column share their x axis, which is time."""

    key: str
    title: str
    caption: str
    panels: list[Panel]
    columns: int = 1


def sections_of(shown: Sequence[Shown]) -> list[Section]:
    """All that is drawn over time, and the histograms, in the order of the page."""
    several = len(shown) > 1
    made = [_errors(shown)]
    for i, one in enumerate(shown):
        ending = f": {one.label}" if several else ""
        made.append(
            Section(
                f"controls-{i + 1}" if several else "controls",
                f"Controls{ending}",
                "Demanded by the law or the handling, sent after all limits, and measured by the vehicle.",
                list(controls(one.flight)),
            )
        )
    made.append(_saturation(shown))
    made.append(_histograms(shown))
    return made


def rows_of(flight: Flight) -> slice:
    """The rows from the first that tracked to the last."""
    return slice(flight.stretches[0][0], flight.stretches[-1][1])


def _line(name: str, x: Floats, y: Floats, role: str | int) -> Line:
    known = np.isfinite(y)
    return Line(name, *thin(x[known], y[known]), role)


def _errors(shown: Sequence[Shown]) -> Section:
    names = (
        ("distance from the reference |e| (logarithmic)", "|e|, m"),
        ("along track (ahead is positive)", "along, m"),
        ("cross track (right is positive)", "cross, m"),
        ("vertical (above is positive)", "vertical, m"),
    )
    panels = [Panel(title, TIME, unit, [], log_y=unit.startswith("|e|")) for title, unit in names]
    for i, one in enumerate(shown):
        flight, rows = one.flight, rows_of(one.flight)
        columns = flight.columns
        x = flight.seconds(columns.sent_ns[rows])
        track = along_cross_up(columns.error_ned_m[rows], columns.reference_velocity_ned_m_s[rows])
        for panel, y in zip(panels, (columns.norm_m[rows], *track.T), strict=True):
            panel.lines.append(_line(one.label, x, y, i))
    if not any(line.y.any() for line in panels[-1].lines):  # it moves in the plane
        panels.pop()
    return Section(
        "error", "Error", "Position minus reference, at the instant that each setpoint acts.", panels
    )


def controls(flight: Flight) -> Iterator[Panel]:
    """What was demanded, sent and measured, by the class of the vehicle and what it is asked for."""
    made = _drawn(flight.columns, profile_of(flight.config))
    rows = rows_of(flight)
    x = flight.seconds(flight.columns.sent_ns[rows])
    for title, unit, lines in made:
        drawn = [_line(role, x, y[rows], role) for role, y in lines.items()]
        yield Panel(title, TIME, unit, [line for line in drawn if len(line.x)])


_Drawn = tuple[str, str, dict[str, Floats]]


def _drawn(c: Columns, profile: Profile) -> list[_Drawn]:
    """First what is sent, then what is only demanded and measured."""
    rates = [_rate(c, 0), _rate(c, 1), _rate(c, 2)]
    match profile.handling, profile.asked:
        case Handling.RATES, _:
            return [*rates, _speed(c), _thrust(c)]
        case Handling.GROUND, Asked.VELOCITY_YAW_RATE:  # its bearing asks for the yaw rate
            return [*_velocity(c)[:2], _unsent(_rate(c, 2)), _unsent(_speed(c))]
        case Handling.GROUND, _:
            return [_rate(c, 2), _speed(c), _thrust(c)]
        case Handling.AIRPLANE, Asked.RATES_THROTTLE:
            return [*rates, _thrust(c, "throttle"), *map(_unsent, _attitude(c)), _airspeed(c)]
        case Handling.AIRPLANE, _:
            return [*_attitude(c), _thrust(c, "throttle"), _airspeed(c)]
        case _, Asked.RATES_THROTTLE:
            turning = [_without(rate, "demanded") for rate in rates[:2]]  # it leans as its velocity needs
            return [*turning, rates[2], _thrust(c), *map(_unsent, _velocity(c))]
        case _:
            return [*_velocity(c), _rate(c, 2)]


def _unsent(drawn: _Drawn) -> _Drawn:
    return _without(drawn, "sent")


def _without(drawn: _Drawn, role: str) -> _Drawn:
    title, unit, lines = drawn
    return title, unit, {other: y for other, y in lines.items() if other != role}


def _thrust(c: Columns, name: str = "thrust") -> _Drawn:
    return f"{name} (part of full)", name, {"sent": c.thrust}


def _speed(c: Columns) -> _Drawn:
    forward = np.einsum("ni,ni->n", c.velocity_ned_m_s, nose(c.attitude_wxyz))
    lines = {"demanded": c.demanded_speed_m_s, "sent": c.speed_m_s, "measured": forward}
    return "forward speed (measured: along the nose)", "speed, m/s", lines


def _rate(c: Columns, axis: int) -> _Drawn:
    name = ("roll", "pitch", "yaw")[axis]
    lines = {
        "demanded": c.demanded_rates_frd_rad_s[:, axis],
        "sent": c.rates_frd_rad_s[:, axis],
        "measured": c.measured_rates_frd_rad_s[:, axis],
    }
    return f"{name} rate", f"{name}, rad/s", lines


def _attitude(c: Columns) -> list[_Drawn]:
    sent, measured = np.degrees(bank_pitch(c.asked_attitude_wxyz)), np.degrees(bank_pitch(c.attitude_wxyz))
    made: list[_Drawn] = []
    for column, name in enumerate(("bank", "pitch")):
        demanded = np.degrees(_handled(c, f"{name}_asked_rad"))
        lines = {"demanded": demanded, "sent": sent[:, column], "measured": measured[:, column]}
        made.append((name, f"{name}, deg", lines))
    return made


def _airspeed(c: Columns) -> _Drawn:
    lines = {"demanded": _handled(c, "airspeed_asked_m_s"), "measured": _handled(c, "airspeed_m_s")}
    return "true airspeed", "airspeed, m/s", lines


def _velocity(c: Columns) -> list[_Drawn]:
    made: list[_Drawn] = []
    for axis, name in enumerate(("north", "east", "down")):
        lines = {
            "demanded": _handled(c, f"wanted_ned_m_s.{axis}"),
            "sent": c.asked_velocity_ned_m_s[:, axis],
            "measured": c.velocity_ned_m_s[:, axis],
        }
        made.append((f"velocity {name}", f"{name}, m/s", lines))
    return made


def _handled(c: Columns, field: str) -> Floats:
    """Of the class's own record; NaN in a log that has none."""
    return c.handling.get(field, np.full(len(c.thrust), np.nan))


def bank_pitch(attitude_wxyz: Floats) -> Floats:
    """Roll and pitch (n, 2) of the sequence yaw, pitch, roll, rad."""
    w, x, y, z = attitude_wxyz.T
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return np.column_stack((roll, np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))))


def nose(attitude_wxyz: Floats) -> Floats:
    """The body's forward axis b1 in NED (n, 3)."""
    w, x, y, z = attitude_wxyz.T
    return np.column_stack((1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)))


def _saturation(shown: Sequence[Shown]) -> Section:
    panel = Panel("setpoints at a limit", TIME, "part of each second, %", [])
    of_airplanes = {"bank": "bank_saturated", "pitch": "pitch_saturated", "throttle": "throttle_saturated"}
    for i, one in enumerate(shown):
        columns, rows = one.flight.columns, rows_of(one.flight)
        x = one.flight.seconds(columns.sent_ns[rows])
        law = np.where(np.isfinite(columns.norm_m[rows]), columns.saturated[rows], np.nan)
        name = one.label if len(shown) > 1 else "any"
        panel.lines.append(_line(name, *_each_second(x, law), i))
        for n, (name, field) in enumerate(of_airplanes.items()):
            if field in columns.handling and len(shown) == 1:
                line = _line(name, *_each_second(x, columns.handling[field][rows]), n + 1)
                panel.lines.append(line)
    caption = "Of the setpoints of each second, those that a limit changed."
    return Section("saturation", "Saturation", caption, [panel])


def _each_second(x: Floats, flags: Floats) -> tuple[Floats, Floats]:
    """The middle of each second, and of its flags the part that is set, %."""
    known = np.isfinite(flags)
    second = np.floor(x[known] / _SATURATION_S).astype(np.int64)
    which, first, count = np.unique(second, return_index=True, return_counts=True)
    part = np.zeros(len(which))
    if len(first):
        part[:] = 100.0 * np.add.reduceat(flags[known], first) / count
    middle = np.asarray((which + 0.5) * _SATURATION_S, dtype=np.float64)
    return middle, part


def _histograms(shown: Sequence[Shown]) -> Section:
    panels = []
    late = [_lateness(one.flight.timing) for one in shown]
    panels.append(_histogram("control loop late", "late, ms", shown, late))
    for title, samples in _samples([one.flight for one in shown]).items():
        known = [values[np.isfinite(values)] * _MS for values in samples]
        everything = np.concatenate(known)
        most_ms = (
            max(1.25 * float(np.percentile(everything, 99.9)), _LEAST_MS) if len(everything) else _LEAST_MS
        )
        edges = np.linspace(0.0, most_ms, _BINS + 1)
        each = [np.histogram(np.minimum(values, most_ms), edges)[0].astype(np.float64) for values in known]
        bars = [(edges, counts) for counts in each]
        panels.append(_histogram(title, f"{title}, ms", shown, bars))
    caption = (
        "Parts of all samples on a logarithmic scale, so that what is rare shows; the last bar also holds "
        "all that is larger. Lateness is of the whole run, the round trip that of TIMESYNC."
    )
    return Section(
        "timing", "Loop timing and link quality", caption, [p for p in panels if p.lines], columns=3
    )


def _lateness(timing: Timing | None) -> tuple[Floats, Floats]:
    """Edges (ms) of the bars and their counts, to the last that has any; none for what no service wrote."""
    if timing is None or len(timing.lateness_counts) != len(timing.lateness_edges_s) + 1:
        return np.empty(0), np.empty(0)
    last_s = max(timing.lateness_max_s, 2.0 * max(timing.lateness_edges_s, default=0.0))
    edges = known(np.asarray((0.0, *timing.lateness_edges_s, last_s))) * _MS
    counts = np.asarray([float(max(-1, min(count, _COUNT_MOST))) for count in timing.lateness_counts])
    if not (np.diff(edges) > 0.0).all() or (counts < 0.0).any() or not counts.any():
        return np.empty(0), np.empty(0)
    most = int(np.flatnonzero(counts)[-1]) + 1
    return edges[: most + 1], counts[:most]


def _samples(flights: Sequence[Flight]) -> dict[str, list[Floats]]:
    """What is counted while tracking, of each flight, s."""
    found: dict[str, list[Floats]] = {}
    for flight in flights:
        rows = np.concatenate([np.arange(*part) for part in flight.stretches])
        intervals = np.concatenate([intervals_s(flight, part) for part in flight.stretches])
        for title, values in (
            ("interval between setpoints", intervals),
            ("age of the attitude", flight.columns.attitude_age_s[rows]),
            ("age of the position", flight.columns.position_age_s[rows]),
            ("round trip", flight.links.round_trip_s),
        ):
            found.setdefault(title, []).append(values)
    return found


def _histogram(title: str, x_label: str, shown: Sequence[Shown], bars: list[tuple[Floats, Floats]]) -> Panel:
    """The outline of each log's bars, in % of its samples; half of one sample is the floor."""
    floor = min((50.0 / counts.sum() for _, counts in bars if counts.any()), default=1.0)
    lines = []
    for i, (edges, counts) in enumerate(bars):
        if counts.any():
            percent = np.maximum(100.0 * counts / counts.sum(), floor)
            outline = np.concatenate(([floor], np.repeat(percent, 2), [floor]))
            lines.append(Line(shown[i].label, np.repeat(edges, 2), outline, i))
    return Panel(title, x_label, "part of all, %", lines, log_y=True, floor=floor)
