"""Gains and limits as MAVLink parameters of this component: listed, read, and tuned within their ranges."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Final

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink

from guidance.changing import settings
from guidance.commands import Set
from guidance.component import PARAMETERS, as_real32, from_real32
from guidance.ground import GONE_NS, PARAMETER_NS, SETTLED_NS
from guidance.records import Packet
from guidance.replay import replay
from guidance.supervisor import State
from sitl.lockstep import Lockstep
from tests.ground_station import COMPONENT, MAY, GroundStation, ready, texts_of, tracking
from tests.helpers import make_config, records_of, setpoints_since, state_of
from tests.test_replay import write

NS: Final = 1_000_000_000
BEAT: Final = mavlink.MAVLink_heartbeat_message(
    mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3
)
PARAM_VALUE: Final = (22).to_bytes(3, "little")


def test_the_list_comes_paced_complete_and_true_and_no_setpoint_waits_for_it() -> None:
    flight, ground = tracking()
    ground.hear()
    start_ns = flight.now_ns
    ground.say(mavlink.MAVLink_param_request_list_message(1, 0))  # to all, as QGroundControl asks
    flight.run(3.0)
    values = ground.hear("PARAM_VALUE")
    times_ns = [p.t_ns for p in records_of(flight, Packet, start_ns) if p.data[7:10] == PARAM_VALUE]
    known = settings(flight.guide.config)
    assert [v.param_index for v in values] == list(range(len(values)))
    assert {v.param_count for v in values} == {len(values)}
    assert {v.param_type for v in values} == {mavlink.MAV_PARAM_TYPE_REAL32}
    assert {PARAMETERS[v.param_id]: v.param_value for v in values} == {
        key: pytest.approx(as_real32(value)) for key, value in known.items()
    }
    assert len(times_ns) == len(values)
    assert min(b - a for a, b in pairwise(times_ns)) >= PARAMETER_NS
    assert max(b - a for a, b in pairwise(setpoints_since(flight, start_ns))) <= 21_000_000


def test_a_list_asked_for_again_and_again_is_told_to_its_end() -> None:
    flight, ground = tracking()
    ground.hear()
    for _ in range(30):
        ground.say(mavlink.MAVLink_param_request_list_message(1, 0))
        flight.run(0.1)
    values = ground.hear("PARAM_VALUE")
    assert {v.param_index for v in values} == set(range(values[0].param_count))


def test_one_is_asked_for_by_name_and_by_number() -> None:
    flight, ground = ready()
    ground.hear()
    for name, number in ((b"LAW_RHO2", -1), (b"", 0), (b"NO_SUCH", -1), (b"", 200), (b"", -300)):
        ground.say(mavlink.MAVLink_param_request_read_message(1, COMPONENT, name, number))
    flight.run(1.0)
    assert [(v.param_id, v.param_value) for v in ground.hear("PARAM_VALUE")] == [
        ("LAW_RHO2", 10.0),
        ("LAW_K", 1.0),
    ]


def test_a_gain_is_tuned_in_flight_within_its_range() -> None:
    flight, ground = tracking()
    ground.hear()
    ground.set("LAW_K", 0.7)
    flight.run(0.1)
    heard = ground.hear()
    assert [(v.param_id, v.param_value) for v in heard if v.get_type() == "PARAM_VALUE"] == [
        ("LAW_K", pytest.approx(0.7))
    ]
    assert texts_of(heard) == []
    assert flight.guide.config.law.k == 0.7  # and not the nearest REAL32
    ground.set("LAW_K", 60.0)
    ground.set("LAW_K", float("nan"))
    ground.set("LAW_K", 0.5, mavlink.MAV_PARAM_TYPE_INT32)
    ground.set("NO_SUCH", 1.0)
    ground.set("_HASH_CHECK", 1.0)
    flight.run(1.0)
    heard = ground.hear()
    assert [(v.param_id, v.param_value) for v in heard if v.get_type() == "PARAM_VALUE"] == [
        ("LAW_K", pytest.approx(0.7))
    ]
    first, second, third, fourth = sorted(texts_of(heard))
    assert first == "guidance: LAW_K is a REAL32"
    assert "must be below 1 to be stable" in second
    assert "must be a number from 1e-06" in third
    assert fourth == "guidance: there is no parameter NO_SUCH"
    assert state_of(flight) is State.TRACKING


def test_an_absent_limit_is_zero_and_a_switch_is_zero_or_one() -> None:
    flight, ground = tracking()
    for name, value in (("LIM_ACC", 2.5), ("LIM_KEEP_DIR", 0.0)):
        ground.set(name, value)
    limits = flight.guide.config.limits
    assert (limits.acceleration_max_m_s2, limits.keep_direction) == (2.5, False)
    for name, value in (("LIM_ACC", 0.0), ("LIM_KEEP_DIR", 1.0), ("LIM_KEEP_DIR", 0.5)):
        ground.set(name, value)
    limits = flight.guide.config.limits
    assert (limits.acceleration_max_m_s2, limits.keep_direction) == (None, True)


def test_what_another_sets_is_told_too() -> None:
    flight, ground = tracking()
    ground.say(mavlink.MAVLink_param_request_read_message(1, COMPONENT, b"LAW_K", -1))
    flight.run(0.5)
    ground.hear()
    flight.guide.command(Set(source="zenoh ada", key="limits.speed_max_m_s", value=3), flight.now_ns)
    flight.run(0.5)
    assert [(v.param_id, v.param_value) for v in ground.hear("PARAM_VALUE")] == [("LIM_SPEED_MAX", 3.0)]


def beats(flight: Lockstep, ground: GroundStation, seconds: int) -> None:
    """A HEARTBEAT a second."""
    for _ in range(seconds):
        ground.say(BEAT)
        flight.run(1.0)


def test_a_station_that_asks_nobody_learns_by_one_unasked_value_that_there_are_parameters() -> None:
    flight, ground = tracking()
    ground.hear()
    start_ns = flight.now_ns
    beats(flight, ground, round(3 * SETTLED_NS / NS))
    (value,) = ground.hear("PARAM_VALUE")
    assert (value.param_id, value.param_index) == ("LAW_K", 0xFFFF)
    assert value.param_count == len(settings(flight.guide.config))
    (at_ns,) = [p.t_ns for p in records_of(flight, Packet, start_ns) if p.data[7:10] == PARAM_VALUE]
    assert 0 <= at_ns - start_ns - SETTLED_NS < 100_000_000
    assert max(b - a for a, b in pairwise(setpoints_since(flight, start_ns))) <= 21_000_000


def test_it_is_told_again_when_it_comes_back_and_not_after_a_gap_in_its_heartbeats() -> None:
    flight, ground = tracking()
    beats(flight, ground, 15)
    assert ground.hear("PARAM_VALUE")
    flight.run(0.9 * GONE_NS / NS - 1.0)
    beats(flight, ground, 15)
    assert not ground.hear("PARAM_VALUE")
    flight.run(1.1 * GONE_NS / NS)
    beats(flight, ground, 15)
    assert len(ground.hear("PARAM_VALUE")) == 1


def test_a_station_that_has_the_list_already_is_told_nothing_more() -> None:
    flight, ground = tracking()
    ground.say(BEAT)
    ground.say(mavlink.MAVLink_param_request_list_message(1, 0))
    beats(flight, ground, 5)
    ground.hear()
    beats(flight, ground, 15)
    assert not ground.hear("PARAM_VALUE")


def test_only_a_ground_station_that_may_command_is_told() -> None:
    flight, ground = tracking()
    ground.hear()
    companion = mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3
    )
    stranger = GroundStation(flight, system=254)
    for _ in range(15):
        stranger.say(BEAT)
        ground.say(companion)
        flight.run(1.0)
    assert not ground.hear("PARAM_VALUE")


def test_a_flight_in_which_a_station_is_told_replays_to_the_bit(tmp_path: Path) -> None:
    flight, ground = tracking()
    beats(flight, ground, 12)
    assert ground.hear("PARAM_VALUE")
    found = replay(write(tmp_path, flight.records, *MAY))
    assert found.identical, found


def test_names_fit_and_every_setting_has_one() -> None:
    assert all(0 < len(name) <= 16 for name in PARAMETERS)
    assert len(set(PARAMETERS.values())) == len(PARAMETERS)
    for chosen in (
        '{name="quadratic"}',
        '{name="bounded", approach_m_s=1.0}',
        '{name="bounded-apart", horizontal_m_s=1.0, vertical_m_s=0.5}',
        '{name="k-of-r", gain=1.0, width_m=5.0}',
    ):
        assert set(settings(make_config(f"law.error_function={chosen}"))) <= set(PARAMETERS.values())


@given(st.floats(width=32))
def test_a_real32_is_kept_whatever_it_is(value: float) -> None:
    kept = from_real32("LAW_K", value)
    assert isinstance(kept, float)
    assert kept == pytest.approx(value, rel=1e-6, nan_ok=True)
