"""The tables of the autopilots' parameters, held against the lists that real autopilots sent."""

from __future__ import annotations

import json
import math
import struct
from operator import attrgetter
from pathlib import Path
from typing import Final

import pytest

from guidance.flying.airplane_fit import ASKED_FOR
from guidance.handling import copter, rover_px4
from guidance.mavlink.messages import ParamValue
from guidance.mavlink.parameters import ParameterReader
from guidance.mavlink.profiles import PROFILES
from guidance.mavlink.requirements import (
    Grade,
    Judged,
    Requirement,
    judged,
    names_of,
    partners_of,
    values_of,
)
from tests.helpers import make_config

RECORDED: Final[dict[str, dict[str, float]]] = json.loads(
    (Path(__file__).parent / "data" / "autopilot_parameters.json").read_text()
)
CONFIG: Final = make_config()
ROW: Final = Requirement(
    "NEW_DEG", "so", unit="deg", older=("OLD_CD",), older_scale=0.01, plausible=(5.0, 80.0), required=True
)


def param_value(name: str, value: float) -> ParamValue:
    """As ArduPilot sends it: whatever its type, the value as a float."""
    return ParamValue(struct.pack("<f", value), name.encode(), 9)


named = pytest.mark.parametrize("name", RECORDED)


@named
def test_every_row_names_what_the_autopilot_has_and_nothing_of_it_is_absurd(name: str) -> None:
    for row in PROFILES[name].requirements:
        found = row.value(RECORDED[name])
        assert found is not None, row.names
        assert judged(row, RECORDED[name], CONFIG).grade in (Grade.GOOD, Grade.DOUBTFUL)


@named
def test_nothing_but_what_the_tables_name_is_kept(name: str) -> None:
    assert RECORDED[name].keys() <= set(names_of(PROFILES[name].requirements))


def test_the_units_of_older_names_are_those_of_the_newer() -> None:
    copter = values_of(PROFILES["ardupilot-copter"].requirements, RECORDED["ardupilot-copter"])
    assert (copter["WP_SPD"], copter["WP_SPD_UP"], copter["WP_SPD_DN"]) == (10.0, 2.5, 1.5)
    assert (copter["WP_ACC"], copter["ATC_ANGLE_MAX"], copter["PSC_NE_JERK"]) == (2.5, 30.0, 5.0)
    old = {"ARSPD_FBW_MIN": 9.0, "TRIM_ARSPD_CM": 1200.0, "ARSPD_FBW_MAX": 22.0, "LIM_ROLL_CD": 4500.0}
    old |= {"LIM_PITCH_MAX": 2000.0, "LIM_PITCH_MIN": -2500.0}
    assert values_of(PROFILES["ardupilot-plane"].requirements, old) == {
        "AIRSPEED_MIN": 9.0,
        "AIRSPEED_CRUISE": 12.0,
        "AIRSPEED_MAX": 22.0,
        "ROLL_LIMIT_DEG": 45.0,
        "PTCH_LIM_MAX_DEG": 20.0,
        "PTCH_LIM_MIN_DEG": -25.0,
    }


def test_no_limit_is_left_out() -> None:
    table = PROFILES["px4-rover"].requirements
    said = {"RO_SPEED_LIM": -1.0, "RO_ACCEL_LIM": 0.0, "RO_YAW_RATE_LIM": 90.0}
    assert values_of(table, said) == {"RO_SPEED_LIM": -1.0, "RO_YAW_RATE_LIM": 90.0}
    assert values_of(table, {"GND_SPEED_MAX": 3.0}) == {"RO_SPEED_LIM": 3.0}
    (speed,) = (row for row in table if row.parameter == "RO_SPEED_LIM")
    assert judged(speed, said, CONFIG).grade is Grade.BAD, "`runSanityChecks`: PX4 does not drive without one"


@pytest.mark.parametrize(
    ("answers", "grade", "text"),
    [
        ({"NEW_DEG": 45.0}, Grade.GOOD, "NEW_DEG = 45 deg"),
        ({"OLD_CD": 4500.0}, Grade.GOOD, "OLD_CD = 4500"),
        ({"NEW_DEG": 45.0, "OLD_CD": 1.0}, Grade.GOOD, "NEW_DEG = 45 deg"),
        (
            {"NEW_DEG": 4500.0},
            Grade.BAD,
            "NEW_DEG = 4500 deg, which cannot be: 5 to 80 may: set NEW_DEG to what the vehicle can do: so",
        ),
        (
            {"OLD_CD": 45.0},
            Grade.BAD,
            "OLD_CD = 45, which cannot be: 500 to 8000 may: set OLD_CD to what the vehicle can do: so",
        ),
        (
            {},
            Grade.BAD,
            "NEW_DEG = the autopilot has no such parameter, and no OLD_CD: "
            "is this the firmware that the profile is for? So",
        ),
        (
            {"NEW_DEG": math.nan},
            Grade.BAD,
            "NEW_DEG = nan is no value: set NEW_DEG anew: the memory of it is damaged",
        ),
    ],
    ids=str,
)
def test_what_is_missing_or_absurd_says_how_much_and_what_to_do(
    answers: dict[str, float], grade: Grade, text: str
) -> None:
    found = judged(ROW, answers, CONFIG)
    assert (found.grade, str(found)) == (grade, text)


