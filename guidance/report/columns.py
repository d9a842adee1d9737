"""One row of numbers for each setpoint of a log, gathered as they are read and seen as numpy's columns after.

A row takes 0.5 kB; an hour at 50 Hz some 100 MB. What a record lacks is NaN.
"""

from __future__ import annotations

from array import array
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from guidance.records import Reference, Setpoint, State, TrackingError

Floats = NDArray[np.float64]
Times = NDArray[np.int64]

_NAN: Final = float("nan")
#: What is larger no vehicle has: it counts as not known, as no plot and no square could hold it.
_MOST: Final = 1e15
_NO_STATE: Final = (_NAN,) * 15
_NO_REFERENCE: Final = (_NAN,) * 7
_NO_ERROR: Final = (_NAN,) * 6


def known(values: Floats) -> Floats:
    """The values, NaN for those that no vehicle has."""
    return np.where(np.abs(values) <= _MOST, values, _NAN)


class Columns(NamedTuple):
    """What is known of each setpoint: n rows; a triple is (n, 3), a quaternion wxyz (n, 4).

    `sent_ns` is when it was sent and `acts_ns` the instant that state, reference and error hold for, both on
    the companion's clock. `measured_rates_frd_rad_s` are the vehicle's own; the ages are at `acts_ns`.
    `reference_*`, `error_*` and V are NaN where nothing was tracked. `handling` has the numbers of the
    class's own record by field, NaN where there was none.
    """

    sent_ns: Times
    acts_ns: Times
    position_ned_m: Floats
    velocity_ned_m_s: Floats
    attitude_wxyz: Floats
    measured_rates_frd_rad_s: Floats
    attitude_age_s: Floats
    position_age_s: Floats
    neutral: NDArray[np.bool_]
    rates_frd_rad_s: Floats
    speed_m_s: Floats
    demanded_rates_frd_rad_s: Floats
    demanded_speed_m_s: Floats
    thrust: Floats
    saturated: NDArray[np.bool_]
    singular: NDArray[np.bool_]
    asked_attitude_wxyz: Floats
    asked_velocity_ned_m_s: Floats
    trajectory_s: Floats
    reference_ned_m: Floats
    reference_velocity_ned_m_s: Floats
    error_ned_m: Floats
    norm_m: Floats
    v1: Floats
    v2: Floats
    handling: dict[str, Floats]


class Gathering:
    """Takes the records in the order of the log; a setpoint ends what was computed for its instant."""

    def __init__(self) -> None:
        self._times = array("q")
        self._rows = array("d")
        self._handling: dict[str, array[float]] = {}
        self._count = 0
        self._state: State | None = None
        self._reference: Reference | None = None
        self._error: TrackingError | None = None

    def state(self, record: State) -> None:
        """The vehicle, as the setpoint behind it sees it."""
        self._state = record

    def reference(self, record: Reference) -> None:
        """What is tracked."""
        self._reference = record

    def error(self, record: TrackingError) -> None:
        """How far off it is."""
        self._error = record

    def setpoint(self, record: Setpoint, sent_ns: int) -> None:
        """What was sent: a row."""
        at_ns = record.t_ns
        state, reference, error = self._state, self._reference, self._error
        self._times += array("q", (sent_ns, at_ns))  # both or, beyond 64 bits, neither
        self._count += 1
        rows = self._rows
        if state is None or state.t_ns != at_ns:
            rows.extend(_NO_STATE)
        else:
            rows.extend(state.position_ned_m)
            rows.extend(state.velocity_ned_m_s)
            rows.extend(state.attitude_wxyz)
            rows.extend(state.measured_body_rates_frd_rad_s)
            rows.extend((state.attitude_age_s, state.position_age_s))
        rows.append(record.neutral)
        rows.extend(record.body_rates_frd_rad_s)
        rows.append(record.speed_m_s)
        rows.extend(record.demanded_body_rates_frd_rad_s)
        rows.extend((record.demanded_speed_m_s, record.thrust, record.saturated, record.singular))
        rows.extend(record.attitude_wxyz)
        rows.extend(record.velocity_ned_m_s)
        if reference is None or reference.t_ns != at_ns:
            rows.extend(_NO_REFERENCE)
        else:
            rows.append(reference.trajectory_s)
            rows.extend(reference.position_ned_m)
            rows.extend(reference.velocity_ned_m_s)
        if error is None or error.t_ns != at_ns:
            rows.extend(_NO_ERROR)
        else:
            rows.extend(error.error_ned_m)
            rows.extend((error.norm_m, error.v1, error.v2))

    def handling(self, values: dict[str, float]) -> None:
        """What was done around the law for the setpoint before."""
        for name, value in values.items():
            column = self._handling.get(name)
            if column is None:
                column = self._handling[name] = array("d")
            while len(column) < self._count - 1:
                column.append(_NAN)
            if len(column) < self._count:
                column.append(value)

    @property
    def tracked(self) -> bool:
        """Whether anything was tracked yet."""
        return self._error is not None

    def columns(self) -> Columns:
        """All rows; nothing may be added after."""
        times = np.frombuffer(self._times, dtype=np.int64).reshape(-1, 2)
        rows = np.frombuffer(self._rows, dtype=np.float64).reshape(len(times), -1 if len(times) else _WIDTH)
        for values in rows.T:
            values[:] = known(values)
        place = 0
        taken: dict[str, Any] = {}
        for name, width in _LAYOUT.items():
            taken[name] = rows[:, place] if width == 1 else rows[:, place : place + width]
            place += width
        handling = {}
        for name, column in self._handling.items():
            column.extend([_NAN] * (len(times) - len(column)))
            handling[name] = known(np.frombuffer(column, dtype=np.float64))
        for name in ("neutral", "saturated", "singular"):
            taken[name] = taken[name] > 0.5
        return Columns(sent_ns=times[:, 0], acts_ns=times[:, 1], handling=handling, **taken)


#: The order in which `Gathering.setpoint` writes a row.
_LAYOUT: Final = {
    "position_ned_m": 3,
    "velocity_ned_m_s": 3,
    "attitude_wxyz": 4,
    "measured_rates_frd_rad_s": 3,
    "attitude_age_s": 1,
    "position_age_s": 1,
    "neutral": 1,
    "rates_frd_rad_s": 3,
    "speed_m_s": 1,
    "demanded_rates_frd_rad_s": 3,
    "demanded_speed_m_s": 1,
    "thrust": 1,
    "saturated": 1,
    "singular": 1,
    "asked_attitude_wxyz": 4,
    "asked_velocity_ned_m_s": 3,
    "trajectory_s": 1,
    "reference_ned_m": 3,
    "reference_velocity_ned_m_s": 3,
    "error_ned_m": 3,
    "norm_m": 1,
    "v1": 1,
    "v2": 1,
}
_WIDTH: Final = sum(_LAYOUT.values())
