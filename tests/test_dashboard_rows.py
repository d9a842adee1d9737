"""The rows that charts and scene are drawn from: what is in them, what is too old, and how many are kept."""

from __future__ import annotations

from math import inf, isnan, nan, pi
from typing import Any

import pytest
from msgspec.structs import replace

from guidance.dashboard.rows import (
    COLUMNS,
    KEPT_S,
    ROW,
    WRAP_S,
    Lateness,
    Ring,
    bank_and_pitch,
    clock_s,
    nothing,
    of_history,
    packed,
    row,
)
from guidance.records import AirplaneHandling, Record, Reference, Timing
from guidance.se3 import from_euler
from tests.fleet_rig import MS, S, error, link, setpoint, state

HALF_S = 500 * MS


def read(packed_row: bytes) -> dict[str, float]:
    return dict(zip(COLUMNS, ROW.unpack(packed_row), strict=True))


def made(*records: Record, peak_m: float = nan, lateness_s: float = nan) -> dict[str, float]:
    newest = {type(record): record for record in records}
    return read(row(7 * S, newest.get, peak_m, lateness_s))


def reference(t_ns: int) -> Reference:
    zero = (0.0, 0.0, 0.0)
    return Reference(
        t_ns=t_ns,
        trajectory_s=0.0,
        position_ned_m=(7.0, 8.0, 9.0),
        velocity_ned_m_s=zero,
        acceleration_ned_m_s2=zero,
    )


def timing(t_ns: int, ticks: int, counts: tuple[int, ...], worst_s: float = 0.5) -> Timing:
    return Timing(
        t_ns=t_ns,
        ticks=ticks,
        lateness_edges_s=(0.001, 0.01),
        lateness_counts=counts,
        lateness_max_s=worst_s,
        setpoint_gap_max_s=0.0,
        setpoint_rate_hz=50.0,
        dropped_records=0,
    )


def test_a_row_has_each_figure_in_its_column() -> None:
    said = made(
        replace(
            state(0),
            attitude_wxyz=from_euler(0.1, 0.2, 0.3),
            velocity_ned_m_s=(3.0, 4.0, 12.0),
            body_rates_frd_rad_s=(9.0, 9.0, 9.0),
            measured_body_rates_frd_rad_s=(0.1, 0.2, 0.3),
        ),
        reference(0),
        replace(error(0, 0.25), v1=4.0, v2=5.0, error_ned_m=(0.5, 0.6, 0.7), field_body=(0.8, 0.9, 1.0)),
        replace(
            setpoint(0, 1),
            body_rates_frd_rad_s=(0.4, 0.5, 0.6),
            speed_m_s=2.5,
            velocity_ned_m_s=(1.5, 1.6, 1.7),
        ),
        replace(link(0), uplink_age_s=0.15),
        peak_m=0.75,
        lateness_s=0.002,
    )
    expected = {
        "t": 7.0,
        "north": 1,
        "east": 2,
        "down": 3,
        "ref_north": 7,
        "ref_east": 8,
        "ref_down": 9,
        "error": 0.25,
        "error_peak": 0.75,
        "error_north": 0.5,
        "error_east": 0.6,
        "error_down": 0.7,
        "v1": 4,
        "v2": 5,
        "field_x": 0.8,
        "field_y": 0.9,
        "field_z": 1.0,
        "roll_rate_set": 0.4,
        "pitch_rate_set": 0.5,
        "yaw_rate_set": 0.6,
        "roll_rate": 0.1,
        "pitch_rate": 0.2,
        "yaw_rate": 0.3,
        "speed_set": 2.5,
        "speed": 13,
        "thrust": 0.3,
        "v_north_set": 1.5,
        "v_east_set": 1.6,
        "v_down_set": 1.7,
        "v_north": 3,
        "v_east": 4,
        "v_down": 12,
        "bank": 0.1,
        "pitch": 0.2,
        "lateness": 0.002,
        "uplink_age": 0.15,
        "attitude_age": 0.012,
        "position_age": 0.034,
        **dict(zip(("qw", "qx", "qy", "qz"), from_euler(0.1, 0.2, 0.3), strict=True)),
    }
    unknown = {name for name, value in said.items() if isnan(value)}
    assert unknown == {"bank_set", "pitch_set", "airspeed_set", "airspeed"}
    assert {name: said[name] for name in expected} == pytest.approx(expected, rel=1e-6)
    assert set(expected) | unknown == set(COLUMNS)


def test_an_airplane_is_held_against_the_bank_pitch_and_airspeed_it_was_asked_for() -> None:
    fields: dict[str, Any] = dict.fromkeys(AirplaneHandling.__struct_fields__, 0.0)
    asked = {"bank_asked_rad": 0.5, "pitch_asked_rad": 0.1, "airspeed_asked_m_s": 15.0, "airspeed_m_s": 14.0}
    said = made(AirplaneHandling(**{**fields, **asked}))
    assert said["bank_set"] == 0.5
    assert said["pitch_set"] == pytest.approx(0.1)
    assert (said["airspeed_set"], said["airspeed"]) == (15.0, 14.0)


def test_what_is_not_known_is_nan_and_nothing_is_all_of_it() -> None:
    for said in (made(), read(nothing(7 * S))):
        assert said.pop("t") == 7.0
        assert all(isnan(value) for value in said.values())


