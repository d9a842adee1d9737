"""What a fault is: how the flight got there, what happens when, and what must come of it, as data."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final, NamedTuple

from guidance.supervisor import State
from sitl.faults.crafts import CRAFTS
from sitl.faults.flight import CONTROL_MODES, Flight
from sitl.vehicle import Firmware

Action = Callable[[Flight], object]


class Never(StrEnum):
    """What must not happen from the fault on, beside what never may (`witness`)."""

    LEAVES = "leaves tracking"
    TRACKS = "tracks"
    FLIES = "is in control of an armed vehicle"
    ARMED = "leaves the vehicle armed"
    MOVES = "moves the vehicle by more than 1 cm"


class Step(NamedTuple):
    """What is done so many seconds after the fault began."""

    at_s: float
    action: Action


class Expected(NamedTuple):
    """The safe outcome.

    `states`: where the supervisor may stand at the end. `told`: codes of events (warnings and worse) that
    must be told, `may` those that may be, beside changes of state. `within_m`: the largest distance from the
    reference while tracking, `out_within_s`: how soon the state is left in which the fault began. `modes`:
    the vehicle's at the end. `again_m`: the largest distance in the last `LATE_S`, if it tracks then.
    """

    states: frozenset[State]
    told: frozenset[str] = frozenset()
    may: frozenset[str] = frozenset()
    within_m: float = math.inf
    out_within_s: float = math.inf
    modes: frozenset[str] = frozenset()
    never: frozenset[Never] = frozenset()
    again_m: float = math.inf


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One row of the table. `title`, `firmware` and `ships` together are its name.

    `ships`: the shipped configuration flies the body of its own kind (`crafts`), engaged by command,
    instead of the demo's an ideal vehicle.
    """

    title: str
    firmware: Firmware
    steps: tuple[Step, ...]
    expected: Expected
    begin: State = State.TRACKING
    seconds: float = 8.0
    overrides: tuple[str, ...] = ()
    vehicle: Mapping[str, Any] = field(default_factory=dict)
    signed: bool = False
    ships: bool = False

    @property
    def vehicle_name(self) -> str:
        """As tables show it."""
        return f"{self.firmware}, as it ships" if self.ships else str(self.firmware)


AUTO: Final = ("supervisor.engage=auto", "supervisor.arm=true")
#: At the end of a flight, s.
LATE_S: Final = 2.0
_READY_S: Final = 20.0
#: Nothing was commanded yet.
_BEFORE: Final = frozenset({State.DISCONNECTED, State.CONNECTED, State.WITHHELD})
PILOT: Final = ("supervisor.engage=pilot", "supervisor.arm=false")


class Beginning(NamedTuple):
    """How a flight gets into a state: configuration, vehicle, and what is done."""

    overrides: tuple[str, ...]
    vehicle: Mapping[str, Any]
    reach: Callable[[Flight], bool]


def _wait(state: State, and_then_s: float = 0.0) -> Callable[[Flight], bool]:
    def reach(flight: Flight) -> bool:
        reached = flight.run(6.0, until=state)
        flight.run(and_then_s)
        return reached

    return reach


def _then(state: State, act: Action, into: State) -> Callable[[Flight], bool]:
    """Reach a state; something makes it another one."""

    def reach(flight: Flight) -> bool:
        flight.run(6.0, until=state)
        flight.run(0.5)
        act(flight)
        return flight.run(8.0, until=into)

    return reach


def _while_switching(order: Action) -> Action:
    def act(flight: Flight) -> None:
        flight.line.vehicle.refuse(modes=True)
        flight.engage()
        flight.run(5.0, until=State.SWITCHING)
        flight.run(0.1)
        order(flight)

    return act


def _without_an_exit(order: Action) -> Action:
    """Every mode is refused, so that the vehicle stays in the control mode."""

    def act(flight: Flight) -> None:
        flight.line.vehicle.refuse(modes=True)
        order(flight)

    return act


#: By the state in which the fault begins. 2.003 s: between two messages.
BEGINNINGS: Final[dict[State, Beginning]] = {
    State.DISCONNECTED: Beginning(AUTO, {}, lambda flight: True),
    State.CONNECTED: Beginning(AUTO, {"estimator_ready_s": 60.0}, _wait(State.CONNECTED, 1.0)),
    State.WITHHELD: Beginning(AUTO, {"initially_armed": True}, _wait(State.WITHHELD, 2.0)),
    State.READY: Beginning(PILOT, {"initially_armed": True}, _wait(State.READY, 1.0)),
    State.STREAMING: Beginning(
        PILOT, {"initially_armed": True}, _then(State.READY, Flight.engage, State.STREAMING)
    ),
    State.SWITCHING: Beginning(
        PILOT,
        {"initially_armed": True, "refuses_modes": True},
        _then(State.READY, Flight.engage, State.SWITCHING),
    ),
    State.ARMING: Beginning(
        PILOT, {}, _then(State.READY, lambda flight: flight.switch("control"), State.ARMING)
    ),
    State.TRACKING: Beginning(AUTO, {}, _wait(State.TRACKING, 2.003)),
    State.PAUSING: Beginning(AUTO, {}, _then(State.TRACKING, _without_an_exit(Flight.hold), State.PAUSING)),
    State.HOLDING: Beginning(AUTO, {}, _then(State.TRACKING, Flight.hold, State.HOLDING)),
    State.ABORTING: Beginning(
        AUTO, {}, _then(State.TRACKING, _without_an_exit(Flight.abort), State.ABORTING)
    ),
    State.CANCELLING: Beginning(
        PILOT, {}, _then(State.READY, _while_switching(Flight.abort), State.CANCELLING)
    ),
    State.BACKING_OUT: Beginning(
        PILOT, {}, _then(State.READY, _while_switching(Flight.shut_down), State.BACKING_OUT)
    ),
    State.LEAVING: Beginning(
        AUTO, {}, _then(State.TRACKING, _without_an_exit(Flight.shut_down), State.LEAVING)
    ),
    State.HANDED_OVER: Beginning(
        AUTO, {}, _then(State.TRACKING, lambda flight: flight.switch("hold"), State.HANDED_OVER)
    ),
    State.ABORTED: Beginning(AUTO, {"refuses_modes": True}, _wait(State.ABORTED)),
    State.FINISHED: Beginning(AUTO, {}, _then(State.TRACKING, Flight.shut_down, State.FINISHED)),
}


def _engaged(reach: Callable[[Flight], bool]) -> Callable[[Flight], bool]:
    """The same, where control is taken on command alone."""

    def reach_it(flight: Flight) -> bool:
        flight.run(_READY_S, until=State.READY)
        flight.engage()
        return reach(flight)

    return reach_it


def beginning(fault: Fault) -> Beginning:
    """How its flight gets where it begins."""
    found = BEGINNINGS[fault.begin]
    if fault.ships and found.overrides is AUTO and fault.begin not in _BEFORE:
        return Beginning((), found.vehicle, _engaged(found.reach))
    return found._replace(overrides=()) if fault.ships else found


def vehicle_options(fault: Fault) -> dict[str, Any]:
    """The vehicle's, those of the craft and of the beginning first."""
    options = dict(CRAFTS[fault.firmware].vehicle) if fault.ships else {}
    options.update(beginning(fault).vehicle)
    if fault.begin is State.WITHHELD:
        options["initial_mode"] = CONTROL_MODES[fault.firmware]
    return {**options, **fault.vehicle}
