"""The autopilot's parameters: read by name over a line that loses, decoded for each firmware, judged."""

from __future__ import annotations

import math
import random
import struct
from operator import attrgetter
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from guidance.mavlink.codec import FrameReader
from guidance.mavlink.messages import DECODERS, ParamValue
from guidance.mavlink.parameters import TIMES_ASKED, ParameterReader, name_of, value_of
from guidance.mavlink.profiles import PROFILES
from guidance.mavlink.requirements import Grade
from guidance.mavlink.requirements import judged as judge
from guidance.preflight.findings import Verdict
from guidance.preflight.vehicle_checks import judged
from tests.helpers import ROVER, make_config
from tests.mavlink_peer import MS, Sender
from tests.preflight_rig import Bench

RATED = (*ROVER, "link.rate_hz=40", "law.rho2_per_s=3", "law.rho3_per_s=3")


def on_the_wire(raw: bytes, kind: int, name: bytes = b"NAME") -> ParamValue:
    """A PARAM_VALUE with these four bytes, through a frame and back."""
    message = mavlink.MAVLink_param_value_message(name, 1.25, kind, 1, 0)
    packet = bytearray(Sender().pack(message))
    assert packet[10:14] == struct.pack("<f", 1.25)
    (frame,) = FrameReader().feed(bytes(packet))
    body = DECODERS[frame.message_id](raw + frame.payload[4:])
    assert isinstance(body, ParamValue)
    return body


@pytest.mark.parametrize("number", [0, 1, -1, 7, -(2**31), 2**31 - 1, 0x7F800001, -8388607, 0x7FC00000])
def test_px4s_integers_keep_every_bit(number: int) -> None:
    body = on_the_wire(struct.pack("<i", number), mavlink.MAV_PARAM_TYPE_INT32)
    assert value_of(body, bytewise=True) == number


@pytest.mark.parametrize(("kind", "layout", "number"), [(1, "<B3x", 255), (2, "<b3x", -3), (4, "<h2x", -300)])
def test_smaller_integers_are_the_first_bytes(kind: int, layout: str, number: int) -> None:
    assert value_of(on_the_wire(struct.pack(layout, number), kind), bytewise=True) == number


@pytest.mark.parametrize("kind", [mavlink.MAV_PARAM_TYPE_INT32, mavlink.MAV_PARAM_TYPE_REAL32])
def test_ardupilots_integers_are_floats(kind: int) -> None:
    assert value_of(on_the_wire(struct.pack("<f", 40.0), kind), bytewise=False) == 40.0


def test_a_float_is_a_float_for_both() -> None:
    body = on_the_wire(struct.pack("<f", 0.5), mavlink.MAV_PARAM_TYPE_REAL32)
    assert value_of(body, bytewise=True) == value_of(body, bytewise=False) == 0.5


def test_a_name_of_sixteen_characters_has_no_end() -> None:
    assert name_of(on_the_wire(b"\0\0\0\0", 9, b"ABCDEFGHIJKLMNOP")) == "ABCDEFGHIJKLMNOP"
    assert name_of(on_the_wire(b"\0\0\0\0", 9, b"ABC")) == "ABC"


def test_a_few_are_asked_for_at_a_time_and_the_rest_as_answers_come() -> None:
    reader = ParameterReader("ABCDEF", bytewise=False)
    assert reader.due(0) == ["A", "B", "C", "D"]
    assert reader.due(1) == []
    assert reader.deadline(1) == 300 * MS
    reader.take(ParamValue(struct.pack("<f", 2.0), b"B", 9))
    reader.take(ParamValue(struct.pack("<f", 2.0), b"Z", 9))
    assert reader.deadline(2) == 2
    assert reader.due(2) == ["E"]
    assert reader.values == {"B": 2.0}


