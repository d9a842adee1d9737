"""The autopilot's clock, followed by TIMESYNC.

An answer proves that the offset lay within half its round trip of the middle; where in between, nobody
knows, but the quickest answers know best. A Kalman filter of two states, offset and drift, weighs them,
because autopilots' clocks run up to 0.5 % off the companion's: a filter that believes in a constant offset
reports tens of ms of false age. Nor do they run evenly: PX4's simulator loses its 0.4 % in slips of 4 ms, one
or two a second (recorded). A slip that an answer proves is followed at once and not taken for drift.

An answer that is off by more than any slip is not believed, unless the following ones agree with it: then
the clock was set anew, and the filter starts over from there.
"""

from __future__ import annotations

from collections import deque
from typing import Final

#: Answers needed before times are converted at all.
SYNCED_AFTER: Final = 3
#: Answers slower than this say nothing useful.
ROUND_TRIP_MAX_S: Final = 0.5
#: 146 years: an autopilot counts from its start or, at most, from 1970. By more no offset is told in 64 bits.
VEHICLE_NS_MAX: Final = 1 << 62
#: More than this is no slip of a running clock.
SLIP_MAX_S: Final = 0.02
#: This many answers in a row that contradict the filter and agree with each other mean a clock set anew.
CONTRADICTIONS_MAX: Final = 4

_STALE_S: Final = 5.0
_MEAN_OF: Final = 128  # answers, some 10 s of them: 100 ms of jitter are then known to 3 ms
_SIGMA_S: Final = 1e-4  # of an answer without delay
_SIGMA_OF_ROUND_TRIP: Final = 0.2  # how unequal the two ways are when the answer is a quick one
_SIGMA_OF_EXCESS: Final = 0.5  # what an answer took longer than the quickest may all be on one way
_DRIFT_SIGMA: Final = 5e-3  # before anything is known
_DRIFT_WALK: Final = 1e-4  # per sqrt(s)
_PHASE_WALK_S: Final = 1e-3  # per sqrt(s): ArduPilot's simulated clock wanders by that without slipping


