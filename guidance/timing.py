"""When setpoints are due, how late the loop is, and how even they come: counted, never averaged away."""

from __future__ import annotations

from bisect import bisect_left
from typing import Final

from guidance.records import Timing

#: A new attitude is used when this part of the period has passed: data that is a little early is not late.
NEARLY: Final = 0.8
#: Without a new attitude, prediction fills in after this many periods.
FILL_IN: Final = 1.5

LATENESS_EDGES_S: Final = (0.0001, 0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1)
#: A gap between two setpoints longer than this is an event of its own.
GAP_EVENT_S: Final = 0.1


class Pace:
    """When the next setpoint is due: `due_ns` may be set, to have one at once."""

    def __init__(self, rate_hz: float) -> None:
        self.due_ns = 0
        self._next_ns = 0
        self._period_ns = round(1e9 / rate_hz)

    def attitude_came(self, now_ns: int) -> None:
        """A new attitude is there: a setpoint is due at once if its period has nearly passed."""
        if now_ns >= self._next_ns - round((1.0 - NEARLY) * self._period_ns):
            self.due_ns = min(self.due_ns, now_ns)

    def taken(self, now_ns: int) -> int:
        """The setpoint is computed now; arranges for the next one and gives when this one was due."""
        due_ns, self.due_ns = self.due_ns, now_ns + round(FILL_IN * self._period_ns)
        # A late one does not move those after it, so that jitter costs no rate; an early one does.
        following_ns = max(self._next_ns + self._period_ns, now_ns + self._period_ns // 2)
        self._next_ns = min(following_ns, now_ns + self._period_ns)
        return due_ns


class LoopTiming:
    """Histogram of lateness, and the intervals between setpoints of one uninterrupted stream."""

    def __init__(self) -> None:
        self._counts = [0] * (len(LATENESS_EDGES_S) + 1)
        self._max_ns = 0
        self._gap_max_ns = 0
        self._streamed_ns = 0
        self._intervals = 0
        self._last_ns: int | None = None

    def sent(self, due_ns: int, now_ns: int) -> float | None:
        """A setpoint that was due at `due_ns` was sent; the gap in s if it was long enough to tell of."""
        late_ns = max(now_ns - due_ns, 0)
        self._counts[bisect_left(LATENESS_EDGES_S, late_ns * 1e-9)] += 1
        self._max_ns = max(self._max_ns, late_ns)
        last_ns, self._last_ns = self._last_ns, now_ns
        if last_ns is None:
            return None
        gap_ns = now_ns - last_ns
        self._intervals += 1
        self._streamed_ns += gap_ns
        self._gap_max_ns = max(self._gap_max_ns, gap_ns)
        return gap_ns * 1e-9 if gap_ns > GAP_EVENT_S * 1e9 else None

    def paused(self) -> None:
        """The stream was ended on purpose: the time until it starts again is no gap."""
        self._last_ns = None

    def record(self, now_ns: int, dropped_records: int, dropped_packets: int = 0) -> Timing:
        """The figures since the start."""
        rate = self._intervals * 1e9 / self._streamed_ns if self._streamed_ns else 0.0
        return Timing(
            t_ns=now_ns,
            ticks=sum(self._counts),
            lateness_edges_s=LATENESS_EDGES_S,
            lateness_counts=tuple(self._counts),
            lateness_max_s=self._max_ns * 1e-9,
            setpoint_gap_max_s=self._gap_max_ns * 1e-9,
            setpoint_rate_hz=rate,
            dropped_records=dropped_records,
            dropped_packets=dropped_packets,
        )
