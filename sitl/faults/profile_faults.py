"""Faults of every profile as it ships, on the body of its own kind: what flies has nowhere to stop.

Whatever fails, the vehicle either tracks well again, with its estimator's noise, or is the autopilot's again
with a reason in words; an airplane never gets slower than it may, or below its floor, while it is guided.
"""

from __future__ import annotations

import math
from typing import Any, Final

from pymavlink.dialects.v20 import all as mavlink

from guidance.supervisor import State
from sitl.faults.crafts import CRAFTS
from sitl.faults.fault import Action, Expected, Fault, Never, Step
from sitl.faults.flight import DEAD, Flight
from sitl.faults.link_faults import line
from sitl.faults.outcomes import SILENCE
from sitl.faults.tampering import (
    ATTITUDE,
    POSITION,
    STATE,
    Stage,
    frozen,
    later,
    moved,
    not_a_number,
    parameters,
    told,
)
from sitl.lockstep import Channel
from sitl.vehicle import Firmware

PLANES: Final = tuple(firmware for firmware in Firmware if firmware.endswith("-plane"))
AIR: Final = ("VFR_HUD", "WIND", "WIND_COV")
_TRACKING: Final = frozenset({State.TRACKING})
#: Where nobody guides.
_OUT: Final = frozenset(
    {
        State.HANDED_OVER,
        State.ABORTED,
        State.READY,
        State.WITHHELD,
        State.CONNECTED,
        State.DISCONNECTED,
        State.FINISHED,
        State.HOLDING,
    }
)
_TOLD: Final = SILENCE | {
    "estimator_reset",
    "reboot",
    "origin_moved",
    "guard_error",
    "guard_jump",
    "guard_state",
    "guard_rate",
    "guard_delay",
    "guard_tilt",
    "guard_speed",
    "guard_effect",
    "parameter_changed",
    "parameters_unfit",
    "order_expired",
    "caution",
}  # fmt: skip
#: From the fault to its end, where nothing says how long.
_A_WHILE_S: Final = 2.0


def _expected(firmware: Firmware, states: frozenset[State], **more: Any) -> Expected:
    return Expected(states, may=_TOLD | more.pop("may", frozenset()), again_m=CRAFTS[firmware].good_m, **more)


def _on(firmware: Firmware, **more: Any) -> Expected:
    """It tracks on, and well."""
    return _expected(firmware, _TRACKING, never=frozenset({Never.LEAVES}), **more)


def _out(firmware: Firmware, within_s: float = math.inf, **more: Any) -> Expected:
    """It is the autopilot's or the pilot's, so soon, and stays so."""
    return _expected(firmware, _OUT, out_within_s=within_s, never=frozenset({Never.TRACKS}), **more)


def _either(firmware: Firmware, **more: Any) -> Expected:
    return _expected(firmware, _TRACKING | _OUT, **more)


def _staged(stage: Stage | None) -> Action:
    return lambda flight: flight.stage(stage)


def _for(seconds: float, begin: Action, end: Action) -> tuple[Step, ...]:
    return (Step(0.0, begin), Step(seconds, end))


def _fault(firmware: Firmware, title: str, expected: Expected, *steps: Step, **more: Any) -> Fault:
    seconds = more.pop("seconds", CRAFTS[firmware].back_s)
    return Fault(
        title=title, firmware=firmware, steps=steps, expected=expected, seconds=seconds, ships=True, **more
    )


