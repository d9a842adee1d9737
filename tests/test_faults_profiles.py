"""Every profile as it ships, on its own body: a part of its faults is flown here, all by `--ships`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import pytest

import guidance.mavlink.setpoints
from guidance.handling import airplane_envelope
from guidance.supervisor import State
from sitl.faults.air_faults import PLANES
from sitl.faults.fault import Fault
from sitl.faults.profile_faults import PROFILE_FAULTS
from sitl.faults.run import fly
from sitl.vehicle import Firmware

#: In the order of the table.
TITLES: Final = tuple(dict.fromkeys(fault.title for fault in PROFILE_FAULTS))


def _rows(title: str) -> list[Fault]:
    return [fault for fault in PROFILE_FAULTS if fault.title == title]


def row(firmware: Firmware, title: str) -> Fault:
    """The one of this name."""
    return next(fault for fault in _rows(title) if fault.firmware is firmware)


def _part() -> list[Fault]:
    """Every fourth title, each for another profile."""
    found = []
    for number, title in enumerate(TITLES):
        rows = _rows(title)
        found.append(rows[number // 4 % len(rows)])
    return found[::4]


def test_every_profile_has_every_fault_and_airplanes_more() -> None:
    assert len({(fault.title, fault.firmware) for fault in PROFILE_FAULTS}) == len(PROFILE_FAULTS)
    for title in TITLES:
        assert {fault.firmware for fault in _rows(title)} in (set(Firmware), set(PLANES)), title
    assert {fault.firmware for fault in _part()} == set(Firmware)
    assert all(fault.ships for fault in PROFILE_FAULTS)


@pytest.mark.parametrize("fault", _part(), ids=lambda fault: f"{fault.firmware}: {fault.title}")
def test_the_outcome_is_the_safe_one(fault: Fault) -> None:
    outcome = fly(fault)
    assert outcome.passed, (outcome.problems, outcome.states, outcome.reason)


# What was found by them ------------------------------------------------------------------------------


def test_a_wrong_wind_dives_no_airplane_into_the_ground() -> None:
    """It was believed more than airspeed and heading, and the stall guard went for the ground."""
    assert fly(row(Firmware.PX4_PLANE, "the wind is 14 m/s")).problems == ()


def test_an_airspeed_is_believed_again_after_the_wind_has_turned() -> None:
    """It was doubted for good, and the airplane flown by a wind of long ago, into the ground."""
    title = "no wind is told any more, and the wind turns by 8 m/s"
    assert fly(row(Firmware.PX4_PLANE, title)).problems == ()


# The service is broken on purpose, and the rows say so ------------------------------------------------


def _unclamped(profile: Any, demand: Any, full_m_s: float) -> Any:
    found = _outgoing(profile, demand, full_m_s)
    north, east, down = found.velocity_ned_m_s
    return found._replace(velocity_ned_m_s=(2.0 * north, 2.0 * east, down))


_outgoing: Final = guidance.mavlink.setpoints.outgoing


def test_a_velocity_outside_the_limits_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("guidance.tracker.outgoing", _unclamped)
    for firmware in (Firmware.PX4_COPTER, Firmware.PX4_ROVER):
        outcome = fly(replace(row(firmware, "a gap of 0.4 s both ways"), seconds=4.0))
        assert any("a level speed of" in problem for problem in outcome.problems), outcome.problems


def _all_of_the_wing(bank_max_rad: float, load: float) -> float:
    return 1.5


def test_a_bank_outside_the_limits_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("guidance.handling.airplane_bank.bank_limit", _all_of_the_wing)
    fault = row(Firmware.ARDUPILOT_PLANE, "the heading jumps by 30 degrees for 2 s")
    far = {**fault.vehicle, "initial_yaw_rad": -1.5}
    outcome = fly(replace(fault, seconds=6.0, vehicle=far))
    assert any("a bank of" in problem for problem in outcome.problems), outcome.problems


def _down(*_: Any) -> airplane_envelope.Climb:
    return airplane_envelope.Climb(-8.0, True, False, False)


def test_below_the_floor_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(airplane_envelope, "climb_within", _down)
    outcome = fly(replace(row(Firmware.PX4_PLANE, "a gap of 0.4 s both ways"), seconds=10.0))
    assert any("below the floor" in problem for problem in outcome.problems), outcome.problems


def test_the_vehicle_is_where_its_state_says() -> None:
    assert {fault.begin for fault in PROFILE_FAULTS} >= {
        State.READY,
        State.STREAMING,
        State.SWITCHING,
        State.PAUSING,
        State.HOLDING,
        State.LEAVING,
    }
