"""What ends a flight under water: in which of PX4's modes thrusters stop, and what the service commands."""

from __future__ import annotations

import math
from typing import Any, Final

import pytest
from pymavlink.dialects.v20 import all as dialect

from guidance.cautions import about_sticks, about_stopping
from guidance.commands import Abort, Hold, Resume
from guidance.config import load
from guidance.guard_limits import ACTIONS
from guidance.mavlink.messages import AutopilotVersion, SysStatus
from guidance.mavlink.profiles import PROFILES
from guidance.preflight.findings import Verdict
from guidance.supervisor import State
from sitl.lockstep import Lockstep
from tests.helpers import events_of, fly_until, fly_until_tracking, make_flight
from tests.pilot import Pilot
from tests.preflight_rig import Bench
from tests.test_unflyable_loads import DEPLOY
from tests.vehicle_peer import Peer, px4_in_offboard

UUV: Final = PROFILES["px4-uuv"]
OLD, NEW = (1, 16, 0), (1, 17, 0)
RECEIVER: Final = dialect.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
NO_STICKS: Final = {"COM_RC_IN_MODE": 4}
NORTH_EAST: Final = (math.cos(math.pi / 8.0), 0.0, 0.0, math.sin(math.pi / 8.0))
#: Main mode and sub-mode.
MANUAL, ALTITUDE, POSITION, ACRO, STABILIZED = (1, 0), (2, 0), (3, 0), (5, 0), (7, 0)
LOITER, MISSION, RETURN, LAND = (4, 3), (4, 4), (4, 5), (4, 6)
AUTOMATIC = (LOITER, MISSION, RETURN)
BY_STICKS = (ALTITUDE, POSITION, ACRO, STABILIZED)


def moved_m(peer: Peer, seconds: float) -> float:
    before = peer.vehicle.truth().position_ned_m
    peer.run(seconds)
    return math.dist(before, peer.vehicle.truth().position_ned_m)


def under_way(version: tuple[int, int, int], **options: Any) -> Peer:
    """In OFFBOARD to the north-east at 2.5 m/s."""
    peer = px4_in_offboard(px4_version=version, **options)
    peer.stream(4.0, thrust=0.5, mask=0x00, q=NORTH_EAST)
    assert moved_m(peer, 0.2) == pytest.approx(0.5, abs=0.05)
    return peer


@pytest.mark.parametrize("mode", [MANUAL, *BY_STICKS, *AUTOMATIC])
@pytest.mark.parametrize("version", [OLD, NEW])
def test_before_1_17_only_manual_stops_the_thrusters(
    version: tuple[int, int, int], mode: tuple[int, int]
) -> None:
    peer = under_way(version)
    assert peer.command(176, 1, *mode)[-1] == 0
    peer.run(0.2)
    stops = version == NEW or mode == MANUAL
    assert moved_m(peer, 4.0) == pytest.approx(0.0 if stops else 10.0, abs=0.1)


@pytest.mark.parametrize(
    ("action", "stops"), [*((action, False) for action in (0, 1, 2, 3, 5)), (6, True), (7, True)]
)
def test_before_1_17_the_thrusters_go_on_where_the_setpoints_end(action: int, stops: bool) -> None:
    peer = under_way(OLD, parameters={"COM_OBL_RC_ACT": action})
    peer.run(1.5)
    assert peer.vehicle.mode != "OFFBOARD" or action == 7
    assert peer.vehicle.armed is (action != 7)
    assert moved_m(peer, 4.0) == pytest.approx(0.0 if stops else 10.0, abs=0.1)


@pytest.mark.parametrize("action", [None, 4])
def test_before_1_17_land_disarms_two_seconds_later(action: int | None) -> None:
    """Its land detector of rovers calls it landed at once."""
    peer = under_way(OLD, parameters={} if action is None else {"COM_OBL_RC_ACT": action})
    if action is None:
        assert peer.command(176, 1, *LAND)[-1] == 0
    else:
        peer.run(1.0)
    peer.run(1.0)
    assert moved_m(peer, 0.8) == pytest.approx(2.0, abs=0.3)
    peer.run(0.5)
    assert not peer.vehicle.armed
    assert moved_m(peer, 4.0) == 0.0


def test_an_automatic_mode_turns_on_to_the_last_attitude() -> None:
    """One that is turned away by the way there comes back; one by sticks turns on with the last torque."""
    ends = []
    for mode in (LOITER, POSITION):
        peer = px4_in_offboard(px4_version=OLD)
        peer.stream(0.1, thrust=0.5, mask=0x00, q=(0.0, 0.0, 0.0, 1.0))
        assert peer.command(176, 1, *mode)[-1] == 0
        peer.run(10.0)
        ends.append(peer.vehicle.truth().attitude_wxyz)
    turned, turning = (abs(q[3]) for q in ends)
    assert turned == pytest.approx(1.0, abs=1e-3)
    assert turning < 0.99