def _estimate(firmware: Firmware) -> list[Fault]:
    """Of what the autopilot's estimator says."""

    def jump(north_m: float, turned_rad: float = 0.0) -> Action:
        return lambda flight: flight.line.vehicle.reset_estimator(
            flight.line.now_ns, (north_m, 0.0, 0.0), turned_rad
        )

    def origin(flight: Flight) -> None:
        at = flight.line.vehicle.options.origin
        flight.line.vehicle.withhold("GPS_GLOBAL_ORIGIN")
        message = mavlink.MAVLink_gps_global_origin_message(
            round(1e7 * at.latitude_deg) + 1000, round(1e7 * at.longitude_deg), round(1e3 * at.altitude_m)
        )
        out = mavlink.MAVLink(None, flight.line.vehicle.options.system_id, 1)
        flight.line.inject(message.pack(out))

    return [
        _fault(
            firmware,
            "the attitude stands still, with its time",
            _out(firmware, 2.5),
            Step(0.0, _staged(frozen(ATTITUDE, stamped=False))),
        ),
        _fault(
            firmware,
            "the attitude stands still for 2 s, its time goes on",
            _either(firmware),
            *_for(_A_WHILE_S, _staged(frozen(ATTITUDE, stamped=True)), _staged(None)),
        ),
        _fault(
            firmware,
            "the position stands still for 1 s, its time goes on",
            _either(firmware),
            *_for(1.0, _staged(frozen(POSITION, stamped=True)), _staged(None)),
            seconds=45.0,  # what jumped back is worked off slowly, as any jump
        ),
        _fault(
            firmware,
            "no number of the state is one",
            _out(firmware, 2.5),
            Step(0.0, _staged(not_a_number(STATE))),
        ),
        _fault(
            firmware,
            "no number of the state is one for 0.2 s",
            _on(firmware),
            *_for(0.2, _staged(not_a_number(STATE)), _staged(None)),
        ),
        _fault(
            firmware,
            "the position jumps by 5 m for 2 s",
            _on(firmware, told=frozenset({"estimator_reset"})),
            *_for(_A_WHILE_S, jump(5.0), jump(0.0)),
        ),
        _fault(
            firmware,
            "the position jumps by 5 m for 2 s and no reset is counted",
            _on(firmware, told=frozenset({"estimator_reset"})),
            *_for(_A_WHILE_S, _staged(moved(5.0, 0.0)), _staged(None)),
        ),
        _fault(
            firmware,
            "the heading jumps by 30 degrees for 2 s",
            _either(firmware),
            *_for(_A_WHILE_S, jump(0.0, math.radians(30.0)), jump(0.0)),
        ),
        _fault(
            firmware,
            "the autopilot's clock jumps by +10 s",
            _either(firmware),
            Step(0.0, _staged(later(10.0))),
        ),
        _fault(
            firmware,
            "the autopilot's clock jumps by +0.04 s",
            _on(firmware),
            Step(0.0, _staged(later(0.04))),
        ),
        _fault(
            firmware,
            "the autopilot's local origin moves by 11 m",
            _out(firmware, 2.5, told=frozenset({"origin_moved"})),
            Step(0.0, origin),
        ),
    ]


def _link(firmware: Firmware) -> list[Fault]:
    late, lossy = Channel(delay_s=0.3), Channel(loss=0.3)
    return [
        _fault(
            firmware, "everything is 300 ms late, each way", _either(firmware), Step(0.0, line(late, late))
        ),
        _fault(
            firmware, "everything is 300 ms late, to the autopilot",
            _either(firmware)._replace(again_m=2.0 * CRAFTS[firmware].good_m),  # the clock sees half of it
            Step(0.0, line(to_vehicle=late)),
        ),
        _fault(
            firmware, "30 % of all datagrams are lost, each way", _on(firmware), Step(0.0, line(lossy, lossy))
        ),
        _fault(
            firmware, "a gap of 0.4 s both ways", _on(firmware),
            *_for(0.4, line(DEAD, DEAD), line()),
        ),
        _fault(
            firmware, "a gap of 2 s both ways", _out(firmware, 1.05), *_for(2.0, line(DEAD, DEAD), line())
        ),
    ]  # fmt: skip


