"""The supervisor's states and the events over time, for whoever draws them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from guidance.report import looks
from guidance.report.panels import Shown
from guidance.report.paths import MARKS_MOST

#: So much before the first and behind the last setpoint of the law is shown, s.
_AROUND_S: Final = 30.0


class Bar(NamedTuple):
    """A state, from and to, s since tracking began."""

    state: str
    reason: str
    from_s: float
    to_s: float


class Dot(NamedTuple):
    """An event."""

    at_s: float
    level: str
    code: str
    text: str


class Timeline(NamedTuple):
    """One log's. More events than can be seen are left to the table."""

    label: str
    bars: list[Bar]
    dots: list[Dot]


def kinds_of(timelines: Sequence[Timeline]) -> dict[str, str]:
    """The colours of the states that are shown, each with the names of its states, for a legend."""
    kinds: dict[str, dict[str, None]] = {}
    for line in timelines:
        for bar in line.bars:
            kinds.setdefault(looks.shade(bar.state), {})[bar.state] = None
    return {shade: ", ".join(states) for shade, states in kinds.items()}


def timeline_of(one: Shown) -> Timeline:
    """What is shown of a flight: from a little before its first setpoint to a little behind its last."""
    flight = one.flight
    last_s = (int(flight.columns.sent_ns[flight.stretches[-1][1] - 1]) - flight.zero_ns) * 1e-9 + _AROUND_S

    def seconds(t_ns: int) -> float:
        return (t_ns - flight.zero_ns) * 1e-9

    bars = [
        Bar(
            span.state,
            span.reason,
            max(seconds(span.start_ns), -_AROUND_S),
            min(seconds(span.end_ns), last_s),
        )
        for span in flight.spans
        if seconds(span.end_ns) > -_AROUND_S and seconds(span.start_ns) < last_s
    ]
    dots = [
        Dot(seconds(event.t_ns), str(event.level), event.code, event.text)
        for event in flight.events
        if -_AROUND_S <= seconds(event.t_ns) <= last_s
    ]
    if len(dots) > MARKS_MOST:
        dots = [dot for dot in dots if dot.level not in ("info", "notice")][:MARKS_MOST]
    return Timeline(one.label, bars, dots)
