"""What the autopilot says of itself: whether a copter flies, whether ArduPilot holds a position."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

from guidance.commands import Engage
from guidance.condition import Condition
from guidance.config import load
from guidance.mavlink.messages import EkfStatusReport, ExtendedSysState, Heartbeat
from guidance.mavlink.profiles import PROFILES
from guidance.records import Event
from guidance.records import State as StateRecord
from guidance.supervisor import State
from sitl.lockstep import Lockstep
from sitl.vehicle.ardupilot_messages import EKF_FLAGS
from sitl.vehicle.px4_modes import TAKEOFF
from tests.helpers import ROVER, fly_until, fly_until_tracking, make_flight, records_of, state_of

DEPLOY = Path(__file__).parents[1] / "deploy"
PARAM_VALUE = bytes([dialect.MAVLINK_MSG_ID_PARAM_VALUE, 0, 0])
STANDBY, ACTIVE = dialect.MAV_STATE_STANDBY, dialect.MAV_STATE_ACTIVE


def beat(status: int) -> Heartbeat:
    """A quadrotor's."""
    return Heartbeat(dialect.MAV_TYPE_QUADROTOR, 3, 0, 4, status)


@pytest.mark.parametrize(
    ("landed_state", "says"), [(1, "stands on the ground"), (3, "takes off"), (4, "lands"), (2, None)]
)
def test_a_copter_is_taken_over_in_the_air(landed_state: int, says: str | None) -> None:
    condition = Condition()
    condition.heard(ExtendedSysState(landed_state), 0)
    why = condition.not_flying(PROFILES["ardupilot-copter"], beat(ACTIVE))
    assert (why is None) if says is None else (why is not None and says in why)
    assert condition.not_flying(PROFILES["ardupilot-rover"], beat(ACTIVE)) is None
    for profile in ("px4-plane", "ardupilot-plane"):
        theirs = condition.not_flying(PROFILES[profile], beat(ACTIVE))
        assert theirs == (None if why is None else why.replace("a copter", "an airplane"))


@pytest.mark.parametrize("said", [(), (ExtendedSysState(0),)])
def test_without_the_message_the_heartbeat_says_whether_it_flies(said: tuple[ExtendedSysState, ...]) -> None:
    condition = Condition()
    for body in said:
        condition.heard(body, 0)
    copter = PROFILES["ardupilot-copter"]
    assert condition.not_flying(copter, beat(ACTIVE)) is None
    assert "not known to fly" in str(condition.not_flying(copter, beat(STANDBY)))


def test_a_reboot_forgets() -> None:
    condition = Condition()
    condition.heard(ExtendedSysState(2), 0)
    condition.heard(EkfStatusReport(EKF_FLAGS[False]), 0)
    condition.rebooted()
    assert condition.no_position is None
    assert condition.not_flying(PROFILES["px4-copter"], beat(STANDBY)) is not None


@pytest.mark.parametrize(
    ("flags", "good"),
    [
        (831, True),
        (8, True),
        (16, True),
        (EKF_FLAGS[False], False),
        (831 | 128, False),
        (831 | 1024, False),
        (7, False),
    ],
)
def test_a_position_is_held_relative_or_absolute_and_not_a_constant(flags: int, good: bool) -> None:
    condition = Condition()
    assert condition.no_position is None, "who never says so is believed"
    condition.heard(EkfStatusReport(flags), 0)
    assert (condition.no_position is None) is good


def copter(profile: str, **options: Any) -> Lockstep:
    """As it ships, from the ground unless said otherwise."""
    config = load(DEPLOY / f"{profile}.toml", ('flight.origin="engage"',))
    return make_flight(config=config, **options)


FLYING = ["ardupilot-copter", "px4-copter", "ardupilot-plane", "px4-plane"]


@pytest.mark.parametrize("profile", FLYING)
def test_what_flies_is_not_ready_on_the_ground(profile: str) -> None:
    flight = copter(profile)
    flight.run(12.0)
    assert state_of(flight) is State.CONNECTED
    assert "stands on the ground" in flight.guide.engagement.reason


@pytest.mark.parametrize("profile", FLYING)
def test_what_flies_is_ready_in_the_air(profile: str) -> None:
    flight = copter(profile, airborne=True)
    assert flight.run(12.0, until=lambda: state_of(flight) is State.READY), flight.guide.engagement.reason
    assert flight.guide.link.streams.get("EXTENDED_SYS_STATE") is not None


