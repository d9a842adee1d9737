"""What people and processes do: the pilot takes over in every state, the service is killed and restarted."""

from __future__ import annotations

import math
from typing import Final

from guidance.leaving import LEAVING
from guidance.supervisor import State
from sitl.faults.fault import Action, Expected, Fault, Never, Step
from sitl.faults.flight import DEAD, Flight
from sitl.faults.outcomes import BOTH, CONTROL, HELD, LEFT_ALONE, PX4, ROVER, SILENCE, hands_over
from sitl.vehicle import Firmware

_MANUAL: Final = frozenset({"MANUAL"})
#: In the profile's words and in the firmware's: not the mode that the vehicle starts in.
_OTHER: Final = {PX4: ("acro", "ACRO"), ROVER: ("hold", "HOLD")}
#: Where the service asks for the hold mode itself, or did.
_COMMANDED: Final = LEAVING | {State.HOLDING, State.FINISHED}
_SHOWN_S: Final = {PX4: 0.55, ROVER: 0.02}
_ENDED: Final = frozenset({State.FINISHED})
_OUT: Final = frozenset({State.HANDED_OVER})
#: Where the supervisor stands at the end, 8 s after the pilot's act in each state.
_AFTER_SWITCH: Final[dict[State, frozenset[State]]] = {
    State.CONNECTED: frozenset({State.CONNECTED}),
    State.WITHHELD: frozenset({State.READY}),
    State.READY: frozenset({State.READY}),
    State.STREAMING: _OUT,
    State.SWITCHING: _OUT,
    State.ARMING: frozenset({State.READY}),
    State.TRACKING: _OUT,
    State.PAUSING: _OUT,
    State.HOLDING: _OUT,
    State.ABORTING: _OUT,
    State.CANCELLING: frozenset({State.READY}),
    State.BACKING_OUT: _ENDED,
    State.LEAVING: _ENDED,
    State.HANDED_OVER: _OUT,
    State.ABORTED: frozenset({State.ABORTED}),
    State.FINISHED: _ENDED,
}


#: Here the pilot takes nothing over: no control is held, or what is offered is as harmless in that mode.
_INDIFFERENT: Final = frozenset(
    {State.CONNECTED, State.READY, State.HANDED_OVER, State.ABORTED, State.FINISHED}
)


def _chosen_by_pilot(firmware: Firmware, state: State) -> tuple[str, str]:
    """A mode that the service does not ask for in this state."""
    return ("steering", "STEERING") if firmware is ROVER and state in _COMMANDED else _OTHER[firmware]


def _pilot_switches(name: str) -> Action:
    return lambda flight: flight.switch(name)


def _disarm(flight: Flight) -> None:
    flight.arm(False)


def _take_overs() -> list[Fault]:
    """By a mode other than the one that the vehicle starts in."""
    return [
        Fault(
            title=f"the pilot chooses another mode while {state}",
            firmware=firmware,
            begin=state,
            steps=(Step(0.0, _pilot_switches(_chosen_by_pilot(firmware, state)[0])),),
            expected=Expected(
                after,
                may=SILENCE,
                # PX4 says so twice a second at most, ArduRover at once.
                out_within_s=math.inf if state in _INDIFFERENT else _SHOWN_S[firmware],
                modes=frozenset({_chosen_by_pilot(firmware, state)[1]}),
                never=frozenset({Never.TRACKS}),
            ),
            seconds=4.0 if state is State.ABORTED else 8.0,
        )
        for state, after in _AFTER_SWITCH.items()
        for firmware in BOTH
    ]


def _disarms() -> list[Fault]:
    """HEARTBEAT shows it, once a second. Where control was not had, an armed vehicle is not needed."""
    after = {
        State.WITHHELD: frozenset({State.READY}),
        State.READY: frozenset({State.READY}),
        State.STREAMING: _OUT,
        State.SWITCHING: frozenset({State.READY}),
        State.TRACKING: _OUT,
        State.PAUSING: _OUT,
        State.HOLDING: frozenset({State.READY}),
        State.ABORTING: _OUT,
        State.CANCELLING: frozenset({State.READY}),
        State.LEAVING: _ENDED,
        State.HANDED_OVER: frozenset({State.READY}),
    }
    return [
        Fault(
            title=f"the pilot disarms while {state}",
            firmware=firmware,
            begin=state,
            steps=(Step(0.0, _disarm),),
            expected=Expected(
                states,
                may=SILENCE,
                out_within_s=math.inf if state in _INDIFFERENT else 1.05,
                never=frozenset({Never.ARMED}),
            ),
        )
        for state, states in after.items()
        for firmware in BOTH
    ]


def _restarts() -> list[Fault]:
    def down(flight: Flight) -> None:
        flight.kill_and_restart()
        flight.link(DEAD, DEAD)

    def up(flight: Flight) -> None:
        flight.link()

    rows = []
    for firmware in BOTH:
        for off_s in (0.0, 0.5, 5.0):
            rows.append(
                Fault(
                    title=f"the service is killed in flight and is back {off_s:g} s later",
                    firmware=firmware,
                    steps=(Step(0.0, down), Step(off_s, up)),
                    expected=hands_over(1.2, modes=LEFT_ALONE[firmware], states=frozenset({State.WITHHELD})),
                    seconds=off_s + 10.0,
                )
            )
    rows += [
        Fault(
            title="the pilot disarms in flight, and the service is killed and back at once",
            firmware=firmware,
            steps=(Step(0.0, _disarm), Step(0.05, Flight.kill_and_restart)),
            expected=Expected(
                frozenset({State.READY}),
                may=SILENCE,
                never=frozenset({Never.TRACKS, Never.ARMED}),
            ),
        )
        for firmware in BOTH
    ]
    rows += [
        Fault(
            title="the pilot takes over, and the service is killed and back at once",
            firmware=firmware,
            steps=(
                Step(0.0, _pilot_switches(_OTHER[firmware][0])),
                Step(0.7, Flight.kill_and_restart),
            ),
            expected=hands_over(0.6, modes=frozenset({_OTHER[firmware][1]}), states=frozenset({State.READY})),
        )
        for firmware in BOTH
    ]
    return rows


