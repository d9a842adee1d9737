"""The figures by which a flight is judged: convergence, error after it, evenness of the setpoints."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import sqrt
from typing import Final, NamedTuple

#: Converged means below this for good.
CONVERGED_M: Final = 0.1
#: "For good" needs some time to show, s.
FOR_GOOD_S: Final = 1.0
#: RMS and maximum start so many time constants 1/(lambda k) after convergence.
SETTLED_TIME_CONSTANTS: Final = 5.0
#: A stream has its rate if it has this part of it.
RATE_REACHED: Final = 0.98


class TrackingFigures(NamedTuple):
    """Convergence time in s and errors in m; None where the flight was too short, or never converged."""

    converged_s: float | None
    rms_error_m: float | None
    max_error_m: float | None


class StreamFigures(NamedTuple):
    """Mean rate and longest gap of a stream of setpoints; None for fewer than two."""

    rate_hz: float | None
    max_gap_s: float | None


class Goals(NamedTuple):
    """What a flight should reach, in s, m and Hz; None where nothing is asked."""

    converged_s: float | None = None
    rms_error_m: float | None = None
    max_error_m: float | None = None
    rate_hz: float | None = None
    max_gap_s: float | None = None


def missed(tracking: TrackingFigures, stream: StreamFigures, goals: Goals) -> list[str]:
    """The goals that were measured and not reached, in words; a figure that is None was not measured."""
    limits = (
        ("convergence", tracking.converged_s, goals.converged_s),
        ("RMS error", tracking.rms_error_m, goals.rms_error_m),
        ("largest error", tracking.max_error_m, goals.max_error_m),
        ("longest gap", stream.max_gap_s, goals.max_gap_s),
    )
    found = [name for name, value, goal in limits if value is not None and goal is not None and value > goal]
    wanted_hz = 0.0 if goals.rate_hz is None else goals.rate_hz
    if stream.rate_hz is not None and stream.rate_hz < RATE_REACHED * wanted_hz:
        found.append("rate")
    return found


def tracking_figures(
    errors: Sequence[tuple[float, float]], time_constant_s: float, converged_m: float = CONVERGED_M
) -> TrackingFigures:
    """Figures of (time since the trajectory's start in s, |error| in m), in order of time.

    Converged is the instant from which on the error was below `converged_m` until the end, which must have
    been `FOR_GOOD_S` at least; an error that is not a number counts as outside.
    """
    outside = max((i for i, (_, error) in enumerate(errors) if not error < converged_m), default=-1)
    inside = errors[outside + 1 :]
    if not inside or inside[-1][0] - inside[0][0] < FOR_GOOD_S:
        return TrackingFigures(None, None, None)
    converged_s = inside[0][0]
    settled_s = converged_s + SETTLED_TIME_CONSTANTS * time_constant_s
    settled = [error for time_s, error in inside if time_s >= settled_s]
    if not settled:
        return TrackingFigures(converged_s, None, None)
    rms = sqrt(sum(error * error for error in settled) / len(settled))
    return TrackingFigures(converged_s, rms, max(settled))


def stream_figures(times_ns: Sequence[int]) -> StreamFigures:
    """Figures of the instants at which setpoints were sent, in order."""
    if len(times_ns) < 2:
        return StreamFigures(None, None)
    gaps = [later - earlier for earlier, later in pairwise(times_ns)]
    return StreamFigures(len(gaps) * 1e9 / (times_ns[-1] - times_ns[0]), max(gaps) * 1e-9)