def test_the_peak_since_the_last_row_is_kept_and_the_newest_is_never_above_it() -> None:
    assert made(error(0, 0.25), peak_m=3.0)["error_peak"] == 3.0
    assert made(error(0, 0.25), peak_m=3.0)["error"] == 0.25
    assert made(error(0, 0.25))["error_peak"] == 0.25  # none came since, and it is still fresh
    assert made(error(0, 5.0), peak_m=3.0)["error_peak"] == 5.0


def test_a_service_that_does_not_tell_measured_rates_apart_has_those_it_tells() -> None:
    assert made(state(0))["yaw_rate"] == 3.0


def test_an_absurd_figure_is_not_known() -> None:
    figures = [1e300, -1e300, inf, nan, 1e17, 1e11, *[1.0] * (len(COLUMNS) - 6)]
    huge = ROW.unpack(packed(figures))
    assert all(isnan(figure) for figure in huge[:5])
    assert huge[5] == pytest.approx(1e11)
    assert huge[6] == 1.0


def test_the_clock_of_rows_goes_round_and_never_loses_its_resolution() -> None:
    late_ns = 400 * 86400 * S + 50 * MS
    earlier = read(nothing(late_ns - 50 * MS))["t"]
    assert (read(nothing(late_ns))["t"] - earlier) % WRAP_S == pytest.approx(0.05, abs=1e-3)
    assert clock_s(WRAP_S * S + 3 * S) == 3.0


@pytest.mark.parametrize("roll", [-3.0, -0.4, 0.0, 1.0])
@pytest.mark.parametrize("pitch", [-1.5, 0.0, 0.7])
def test_bank_and_pitch_are_those_of_the_attitude(roll: float, pitch: float) -> None:
    assert bank_and_pitch(from_euler(roll, pitch, 2.0)) == pytest.approx((roll, pitch), abs=1e-9)


def test_straight_up_and_a_strangers_quaternion_have_a_pitch() -> None:
    assert bank_and_pitch((1.0, 0.0, 1.0, 0.0))[1] == pytest.approx(pi / 2)
    assert bank_and_pitch((9.0, 0.0, -9.0, 0.0))[1] == pytest.approx(-pi / 2)


def rows_of(*numbers: int) -> list[bytes]:
    return [packed([float(number)] * len(COLUMNS)) for number in numbers]


def firsts(ring: Ring) -> list[float]:
    whole = ring.all()
    return [ROW.unpack_from(whole, at)[0] for at in range(0, len(whole), ROW.size)]


def test_a_ring_keeps_the_newest_rows_oldest_first() -> None:
    ring = Ring(3)
    assert ring.all() == b""
    for number, one in enumerate(rows_of(*range(7))):
        ring.add(one)
        assert firsts(ring) == [float(n) for n in range(max(0, number - 2), number + 1)]


def test_older_rows_go_before_those_held_as_far_as_there_is_room() -> None:
    ring = Ring(4)
    for one in rows_of(10, 11):
        ring.add(one)
    ring.precede(rows_of(1, 2, 3))
    assert firsts(ring) == [2.0, 3.0, 10.0, 11.0]
    ring.precede(rows_of(5))
    assert firsts(ring) == [2.0, 3.0, 10.0, 11.0]
    ring.add(rows_of(12)[0])
    assert firsts(ring) == [3.0, 10.0, 11.0, 12.0]


def test_lateness_is_the_highest_count_that_grew_since_the_record_before() -> None:
    late = Lateness()
    late.take(timing(0, 10, (10, 0, 0)))
    assert isnan(late.lately_s)  # since the start: nothing of now
    late.take(timing(S, 20, (18, 2, 0)))
    assert late.lately_s == 0.01
    late.take(timing(S, 20, (18, 2, 0)))  # the same again, in answer to a query
    assert late.lately_s == 0.01
    late.take(timing(2 * S, 30, (28, 2, 0)))
    assert late.lately_s == 0.001
    late.take(timing(3 * S, 40, (37, 2, 1), worst_s=0.7))
    assert late.lately_s == 0.7
    late.take(timing(4 * S, 50, (46, 2, 2), worst_s=0.7))  # that was before: now at least the last edge
    assert late.lately_s == 0.01
    late.take(timing(0, 5, (5, 0, 0)))  # another run
    assert isnan(late.lately_s)


def test_rows_of_a_history_are_on_the_servers_clock_and_end_where_its_own_begin() -> None:
    offset_ns = 1000 * S
    records: list[Record] = []
    for k in range(20):
        records += [state(k * HALF_S), error(k * HALF_S, float(k))]
    rows = of_history(records, offset_ns, offset_ns + 8 * S, Lateness())
    said = [read(one) for one in rows]
    assert [one["t"] for one in said] == pytest.approx([1000 + 0.5 * k for k in range(16)])
    assert [one["error"] for one in said] == [float(k) for k in range(16)]
    assert [one["error_peak"] for one in said] == [float(k) for k in range(16)]


def test_a_history_holds_no_figure_longer_than_it_was_fresh() -> None:
    records: list[Record] = [error(0, 1.0), *(state(k * HALF_S) for k in range(8))]
    said = [read(one)["error"] for one in of_history(records, 0, 100 * S, Lateness())]
    assert said[:5] == [1.0] * 5
    assert all(isnan(one) for one in said[5:])


def test_a_history_of_longer_than_rows_are_kept_is_cut() -> None:
    records = [state(k * S) for k in range(2 * KEPT_S)]
    rows = of_history(records, 0, 2 * KEPT_S * S, Lateness())
    assert len(rows) == KEPT_S - 1
    assert of_history([], 0, S, Lateness()) == []
    assert of_history([error(0, 1.0)], 0, S, Lateness()) == []