def _parameters(firmware: Firmware) -> list[Fault]:
    """Of what the autopilot says of itself, before a flight and in it."""
    rows = [
        _fault(
            firmware,
            f"the autopilot's parameters {what}",
            # nothing that a submarine needs, and a limit that nobody tells is none
            _either(firmware) if firmware is Firmware.PX4_UUV and value is None else _out(firmware),
            Step(0.0, _staged(parameters(value))),
            Step(6.0, Flight.engage),
            begin=State.DISCONNECTED,
            seconds=25.0,
        )
        for what, value in (
            ("are not told", None),
            ("are no numbers", math.nan),
            ("are infinite", math.inf),
            ("are negative", -1e30),
        )
    ]
    rows.append(
        _fault(
            firmware,
            "the autopilot's parameters come 5 s late",
            _expected(firmware, _TRACKING),
            Step(0.0, _staged(parameters(None))),
            Step(5.0, _staged(None)),
            Step(15.0, Flight.engage),
            begin=State.DISCONNECTED,
            seconds=40.0,
        )
    )
    rows += [
        _fault(
            firmware,
            f"every parameter becomes {value:g} in flight",
            _on(firmware, may=frozenset({"parameters"})),
            Step(0.0, _set_all(value)),
        )
        for value in (0.0, 1e6)
    ]
    return rows


def _set_all(value: float) -> Action:
    """Somebody sets them; the vehicle itself goes on as it was, so that only the word is heard."""

    def act(flight: Flight) -> None:
        out = mavlink.MAVLink(None, flight.line.vehicle.options.system_id, 1)
        names = flight.line.vehicle.parameter_names
        for number, name in enumerate(names):
            message = mavlink.MAVLink_param_value_message(
                name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32, len(names), number
            )
            flight.line.inject(message.pack(out))

    return act


def _autopilot(firmware: Firmware) -> list[Fault]:
    def refuse(flight: Flight) -> None:
        flight.line.vehicle.refuse(modes=True)

    def obey(flight: Flight) -> None:
        flight.line.vehicle.refuse()

    return [
        _fault(firmware, "the autopilot reboots in flight", _out(firmware, 0.5), Step(0.0, Flight.reboot)),
        _fault(
            firmware,
            "the autopilot reboots in flight, and tells no parameters any more",
            _expected(firmware, _TRACKING | _OUT, out_within_s=0.5),
            Step(0.0, _staged(parameters(None))),
            Step(0.0, Flight.reboot),
            Step(8.0, Flight.engage),
            seconds=30.0,
        ),
        _fault(
            firmware,
            "the control mode is denied",
            _out(firmware),
            Step(0.0, refuse),
            Step(0.0, Flight.engage),
            begin=State.READY,
        ),
        _fault(
            firmware,
            "the control mode is denied for 1.5 s",
            _expected(firmware, _TRACKING),
            Step(0.0, refuse),
            Step(0.0, Flight.engage),
            Step(1.5, obey),
            begin=State.READY,
        ),
        _fault(
            firmware,
            "the exit mode is denied when the operator aborts",
            _out(firmware),
            Step(0.0, refuse),
            Step(0.0, Flight.abort),
        ),
    ]


#: A mode that the service asks for in no state.
_PILOTS: Final = {
    Firmware.PX4_UUV: "manual",
    Firmware.PX4_PLANE: "stabilized",
    Firmware.PX4_COPTER: "position",
    Firmware.PX4_ROVER: "manual",
    Firmware.ARDUPILOT_ROVER: "steering",
    Firmware.ARDUPILOT_PLANE: "fbwa",
    Firmware.ARDUPILOT_COPTER: "alt_hold",
}
_BEGUN: Final = (
    State.READY, State.STREAMING, State.SWITCHING, State.TRACKING, State.PAUSING, State.HOLDING,
    State.ABORTING, State.CANCELLING, State.BACKING_OUT, State.LEAVING, State.HANDED_OVER, State.FINISHED,
)  # fmt: skip


