"""Fly a fault and hold what came of it against what was expected."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from guidance.supervisor import State
from sitl.faults.crafts import CRAFTS
from sitl.faults.fault import LATE_S, Fault, Never, beginning, vehicle_options
from sitl.faults.flight import Flight, as_it_ships, configured

KEY: Final = bytes(range(32))
#: The autopilot's own words, passed on, and that the rover's loop grants no 50 Hz.
_WORDS: Final = frozenset({"autopilot", "parameter", "rate_denied"})
_MOVED_M: Final = 0.01


class Outcome(NamedTuple):
    """What came of a fault; no `problems`: it passed. `digest` is of all bytes that came to the vehicle."""

    title: str
    firmware: str
    problems: tuple[str, ...]
    states: tuple[str, ...]
    reason: str
    mode: str
    codes: tuple[str, ...]
    deviation_m: float
    left_after_s: float | None
    setpoints: int
    digest: str

    @property
    def passed(self) -> bool:
        """Whether it is as expected."""
        return not self.problems


def fly(fault: Fault, seed: int = 0) -> Outcome:
    """One flight on virtual time; the same fault and seed give the same bytes."""
    begin = beginning(fault)
    signing = ("link.signing_key_file=signing.key",) if fault.signed else ()
    chosen = as_it_ships if fault.ships else configured
    config = chosen(fault.firmware, *begin.overrides, *signing, *fault.overrides)
    flight = Flight(config, vehicle_options(fault), seed, KEY if fault.signed else None)
    problems: list[str] = []
    try:
        if not begin.reach(flight):
            problems.append(f"the flight did not get to {fault.begin}, but to {flight.state}")
        flight.begin()
        began_ns = flight.line.now_ns
        for step in fault.steps:
            _run_to(flight, began_ns, step.at_s)
            step.action(flight)
        _run_to(flight, began_ns, fault.seconds - LATE_S)
        flight.lately()
        _run_to(flight, began_ns, fault.seconds)
    except Exception as error:
        problems.append(f"raised {type(error).__name__}: {error}")
    digest = flight.witness.finish()
    problems += flight.witness.broken
    problems += _judged(fault, flight)
    return Outcome(
        fault.title,
        fault.vehicle_name,
        tuple(problems),
        tuple(flight.states),
        flight.line.guide.engagement.reason,
        flight.line.vehicle.mode,
        tuple(sorted(set(flight.codes))),
        flight.deviation_m,
        _left_after_s(flight),
        len(flight.witness.setpoints),
        digest,
    )


def _run_to(flight: Flight, began_ns: int, at_s: float) -> None:
    flight.run(at_s - (flight.line.now_ns - began_ns) * 1e-9)


def _left_after_s(flight: Flight) -> float | None:
    if flight.left_ns is None or flight.since_ns is None:
        return None
    return (flight.left_ns - flight.since_ns) * 1e-9


def _judged(fault: Fault, flight: Flight) -> list[str]:
    """What is not as expected, in words."""
    wanted = fault.expected
    problems: list[str] = []
    if flight.state not in wanted.states:
        problems.append(f"ends {flight.state}, not {' or '.join(sorted(wanted.states))}")
    codes = {code for code in flight.codes if not code.startswith("state_")}
    if missing := wanted.told - codes:
        problems.append(f"not told: {', '.join(sorted(missing))}")
    if surplus := codes - wanted.told - wanted.may - _WORDS:
        problems.append(f"told besides: {', '.join(sorted(surplus))}")
    if not flight.deviation_m <= wanted.within_m:
        problems.append(f"{flight.deviation_m:.3f} m off, not within {wanted.within_m:g} m")
    if flight.state is State.TRACKING and not flight.late_m <= wanted.again_m:
        problems.append(f"{flight.late_m:.2f} m off at the end, not within {wanted.again_m:g} m again")
    if flight.state is not State.TRACKING and not flight.line.guide.engagement.reason:
        problems.append(f"{flight.state} without a reason")
    problems += _flown_badly(fault, flight)
    left_after_s = _left_after_s(flight)
    if (
        math.isfinite(wanted.out_within_s)
        and not (math.inf if left_after_s is None else left_after_s) <= wanted.out_within_s
    ):
        when = "never" if left_after_s is None else f"after {left_after_s:.2f} s"
        problems.append(f"left {fault.begin} {when}, not within {wanted.out_within_s:g} s")
    if wanted.modes and flight.line.vehicle.mode not in wanted.modes:
        problems.append(
            f"the vehicle is in {flight.line.vehicle.mode}, not {' or '.join(sorted(wanted.modes))}"
        )
    problems += [f"it {never}" for never in sorted(wanted.never) if _happened(never, fault, flight)]
    return problems


def _flown_badly(fault: Fault, flight: Flight) -> list[str]:
    """What no airplane may do while it is guided."""
    craft = CRAFTS[fault.firmware]
    if not fault.ships or not craft.airspeed_min_m_s:
        return []
    problems: list[str] = []
    if flight.airspeed_min_m_s < craft.airspeed_min_m_s:
        problems.append(f"{flight.airspeed_min_m_s:.1f} m/s, least {craft.airspeed_min_m_s:g} m/s")
    if flight.lowest_down_m > craft.floor_down_m:
        problems.append(f"down to {flight.lowest_down_m:.1f} m, below the floor at {craft.floor_down_m:g} m")
    return problems


def _happened(never: Never, fault: Fault, flight: Flight) -> bool:
    match never:
        case Never.LEAVES:
            return any(state is not State.TRACKING for state in flight.states)
        case Never.TRACKS:
            return State.TRACKING in flight.states[fault.begin is State.TRACKING :]
        case Never.FLIES:
            return flight.witness.was_in_control
        case Never.ARMED:
            return flight.line.vehicle.armed
        case Never.MOVES:
            return flight.travel_m > _MOVED_M
