"""What the charts and the scene are drawn from: rows of float32, one per vehicle and tick, kept for minutes.

A row is what is known at an instant; NaN is what is not, or not any more. Each figure comes from a record of
its own and ages with it.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from math import asin, atan2, copysign, hypot, nan, pi
from typing import Final, TypeVar

from guidance.records import (
    AirplaneHandling,
    Link,
    Record,
    Reference,
    Setpoint,
    State,
    Timing,
    TrackingError,
)

#: Rows a second, and for how long they are kept.
TICK_HZ: Final = 20
KEPT_S: Final = 300
#: A row's time is counted modulo this, s: a float32 then resolves half a millisecond for ever.
WRAP_S: Final = 4096

#: Local NED, m and m/s; attitude wxyz; body FRD rates, rad/s; angles, rad; ages and lateness, s.
COLUMNS: Final = (
    *("t", "north", "east", "down", "ref_north", "ref_east", "ref_down", "qw", "qx", "qy", "qz"),
    *("error", "error_peak", "error_north", "error_east", "error_down", "v1", "v2"),
    *("field_x", "field_y", "field_z"),
    *("roll_rate_set", "pitch_rate_set", "yaw_rate_set", "roll_rate", "pitch_rate", "yaw_rate"),
    *("speed_set", "speed", "thrust"),
    *("v_north_set", "v_east_set", "v_down_set", "v_north", "v_east", "v_down"),
    *("bank_set", "bank", "pitch_set", "pitch", "airspeed_set", "airspeed"),
    *("lateness", "uplink_age", "attitude_age", "position_age"),
)
ROW: Final = struct.Struct(f"<{len(COLUMNS)}f")
#: How old a record may be whose figures are shown: those of each setpoint, and those at 2 and 1 Hz.
FRESH_NS: Final[dict[type[Record], int]] = {Link: 1_500_000_000, Timing: 2_500_000_000}
FRESH_OTHERS_NS: Final = 1_000_000_000

#: What is larger is no figure of a vehicle; a chart of it would show nothing else.
LARGEST: Final = 1e12
_N3: Final = (nan, nan, nan)
_N4: Final = (nan, nan, nan, nan)

R = TypeVar("R", bound=Record)
#: The newest record of a type if it is fresh.
Newest = Callable[[type[Record]], Record | None]


class Ring:
    """The newest rows of one vehicle, packed, oldest first; its memory is taken once."""

    def __init__(self, capacity: int = KEPT_S * TICK_HZ) -> None:
        self.held = 0
        self._capacity = capacity
        self._bytes = bytearray(capacity * ROW.size)
        self._next = 0

    def add(self, row: bytes) -> None:
        """Keep a row; the oldest gives way."""
        at = self._next * ROW.size
        self._bytes[at : at + ROW.size] = row
        self._next = (self._next + 1) % self._capacity
        self.held = min(self.held + 1, self._capacity)

    def clear(self) -> None:
        """What is held is too old to be shown beside what comes."""
        self.held = self._next = 0

    def all(self) -> bytes:
        """Every row, oldest first."""
        cut = self._next * ROW.size
        if self.held < self._capacity:
            return bytes(self._bytes[:cut])
        return bytes(self._bytes[cut:] + self._bytes[:cut])

    def precede(self, rows: Sequence[bytes]) -> None:
        """Put older rows before those that are held, as many as there is room for."""
        room = self._capacity - self.held
        held = self.all()
        self.held = self._next = 0
        whole = b"".join(rows[-room:] if room else ()) + held
        for at in range(0, len(whole), ROW.size):
            self.add(whole[at : at + ROW.size])


def packed(figures: Sequence[float]) -> bytes:
    """A row; absurd figures are not known."""
    return ROW.pack(*(nan if abs(f) > LARGEST else f for f in figures))


def clock_s(instant_ns: int) -> float:
    """The time of a row."""
    return (instant_ns % (WRAP_S * 1_000_000_000)) * 1e-9


def nothing(instant_ns: int) -> bytes:
    """The row of a vehicle that is not heard: lines end here."""
    return packed((clock_s(instant_ns), *(nan,) * (len(COLUMNS) - 1)))


def row(instant_ns: int, newest: Newest, peak_m: float, lateness_s: float) -> bytes:
    """What is known at an instant of the server's clock.

    Args:
        instant_ns: of the row.
        newest: the newest record of each type, None where it is too old.
        peak_m: the largest |e| since the last row, NaN if none came: a spike between two rows is not lost.
        lateness_s: of the control loop lately, see `Lateness`.
    """
    state, reference, error = _of(newest, State), _of(newest, Reference), _of(newest, TrackingError)
    setpoint, link, airplane = _of(newest, Setpoint), _of(newest, Link), _of(newest, AirplaneHandling)
    bank, pitch = (nan, nan) if state is None else bank_and_pitch(state.attitude_wxyz)
    uplink = nan if link is None or link.uplink_age_s is None else link.uplink_age_s
    return packed(
        (
            clock_s(instant_ns),
            *(_N3 if state is None else state.position_ned_m),
            *(_N3 if reference is None else reference.position_ned_m),
            *(_N4 if state is None else state.attitude_wxyz),
            nan if error is None else error.norm_m,
            peak_m if error is None or peak_m > error.norm_m else error.norm_m,
            *(_N3 if error is None else error.error_ned_m),
            *((nan, nan) if error is None else (error.v1, error.v2)),
            *(_N3 if error is None else error.field_body),
            *(_N3 if setpoint is None else setpoint.body_rates_frd_rad_s),
            *(_N3 if state is None else _measured_rates(state)),
            nan if setpoint is None else setpoint.speed_m_s,
            nan if state is None else hypot(*state.velocity_ned_m_s),
            nan if setpoint is None else setpoint.thrust,
            *(_N3 if setpoint is None else setpoint.velocity_ned_m_s),
            *(_N3 if state is None else state.velocity_ned_m_s),
            nan if airplane is None else airplane.bank_asked_rad,
            bank,
            nan if airplane is None else airplane.pitch_asked_rad,
            pitch,
            *((nan, nan) if airplane is None else (airplane.airspeed_asked_m_s, airplane.airspeed_m_s)),
            lateness_s,
            uplink,
            *((nan, nan) if state is None else (state.attitude_age_s, state.position_age_s)),
        )
    )


def _of(newest: Newest, kind: type[R]) -> R | None:
    record = newest(kind)
    return record if isinstance(record, kind) else None


def _measured_rates(state: State) -> tuple[float, float, float]:
    """The vehicle's own; a service from before they were told apart leaves them out."""
    measured = state.measured_body_rates_frd_rad_s
    return state.body_rates_frd_rad_s if measured == (0.0, 0.0, 0.0) else measured


