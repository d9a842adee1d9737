"""Faults of every profile as it ships, on the body of its own kind: what flies has nowhere to stop.

Whatever fails, the vehicle either tracks well again, with its estimator's noise, or is the autopilot's again
with a reason in words; an airplane never gets slower than it may, or below its floor, while it is guided.
"""

from __future__ import annotations

import math
from typing import Final

from pymavlink.dialects.v20 import all as mavlink

from guidance.supervisor import State
from sitl.faults.air_faults import PLANES, of_the_air
from sitl.faults.as_shipped import (
    A_WHILE_S,
    OUT,
    TRACKING,
    either,
    expected,
    fault_of,
    given_up,
    lasting,
    staged,
    tracks_on,
)
from sitl.faults.crafts import CRAFTS
from sitl.faults.fault import Action, Fault, Step
from sitl.faults.flight import DEAD, Flight
from sitl.faults.link_faults import line
from sitl.faults.tampering import (
    ATTITUDE,
    POSITION,
    STATE,
    frozen,
    later,
    moved,
    not_a_number,
    parameters,
)
from sitl.lockstep import Channel
from sitl.vehicle import Firmware


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
        fault_of(
            firmware,
            "the attitude stands still, with its time",
            given_up(firmware, 2.5),
            Step(0.0, staged(frozen(ATTITUDE, stamped=False))),
        ),
        fault_of(
            firmware,
            "the attitude stands still for 2 s, its time goes on",
            either(firmware),
            *lasting(A_WHILE_S, staged(frozen(ATTITUDE, stamped=True)), staged(None)),
        ),
        fault_of(
            firmware,
            "the position stands still for 1 s, its time goes on",
            either(firmware),
            *lasting(1.0, staged(frozen(POSITION, stamped=True)), staged(None)),
            seconds=45.0,  # what jumped back is worked off slowly, as any jump
        ),
        fault_of(
            firmware,
            "no number of the state is one",
            given_up(firmware, 2.5),
            Step(0.0, staged(not_a_number(STATE))),
        ),
        fault_of(
            firmware,
            "no number of the state is one for 0.2 s",
            tracks_on(firmware),
            *lasting(0.2, staged(not_a_number(STATE)), staged(None)),
        ),
        fault_of(
            firmware,
            "the position jumps by 5 m for 2 s",
            tracks_on(firmware, told=frozenset({"estimator_reset"})),
            *lasting(A_WHILE_S, jump(5.0), jump(0.0)),
        ),
        fault_of(
            firmware,
            "the position jumps by 5 m for 2 s and no reset is counted",
            tracks_on(firmware, told=frozenset({"estimator_reset"})),
            *lasting(A_WHILE_S, staged(moved(5.0, 0.0)), staged(None)),
        ),
        fault_of(
            firmware,
            "the heading jumps by 30 degrees for 2 s",
            either(firmware),
            *lasting(A_WHILE_S, jump(0.0, math.radians(30.0)), jump(0.0)),
        ),
        fault_of(
            firmware,
            "the autopilot's clock jumps by +10 s",
            either(firmware),
            Step(0.0, staged(later(10.0))),
        ),
        fault_of(
            firmware,
            "the autopilot's clock jumps by +0.04 s",
            tracks_on(firmware),
            Step(0.0, staged(later(0.04))),
        ),
        fault_of(
            firmware,
            "the autopilot's local origin moves by 11 m",
            given_up(firmware, 2.5, told=frozenset({"origin_moved"})),
            Step(0.0, origin),
        ),
    ]


def _link(firmware: Firmware) -> list[Fault]:
    late, lossy = Channel(delay_s=0.3), Channel(loss=0.3)
    return [
        fault_of(
            firmware, "everything is 300 ms late, each way", either(firmware), Step(0.0, line(late, late))
        ),
        fault_of(
            firmware, "everything is 300 ms late, to the autopilot",
            either(firmware)._replace(again_m=2.0 * CRAFTS[firmware].good_m),  # the clock sees half of it
            Step(0.0, line(to_vehicle=late)),
        ),
        fault_of(
            firmware,
            "30 % of all datagrams are lost, each way",
            tracks_on(firmware),
            Step(0.0, line(lossy, lossy)),
        ),
        fault_of(
            firmware, "a gap of 0.4 s both ways", tracks_on(firmware),
            *lasting(0.4, line(DEAD, DEAD), line()),
        ),
        fault_of(
            firmware,
            "a gap of 2 s both ways",
            given_up(firmware, 1.05),
            *lasting(2.0, line(DEAD, DEAD), line()),
        ),
    ]  # fmt: skip


def _parameters(firmware: Firmware) -> list[Fault]:
    """Of what the autopilot says of itself, before a flight and in it."""
    rows = [
        fault_of(
            firmware,
            f"the autopilot's parameters {what}",
            # nothing that a submarine needs, and a limit that nobody tells is none
            either(firmware) if firmware is Firmware.PX4_UUV and value is None else given_up(firmware),
            Step(0.0, staged(parameters(value))),
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
        fault_of(
            firmware,
            "the autopilot's parameters come 5 s late",
            expected(firmware, TRACKING),
            Step(0.0, staged(parameters(None))),
            Step(5.0, staged(None)),
            Step(15.0, Flight.engage),
            begin=State.DISCONNECTED,
            seconds=40.0,
        )
    )
    rows += [
        fault_of(
            firmware,
            f"every parameter becomes {value:g} in flight",
            tracks_on(firmware, may=frozenset({"parameters"})),
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
        fault_of(
            firmware, "the autopilot reboots in flight", given_up(firmware, 0.5), Step(0.0, Flight.reboot)
        ),
        fault_of(
            firmware,
            "the autopilot reboots in flight, and tells no parameters any more",
            expected(firmware, TRACKING | OUT, out_within_s=0.5),
            Step(0.0, staged(parameters(None))),
            Step(0.0, Flight.reboot),
            Step(8.0, Flight.engage),
            seconds=30.0,
        ),
        fault_of(
            firmware,
            "the control mode is denied",
            given_up(firmware),
            Step(0.0, refuse),
            Step(0.0, Flight.engage),
            begin=State.READY,
        ),
        fault_of(
            firmware,
            "the control mode is denied for 1.5 s",
            expected(firmware, TRACKING),
            Step(0.0, refuse),
            Step(0.0, Flight.engage),
            Step(1.5, obey),
            begin=State.READY,
        ),
        fault_of(
            firmware,
            "the exit mode is denied when the operator aborts",
            given_up(firmware),
            Step(0.0, refuse),
            Step(0.0, Flight.abort),
        ),
    ]


#: A mode that the service asks for in no state.
_PILOTS: Final = {
    Firmware.PX4_UUV: "acro",
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
        fault_of(
            firmware,
            f"the pilot takes over while {state}",
            given_up(firmware),
            Step(0.0, switch),
            begin=state,
            seconds=6.0,
        )
        for state in _BEGUN
    ] + [
        fault_of(
            firmware,
            "the service is killed in flight and is back at once",
            given_up(firmware, 1.2),
            Step(0.0, Flight.kill_and_restart),
            seconds=10.0,
        )
    ]


PROFILE_FAULTS: Final = tuple(
    fault
    for firmware in Firmware
    for fault in (
        *_estimate(firmware),
        *_link(firmware),
        *_parameters(firmware),
        *_autopilot(firmware),
        *_pilot(firmware),
        *(of_the_air(firmware) if firmware in PLANES else ()),
    )
)