def test_what_no_flight_needs_may_be_absent() -> None:
    assert judged(ROW._replace(required=False), {}, CONFIG).grade is Grade.ABSENT


def test_bounds_of_an_older_name_are_told_in_its_unit() -> None:
    row = ROW._replace(low=10.0, serious=False)
    found = judged(row, {"OLD_CD": 600.0}, CONFIG)
    assert found == Judged(
        "OLD_CD", Grade.DOUBTFUL, "600, needs at least 1000", "set OLD_CD to at least 1000: so"
    )


@pytest.mark.parametrize("profile", PROFILES.values(), ids=lambda profile: profile.name)
def test_rows_are_whole(profile: object) -> None:
    table = attrgetter("requirements")(profile)
    names = names_of(table)
    assert len(names) == len(set(names))
    assert all(len(name) <= 16 for name in names)
    assert partners_of(table).keys() <= set(names)
    for row in table:
        assert row.why or not (row.required or row.plausible)
        assert row.required <= row.used
    required = [row.parameter for row in table if row.required]
    assert names[: len(required)] == required


@pytest.mark.parametrize(
    ("name", "taken"),
    [
        ("px4-uuv", ()),
        ("px4-plane", ASKED_FOR),
        ("px4-copter", (*copter.Px4._fields, "MC_YAWRATE_MAX")),
        ("px4-rover", (*rover_px4.Autopilot._fields, "RD_WHEEL_TRACK")),
        ("ardupilot-plane", (*ASKED_FOR, "SCHED_LOOP_RATE")),
        ("ardupilot-copter", (*copter.ArduPilot._fields, "ATC_RATE_Y_MAX", "SCHED_LOOP_RATE")),
    ],
)
def test_what_is_recorded_as_used_is_used(name: str, taken: tuple[str, ...]) -> None:
    assert {row.parameter for row in PROFILES[name].requirements if row.used} <= set(taken)


def test_what_is_taken_is_asked_for() -> None:
    """RLL2SRV_RMAX was taken and never asked for."""
    asked = set(names_of(PROFILES["ardupilot-plane"].requirements))
    assert {name for name in ASKED_FOR if not name.startswith("FW_")} <= asked


def test_a_copter_that_changes_its_names_again_is_known_by_each() -> None:
    """PSC_JERK_XY of 4.6 is PSC_JERK_NE in 4.7.0 and PSC_NE_JERK from 4.7.1 on."""
    table = PROFILES["ardupilot-copter"].requirements
    for level, upright in (("XY", "Z"), ("NE", "D")):
        told = {f"PSC_JERK_{level}": 6.0, f"PSC_JERK_{upright}": 7.0}
        assert values_of(table, told) == {"PSC_NE_JERK": 6.0, "PSC_D_JERK": 7.0}
    partners = partners_of(table)
    assert partners["PSC_JERK_NE"] == ("PSC_NE_JERK", "PSC_JERK_XY")
    reader = ParameterReader(["PSC_NE_JERK", "PSC_JERK_NE", "PSC_JERK_XY"], bytewise=False, partners=partners)
    reader.take(param_value("PSC_JERK_XY", 6.0))
    assert reader.complete
    assert reader.due(0) == []


def test_a_service_of_the_vehicles_own_system_is_heard_whoever_else_is_not() -> None:
    """ArduPilot's `accept_packet`: a companion's system id is the vehicle's."""
    (row,) = (row for row in PROFILES["ardupilot-rover"].requirements if row.parameter == "MAV_OPTIONS")
    assert judged(row, {"MAV_OPTIONS": 1.0}, CONFIG).grade is Grade.GOOD
    assert judged(row, {"SYSID_ENFORCE": 1.0}, CONFIG).grade is Grade.GOOD


def test_an_airplane_that_takes_no_throttle_in_guided_is_refused() -> None:
    """ArduPlane's `mode_guided.cpp`: a forced throttle counts where TRIM_THROTTLE is above 1 %."""
    (row,) = (row for row in PROFILES["ardupilot-plane"].requirements if row.parameter == "TRIM_THROTTLE")
    assert judged(row, {"TRIM_THROTTLE": 1.0}, CONFIG).grade is Grade.BAD
    assert judged(row, {"TRIM_THROTTLE": 2.0}, CONFIG).grade is Grade.GOOD


@pytest.mark.parametrize("bound", [0.01, 10.0])
def test_a_bound_that_was_kept_as_a_float32_may_be(bound: float) -> None:
    """It told that 0.01 cannot be, since 0.01 to 10 may."""
    row = Requirement("ATC_TURN_MAX_G", "it turns no tighter", unit="g", plausible=(0.01, 10.0))
    kept = struct.unpack("<f", struct.pack("<f", bound))[0]
    assert judged(row, {row.parameter: kept}, CONFIG).grade is Grade.GOOD
    assert judged(row, {row.parameter: bound * (0.999 if bound < 1.0 else 1.001)}, CONFIG).grade is Grade.BAD
