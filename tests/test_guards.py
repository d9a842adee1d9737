"""Each guard in flight against the built-in vehicle: its reason, event and action, and nothing after it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import pytest

from guidance.guards import GUARDS
from guidance.mavlink.messages import BatteryStatus, StatusText, SysStatus
from guidance.records import Event, Level, Packet
from guidance.se3 import Pose, Vec3, quaternion_exp
from guidance.supervisor import State
from sitl.lockstep import Channel, Lockstep
from sitl.plant import PlantParameters
from sitl.vehicle.controls import Effect
from tests.helpers import (
    PERFECT,
    ROVER,
    events_of,
    fly_until,
    make_flight,
    records_of,
    setpoints_since,
    state_of,
)
from tests.pilot import AUTO, BOTH, NAMES, PX4, Pilot, tracking
from tests.sent_setpoints import sent_setpoint

#: Below the band of depth in 20 s: the demo's helix goes down at 0.1 m/s.
SHALLOW: Final = ("guards.fence_plan_s=0", "guards.fence_down_max_m=2.0")


def assert_ended(flight: Lockstep, name: str, seconds: float, mode: str | None = "hold") -> str:
    """The guard ends the flight, and nothing is sent after; its reason."""
    began_ns = flight.now_ns
    assert flight.run(seconds, until=lambda: state_of(flight) in (State.ABORTING, State.ABORTED)), (
        f"{state_of(flight)}: {flight.guide.engagement.reason}"
    )
    told = [event for event in records_of(flight, Event, began_ns) if event.code == f"guard_{name}"]
    assert [event.level for event in told] == [Level.ERROR], events_of(flight, since_ns=began_ns)
    assert told[0].text.startswith(f"{name}: ")
    fly_until(flight, State.ABORTED, 1.1)
    if mode is not None:
        assert flight.vehicle.mode in NAMES[mode]
    aborted_ns = flight.now_ns
    flight.to_guide = flight.to_vehicle = PERFECT
    flight.run(10.0)
    assert setpoints_since(flight, aborted_ns) == []
    assert state_of(flight) in (State.ABORTED, State.CONNECTED, State.READY)  # that only if it was put down
    packets = [packet.data for packet in records_of(flight, Packet, began_ns)]
    texts = [data for data in packets if b"guidance: abort" in data]
    assert name.encode() in texts[0]
    return told[0].text


@BOTH
def test_state_that_stops_while_the_link_lives_commands_the_mode(firmware: tuple[str, ...]) -> None:
    flight, _ = tracking(firmware, "guards.state_max_s=0.3")
    flight.vehicle.withhold("ATTITUDE", "ATTITUDE_QUATERNION", "ODOMETRY")
    assert "the attitude is 0." in assert_ended(flight, "state", 1.0)


@BOTH
def test_a_low_rate_ends_the_flight_before_it_breaks_off(firmware: tuple[str, ...]) -> None:
    flight, _ = tracking(firmware, "link.attitude_timeout_s=0.5", "link.position_timeout_s=0.5")
    flight.to_guide = Channel(loss=0.8)
    assert " Hz" in assert_ended(flight, "rate", 20.0)


@BOTH
@pytest.mark.parametrize("loss", [0.3, 0.5])
def test_random_loss_trips_nothing(firmware: tuple[str, ...], loss: float) -> None:
    flight, _ = tracking(firmware, "guards.state_max_s=0.3", seed=1)
    flight.to_guide = flight.to_vehicle = Channel(loss=loss, jitter_s=0.1)
    flight.run(30.0)
    assert not [text for code, text in codes(flight) if code.startswith("guard_")]
    assert loss > 0.3 or state_of(flight) is State.TRACKING


def codes(flight: Lockstep) -> list[tuple[str, str]]:
    """The events' codes and texts."""
    return [(event.code, event.text) for event in records_of(flight, Event)]


@BOTH
def test_old_states_end_the_flight(firmware: tuple[str, ...]) -> None:
    flight, _ = tracking(
        firmware, "link.attitude_timeout_s=1", "link.position_timeout_s=1", "guards.delay_max_s=0.1"
    )
    flight.to_guide = flight.to_vehicle = Channel(delay_s=0.2)
    assert "late" in assert_ended(flight, "delay", 10.0)