def test_px4_s_airplane_is_not_ready_as_it_takes_off() -> None:
    """It engaged at 0.6 m and 6 m/s and drove along the ground."""
    flight = copter("px4-plane")
    flight.run(12.0)
    pilot = flight.vehicle._pilot
    pilot.arm(forced=False)
    pilot.select_mode(TAKEOFF)
    flight.run(3.0)
    assert "takes off" in flight.guide.engagement.reason
    assert not flight.run(3.0, until=lambda: state_of(flight) is State.READY)
    assert flight.run(40.0, until=lambda: state_of(flight) is State.READY), flight.guide.engagement.reason
    assert flight.truth().position_ned_m[2] < -10.0


@pytest.mark.parametrize("profile", ["px4-copter", "ardupilot-copter"])
def test_a_restarted_service_is_not_ready_before_it_has_read_the_parameters(profile: str) -> None:
    """In flight, and told to engage, all else is met at once."""
    flight = copter(profile, airborne=True)
    fly_until(flight, State.READY, 12.0)
    flight.guide.command(Engage(), flight.now_ns)
    fly_until(flight, State.TRACKING, 12.0)
    since_ns = flight.now_ns
    flight.on_the_way = lambda data, _: () if data[7:10] == PARAM_VALUE else (data,)
    flight.restart_guide()
    fly_until(flight, State.WITHHELD)
    flight.run(6.0)
    flight.guide.command(Engage(), flight.now_ns)
    flight.run(2.0)
    assert state_of(flight) is State.CONNECTED
    assert "parameters are being read" in flight.guide.engagement.reason
    assert not any(event.code == "state_ready" for event in records_of(flight, Event, since_ns))


def test_arducopters_take_off_in_guided_is_not_broken_off() -> None:
    """GUIDED, arm, NAV_TAKEOFF to 10 m: not one setpoint, and ready above."""
    flight = copter("ardupilot-copter")
    flight.run(12.0)
    pilot = flight.vehicle._pilot
    pilot.select_mode(4)
    pilot.arm(forced=False)
    pilot._takeoff(_Takeoff())  # type: ignore[attr-defined]
    flight.run(5.0)  # the motors spool up first
    assert "takes off" in flight.guide.engagement.reason
    flight.run(12.0)
    assert flight.truth().position_ned_m[2] < -9.0
    assert flight.guide.setpoints_sent == 0
    assert state_of(flight) is State.READY


class _Takeoff:
    params = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 10.0)


def test_a_rover_is_not_driven_by_dead_reckoning_that_nobody_has_told_of_yet() -> None:
    """LOCAL_POSITION_NED stops before the EKF_STATUS_REPORT that says why."""
    flight = make_flight(*ROVER, "trajectory.name=circle")
    fly_until_tracking(flight)
    flight.run(5.0)
    lost_ns = flight.now_ns
    flight.vehicle.withhold("LOCAL_POSITION_NED", "EKF_STATUS_REPORT")
    flight.run(3.0)
    sources = {state.position_source for state in records_of(flight, StateRecord, lost_ns)}
    assert sources == {"LOCAL_POSITION_NED"}
    assert state_of(flight) is not State.TRACKING


def test_a_rover_is_driven_by_global_positions_that_the_estimator_holds() -> None:
    flight = make_flight(*ROVER, "trajectory.name=circle")
    fly_until_tracking(flight)
    flight.run(5.0)
    flight.vehicle.withhold("LOCAL_POSITION_NED")
    flight.run(3.0)
    assert state_of(flight) is State.TRACKING
    assert records_of(flight, StateRecord)[-1].position_source == "GLOBAL_POSITION_INT"


def test_a_rover_is_not_driven_by_dead_reckoning() -> None:
    """No position: LOCAL_POSITION_NED stops, GLOBAL_POSITION_INT goes on and is not used."""
    flight = make_flight(*ROVER, "trajectory.name=circle")
    fly_until_tracking(flight)
    flight.run(5.0)
    lost_ns = flight.now_ns
    flight.guide.condition.heard(EkfStatusReport(EKF_FLAGS[False]), flight.now_ns)
    flight.vehicle.withhold("LOCAL_POSITION_NED", "EKF_STATUS_REPORT")
    flight.run(3.0)
    sources = {state.position_source for state in records_of(flight, StateRecord, lost_ns)}
    assert sources == {"LOCAL_POSITION_NED"}
    assert state_of(flight) is not State.TRACKING