class ClockFilter:
    """Maps the autopilot's time since boot to the companion's monotonic clock, both in ns.

    `rejected` counts answers that were not believed, `restarts` how often the clock was found set anew;
    `stepped_s` is by how much the autopilot's clock went forward the last time.
    """

    def __init__(self) -> None:
        self.rejected = 0
        self.restarts = 0
        self.stepped_s = 0.0
        self.reset()

    def reset(self) -> None:
        """Forget everything: the autopilot rebooted."""
        self.accepted = 0
        self.round_trip_s: float | None = None
        self._uplink_s = 0.0
        self._round_trips_ns: deque[int] = deque(maxlen=64)
        self._contradictions = 0
        self._contradicting_ns = 0  # the offset that the last contradicting answer asked for
        self._base_ns = 0  # local minus vehicle at the first answer; the filter works on the difference
        self._at_ns = 0
        self._offset_s = 0.0
        self._drift = 0.0
        self._covariance = (0.0, 0.0, 0.0)

    def synced(self, now_ns: int) -> bool:
        """Whether `to_local_ns` may be believed: enough answers, and not too old."""
        return self.accepted >= SYNCED_AFTER and now_ns - self._at_ns <= _STALE_S * 1e9

    @property
    def uplink_s(self) -> float:
        """How long what is sent is on its way to the autopilot, on the mean of the last questions.

        By the same clock as the times of what comes from there: where that is off, because the two ways are
        unequal, this is off by as much, and both together are right.
        """
        return max(self._uplink_s, 0.0)

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
        return vehicle_ns + self.offset_ns(vehicle_ns + self._base_ns + round(self._offset_s * 1e9))

    def update(self, asked_ns: int, vehicle_ns: int, now_ns: int) -> bool:
        """Take an answer to the question sent at `asked_ns`; False if it was not believed."""
        round_trip_ns = now_ns - asked_ns
        if not 0 <= round_trip_ns <= ROUND_TRIP_MAX_S * 1e9 or abs(vehicle_ns) > VEHICLE_NS_MAX:
            self.rejected += 1
            return False
        self._round_trips_ns.append(round_trip_ns)
        middle_ns = asked_ns + round_trip_ns // 2
        offset_ns = middle_ns - vehicle_ns
        if self.accepted == 0:
            self._start(middle_ns, offset_ns, self._sigma_s(round_trip_ns))
        elif not self._correct(middle_ns, offset_ns, round_trip_ns):
            self.rejected += 1
            if not self._set_anew(middle_ns, offset_ns, round_trip_ns):
                return False
        self._contradictions = 0
        self.accepted += 1
        self.round_trip_s = round_trip_ns * 1e-9
        uplink_s = (self.to_local_ns(vehicle_ns) - asked_ns) * 1e-9
        self._uplink_s += (uplink_s - self._uplink_s) / min(self.accepted, _MEAN_OF)
        return True

    def _sigma_s(self, round_trip_ns: int) -> float:
        excess_ns = round_trip_ns - min(self._round_trips_ns)
        return _SIGMA_S + (_SIGMA_OF_ROUND_TRIP * round_trip_ns + _SIGMA_OF_EXCESS * excess_ns) * 1e-9

    def _start(self, at_ns: int, offset_ns: int, sigma_s: float) -> None:
        self._base_ns = offset_ns
        self._at_ns = at_ns
        self._offset_s = 0.0
        self._covariance = (sigma_s**2, 0.0, _DRIFT_SIGMA**2)

    def _correct(self, at_ns: int, offset_ns: int, round_trip_ns: int) -> bool:
        dt = max((at_ns - self._at_ns) * 1e-9, 0.0)
        p00, p01, p11 = self._covariance
        p00 += dt * (2.0 * p01 + dt * p11) + dt * (_PHASE_WALK_S**2 + dt * dt * _DRIFT_WALK**2 / 3.0)
        p01 += dt * p11 + dt * dt * _DRIFT_WALK**2 / 2.0
        p11 += dt * _DRIFT_WALK**2
        predicted = self._offset_s + self._drift * dt
        innovation = (offset_ns - self._base_ns) * 1e-9 - predicted
        # What neither the unequal ways of this answer nor the filter's own doubt can explain.
        slip = abs(innovation) - 0.5e-9 * round_trip_ns - 3.0 * p00**0.5 - _SIGMA_S
        if slip > SLIP_MAX_S:
            return False
        if slip > 0.0:
            p00 += innovation * innovation
        total = p00 + self._sigma_s(round_trip_ns) ** 2
        gain0, gain1 = p00 / total, p01 / total
        self._offset_s = predicted + gain0 * innovation
        self._drift += gain1 * innovation
        self._covariance = ((1.0 - gain0) * p00, (1.0 - gain0) * p01, p11 - gain1 * p01)
        self._at_ns = max(at_ns, self._at_ns)
        return True

    def _set_anew(self, at_ns: int, offset_ns: int, round_trip_ns: int) -> bool:
        """Count an answer that contradicts the filter; True if it starts over from this one."""
        agrees_ns = SLIP_MAX_S * 1e9 + round_trip_ns // 2
        agrees = self._contradictions > 0 and abs(offset_ns - self._contradicting_ns) <= agrees_ns
        self._contradictions = self._contradictions + 1 if agrees else 1
        self._contradicting_ns = offset_ns
        if self._contradictions < CONTRADICTIONS_MAX:
            return False
        self.restarts += 1
        self.stepped_s = (self.offset_ns(at_ns) - offset_ns) * 1e-9
        self.accepted = max(self.accepted, SYNCED_AFTER - 1)  # the answers that agreed count
        self._start(at_ns, offset_ns, self._sigma_s(round_trip_ns))
        return True