@BOTH
def test_a_jump_past_the_limit_ends_the_flight_and_one_below_does_not(firmware: tuple[str, ...]) -> None:
    flight, _ = tracking(firmware)
    flight.vehicle.reset_estimator(flight.now_ns, (5.0, 0.0, 0.0), 0.0)
    flight.run(1.0)
    assert state_of(flight) is State.TRACKING
    flight.vehicle.reset_estimator(flight.now_ns, (55.0, 0.0, 0.0), 0.0)
    assert assert_ended(flight, "jump", 0.2).startswith("jump: estimator")


@BOTH
def test_a_turned_estimator_ends_the_flight(firmware: tuple[str, ...]) -> None:
    flight, _ = tracking(firmware)
    flight.vehicle.reset_estimator(flight.now_ns, (0.0, 0.0, 0.0), 1.5)
    assert assert_ended(flight, "jump", 0.2) == "jump: estimator turned by 86 deg"


@BOTH
def test_a_turn_is_judged_beside_a_larger_move(firmware: tuple[str, ...]) -> None:
    flight, _ = tracking(firmware)
    flight.vehicle.reset_estimator(flight.now_ns, (3.0, 0.0, 0.0), 1.5)
    assert "turned by 86 deg" in assert_ended(flight, "jump", 0.2)


@BOTH
def test_an_error_that_lasts_ends_the_flight(firmware: tuple[str, ...]) -> None:
    start = (-40.0, -30.0, 0.0)
    flight = make_flight(
        *firmware,
        *AUTO,
        "flight.origin=ekf",
        "guards.error_max_m=10",
        "guards.error_s=2",
        initial_position_ned_m=start,
    )
    fly_until(flight, State.TRACKING)
    began_ns = flight.now_ns
    assert "m off the trajectory" in assert_ended(flight, "error", 3.0)
    ended = next(event for event in records_of(flight, Event) if event.code == "guard_error")
    assert 1.9e9 <= ended.t_ns - began_ns <= 2.2e9


def test_the_fence_ends_the_flight_before_the_vehicle_is_outside() -> None:
    flight, _ = tracking(PX4, *SHALLOW, "flight.origin=ekf", "guards.fence_ahead_s=3")
    assert assert_ended(flight, "fence", 40.0) == "fence: the trajectory leaves the fence in 3 s"
    assert flight.vehicle.truth().position_ned_m[2] < 2.0


@BOTH
def test_a_vehicle_that_finds_itself_outside_is_stopped_at_once(firmware: tuple[str, ...]) -> None:
    square = "guards.fence_ned_m=[[-60.0,-60.0],[60.0,-60.0],[60.0,60.0],[-60.0,60.0]]"
    flight, _ = tracking(firmware, square, "guards.jump_max_m=1000")
    flight.vehicle.reset_estimator(flight.now_ns, (0.0, 200.0, 0.0), 0.0)
    assert assert_ended(flight, "fence", 0.2).endswith("m outside the fence")


@BOTH
@pytest.mark.parametrize("way", ["vehicle", "trajectory"])
def test_what_is_not_inside_the_fence_does_not_engage(firmware: tuple[str, ...], way: str) -> None:
    east = 0.0 if way == "vehicle" else -29.5  # the start is at -30, and the helix begins to the north
    fence = f"guards.fence_ned_m=[[-60.0,{east}],[60.0,{east}],[60.0,-60.0],[-60.0,-60.0]]"
    if way == "vehicle":
        fence = "guards.fence_ned_m=[[-60.0,0.0],[60.0,0.0],[60.0,60.0],[-60.0,60.0]]"
    flight = make_flight(*firmware, *AUTO, "flight.origin=engage", "trajectory.name=circle", fence)
    flight.run(10.0)
    assert state_of(flight) is State.CONNECTED
    said = flight.guide.engagement.reason
    assert ("outside the fence" if way == "vehicle" else "leaves the fence in") in said


