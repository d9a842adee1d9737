"""Which setpoint answers which state, how long that took, and the figures that are made of it.

The states go round a few headings in turn, and each setpoint tells the heading that it was computed from: so
one that is repeated, or filled in by a timer, is known for what it is.
"""

from __future__ import annotations

import math
import statistics
from bisect import bisect_right
from collections.abc import Sequence
from typing import NamedTuple


class Stamp(NamedTuple):
    """A state went out, or a setpoint came in, at `t_ns` of the monotonic clock, of the i-th heading."""

    t_ns: int
    heading: int


class Flight(NamedTuple):
    """The states that were sent, when, and the setpoints that came, in order.

    `late_ns` is how late the autopilot itself sent each state.
    """

    states: list[bytes]
    sent: list[Stamp]
    came: list[Stamp]
    late_ns: list[int]


def answer_times_ns(sent: Sequence[Stamp], came: Sequence[Stamp]) -> list[int | None]:
    """For each state, the time to the first setpoint that was computed from it or from a newer one, ns.

    A setpoint answers the newest state of its heading that was sent before it came. One that answers nothing
    newer than the one before is a repetition, and is passed over. None: never answered.
    """
    instants = [stamp.t_ns for stamp in sent]
    found: list[int | None] = [None] * len(sent)
    answered = 0
    for t_ns, heading in came:
        newest = bisect_right(instants, t_ns) - 1
        while newest >= answered and sent[newest].heading != heading:
            newest -= 1
        for i in range(answered, newest + 1):
            found[i] = t_ns - instants[i]
        answered = newest + 1
    return found


def answered_us(flight: Flight) -> list[float]:
    """`answer_times_ns` of a flight, us; infinite for a state that was never answered."""
    times_ns = answer_times_ns(flight.sent, flight.came)
    return [math.inf if t is None else t * 1e-3 for t in times_ns]


def percentile(values: Sequence[float], percent: float) -> float:
    """The smallest of the values that so many percent of all do not exceed."""
    ordered = sorted(values)
    return ordered[max(math.ceil(percent * len(ordered) / 100.0) - 1, 0)]


def typical(rounds: Sequence[Sequence[float]], percent: float) -> float | None:
    """The median over the rounds of each one's percentile; None where that is not finite.

    Nor is there one where the percentile of all rounds together is infinite: rounds that are slow are
    outvoted, one that fell silent is not.
    """
    found = statistics.median(percentile(values, percent) for values in rounds)
    together = percentile([value for values in rounds for value in values], percent)
    return found if math.isfinite(found) and math.isfinite(together) else None


def worst(rounds: Sequence[Sequence[float]]) -> float | None:
    """The largest of all finite values, None if there is none."""
    return max((value for values in rounds for value in values if math.isfinite(value)), default=None)


def never(rounds: Sequence[Sequence[float]]) -> int:
    """How many are infinite."""
    return sum(math.isinf(value) for values in rounds for value in values)