def test_what_is_never_answered_is_absent_and_no_longer_asked_for() -> None:
    reader = ParameterReader(["A", "B"], bytewise=False)
    asked = []
    for now_ns in range(0, 3000 * MS, 10 * MS):
        asked += reader.due(now_ns)
        if "B" in asked:
            reader.take(ParamValue(bytes(4), b"B", 9))
    assert asked.count("A") == TIMES_ASKED
    assert asked.count("B") == 1
    assert reader.complete
    assert reader.deadline(3000 * MS) is None


def test_all_are_read_over_a_line_that_loses_a_third_each_way() -> None:
    dice = random.Random(5)
    bench = Bench(
        *RATED,
        garbles=lambda data: b"" if dice.random() < 0.3 else data,
        deaf_to=lambda message: dice.random() < 0.3,
    )
    assert bench.observation.parameters.values.keys() >= {
        r.parameter for r in PROFILES["ardupilot-rover"].requirements
    }


@pytest.mark.parametrize("profile", PROFILES.values(), ids=lambda profile: profile.name)
def test_the_tables_name_keys_of_the_configuration(profile: Any) -> None:
    for row in profile.requirements:
        for bound in (row.low, row.high):
            if isinstance(bound, str):
                attrgetter(bound)(make_config())
        assert len(row.parameter) <= 16
        assert row.doubtful <= row.meanings.keys()
        assert row.why or not (row.doubtful or row.low or row.high)


@pytest.mark.parametrize(
    ("overrides", "parameters", "verdict", "found", "todo"),
    [
        (
            (),
            {"COM_OF_LOSS_T": 0.5},
            Verdict.WARN,
            "0.5 s, needs at least 1",
            "set COM_OF_LOSS_T to at least 1: ",
        ),
        (
            (),
            {"COM_OF_LOSS_T": 30.0},
            Verdict.WARN,
            "30 s, needs at most 2",
            "set COM_OF_LOSS_T to at most 2: ",
        ),
        (
            (),
            {"COM_OF_LOSS_T": 0.0},
            Verdict.FAIL,
            "0 s, which cannot be: 0.2 to 60 may",
            "set COM_OF_LOSS_T to what the vehicle can do: ",
        ),
        (
            (),
            {"UUV_THRUST_SAT": 0.1},
            Verdict.WARN,
            "0.1, needs at least 1",
            "set UUV_THRUST_SAT to at least 1: thrust is cut off here",
        ),
        ((), {"COM_OBL_RC_ACT": 7}, Verdict.OK, "7: disarm", ""),
        ((), {"COM_OBL_RC_ACT": 99}, Verdict.WARN, "99: a meaning that is not known here", "look it up in"),
        ((), {"COM_OBL_RC_ACT": 5}, Verdict.OK, "5: hold", ""),
        ((), {"MAV_FWDEXTSP": 0}, Verdict.FAIL, "0, needs 1", "set MAV_FWDEXTSP to 1: without it"),
        (
            RATED,
            {"WP_SPEED": 2.0},
            Verdict.WARN,
            "2 m/s, needs 5 for vehicle.speed_at_full_thrust_m_s = 5",
            "set WP_SPEED to 5, or vehicle.speed_at_full_thrust_m_s = 2: thrust 1 gives WP_SPEED",
        ),
        (RATED, {"WP_SPEED": 4.97}, Verdict.OK, "4.97 m/s", ""),
        (
            RATED,
            {"WP_SPEED": 0.0},
            Verdict.FAIL,
            "0 m/s, which cannot be: 0.1 to 50 may",
            "set WP_SPEED to what the vehicle can do: thrust 1 gives WP_SPEED",
        ),
        (
            RATED,
            {"WP_SPEED": 400.0},
            Verdict.FAIL,
            "400 m/s, which cannot be: 0.1 to 50 may",
            "set WP_SPEED to what the vehicle can do: ",
        ),
        (
            RATED,
            {"ATC_STR_RAT_MAX": 60.0},
            Verdict.WARN,
            "60 deg/s, needs at least 114.592 for limits.yaw_rate_max_rad_s = 2",
            "set ATC_STR_RAT_MAX to at least 114.592, or limits.yaw_rate_max_rad_s = 1.0472: ",
        ),
        (RATED, {"ATC_STR_RAT_MAX": 0.0}, Verdict.OK, "no limit", ""),
        (RATED, {"ATC_ACCEL_MAX": 0.1}, Verdict.OK, "0.1 m/s^2", ""),
        (
            (*RATED, "limits.acceleration_max_m_s2=2"),
            {"ATC_ACCEL_MAX": 1.0},
            Verdict.WARN,
            "1 m/s^2, needs at least 2 for limits.acceleration_max_m_s2 = 2",
            "set ATC_ACCEL_MAX to at least 2, or limits.acceleration_max_m_s2 = 1: ",
        ),
        (RATED, {"FS_ACTION": 0}, Verdict.WARN, "0: nothing", "no failsafe of the autopilot's own"),
        (RATED, {"FS_ACTION": 6}, Verdict.OK, "6: loiter or hold", ""),
        (RATED, {"FS_EKF_ACTION": 0}, Verdict.WARN, "0: nothing", "it drives on when its estimator fails"),
        (RATED, {"FS_EKF_ACTION": 1}, Verdict.OK, "1: hold", ""),
        (RATED, {"FS_GCS_ENABLE": 1}, Verdict.OK, "1: a lost ground station is a failsafe", ""),
        (
            RATED,
            {"MAV_OPTIONS": 1},
            Verdict.OK,
            "1: only MAV_GCS_SYSID and the vehicle's own id are heard",
            "",
        ),
    ],
    ids=lambda value: "".join(f"{k}={v}" for k, v in value.items()) if isinstance(value, dict) else "",
)
def test_each_value_is_judged_for_what_it_does(
    overrides: tuple[str, ...], parameters: dict[str, float], verdict: Verdict, found: str, todo: str
) -> None:
    (name,) = parameters
    finding = Bench(*overrides, vehicle={"parameters": parameters}).findings()[name]
    assert (finding.verdict, finding.found) == (verdict, found)
    assert finding.todo.startswith(todo)
    assert bool(finding.todo) == bool(todo)