def _pilot(firmware: Firmware) -> list[Fault]:
    def switch(flight: Flight) -> None:
        flight.switch(_PILOTS[firmware])

    return [
        _fault(
            firmware,
            f"the pilot takes over while {state}",
            _out(firmware),
            Step(0.0, switch),
            begin=state,
            seconds=6.0,
        )
        for state in _BEGUN
    ] + [
        _fault(
            firmware,
            "the service is killed in flight and is back at once",
            _out(firmware, 1.2),
            Step(0.0, Flight.kill_and_restart),
            seconds=10.0,
        )
    ]


def _air(firmware: Firmware) -> list[Fault]:
    """An airplane's: of airspeed and wind, in a wind and while it changes."""

    def without(*names: str) -> Action:
        return lambda flight: flight.line.vehicle.withhold(*names)

    windy: dict[str, Any] = {"wind_ned_m_s": (-4.0, 3.0, 0.0), "gusts_m_s": 0.8}
    blind = _out(firmware, 16.0, told=frozenset({"guard_air"}))
    rows = []
    for what, names, still, turns in (
        ("airspeed", AIR[:1], _on(firmware), _either(firmware)),
        ("wind", AIR[1:], _on(firmware), _either(firmware)),
        # by the last wind alone while that may be late, 10 s, and 5 s more
        ("air", AIR, blind, blind),
    ):
        rows.append(
            _fault(
                firmware,
                f"no {what} is told any more, in wind",
                still,
                Step(0.0, without(*names)),
                vehicle=windy,
                seconds=40.0,
            )
        )
        rows.append(
            _fault(
                firmware,
                f"no {what} is told any more, and the wind turns by 8 m/s",
                turns,
                Step(0.0, without(*names)),
                *_front(5.0, (-2.4, 1.8), (4.0, -3.0)),
                vehicle={"wind_ned_m_s": (-2.4, 1.8, 0.0)},
                seconds=60.0,
            )
        )
    for what, value in (
        ("no number", math.nan), ("0", 0.0), ("1e6 m/s", 1e6), ("7 m/s", 7.0), ("30 m/s", 30.0)
    ):  # fmt: skip
        rows.append(
            _fault(
                firmware,
                f"the airspeed is {what}",
                _on(firmware),
                Step(0.0, _staged(told("VFR_HUD", airspeed=value))),
                vehicle=windy,
                seconds=30.0,
            )
        )
    rows += [
        _fault(
            firmware,
            f"the wind is {what}",
            _on(firmware),
            Step(0.0, _staged(_wind(value))),
            seconds=40.0,
        )
        for what, value in (("no number", math.nan), ("1e6 m/s", 1e6), ("90 m/s", 90.0), ("14 m/s", 14.0))
    ]
    return rows


def _front(at_s: float, before: tuple[float, float], after: tuple[float, float]) -> tuple[Step, ...]:
    """The wind turns within 8 s, as in a strong front."""

    def blows(part: float) -> Action:
        north, east = (part * new + (1.0 - part) * old for old, new in zip(before, after, strict=True))
        return lambda flight: flight.line.vehicle.current(flight.line.now_ns, (north, east, 0.0))

    return tuple(Step(at_s + 0.1 * i, blows(i / 80.0)) for i in range(1, 81))


def _wind(speed_m_s: float) -> Stage:
    """From the north, in either message."""
    wind, covariance = told("WIND", speed=speed_m_s, direction=0.0), told("WIND_COV", wind_x=-speed_m_s)

    def both(data: bytes, now_ns: int) -> list[bytes]:
        return [out for first in wind(data, now_ns) for out in covariance(first, now_ns)]

    return both


PROFILE_FAULTS: Final = tuple(
    fault
    for firmware in Firmware
    for fault in (
        *_estimate(firmware),
        *_link(firmware),
        *_parameters(firmware),
        *_autopilot(firmware),
        *_pilot(firmware),
        *(_air(firmware) if firmware in PLANES else ()),
    )
)
