"""The link falls silent in each state of engaging, for each length, at each phase, one way or both.

Once the autopilot's failsafe has acted, or the service has handed over, nothing that merely comes back may
take control: not a stream, not a switch that nobody saw, not what waited in a queue.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import pytest

from guidance.commands import Engage, Shutdown
from guidance.supervisor import State
from sitl.lockstep import Lockstep
from sitl.vehicle.px4 import Px4
from tests.helpers import PERFECT, events_of, fly_until, make_flight, state_of
from tests.pilot import AUTO, BOTH, DEAD, NAMES, PILOT, Pilot, tracking

WAYS: Final = {"both": (DEAD, DEAD), "to guide": (DEAD, PERFECT), "to vehicle": (PERFECT, DEAD)}
GAPS_S: Final = (0.6, 1.15, 1.6, 2.2, 2.9)
OFFSETS_S: Final = (0.0, 0.15, 0.03, 0.4)


def streaming(firmware: tuple[str, ...]) -> Lockstep:
    flight = make_flight(*firmware, *PILOT, initially_armed=True)
    fly_until(flight, State.READY)
    flight.guide.command(Engage(), flight.now_ns)
    fly_until(flight, State.STREAMING)
    return flight


def switching(firmware: tuple[str, ...]) -> Lockstep:
    flight = streaming(firmware)
    fly_until(flight, State.SWITCHING)
    return flight


def entered(firmware: tuple[str, ...]) -> Lockstep:
    """The vehicle has obeyed the mode command; the service does not know yet."""
    flight = switching(firmware)
    assert flight.run(1.0, until=lambda: flight.vehicle.mode in NAMES["control"])
    return flight


def armed(firmware: tuple[str, ...]) -> Lockstep:
    """The vehicle has obeyed the arming command; the service does not know yet."""
    flight = make_flight(*firmware, *AUTO)
    fly_until(flight, State.ARMING)
    assert flight.run(1.0, until=lambda: flight.vehicle.armed)
    return flight


def waiting_for_arming(firmware: tuple[str, ...]) -> Lockstep:
    """Its pilot is about to arm."""
    flight = make_flight(*firmware, *PILOT)
    flight.run(3.0)
    Pilot(flight).switch("control")
    fly_until(flight, State.ARMING, 1.0)
    return flight


def ready(firmware: tuple[str, ...]) -> Lockstep:
    """Its pilot is about to switch."""
    flight = make_flight(*firmware, *PILOT, initially_armed=True)
    flight.run(3.0)
    assert state_of(flight) is State.READY
    return flight


def flying(firmware: tuple[str, ...]) -> Lockstep:
    return tracking(firmware)[0]


def arm(flight: Lockstep) -> None:
    Pilot(flight).arm()


def switch(flight: Lockstep) -> None:
    Pilot(flight).switch("control")


def stop(flight: Lockstep) -> None:
    flight.guide.command(Shutdown(), flight.now_ns)


def nothing(_: Lockstep) -> None:
    pass


#: How a flight gets there, and what happens 0.1 s into the gap.
CASES: Final[dict[str, tuple[Callable[[tuple[str, ...]], Lockstep], Callable[[Lockstep], None]]]] = {
    "streaming": (streaming, nothing),
    "switching": (switching, nothing),
    "mode entered": (entered, nothing),
    "armed": (armed, nothing),
    "the pilot arms in the gap": (waiting_for_arming, arm),
    "the pilot switches in the gap": (ready, switch),
    "tracking": (flying, nothing),
    "stopped in the gap": (flying, stop),
    "stopped in the gap while arming": (armed, stop),
}


def failsafe(flight: Lockstep) -> bool:
    """Whether PX4's has acted. ArduRover's changes no mode: it stops and waits for the next setpoint."""
    pilot = flight.vehicle._pilot
    return isinstance(pilot, Px4) and pilot.failsafe


def through_a_gap(flight: Lockstep, way: str, gap_s: float, act: Callable[[Lockstep], None]) -> list[str]:
    """Fly through it and on for 4 s; what is wrong then."""
    acted = False
    wrong: list[str] = []

    def watch() -> bool:
        nonlocal acted
        if acted and flight.vehicle.mode in NAMES["control"]:
            wrong.append("the autopilot was taken out of its failsafe")
        acted |= failsafe(flight)
        return False

    flight.to_guide, flight.to_vehicle = WAYS[way]
    began_ns = flight.now_ns
    flight.run(min(0.1, gap_s), until=watch)
    act(flight)
    flight.run(gap_s - min(0.1, gap_s), until=watch)
    flight.to_guide = flight.to_vehicle = PERFECT
    flight.run(4.0, until=watch)
    if acted and state_of(flight) is State.TRACKING:
        wrong.append("tracking after a failsafe")
    said = [text.split(":")[0] for text in events_of(flight, since_ns=began_ns)]
    if "handed-over" in said and "tracking" in said[said.index("handed-over") :]:
        wrong.append("tracking after a hand-over")
    return wrong


@BOTH
@pytest.mark.parametrize("case", CASES)
def test_a_gap_never_gives_control_back(firmware: tuple[str, ...], case: str) -> None:
    begin, act = CASES[case]
    wrong = []
    for i, (way, gap_s) in enumerate((way, gap_s) for way in WAYS for gap_s in GAPS_S):
        offset_s = OFFSETS_S[i % len(OFFSETS_S)]
        flight = begin(firmware)
        flight.run(offset_s)
        if problems := through_a_gap(flight, way, gap_s, act):
            wrong.append((way, gap_s, offset_s, set(problems), events_of(flight)[-4:]))
    assert not wrong, "\n".join(map(str, wrong))