#: As PX4 comes, if nobody sets them.
STOCK = {"COM_RC_IN_MODE": 3, "COM_RCL_EXCEPT": 0, "NAV_RCL_ACT": 2, "NAV_DLL_ACT": 0}


@pytest.mark.parametrize(
    ("said", "warned"),
    [
        ({}, {}),
        ({"COM_RCL_EXCEPT": 11}, {}),
        ({"COM_RCL_EXCEPT": 4}, {"COM_RCL_EXCEPT": "4: OFFBOARD goes on when sticks are lost"}),
        ({"COM_RCL_EXCEPT": 7}, {"COM_RCL_EXCEPT": "7: OFFBOARD goes on when sticks are lost"}),
        ({"NAV_RCL_ACT": 6}, {"NAV_RCL_ACT": "6: disarm"}),
        ({"COM_RC_IN_MODE": 4, "COM_RCL_EXCEPT": 4, "NAV_RCL_ACT": 6}, {}),
        ({"COM_RC_IN_MODE": 4, "NAV_DLL_ACT": 1}, {"NAV_DLL_ACT": "1: hold"}),
        (
            {"COM_RC_IN_MODE": 9},
            {"COM_RC_IN_MODE": "9: a meaning that is not known here"},
        ),
    ],
)
@pytest.mark.parametrize("profile", ["px4-uuv", "px4-plane", "px4-copter", "px4-rover"])
def test_what_keeps_lost_sticks_or_no_ground_station_from_ending_offboard_well_is_warned_of(
    profile: str, said: dict[str, float], warned: dict[str, str]
) -> None:
    """PX4 as it comes ends OFFBOARD when the transmitter is lost, and so the pilot has the last word.

    `failsafe.cpp` and `rcAndDataLinkCheck.cpp` of PX4 1.14 to main of 2026-03.
    """
    answers = STOCK | said
    rows = [row for row in PROFILES[profile].requirements if row.parameter in STOCK]
    assert {row.parameter for row in rows} == STOCK.keys()
    found = [(row, judge(row, answers, make_config())) for row in rows]
    assert {one.name: one.found for _, one in found if one.grade is Grade.DOUBTFUL} == warned
    assert all(one.grade in (Grade.GOOD, Grade.DOUBTFUL) for _, one in found), "none forbids a flight"
    assert not any(row.used or row.required for row in rows)