def test_the_whole_plan_must_be_inside_before_the_flight_begins() -> None:
    flight = make_flight(*AUTO, "flight.origin=engage", "guards.fence_down_max_m=-4")
    flight.run(5.0)
    assert flight.guide.engagement.reason == "fence: the trajectory leaves the fence in 10 s"


def test_a_failsafe_from_before_does_not_end_the_flight_that_was_commanded_after_it() -> None:
    flight, _ = tracking(PX4)
    flight.to_guide = flight.to_vehicle = Channel(loss=1.0)
    flight.run(2.0)
    flight.to_guide = flight.to_vehicle = PERFECT
    flight.run(5.0)
    assert flight.vehicle.mode == "POSCTL"
    assert flight.guide.engagement.engage(flight.now_ns) is None
    fly_until(flight, State.TRACKING)
    flight.run(3.0)
    assert state_of(flight) is State.TRACKING


def test_jumps_that_are_still_blended_add_up() -> None:
    flight, _ = tracking(PX4)
    flight.vehicle.reset_estimator(flight.now_ns, (8.0, 0.0, 0.0))
    flight.run(0.5)
    assert state_of(flight) is State.TRACKING
    flight.vehicle.reset_estimator(flight.now_ns, (16.0, 0.0, 0.0))
    assert assert_ended(flight, "jump", 0.2).startswith("jump: estimator off by 1")


def test_a_fence_on_earth_is_found_in_the_local_frame() -> None:
    around = [[47.396, 8.543], [47.399, 8.543], [47.399, 8.548], [47.396, 8.548]]
    flight = make_flight(*AUTO, f"guards.fence_deg={around}")
    fly_until(flight, State.TRACKING)
    elsewhere = [[48.396, 8.543], [48.399, 8.543], [48.399, 8.548], [48.396, 8.548]]
    flight = make_flight(*AUTO, f"guards.fence_deg={elsewhere}")
    flight.run(5.0)
    assert "outside the fence" in flight.guide.engagement.reason


@BOTH
def test_speed_ends_the_flight(firmware: tuple[str, ...]) -> None:
    flight = make_flight(*firmware, *AUTO, "guards.speed_max_m_s=0.05")
    fly_until(flight, State.TRACKING)
    assert "above 0.05 m/s" in assert_ended(flight, "speed", 10.0)


def test_tilt_ends_the_flight() -> None:
    start = (-10.0, -30.0, 40.0)  # far below: it climbs steeply
    flight = make_flight(*AUTO, "guards.tilt_max_deg=20", initial_position_ned_m=start)
    fly_until(flight, State.TRACKING)
    assert "above 20 deg" in assert_ended(flight, "tilt", 10.0)


def test_a_tilt_is_one_that_was_seen_not_one_that_is_expected() -> None:
    """A late airplane that rolls would be upside down by the time its setpoint acts, by its rates alone."""
    flight = make_flight(*AUTO, "guards.tilt_max_deg=20")
    fly_until(flight, State.TRACKING)
    level = flight.guide.steering.estimate(flight.now_ns)
    assert not isinstance(level, str)
    tilt = next(guard for guard in GUARDS if guard.name == "tilt")
    over = Pose(level.pose.position, quaternion_exp(Vec3(2.0, 0.0, 0.0)))
    for estimate, ends in ((level._replace(pose=over), False), (level._replace(seen=over), True)):
        look = flight.guide.guards._seen(estimate, flight.now_ns)
        assert (tilt.exceeded(look) is not None) is ends


