"""The outcomes that faults have in common."""

from __future__ import annotations

import math
from typing import Final

from guidance.supervisor import State
from sitl.faults.fault import Expected, Never
from sitl.vehicle import Firmware

PX4: Final = Firmware.PX4_UUV
ROVER: Final = Firmware.ARDUPILOT_ROVER
BOTH: Final = (PX4, ROVER)

#: Where control is given up after a silence: PX4's failsafe acts, ArduRover stops where it is.
LEFT_ALONE: Final = {PX4: frozenset({"POSCTL"}), ROVER: frozenset({"GUIDED"})}
HELD: Final = {PX4: frozenset({"MANUAL"}), ROVER: frozenset({"HOLD"})}
CONTROL: Final = {PX4: frozenset({"OFFBOARD"}), ROVER: frozenset({"GUIDED"})}
#: What may be told of any gap or silence, short or long.
SILENCE: Final = frozenset({"silent", "setpoint_gap", "rate_fell"})
_OUT: Final = frozenset({State.HANDED_OVER})


def tracks_on(within_m: float, *may: str, told: tuple[str, ...] = ()) -> Expected:
    """The flight goes on, and the vehicle is never farther from the reference than this."""
    return Expected(
        frozenset({State.TRACKING}),
        frozenset(told),
        frozenset(may) | SILENCE,
        within_m,
        never=frozenset({Never.LEAVES}),
    )


def tracks_on_or_hands_over(within_m: float, *may: str, states: frozenset[State] = frozenset()) -> Expected:
    """At the edge of what is flown through: either is safe."""
    either = frozenset({State.TRACKING, State.HANDED_OVER})
    return Expected(either | states, may=frozenset(may) | SILENCE, within_m=within_m)


def hands_over(
    within_s: float,
    *may: str,
    told: tuple[str, ...] = (),
    modes: frozenset[str] = frozenset(),
    states: frozenset[State] = _OUT,
    within_m: float = math.inf,
) -> Expected:
    """Control is given up so soon, and not taken again."""
    return Expected(
        states,
        frozenset(told),
        frozenset(may) | SILENCE,
        within_m,
        within_s,
        modes,
        frozenset({Never.TRACKS}),
    )


def guarded(
    firmware: Firmware, guard: str, within_s: float, *may: str, within_m: float = math.inf
) -> Expected:
    """A guard ends the flight so soon, in the autopilot's own mode."""
    return Expected(
        frozenset({State.ABORTED}),
        frozenset({f"guard_{guard}"}),
        frozenset(may) | SILENCE,
        within_m,
        within_s,
        HELD[firmware],
        frozenset({Never.TRACKS}),
    )


def stays_out(*states: State, may: tuple[str, ...] = (), told: tuple[str, ...] = ()) -> Expected:
    """It does not engage, and the vehicle does not move."""
    return Expected(
        frozenset(states),
        frozenset(told),
        frozenset(may) | SILENCE,
        never=frozenset({Never.TRACKS, Never.MOVES}),
    )
