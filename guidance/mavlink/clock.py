"""The autopilot's clock, followed by TIMESYNC.

A Kalman filter of two states, offset and drift, because autopilots' clocks run up to 0.5 % off the
companion's, and not evenly (PX4's simulator loses 4 ms a second): a filter that believes in a constant
offset reports tens of ms of false age. Answers that travelled longer than the quickest are trusted less,
as the excess bounds how far the two ways may differ.
"""

from __future__ import annotations

from collections import deque
from typing import Final

#: Answers needed before times are converted at all.
SYNCED_AFTER: Final = 3
#: Answers slower than this say nothing useful.
ROUND_TRIP_MAX_S: Final = 0.5
#: This many answers in a row that contradict the filter mean that a clock was set anew.
CONTRADICTIONS_MAX: Final = 4

_STALE_S: Final = 5.0
_GATE_S: Final = 0.005
_SIGMA_S: Final = 1e-4  # of the quickest answers
_DRIFT_SIGMA: Final = 1e-2  # before anything is known
_DRIFT_WALK: Final = 1e-3  # per sqrt(s)
_PHASE_WALK_S: Final = 2e-5  # per sqrt(s)


class ClockFilter:
    """Maps the autopilot's time since boot to the companion's monotonic clock, both in ns."""

    def __init__(self) -> None:
        self.rejected = 0
        self.reset()

    def reset(self) -> None:
        """Forget everything: the autopilot rebooted."""
        self.accepted = 0
        self.round_trip_s: float | None = None
        self._round_trips_ns: deque[int] = deque(maxlen=64)
        self._contradictions = 0
        self._base_ns = 0  # local minus vehicle at the first answer; the filter works on the difference
        self._at_ns = 0
        self._offset_s = 0.0
        self._drift = 0.0
        self._covariance = (0.0, 0.0, 0.0)

    def synced(self, now_ns: int) -> bool:
        """Whether `to_local_ns` may be believed: enough answers, and not too old."""
        return self.accepted >= SYNCED_AFTER and now_ns - self._at_ns <= _STALE_S * 1e9

    @property
    def drift_ppm(self) -> float:
        """How much faster the companion's clock runs than the autopilot's."""
        return self._drift * 1e6

    def offset_ns(self, now_ns: int) -> int:
        """Local minus vehicle time at `now_ns`."""
        return self._base_ns + round((self._offset_s + self._drift * (now_ns - self._at_ns) * 1e-9) * 1e9)

    def to_local_ns(self, vehicle_ns: int) -> int:
        """The companion's monotonic time at which the autopilot's clock showed `vehicle_ns`."""
        # The drift is small, so that the offset at the approximate instant is the offset at the instant.
        return vehicle_ns + self.offset_ns(vehicle_ns + self.offset_ns(self._at_ns))

    def update(self, asked_ns: int, vehicle_ns: int, now_ns: int) -> bool:
        """Take an answer to the question sent at `asked_ns`; False if it was not believed."""
        round_trip_ns = now_ns - asked_ns
        if not 0 <= round_trip_ns <= ROUND_TRIP_MAX_S * 1e9:
            self.rejected += 1
            return False
        self._round_trips_ns.append(round_trip_ns)
        middle_ns = asked_ns + round_trip_ns // 2
        excess_s = (round_trip_ns - min(self._round_trips_ns)) * 1e-9
        variance = (_SIGMA_S + 0.5 * excess_s) ** 2
        if self.accepted == 0:
            self._base_ns = middle_ns - vehicle_ns
            self._at_ns = middle_ns
            self._covariance = (variance, 0.0, _DRIFT_SIGMA**2)
        elif not self._correct(middle_ns, middle_ns - vehicle_ns, variance):
            self.rejected += 1
            self._contradictions += 1
            if self._contradictions >= CONTRADICTIONS_MAX:
                self.reset()
            return False
        self._contradictions = 0
        self.accepted += 1
        self.round_trip_s = round_trip_ns * 1e-9
        return True

    def _correct(self, at_ns: int, offset_ns: int, variance: float) -> bool:
        dt = max((at_ns - self._at_ns) * 1e-9, 0.0)
        p00, p01, p11 = self._covariance
        p00 += dt * (2.0 * p01 + dt * p11) + dt * (_PHASE_WALK_S**2 + dt * dt * _DRIFT_WALK**2 / 3.0)
        p01 += dt * p11 + dt * dt * _DRIFT_WALK**2 / 2.0
        p11 += dt * _DRIFT_WALK**2
        predicted = self._offset_s + self._drift * dt
        innovation = (offset_ns - self._base_ns) * 1e-9 - predicted
        total = p00 + variance
        if innovation * innovation > (_GATE_S + 5.0 * total**0.5) ** 2:
            return False
        gain0, gain1 = p00 / total, p01 / total
        self._offset_s = predicted + gain0 * innovation
        self._drift += gain1 * innovation
        self._covariance = ((1.0 - gain0) * p00, (1.0 - gain0) * p01, p11 - gain1 * p01)
        self._at_ns = max(at_ns, self._at_ns)
        return True
