"""The pilot takes over, the link fails, the service stops: lockstep flights with both firmwares."""

from __future__ import annotations

import pytest

from guidance.commands import Engage, Shutdown
from guidance.supervisor import State
from tests.helpers import (
    PERFECT,
    ROVER,
    events_of,
    fly_until,
    fly_until_tracking,
    make_flight,
    setpoints_since,
    state_of,
)
from tests.pilot import BOTH, DEAD, NAMES, PILOT, PX4, Pilot, S, silent_for, tracking


@BOTH
@pytest.mark.parametrize("act", ["manual", "acro", "disarm"])
def test_a_take_over_is_obeyed_with_the_message_that_shows_it(firmware: tuple[str, ...], act: str) -> None:
    flight, pilot = tracking(firmware)
    if act == "disarm":
        pilot.arm(False)
    else:
        pilot.switch(act)
    link = flight.guide.link
    mode, armed = link.custom_mode, link.armed
    assert flight.run(1.5, until=lambda: (link.custom_mode, link.armed) != (mode, armed))
    shown_ns = flight.now_ns
    # Not one more setpoint: the message that shows it is the end.
    assert setpoints_since(flight, shown_ns - 1) == []
    assert state_of(flight) is State.HANDED_OVER
    flight.run(30.0)
    assert setpoints_since(flight, shown_ns) == []
    assert flight.vehicle.armed is (act != "disarm")
    said = [text for text in events_of(flight) if text.startswith("handed-over")]
    want = "the vehicle was disarmed" if act == "disarm" else f"the mode was changed to {act}"
    assert said == [f"handed-over: {want}"]


@BOTH
def test_after_a_hand_over_only_a_command_or_a_fresh_switch_engages_again(firmware: tuple[str, ...]) -> None:
    flight, pilot = tracking(firmware)
    pilot.switch("hold")
    flight.run(20.0)
    assert state_of(flight) is State.HANDED_OVER
    flight.guide.command(Engage(), flight.now_ns)
    fly_until_tracking(flight, 1.5)
    if firmware is ROVER:
        pilot.switch("hold")
        flight.run(1.3)  # a mode that stood for less is none to switch from
        pilot.switch("control")
        fly_until_tracking(flight, 0.2)


@BOTH
def test_a_gap_of_0_3_s_is_survived(firmware: tuple[str, ...]) -> None:
    flight, _ = tracking(firmware)
    flight.to_guide = flight.to_vehicle = DEAD
    flight.run(0.3)
    flight.to_guide = flight.to_vehicle = PERFECT
    flight.run(10.0)
    assert state_of(flight) is State.TRACKING
    assert flight.vehicle.mode in NAMES["control"]


@BOTH
@pytest.mark.parametrize("gap_s", [1.2, 2.0, 10.0])
def test_a_longer_gap_hands_over_and_the_resumed_link_does_not_take_control(
    firmware: tuple[str, ...], gap_s: float
) -> None:
    flight, pilot = tracking(firmware)
    flight.to_guide = flight.to_vehicle = DEAD
    flight.run(gap_s)
    resumed_ns = flight.now_ns
    flight.to_guide = flight.to_vehicle = PERFECT
    flight.run(20.0)
    assert setpoints_since(flight, resumed_ns) == []
    assert any(text.startswith("handed-over: ") for text in events_of(flight))
    if firmware is PX4:
        assert flight.vehicle.mode == "POSCTL"  # where one setpoint would have taken control again
    pilot.arm(False)
    assert silent_for(flight, 12.0)
    flight.guide.command(Engage(), flight.now_ns)
    fly_until_tracking(flight, 3.0)


@BOTH
def test_a_gap_only_towards_the_guide_hands_over_as_well(firmware: tuple[str, ...]) -> None:
    flight, _ = tracking(firmware)
    flight.to_guide = DEAD
    flight.run(1.2)
    flight.to_guide = PERFECT
    assert silent_for(flight, 20.0)


@BOTH
def test_an_autopilot_that_reboots_in_flight_is_handed_over(firmware: tuple[str, ...]) -> None:
    flight, _ = tracking(firmware)
    flight.vehicle.reboot(flight.now_ns)
    rebooted_ns = flight.now_ns
    flight.run(1.5)
    assert any(text.startswith("handed-over: ") for text in events_of(flight, since_ns=rebooted_ns))
    assert silent_for(flight, 12.0)
    assert state_of(flight) is State.READY
    assert not flight.vehicle.armed


@BOTH
@pytest.mark.parametrize("obeys", [True, False])
def test_shutdown_streams_on_while_the_exit_mode_is_commanded(firmware: tuple[str, ...], obeys: bool) -> None:
    flight, _ = tracking(firmware)
    if not obeys:
        flight.vehicle._pilot.select_mode = lambda custom_mode: 4  # type: ignore[method-assign]
    stopped_ns = flight.now_ns
    flight.guide.command(Shutdown(), stopped_ns)
    assert flight.run(2.0, until=lambda: flight.guide.finished)
    took_s = (flight.now_ns - stopped_ns) / S
    setpoints = setpoints_since(flight, stopped_ns)
    gaps = [b - a for a, b in zip([stopped_ns, *setpoints], [*setpoints, flight.now_ns], strict=True)]
    if obeys:
        assert flight.vehicle.mode in NAMES["hold"]
        assert took_s < 0.2
    else:
        assert flight.vehicle.mode in NAMES["control"]
        assert 1.0 <= took_s <= 1.05
        assert len(setpoints) >= 38
    assert max(gaps) <= 0.1 * S
    assert silent_for(flight, 5.0)


@BOTH
def test_shutdown_while_waiting_for_arming_never_moves_the_vehicle(firmware: tuple[str, ...]) -> None:
    flight = make_flight(*firmware, *PILOT)
    pilot = Pilot(flight)
    flight.run(3.0)
    pilot.switch("control")
    fly_until(flight, State.ARMING, 1.0)
    start = flight.truth().position_ned_m
    pilot.arm()
    flight.guide.command(Shutdown(), flight.now_ns)
    assert flight.run(2.0, until=lambda: flight.guide.finished)
    assert flight.truth().position_ned_m == start
    assert flight.vehicle.mode in NAMES["hold"]