def _held() -> list[Fault]:
    """On hold the autopilot flies by itself: whatever fails, it goes on holding; and the way there."""

    def out(firmware: Firmware, *states: State, never: Never = Never.TRACKS) -> Expected:
        return Expected(
            frozenset(states), may=SILENCE, modes=HELD[firmware], never=frozenset({never, Never.MOVES})
        )

    def silence(gap_s: float) -> tuple[Step, ...]:
        return (
            Step(0.0, lambda flight: flight.link(DEAD, DEAD)),
            Step(gap_s, lambda flight: flight.link()),
        )

    return [
        fault
        for firmware in BOTH
        for fault in (
            Fault(
                title="a gap of 2 s while holding",
                firmware=firmware,
                begin=State.HOLDING,
                steps=silence(2.0),
                expected=out(firmware, State.HOLDING),
                seconds=10.0,
            ),
            Fault(
                title="a gap of 5 s while holding",
                firmware=firmware,
                begin=State.HOLDING,
                steps=silence(5.0),
                expected=out(firmware, State.READY),
                seconds=13.0,
            ),
            Fault(
                title="a gap of 1.5 s while pausing: a stream that came back would take control",
                firmware=firmware,
                begin=State.PAUSING,
                steps=silence(1.5),
                expected=Expected(
                    frozenset({State.HANDED_OVER if firmware is PX4 else State.ABORTED}),
                    may=SILENCE,
                    modes=LEFT_ALONE[firmware],
                    never=frozenset({Never.TRACKS}),
                ),
            ),
            Fault(
                title="the service is killed while holding and is back at once",
                firmware=firmware,
                begin=State.HOLDING,
                steps=(Step(0.0, Flight.kill_and_restart),),
                expected=out(firmware, State.READY),
            ),
            Fault(
                title="the operator resumes, and the control mode is refused",
                firmware=firmware,
                begin=State.HOLDING,
                steps=(
                    Step(0.0, lambda flight: flight.line.vehicle.refuse(modes=True)),
                    Step(0.0, Flight.resume),
                ),
                expected=out(firmware, State.ABORTED),
            ),
        )
    ]


def _back_again() -> list[Fault]:
    """After a hand-over: what may bring control back, and what must not."""

    def after_a_gap(*more: Step) -> tuple[Step, ...]:
        return (
            Step(0.0, lambda flight: flight.link(DEAD, DEAD)),
            Step(2.0, lambda flight: flight.link()),
            *more,
        )

    never = frozenset({Never.TRACKS})
    return [
        Fault(
            title="PX4 intends OFFBOARD still: a stream that came back would take control",
            firmware=PX4,
            steps=after_a_gap(),
            expected=hands_over(1.2, modes=LEFT_ALONE[PX4]),
            seconds=30.0,
        ),
        Fault(
            title="ArduRover obeys any setpoint still: none comes after the gap",
            firmware=ROVER,
            steps=after_a_gap(),
            expected=hands_over(1.2, modes=CONTROL[ROVER]),
            seconds=30.0,
        ),
        *(
            Fault(
                title="after the gap the operator commands to engage",
                firmware=firmware,
                steps=after_a_gap(Step(4.0, Flight.engage)),
                overrides=("supervisor.engage_max_error_m=20", "guards.error_max_m=25"),
                expected=Expected(frozenset({State.TRACKING}), may=SILENCE, modes=CONTROL[firmware]),
                seconds=12.0,
            )
            for firmware in BOTH
        ),
        Fault(
            title="the rover's pilot takes over and switches back to GUIDED",
            firmware=ROVER,
            steps=(Step(0.0, _pilot_switches("manual")), Step(4.0, _pilot_switches("control"))),
            expected=Expected(frozenset({State.TRACKING}), may=SILENCE, modes=CONTROL[ROVER]),
        ),
        Fault(
            title="PX4's pilot takes over and asks for OFFBOARD again: refused, there is no stream",
            firmware=PX4,
            steps=(Step(0.0, _pilot_switches("manual")), Step(4.0, _pilot_switches("control"))),
            expected=Expected(_OUT, may=SILENCE, modes=_MANUAL, never=never),
        ),
        *(
            Fault(
                title="the pilot takes over in a gap that nobody sees the end of",
                firmware=firmware,
                steps=(
                    Step(0.0, lambda flight: flight.link(DEAD, DEAD)),
                    Step(0.1, _pilot_switches("manual")),
                    Step(0.4, lambda flight: flight.link()),
                ),
                expected=hands_over(1.5, "rate_fell", modes=_MANUAL),
            )
            for firmware in BOTH
        ),
        *(
            Fault(
                title="the service is stopped in flight",
                firmware=firmware,
                steps=(Step(0.0, Flight.shut_down),),
                expected=hands_over(0.5, modes=HELD[firmware], states=_ENDED),
            )
            for firmware in BOTH
        ),
    ]


PEOPLE_FAULTS: Final = (*_take_overs(), *_disarms(), *_restarts(), *_held(), *_back_again())
