"""Faults of the vehicle and of what carries it: reboots, actuators, refusals, current and gusts."""

from __future__ import annotations

import math
from typing import Any, Final

from guidance.supervisor import State
from sitl.faults.fault import Action, Fault, Step
from sitl.faults.flight import Flight
from sitl.faults.outcomes import BOTH, PX4, guarded, hands_over, stays_out, tracks_on
from sitl.plant import PlantParameters
from sitl.vehicle import Effect


def _refit(**changes: Any) -> tuple[Step, ...]:
    return (Step(0.0, lambda flight: flight.line.vehicle.refit(flight.line.now_ns, **changes)),)


def _current(north_m_s: float, east_m_s: float) -> Action:
    return lambda flight: flight.line.vehicle.current(flight.line.now_ns, (north_m_s, east_m_s, 0.0))


def _gusts(amplitude_m_s: float, period_s: float, seconds: float) -> tuple[Step, ...]:
    """A sine in steps of a tenth of a second."""
    return tuple(
        Step(0.1 * i, _current(0.0, amplitude_m_s * math.sin(2.0 * math.pi * 0.1 * i / period_s)))
        for i in range(round(10.0 * seconds))
    )


def _reboots() -> list[Fault]:
    """Seen by the autopilot's time, for 0.2 s."""
    rows = [
        Fault(
            title="the autopilot reboots in flight",
            firmware=firmware,
            steps=(Step(0.0, Flight.reboot),),
            expected=hands_over(0.3, told=("reboot",), states=frozenset({State.READY})),
            seconds=15.0,
        )
        for firmware in BOTH
    ]
    rows.append(
        Fault(
            title="the autopilot reboots while it is asked for its mode",
            firmware=PX4,
            begin=State.SWITCHING,
            steps=(Step(0.0, Flight.reboot),),
            expected=stays_out(State.READY, State.HANDED_OVER, may=("reboot",)),
            seconds=15.0,
        )
    )
    return rows


def _actuators() -> list[Fault]:
    slow = PlantParameters(max_rate_rad_s=0.1, max_speed_m_s=5.0)
    weak = PlantParameters(max_rate_rad_s=5.0, max_speed_m_s=0.5)
    rows = [
        Fault(
            title=title,
            firmware=firmware,
            steps=_refit(**changes),
            expected=guarded(firmware, guard, within_s, within_m=4.5),
            seconds=12.0,
        )
        for title, changes, guard, within_s in (
            ("the vehicle turns by 0.1 rad/s at most", {"plant": slow}, "error", 10.0),
            ("half of the speed that is needed", {"plant": weak}, "error", 8.0),
            ("the yaw actuator acts backwards", {"effect": Effect(yaw=-1.0)}, "error", 5.0),
            ("the propeller failed", {"effect": Effect(speed=0.0)}, "error", 4.5),
            ("all actuators failed", {"effect": Effect(0.0, 0.0, 0.0, 0.0)}, "error", 4.5),
        )
        for firmware in BOTH
    ]
    rows += [
        Fault(
            title=f"the {what} actuator failed",
            firmware=PX4,
            steps=_refit(effect=effect),
            expected=expected,
            seconds=12.0,
        )
        for what, effect, expected in (
            ("roll", Effect(roll=0.0), tracks_on(0.01)),
            ("pitch", Effect(pitch=0.0), tracks_on(1.5)),
            ("yaw", Effect(yaw=0.0), guarded(PX4, "error", 7.5, within_m=4.5)),
        )
    ]
    return rows


def _carried() -> list[Fault]:
    return [
        Fault(
            title="a current of 0.3 m/s from the side",
            firmware=firmware,
            steps=(Step(0.0, _current(0.3, 0.0)),),
            expected=tracks_on(0.4),
            seconds=12.0,
        )
        for firmware in BOTH
    ] + [
        Fault(
            title="gusts of 0.5 m/s, one in 3 s",
            firmware=PX4,
            steps=_gusts(0.5, 3.0, 12.0),
            expected=tracks_on(0.4),
            seconds=12.0,
        ),
        Fault(
            title="a current faster than the vehicle",
            firmware=PX4,
            steps=(Step(0.0, _current(7.0, 0.0)),),
            expected=guarded(PX4, "error", 2.0, within_m=6.5),
            seconds=10.0,
        ),
    ]


def _refusals() -> list[Fault]:
    refuses_modes: dict[str, Any] = {"refuses_modes": True}
    refuses_arming: dict[str, Any] = {"refuses_arming": True}
    rows = [
        Fault(
            title=f"the autopilot refuses {what}",
            firmware=firmware,
            begin=State.DISCONNECTED,
            vehicle=options,
            steps=(),
            expected=stays_out(State.ABORTED),
            seconds=9.0,
        )
        for what, options in (("the mode", refuses_modes), ("arming", refuses_arming))
        for firmware in BOTH
    ]
    rows.append(
        Fault(
            title="the autopilot refuses the exit mode when the service stops",
            firmware=PX4,
            vehicle={},
            steps=(Step(0.0, _refuse_modes), Step(0.0, Flight.shut_down)),
            expected=hands_over(1.2, states=frozenset({State.FINISHED})),
        )
    )
    return rows


def _refuse_modes(flight: Flight) -> None:
    flight.line.vehicle.refuse(modes=True)


VEHICLE_FAULTS: Final = (*_reboots(), *_actuators(), *_carried(), *_refusals())
