"""Engaging in lockstep flights with the built-in vehicle, in the manners of both firmwares."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import all as mavlink

from guidance.commands import Engage, Shutdown
from guidance.records import Status
from guidance.supervisor import State
from sitl.lockstep import Lockstep
from sitl.vehicle import Firmware
from tests.helpers import ROVER, events_of, fly_until, fly_until_tracking, make_flight, records_of, state_of
from tests.pilot import AUTO, BOTH, PILOT, PX4, Pilot, S, reason, silent_for


@BOTH
def test_the_first_setpoint_leaves_within_1_5_s_of_the_heartbeat(firmware: tuple[str, ...]) -> None:
    flight = make_flight(*firmware, *AUTO)
    assert flight.run(5.0, until=lambda: flight.guide.link.heartbeat is not None)
    heard_ns = flight.now_ns
    assert flight.run(5.0, until=lambda: len(flight.setpoint_times_ns) > 0)
    assert flight.now_ns - heard_ns <= 1.5 * S
    fly_until_tracking(flight)
    assert flight.vehicle.armed
    assert flight.now_ns - heard_ns <= 3 * S


@BOTH
def test_nothing_is_streamed_before_mode_and_arming_are_known(firmware: tuple[str, ...]) -> None:
    flight = make_flight(*firmware, *AUTO)
    while flight.guide.link.heartbeat is None:
        flight.run(0.01)
        assert not flight.setpoint_times_ns
    fly_until_tracking(flight)


@BOTH
def test_the_pilot_engages_by_a_mode_switch_and_arms(firmware: tuple[str, ...]) -> None:
    flight = make_flight(*firmware, *PILOT)
    pilot = Pilot(flight)
    flight.run(5.0)
    assert state_of(flight) is State.READY
    control = "offboard" if firmware is PX4 else "guided"
    assert reason(flight) == f"waiting for the pilot to switch to {control}"
    # PX4 gets its proof of life beforehand; the rover needs none and gets none.
    assert bool(flight.setpoint_times_ns) is (firmware is PX4)
    pilot.switch("control")
    fly_until(flight, State.ARMING, 0.5)
    flight.run(10.0)
    assert (state_of(flight), flight.vehicle.armed) == (State.ARMING, False)
    assert reason(flight) == "waiting for the pilot to arm"
    pilot.arm()
    fly_until_tracking(flight, 1.1)  # PX4 says so with its next HEARTBEAT
    start = flight.truth().position_ned_m
    flight.run(2.0)
    assert math.dist(start, flight.truth().position_ned_m) > 0.5


@BOTH
def test_the_pilot_engages_a_vehicle_that_is_armed_already(firmware: tuple[str, ...]) -> None:
    flight = make_flight(*firmware, *PILOT, initially_armed=True, initial_mode=None)
    pilot = Pilot(flight)
    flight.run(3.0)
    pilot.switch("control")
    fly_until_tracking(flight, 0.5)


def test_px4_armed_in_an_intended_offboard_is_left_alone_until_somebody_acts() -> None:
    for act in ("mode", "disarm", "command"):
        # The previous stream is gone: PX4 flies position mode, and would obey the first setpoint.
        flight = make_flight(*AUTO, initially_armed=True, initial_mode="OFFBOARD")
        pilot = Pilot(flight)
        assert silent_for(flight, 10.0)
        assert flight.vehicle.mode == "POSCTL"
        assert state_of(flight) is State.WITHHELD
        assert reason(flight) == (
            "found armed in offboard: silent until the mode changes, it disarms, or engage is commanded"
        )
        if act == "command":
            flight.guide.command(Engage(), flight.now_ns)
            fly_until_tracking(flight, 1.5)
        elif act == "mode":
            pilot.switch("hold")
            fly_until(flight, State.READY, 1.5)  # HEARTBEAT still says CRITICAL
            flight.run(10.0)  # neutral setpoints change nothing there, and auto is spent
            assert (state_of(flight), flight.vehicle.mode) == (State.READY, "MANUAL")
            pilot.switch("control")
            fly_until_tracking(flight, 0.5)
        else:
            pilot.arm(False)
            flight.run(20.0)  # auto does not arm what the pilot has just disarmed
            assert (state_of(flight), flight.vehicle.armed) == (State.READY, False)
            flight.guide.command(Engage(), flight.now_ns)
            fly_until_tracking(flight, 3.0)


def test_px4_armed_with_an_unknown_intended_mode_is_left_alone() -> None:
    flight = make_flight(*AUTO, initially_armed=True, initial_mode="AUTO.LOITER")
    drop_current_mode(flight)
    assert silent_for(flight, 10.0)
    assert state_of(flight) is State.WITHHELD
    assert reason(flight) == "armed, and CURRENT_MODE does not say yet whether offboard is intended: silent"
    Pilot(flight).arm(False)
    flight.run(3.0)
    assert state_of(flight) is not State.WITHHELD


def test_px4_without_current_mode_says_what_the_pilot_can_do_and_that_is_true() -> None:
    said = (
        "no CURRENT_MODE tells the intended mode, so no stream is offered: "
        "command engage, or switch to offboard before arming"
    )
    for act in ("armed first", "command", "switch"):
        flight = make_flight(*PILOT)
        drop_current_mode(flight)
        pilot = Pilot(flight)
        assert silent_for(flight, 3.0)
        assert (state_of(flight), reason(flight)) == (State.READY, said)
        if act == "switch":
            pilot.switch("control")
            fly_until(flight, State.ARMING, 1.1)
            flight.run(0.1)  # the stream begins
        pilot.arm()
        if act == "armed first":
            with pytest.raises(AssertionError, match="LOITER"):
                pilot.switch("control")
            assert silent_for(flight, 3.0)
            assert reason(flight) == said
            continue
        flight.run(1.1)  # HEARTBEAT shows it
        if act == "command":
            flight.guide.command(Engage(), flight.now_ns)
        fly_until_tracking(flight, 2.5)


def test_a_stalled_process_does_not_take_control_back() -> None:
    # Armed in READY, the pilot switches while this process stands still: PX4's failsafe acts.
    flight = make_flight(*PILOT, initially_armed=True)
    flight.run(3.0)
    guide, queue = flight.guide, list[bytes]()
    with pytest.MonkeyPatch.context() as stopped:
        stopped.setattr(guide, "receive", lambda data, now_ns: queue.append(data))
        stopped.setattr(guide, "tick", lambda now_ns: None)
        stopped.setattr(guide, "deadline", lambda: 1 << 62)
        Pilot(flight).switch("control")
        flight.run(2.0)
    assert flight.vehicle.mode == "POSCTL"
    for data in queue[: len(queue) // 10]:  # the rest found no room
        guide.receive(data, flight.now_ns)
    assert silent_for(flight, 10.0)
    assert (state_of(flight), flight.vehicle.mode) == (State.READY, "POSCTL")


def test_an_engage_command_that_could_not_be_obeyed_says_so() -> None:
    flight = make_flight(*PILOT, "flight.origin=ekf", "supervisor.engage_max_error_m=5")
    flight.run(3.0)
    flight.guide.command(Engage(), flight.now_ns)
    flight.run(4.9)
    assert events_of(flight, "order_expired") == []
    flight.run(10.0)
    why = "33.0 m from the start, engage_max_error_m is 5: go closer"
    assert events_of(flight, "order_expired") == [f"engage given up after 5 s: {why}"]


def drop_current_mode(flight: Lockstep) -> None:
    """The autopilot is of a version without CURRENT_MODE (436)."""
    receive = flight.guide.receive

    def without(data: bytes, now_ns: int) -> None:
        if data[7:10] != (436).to_bytes(3, "little"):
            receive(data, now_ns)

    flight.guide.receive = without  # type: ignore[method-assign]


def test_the_rover_armed_in_guided_is_left_alone() -> None:
    flight = make_flight(*ROVER, *AUTO, initially_armed=True, initial_mode="GUIDED")
    assert silent_for(flight, 10.0)
    assert state_of(flight) is State.WITHHELD
    Pilot(flight).switch("hold")
    assert silent_for(flight, 10.0)
    Pilot(flight).switch("control")
    fly_until_tracking(flight, 0.5)


def test_a_vehicle_that_the_profile_is_not_for_is_refused_with_the_reason() -> None:
    rover = make_flight(*PX4, *AUTO, firmware=Firmware.ARDUPILOT_ROVER)
    assert silent_for(rover, 10.0)
    said = (
        "MAV_AUTOPILOT_ARDUPILOTMEGA MAV_TYPE_GROUND_ROVER is not what vehicle.profile px4-uuv is for: "
        "this vehicle needs ardupilot-rover"
    )
    assert (state_of(rover), reason(rover)) == (State.CONNECTED, said)
    submarine = make_flight(*ROVER, *AUTO, firmware=Firmware.PX4_UUV)
    assert silent_for(submarine, 10.0)
    assert reason(submarine) == (
        "MAV_AUTOPILOT_PX4 MAV_TYPE_SUBMARINE is not what vehicle.profile ardupilot-rover is for: "
        "this vehicle needs px4-uuv"
    )


@BOTH
def test_an_estimator_that_is_not_ready_blocks_by_name_and_then_engages(firmware: tuple[str, ...]) -> None:
    flight = make_flight(*firmware, *AUTO, estimator_ready_s=8.0)
    assert silent_for(flight, 7.9)
    assert state_of(flight) is State.CONNECTED
    wanted = "LOCAL_POSITION_NED or GLOBAL_POSITION_INT: is the estimator ready?"
    assert reason(flight).startswith("no ")
    assert wanted in reason(flight)
    fly_until_tracking(flight, 4.0)


@BOTH
def test_a_refused_arming_aborts_with_the_autopilots_answer_and_is_tried_again(
    firmware: tuple[str, ...],
) -> None:
    flight = make_flight(*firmware, *AUTO)
    refusing = refuse_arming(flight)
    fly_until(flight, State.ABORTED, 10.0)
    answer = "TEMPORARILY_REJECTED" if firmware is PX4 else "FAILED"
    assert reason(flight) == f"the autopilot does not arm; its answer: {answer}"
    assert silent_for(flight, 4.9)
    refusing.clear()
    fly_until_tracking(flight, 3.0)


def refuse_arming(flight: Lockstep) -> list[str]:
    """Arming is refused until the list is emptied."""
    pilot = flight.vehicle._pilot
    arm, why = pilot.arm, ["not today"]

    def refused(*, forced: bool) -> int:
        if not why:
            return arm(forced=forced)
        return mavlink.MAV_RESULT_TEMPORARILY_REJECTED if not is_rover(flight) else 4

    pilot.arm = refused  # type: ignore[method-assign]
    return why


def is_rover(flight: Lockstep) -> bool:
    """Whether the vehicle is the rover."""
    return flight.vehicle.options.firmware is Firmware.ARDUPILOT_ROVER


@BOTH
def test_far_from_the_start_it_does_not_engage(firmware: tuple[str, ...]) -> None:
    flight = make_flight(*firmware, *AUTO, "flight.origin=ekf", "supervisor.engage_max_error_m=5")
    assert silent_for(flight, 10.0)
    # x(0) = (-10, -30, -5) to r(0) = (0, 1, 0), in the plane for the rover.
    error_m = math.dist((-10, -30, -5), (0, 1, 0)) if firmware is PX4 else math.dist((-10, -30), (0, 1))
    assert reason(flight) == f"{error_m:.1f} m from the start, engage_max_error_m is 5: go closer"


@BOTH
@pytest.mark.parametrize("origin", ["ekf", "home", "engage", "point"])
def test_the_origin_is_where_the_configuration_puts_it(firmware: tuple[str, ...], origin: str) -> None:
    place = "[47.3980, 8.5460, 492.0]"
    wanted = {"ekf": (0.0, 0.0, 0.0), "home": (0.0, 0.0, 0.0), "engage": (-10.0, -30.0, -5.0)}
    if firmware is ROVER:
        wanted["engage"] = (-10.0, -30.0, 0.0)
    # By hand, on the firmware's sphere, about the vehicle's origin (47.397742, 8.545594, 489).
    radius_m = 6371000.0 if firmware is PX4 else 6378100.0
    north_m = math.radians(47.3980 - 47.397742) * radius_m
    east_m = math.radians(8.5460 - 8.545594) * radius_m * math.cos(math.radians(47.3979))
    wanted["point"] = (north_m, east_m, -3.0)
    value = place if origin == "point" else origin
    flight = make_flight(*firmware, *AUTO, f"flight.origin={value}")
    fly_until_tracking(flight)
    flight.run(25.0)
    status = records_of(flight, Status)[-1]
    assert status.origin_ned_m is not None
    assert math.dist(status.origin_ned_m, wanted[origin]) < 0.02
    # The helix's radius is 1 m: the vehicle is on it, and the rover in its plane.
    position = flight.truth().position_ned_m
    assert math.hypot(position[0] - wanted[origin][0], position[1] - wanted[origin][1]) == pytest.approx(
        1, abs=0.02
    )


def test_the_engage_command_is_refused_with_the_reason() -> None:
    flight = make_flight(*AUTO)
    flight.guide.command(Engage(), flight.now_ns)
    fly_until_tracking(flight)
    flight.guide.command(Engage(), flight.now_ns)
    flight.guide.command(Shutdown(), flight.now_ns)
    flight.guide.command(Engage(), flight.now_ns)
    flight.run(1.0)
    assert events_of(flight, "engage_refused") == [
        "engage refused: disconnected: no heartbeat of the autopilot yet",
        "engage refused: the service is shutting down",
    ]
    assert events_of(flight, "engage") == ["engage commanded: already tracking"]