def test_what_is_quiet_is_shown_only_if_something_is_wrong_with_it() -> None:
    assert not STOCK.keys() & Bench().findings().keys()
    assert not STOCK.keys() & Bench(vehicle={"parameters": STOCK}).findings().keys()
    shown = Bench(vehicle={"parameters": STOCK | {"COM_RCL_EXCEPT": 7}}).findings()
    assert STOCK.keys() & shown.keys() == {"COM_RCL_EXCEPT"}
    assert shown["COM_RCL_EXCEPT"].verdict is Verdict.WARN
    assert "take 4 from it (bit 2)" in shown["COM_RCL_EXCEPT"].todo


@pytest.mark.parametrize(
    ("profile", "name", "value", "grade"),
    [
        ("ardupilot-plane", "FS_LONG_ACTN", 0, Grade.DOUBTFUL),
        ("ardupilot-plane", "FS_LONG_ACTN", 1, Grade.GOOD),
        ("px4-rover", "COM_OBL_RC_ACT", 0, Grade.DOUBTFUL),
        ("px4-rover", "COM_OBL_RC_ACT", 5, Grade.GOOD),
        ("px4-copter", "COM_OBL_RC_ACT", 0, Grade.GOOD),
        ("px4-copter", "COM_OBL_RC_ACT", 7, Grade.DOUBTFUL),
        ("px4-uuv", "COM_OBL_RC_ACT", 7, Grade.GOOD),  # the thrusters stop, and it floats up
    ],
)
def test_a_vehicle_that_would_go_on_with_nobody_in_command_is_warned_of(
    profile: str, name: str, value: int, grade: Grade
) -> None:
    (row,) = (row for row in PROFILES[profile].requirements if row.parameter == name)
    assert judge(row, {name: float(value)}, make_config()).grade is grade


def test_a_parameter_that_the_autopilot_lacks_says_so_and_an_older_name_stands_in() -> None:
    def deaf(message: Any) -> bool:
        return message.get_type() == "PARAM_REQUEST_READ" and message.param_id in ("MAV_OPTIONS", "WP_SPEED")

    bench = Bench(*RATED, deaf_to=deaf)
    findings = bench.findings()
    assert findings["WP_SPEED"][:3] == ("WP_SPEED", Verdict.FAIL, "the autopilot has no such parameter")
    assert findings["WP_SPEED"].todo.startswith("is this the firmware that the profile is for? Thrust 1")
    assert findings["MAV_OPTIONS"].found == "the autopilot has no such parameter, and no SYSID_ENFORCE"
    bench.observation.parameters.values["SYSID_ENFORCE"] = 1.0
    assert bench.findings()["SYSID_ENFORCE"].verdict is Verdict.OK


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf], ids=str)
@pytest.mark.parametrize("overrides", [(), RATED], ids=["px4-uuv", "ardupilot-rover"])
def test_a_value_that_is_no_number_fails_whatever_is_asked_of_it(
    overrides: tuple[str, ...], value: float
) -> None:
    bench = Bench(*overrides, seconds=0.1)
    for row in bench.observation.profile.requirements:
        bench.observation.parameters.values[row.parameter] = value
        finding = judged(row, bench.seen())
        assert (finding.check, finding.verdict) == (row.parameter, Verdict.FAIL)
        assert finding.found == f"{value} is no value"
        assert finding.todo.startswith(f"set {row.parameter} anew")