@pytest.mark.parametrize("mode", [MANUAL, *BY_STICKS])
def test_without_sticks_no_mode_by_hand_is_taken_in_flight(mode: tuple[int, int]) -> None:
    peer = px4_in_offboard(parameters=NO_STICKS)
    assert peer.command(176, 1, *mode)[-1] != 0
    assert peer.vehicle.mode == "OFFBOARD"


def flown(version: tuple[int, int, int], **options: Any) -> Lockstep:
    flight = make_flight("supervisor.engage=auto", "supervisor.arm=true", px4_version=version, **options)
    fly_until_tracking(flight)
    flight.run(3.0)
    return flight


def drift_m(flight: Lockstep, seconds: float) -> float:
    before = flight.vehicle.truth().position_ned_m
    flight.run(seconds)
    return math.dist(before, flight.vehicle.truth().position_ned_m)


@pytest.mark.parametrize("version", [OLD, NEW])
@pytest.mark.parametrize("order", [Hold(), Abort()])
def test_a_hold_and_an_abort_stop_the_thrusters(version: tuple[int, int, int], order: Hold | Abort) -> None:
    flight = flown(version)
    flight.guide.command(order, flight.now_ns)
    fly_until(flight, State.HOLDING if isinstance(order, Hold) else State.ABORTED, 1.0)
    assert flight.vehicle.mode == "MANUAL"
    assert drift_m(flight, 10.0) == pytest.approx(0.0, abs=0.01)


def test_a_held_flight_goes_on() -> None:
    flight = flown(OLD)
    flight.guide.command(Hold(), flight.now_ns)
    fly_until(flight, State.HOLDING, 1.0)
    flight.run(2.0)
    flight.guide.command(Resume(), flight.now_ns)
    fly_until(flight, State.TRACKING, 3.0)


def test_the_pilot_takes_a_held_vehicle_by_any_other_mode() -> None:
    flight = flown(NEW)
    flight.guide.command(Hold(), flight.now_ns)
    fly_until(flight, State.HOLDING, 1.0)
    Pilot(flight).switch("acro")
    fly_until(flight, State.HANDED_OVER, 1.0)


def test_without_sticks_the_flight_ends_in_silence_and_px4_disarms() -> None:
    flight = flown(OLD, parameters={**NO_STICKS, "COM_OBL_RC_ACT": 7})
    flight.guide.command(Abort(), flight.now_ns)
    fly_until(flight, State.ABORTED, 1.1)
    assert flight.run(2.0, until=lambda: not flight.vehicle.armed)
    assert drift_m(flight, 5.0) == 0.0


def test_what_ships_leaves_the_thrusters_still() -> None:
    config = load(DEPLOY / "px4-uuv.toml")
    guards = {getattr(config.guards, name) for name in ACTIONS}
    commanded = {config.supervisor.exit_mode, config.supervisor.hold_mode, *guards} - {"silence"}
    assert {UUV.mode(name) for name in commanded} == {UUV.mode("manual")}


# What is told before ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("version", "action", "told"),
    [
        (0x010E0000, 0, "before 1.17, and COM_OBL_RC_ACT = 0"),
        (0x011000FF, 5, "before 1.17, and COM_OBL_RC_ACT = 5"),
        (None, 3, "of a version that is not known, and COM_OBL_RC_ACT = 3"),
        (0x011000FF, 6, ""),
        (0x011000FF, 7, ""),
        (0x011100FF, 0, ""),
    ],
)
def test_thrusters_that_would_go_on_are_told(version: int | None, action: int, told: str) -> None:
    known = None if version is None else AutopilotVersion(version, 0)
    found = [one.text for one in about_stopping(UUV, {"COM_OBL_RC_ACT": float(action)}, known)]
    assert bool(found) == bool(told)
    assert told in "".join(found)
    assert not about_stopping(UUV, {}, known), "no parameter was told"
    assert not about_stopping(PROFILES["px4-rover"], {"COM_OBL_RC_ACT": 0.0}, known)


@pytest.mark.parametrize(
    ("action", "mode", "present", "told"),
    [(0, 4, RECEIVER, True), (5, 1, 0, True), (5, 1, RECEIVER, False), (6, 4, 0, False), (7, 4, 0, False)],
)
def test_missing_sticks_are_told_of_a_vehicle_that_is_given_back_to_them(
    action: int, mode: int, present: int, told: bool
) -> None:
    answers = {"COM_OBL_RC_ACT": float(action), "COM_RC_IN_MODE": float(mode)}
    found = about_sticks(UUV, answers, SysStatus(present, RECEIVER, 0, -1))
    assert bool(found) is told
    assert not told or found[0].text.endswith("set COM_OBL_RC_ACT to 7 (disarm)")


@pytest.mark.parametrize("version", [OLD, NEW])
def test_check_and_the_service_tell_it(version: tuple[int, int, int]) -> None:
    found = Bench(vehicle={"px4_version": version}).findings().get("stopping")
    assert (found.verdict if found else None) is (Verdict.WARN if version == OLD else None)
    flight = make_flight("supervisor.engage=pilot", px4_version=version)
    flight.run(8.0)
    assert any("the thrusters go on" in text for text in events_of(flight, "caution")) is (version == OLD)