@BOTH
def test_a_number_that_is_not_finite_is_never_sent(
    firmware: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    flight, _ = tracking(firmware)
    tracker = flight.guide.tracker
    solve = tracker.solve

    def broken(estimate: Any) -> Any:
        solution = solve(estimate)
        return solution._replace(outgoing=solution.outgoing._replace(thrust=float("nan")))

    monkeypatch.setattr(tracker, "solve", broken)
    since_ns = flight.now_ns
    assert "not finite" in assert_ended(flight, "number", 0.035)  # with the very setpoint
    assert not [p for p in records_of(flight, Packet, since_ns + 1) if sent_setpoint(p) is not None]


@BOTH
def test_setpoints_without_effect_end_the_flight(firmware: tuple[str, ...]) -> None:
    stuck = PlantParameters(max_rate_rad_s=1e-3, max_speed_m_s=1e-3)
    flight = make_flight(*firmware, *AUTO, plant=stuck)
    fly_until(flight, State.TRACKING)
    assert "no effect" in assert_ended(flight, "effect", 6.0)


@BOTH
def test_rates_without_effect_are_seen_behind_a_prediction(firmware: tuple[str, ...]) -> None:
    """Predicted rates are those that were sent: with a delay they say nothing of the vehicle."""
    flight = make_flight(*firmware, *AUTO, "link.actuation_delay_s=0.1", "guards.effect_s=2")
    fly_until(flight, State.TRACKING)
    flight.run(2.0)
    flight.vehicle.refit(flight.now_ns, effect=Effect(yaw=0.0, pitch=0.0))
    assert "rad/s: no effect" in assert_ended(flight, "effect", 15.0)


@BOTH
def test_a_late_loop_ends_the_flight(firmware: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    flight, _ = tracking(firmware)
    pace = flight.guide.steering.pace
    taken = pace.taken
    monkeypatch.setattr(pace, "taken", lambda now_ns: taken(now_ns) - 60_000_000)
    assert "ms late" in assert_ended(flight, "late", 2.0)


BATTERIES: Final = [(BatteryStatus(1, 5, 0), 4.0, "5 %"), (BatteryStatus(1, -1, 3), 4.0, "critical")]


@BOTH
@pytest.mark.parametrize(("battery", "seconds", "words"), BATTERIES, ids=["percent", "state"])
def test_a_low_battery_ends_the_flight_and_forbids_the_next(
    firmware: tuple[str, ...], battery: BatteryStatus, seconds: float, words: str
) -> None:
    flight, _ = tracking(firmware)
    flight.guide.guards.heard(battery)
    assert words in assert_ended(flight, "battery", seconds)
    assert flight.guide.engagement.engage(flight.now_ns) is None
    flight.run(2.0)
    assert state_of(flight) is State.CONNECTED
    assert words in flight.guide.engagement.reason


def test_a_battery_at_its_limit_does_not_come_and_go_as_a_condition() -> None:
    flight = make_flight("supervisor.engage=pilot")
    flight.run(5.0)
    assert state_of(flight) is State.READY
    for percent in 10 * (14, 15):
        flight.guide.guards.heard(BatteryStatus(1, percent, 0))
        flight.run(0.7)
    assert state_of(flight) is State.CONNECTED
    assert len(events_of(flight, "state_connected")) == 2, "found, and once for the battery"
    flight.run(4.0)
    assert state_of(flight) is State.READY


def _critical() -> int:
    return 6


@BOTH
def test_the_autopilots_own_failsafe_is_left_alone(
    firmware: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    flight, _ = tracking(firmware)
    monkeypatch.setattr(flight.vehicle._pilot, "system_status", _critical)
    assert flight.run(1.5, until=lambda: state_of(flight) is State.ABORTED)
    assert "failsafe: the autopilot's state is EMERGENCY" in events_of(flight, "guard_failsafe")
    aborted_ns = flight.now_ns
    assert flight.guide.engagement.engage(flight.now_ns) is None
    flight.run(10.0)
    assert setpoints_since(flight, aborted_ns) == []
    assert state_of(flight) is State.CONNECTED


def tell(flight: Lockstep, words: str) -> None:
    """A text of the autopilot."""
    flight.vehicle._pilot.text(6, words)


def outputs_off(flight: Lockstep) -> None:
    """As ArduPilot's SYS_STATUS has it while the safety switch is on."""
    pilot: Any = flight.vehicle._pilot
    present, enabled, *health = pilot.sensors
    pilot.sensors = (present, enabled & ~0x8000, *health)


STOPS: Final[dict[str, Callable[[Lockstep], object]]] = {
    "the motors are stopped by the emergency switch": lambda flight: tell(flight, "RC7: MotorEStop HIGH"),
    "the motors are off by the safety switch": outputs_off,
}


@pytest.mark.parametrize("reason", STOPS)
def test_a_pilot_who_stops_ardupilots_motors_has_ended_the_flight(reason: str) -> None:
    """It stays armed and in GUIDED: whoever let go of the switch would have it drive on by our setpoints."""
    flight, _ = tracking(ROVER)
    STOPS[reason](flight)
    flight.vehicle.refit(flight.now_ns, effect=Effect(speed=0.0, yaw=0.0))
    assert assert_ended(flight, "failsafe", 1.0, mode=None) == f"failsafe: {reason}"
    assert (flight.vehicle.armed, flight.vehicle.mode) == (True, "GUIDED")
    assert flight.guide.engagement.engage(flight.now_ns) is None
    flight.run(2.0)
    assert state_of(flight) is State.CONNECTED
    assert flight.guide.engagement.reason == f"failsafe: {reason}"


def test_a_stop_before_the_arming_is_heard_of_is_not_forgotten() -> None:
    """HEARTBEAT says once a second that it is armed; the switch is told at once, and only once."""
    flight = make_flight(*ROVER, "supervisor.engage=pilot")
    flight.run(3.0)
    assert state_of(flight) is State.READY
    tell(flight, "RC7: MotorEStop HIGH")
    flight.run(0.5)
    Pilot(flight).arm()
    flight.run(3.0)
    assert flight.guide.guards.condition == "failsafe: the motors are stopped by the emergency switch"


@pytest.mark.parametrize("how", ["let go", "disarmed"])
def test_a_stop_switch_that_is_let_go_and_a_disarmed_vehicle_forbid_no_flight(how: str) -> None:
    flight, pilot = tracking(ROVER)
    tell(flight, "RC7: MotorEStop HIGH")
    fly_until(flight, State.ABORTED, 1.0)
    if how == "let go":
        tell(flight, "RC7: MotorEStop MIDDLE")
        flight.run(5.0)
        assert flight.guide.guards.condition is not None
        tell(flight, "RC7: MotorEStop LOW")
    else:
        pilot.switch("manual")
        pilot.arm(False)
        flight.run(2.0)
        pilot.arm()
    flight.run(5.0)
    assert flight.guide.guards.condition is None


def test_the_safety_switch_of_a_vehicle_that_is_not_armed_is_the_autopilots_to_complain_of() -> None:
    flight = make_flight(*ROVER, "supervisor.engage=pilot")
    outputs_off(flight)
    flight.run(5.0)
    assert state_of(flight) is State.READY


@pytest.mark.parametrize(
    "words", ["RC7: MotorEStop LOW", "RC7: MotorInterlock HIGH", "no RC7: MotorEStop HIGH"]
)
def test_other_texts_stop_nothing(words: str) -> None:
    flight, _ = tracking(ROVER)
    tell(flight, words)
    flight.run(3.0)
    assert state_of(flight) is State.TRACKING


def test_px4_has_no_such_switch() -> None:
    """It says so in its HEARTBEAT, and by that bit of SYS_STATUS it means its ESCs."""
    flight, _ = tracking(PX4)
    flight.guide.guards.heard(StatusText(6, b"RC7: MotorEStop HIGH"))
    flight.guide.guards.heard(SysStatus(0x8000, 0, 0, 90))
    flight.run(0.1)
    assert state_of(flight) is State.TRACKING


ACTS: Final[dict[str, Callable[[Lockstep], object]]] = {
    "land": lambda flight: flight.vehicle.mode == "AUTO.LAND",
    "return": lambda flight: flight.vehicle.mode == "AUTO.RTL",
    "silence": lambda flight: flight.vehicle.mode == "POSCTL",  # its failsafe
}


@pytest.mark.parametrize("action", ACTS)
def test_the_action_is_the_one_that_was_chosen(action: str) -> None:
    flight, _ = tracking(PX4, f"guards.jump_action={action}")
    flight.vehicle.reset_estimator(flight.now_ns, (50.0, 0.0, 0.0), 0.0)
    assert_ended(flight, "jump", 0.2, mode=None)
    assert ACTS[action](flight), flight.vehicle.mode
