"""Faults of the vehicle and of what carries it: reboots, actuators, refusals, current and gusts."""

from __future__ import annotations

import math
from typing import Any, Final

from guidance.supervisor import State
from sitl.faults.fault import Action, Fault, Step
from sitl.faults.flight import Flight
from sitl.faults.outcomes import BOTH, PX4, ROVER, hands_over, stays_out, tracks_on
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
    return [
        Fault(
            title="the autopilot reboots in flight",
            firmware=firmware,
            steps=(Step(0.0, Flight.reboot),),
            expected=hands_over(0.3, told=("reboot",), states=frozenset({State.READY})),
            seconds=15.0,
        )
        for firmware in BOTH
    ] + [
        Fault(
            title="the autopilot reboots while it is asked for its mode",
            firmware=PX4,
            begin=State.SWITCHING,
            steps=(Step(0.0, Flight.reboot),),
            expected=stays_out(State.READY, State.HANDED_OVER, may=("reboot")),
            seconds=15.0,
        )
    ]


def _actuators() -> list[Fault]:
    slow = PlantParameters(max_rate_rad_s=0.1, max_speed_m_s=5.0)
    weak = PlantParameters(max_rate_rad_s=5.0, max_speed_m_s=0.5)
    return (
        [
            Fault(
                title="the vehicle turns by 0.1 rad/s at most",
                firmware=firmware,
                steps=_refit(plant=slow),
                expected=tracks_on(2.0),
            )
            for firmware in BOTH
        ]
        + [
            Fault(
                title="half of the speed that is needed",
                firmware=firmware,
                steps=_refit(plant=weak),
                expected=tracks_on(5.0),
            )
            for firmware in BOTH
        ]
        + [
            Fault(
                title=f"{what} failed",
                firmware=PX4,
                steps=_refit(effect=effect),
                expected=tracks_on(10.0),
            )
            for what, effect in (
                ("the roll actuator", Effect(roll=0.0)),
                ("the pitch actuator", Effect(pitch=0.0)),
                ("the yaw actuator", Effect(yaw=0.0)),
                ("the propeller", Effect(speed=0.0)),
                ("all actuators", Effect(0.0, 0.0, 0.0, 0.0)),
            )
        ]
        + [
            Fault(
                title="the yaw actuator acts backwards",
                firmware=firmware,
                steps=_refit(effect=Effect(yaw=-1.0)),
                expected=tracks_on(10.0),
            )
            for firmware in (PX4, ROVER)
        ]
    )


def _carried() -> list[Fault]:
    return [
        Fault(
            title="a current of 0.3 m/s from the side",
            firmware=firmware,
            steps=(Step(0.0, _current(0.3, 0.0)),),
            expected=tracks_on(0.5),
            seconds=12.0,
        )
        for firmware in BOTH
    ] + [
        Fault(
            title="gusts of 0.5 m/s, one in 3 s",
            firmware=PX4,
            steps=_gusts(0.5, 3.0, 12.0),
            expected=tracks_on(0.6),
            seconds=12.0,
        ),
        Fault(
            title="a current faster than the vehicle",
            firmware=PX4,
            steps=(Step(0.0, _current(7.0, 0.0)),),
            expected=hands_over(8.0),
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
