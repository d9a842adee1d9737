"""What an airplane must reach, flown by the whole service on its model with noise; what each part is for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from sitl.lockstep import SECOND
from sitl.models.manuals import MANUALS
from sitl.scenarios import airplane, jsbsim
from sitl.scenarios.flight import NotFlownError, Task, fly
from sitl.scenarios.table import Row, fly_row, in_words
from sitl.vehicle import Firmware, Vehicle, VehicleOptions

ROWS = airplane.rows()
JSBSIM = jsbsim.rows()
#: Long enough to converge, and to see that it stays.
SHORT_S = 50.0


def with_settings(flown: Task, *settings: str) -> Task:
    return replace(flown, settings=(*flown.settings, *settings))


def task_of(profile: str, name: str, *, windy: bool = False) -> Task:
    """Of the row with this in its name."""
    (row,) = (
        row
        for row in ROWS
        if row.task.profile == profile and name in row.name and (row.variations == (airplane.WIND,)) == windy
    )
    return row.variations[0].of(replace(row.task, duration_s=SHORT_S))


def reaches(row: Row) -> None:
    short = replace(row, task=replace(row.task, duration_s=SHORT_S))
    result = fly_row(short, row.variations[0], seeds=1)
    assert not result.missed, in_words(result)


@pytest.mark.parametrize(
    "row", [pytest.param(row, id=f"{row.name}, {row.variations[0].name}") for row in ROWS]
)
def test_it_reaches_what_it_must(row: Row) -> None:
    reaches(row)


@pytest.mark.parametrize(
    "row",
    [
        pytest.param(row, id=f"{row.name}, {row.variations[0].name}")
        for row in JSBSIM
        if "circle" in row.name or "J3Cub" in row.name
    ],
)
def test_airplanes_that_others_wrote_are_flown_by_settings_alone(row: Row) -> None:
    reaches(row)


@pytest.mark.parametrize(("profile", "worse"), [("ardupilot-plane", 6.0), ("px4-plane", 2.5)])
def test_what_is_learned_is_needed(profile: str, worse: float) -> None:
    """What a bank gives (ArduPlane's 0.74), and the pitch that the autopilot does not hold (PX4's)."""
    circle = task_of(profile, "circle r 100")
    without = fly(with_settings(circle, "airplane.learns=false"))
    assert without.rms_m > worse * fly(circle).rms_m


def test_a_reference_that_waits_is_reached_earlier() -> None:
    away = task_of("px4-plane", "150 m off")
    assert fly(with_settings(away, "airplane.waits=false")).converged_s > 1.8 * fly(away).converged_s


def test_a_bank_at_its_limit_counts_as_saturated() -> None:
    """The circle takes 10.4 degrees: a limit of 12 is refused nothing, but keeps it from arriving at once."""
    circle = replace(task_of("px4-plane", "circle r 80"), duration_s=20.0, converged_m=1000.0)
    assert fly(with_settings(circle, "airplane.bank_max_deg=12")).saturated > 0.01
    assert fly(replace(circle, converged_m=3.0)).saturated == 0.0


def test_in_more_wind_than_is_flown_with_it_is_not_engaged() -> None:
    windy = task_of("ardupilot-plane", "circle r 100", windy=True)
    with pytest.raises(NotFlownError, match=r"the wind is 4\.9 m/s, airplane\.wind_max_m_s = 3"):
        fly(with_settings(windy, "airplane.wind_max_m_s=3"))


def test_a_flight_is_twice_the_same_and_another_with_another_seed() -> None:
    short = replace(task_of("px4-plane", "circle r 80"), duration_s=4.0)
    assert fly(short) == fly(short)
    assert fly(short) != fly(short, seed=1)


def refused(task: Task, **parameters: float) -> str:
    vehicle: dict[str, Any] = {**task.vehicle, "parameters": parameters}
    with pytest.raises(NotFlownError) as caught:
        fly(replace(task, vehicle=vehicle, duration_s=1.0))
    return str(caught.value)


def test_a_least_airspeed_above_the_plan_is_refused_with_numbers() -> None:
    why = refused(task_of("px4-plane", "circle r 100"), FW_AIRSPD_MIN=14.0)
    assert "14" in why
    assert "airspeed" in why


def test_a_turn_that_is_too_tight_is_refused_with_numbers() -> None:
    tight = with_settings(task_of("px4-plane", "circle r 100"), "trajectory.radius_m=15")
    why = refused(tight)
    assert "bank" in why
    assert "deg" in why


@pytest.mark.parametrize("aircraft", ["J3Cub", "c172p", "t6texan2"])
@pytest.mark.parametrize("firmware", [Firmware.PX4_PLANE, Firmware.ARDUPILOT_PLANE])
def test_by_itself_the_autopilot_circles_at_the_cruise(aircraft: str, firmware: Firmware) -> None:
    vehicle = Vehicle(VehicleOptions(firmware=firmware, model=f"jsbsim:{aircraft}"), boot_ns=SECOND)
    for n in range(1500):
        vehicle.advance(SECOND + n * SECOND // 50)
    truth = vehicle.truth()
    cruise = MANUALS[aircraft].airspeed_cruise_m_s
    assert truth.armed
    assert "LOITER" in truth.mode
    assert truth.airspeed_m_s == pytest.approx(cruise, rel=0.05)
    assert truth.position_ned_m[2] == pytest.approx(-60.0, abs=3.0)