def bank_and_pitch(q: tuple[float, float, float, float]) -> tuple[float, float]:
    """Of an attitude wxyz (body FRD to NED), rad."""
    w, x, y, z = q
    sine = 2.0 * (w * y - x * z)
    pitch = asin(sine) if abs(sine) < 1.0 else copysign(0.5 * pi, sine)
    return atan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)), pitch


class Lateness:
    """How late the control loop was lately: `Timing` counts since the start, this what a record adds."""

    def __init__(self) -> None:
        self._before: Timing | None = None
        self.lately_s = nan

    def take(self, timing: Timing) -> None:
        """The upper edge of the highest count that grew; above all edges the largest of the run if it is new,
        else what is certain, the last edge."""
        before, self._before = self._before, timing
        if before is None or timing.ticks < before.ticks or before == timing:
            self.lately_s = nan if before is None or before != timing else self.lately_s
            return
        pairs = zip(timing.lateness_counts, before.lateness_counts, strict=False)
        grown = [i for i, (now, then) in enumerate(pairs) if now > then]
        edges = timing.lateness_edges_s
        if grown and grown[-1] < len(edges):
            self.lately_s = edges[grown[-1]]
        elif grown:
            new = timing.lateness_max_s > before.lateness_max_s
            self.lately_s = timing.lateness_max_s if new or not edges else edges[-1]


def of_history(records: Sequence[Record], offset_ns: int, before_ns: int, lateness: Lateness) -> list[bytes]:
    """Rows from what a service kept, in the order of its instants: one for each state.

    `offset_ns` makes an instant of the server's clock of one of the vehicle's. Only what is before
    `before_ns`, and not longer ago than rows are kept, makes a row.
    """
    rows: list[bytes] = []
    known: dict[type[Record], Record] = {}
    at_ns: int | None = None

    def newest(kind: type[Record]) -> Record | None:
        record = known.get(kind)
        assert at_ns is not None
        if record is None or at_ns - record.t_ns > 2 * FRESH_NS.get(kind, FRESH_OTHERS_NS):
            return None  # kept are half as many as come
        return record

    def close() -> None:
        if at_ns is not None and before_ns - KEPT_S * 1_000_000_000 < at_ns + offset_ns < before_ns:
            rows.append(row(at_ns + offset_ns, newest, nan, lateness.lately_s))

    for record in records:
        if at_ns is not None and record.t_ns != at_ns:
            close()
            at_ns = None
        known[type(record)] = record
        if isinstance(record, State):
            at_ns = record.t_ns
        elif isinstance(record, Timing):
            lateness.take(record)
    close()
    return rows
