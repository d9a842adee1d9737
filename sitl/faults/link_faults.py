"""Faults of the line: losses, gaps, copies, disorder, damage, delay, strangers."""

from __future__ import annotations

from typing import Final

from guidance.supervisor import State
from sitl.faults.fault import Action, Fault, Step
from sitl.faults.flight import DEAD, SOUND, Flight
from sitl.faults.outcomes import (
    BOTH,
    LEFT_ALONE,
    PX4,
    ROVER,
    guarded,
    hands_over,
    tracks_on,
    tracks_on_or_hands_over,
)
from sitl.faults.tampering import STATE, thinned, with_another
from sitl.lockstep import Channel
from sitl.vehicle import Firmware, VehicleOptions

#: Beyond this gap (s) control is given up; shorter ones are flown through.
_SURVIVED_GAP_S: Final = 0.5
#: The other one is disarmed and in another mode: a hand-over may seem to be over, but control is not taken.
_TWINS: Final = frozenset({State.HANDED_OVER, State.READY, State.CONNECTED})
#: Beyond this (s) the autopilot counts as lost, and what comes back is found armed where it was left.
_LOST_GAP_S: Final = 3.0


#: Without wind the vehicle keeps to the reference; what a bad line adds is the blending of late estimates.
CALM_M: Final = 0.01


def line(to_guide: Channel = SOUND, to_vehicle: Channel = SOUND) -> Action:
    """The line is so from now on."""
    return lambda flight: flight.link(to_guide, to_vehicle)


def _always(action: Action) -> tuple[Step, ...]:
    return (Step(0.0, action),)


def _losses() -> list[Fault]:
    rows = []
    for part in (0.01, 0.1, 0.3):
        lossy = Channel(loss=part)
        rows += [
            Fault(
                title=f"{part * 100:g} % of all datagrams are lost, each way",
                firmware=firmware,
                steps=_always(line(lossy, lossy)),
                expected=tracks_on(CALM_M, "rate_fell"),
                seconds=12.0,
            )
            for firmware in BOTH
        ]
    found = frozenset({State.WITHHELD, State.DISCONNECTED})  # at 90 %, again and again
    for part, states in ((0.5, frozenset[State]()), (0.9, found)):
        lossy = Channel(loss=part)
        rows += [
            Fault(
                title=f"{part * 100:g} % of all datagrams are lost, each way",
                firmware=firmware,
                steps=_always(line(lossy, lossy)),
                expected=tracks_on_or_hands_over(0.05, "rate_fell", states=states),
                seconds=12.0,
            )
            for firmware in BOTH
        ]
    for way, channels in {
        "service": (Channel(loss=0.3), SOUND),
        "autopilot": (SOUND, Channel(loss=0.3)),
    }.items():
        rows.append(
            Fault(
                title=f"30 % of all datagrams to the {way} are lost",
                firmware=PX4,
                steps=_always(line(*channels)),
                expected=tracks_on(CALM_M, "rate_fell"),
            )
        )
    return rows


def _gaps() -> list[Fault]:
    rows = []
    ways = {"both ways": (DEAD, DEAD), "to the service": (DEAD, SOUND), "to the autopilot": (SOUND, DEAD)}
    for gap_s in (0.2, 0.5, 1.0, 2.0, 5.0):
        for way, channels in ways.items():
            for firmware in BOTH if way == "both ways" else (PX4,):
                survived = gap_s <= _SURVIVED_GAP_S
                lost = gap_s > _LOST_GAP_S and way != "to the autopilot"
                after = frozenset({State.WITHHELD if lost else State.HANDED_OVER})
                rows.append(
                    Fault(
                        title=f"a gap of {gap_s:g} s {way}",
                        firmware=firmware,
                        steps=(Step(0.0, line(*channels)), Step(gap_s, line())),
                        expected=tracks_on(CALM_M) if survived else hands_over(1.05, states=after),
                        seconds=gap_s + 6.0,
                    )
                )
    rows += [
        Fault(
            title="a gap of 0.5 s to the service, with guards.state_max_s = 0.2",
            firmware=firmware,
            overrides=("guards.state_max_s=0.2",),
            steps=(Step(0.0, line(DEAD)), Step(0.5, line())),
            expected=guarded(firmware, "state", 0.55),
        )
        for firmware in BOTH
    ]
    return rows


def _damage() -> list[Fault]:
    copies = Channel(duplication=0.5)
    disorder = Channel(jitter_s=0.03)
    damage = Channel(corruption=0.1)
    return [
        Fault(
            title="half of all datagrams come twice",
            firmware=PX4,
            steps=_always(line(copies, copies)),
            expected=tracks_on(CALM_M),
        ),
        *(
            Fault(
                title="datagrams overtake each other by up to 30 ms",
                firmware=firmware,
                steps=_always(line(disorder, disorder)),
                expected=tracks_on(CALM_M),
            )
            for firmware in BOTH
        ),
        *(
            Fault(
                title="a byte is changed in every tenth datagram",
                firmware=firmware,
                steps=_always(line(damage, damage)),
                expected=tracks_on(CALM_M),
            )
            for firmware in BOTH
        ),
        Fault(
            title="a byte is changed in every second datagram",
            firmware=PX4,
            steps=_always(line(Channel(corruption=0.5), Channel(corruption=0.5))),
            expected=tracks_on(CALM_M, "rate_fell"),
        ),
        Fault(
            title="noise of 280 bytes between all datagrams",
            firmware=PX4,
            steps=_always(_noise),
            expected=tracks_on(CALM_M),
        ),
    ]


def _noise(flight: Flight) -> None:
    """Bytes that begin as frames do, and are none."""
    noise = bytes((0xFD, 0xFF, 0, 0) + (0xFE, 0x21, 0xA5) * 92)
    flight.stage(lambda data, now_ns: (noise, data))


def _delays() -> list[Fault]:
    late = Channel(delay_s=0.5)
    rows = [
        Fault(
            title=f"everything is {delay_s * 1e3:g} ms late, each way",
            firmware=PX4,
            steps=_always(line(Channel(delay_s=delay_s), Channel(delay_s=delay_s))),
            expected=tracks_on(CALM_M),
        )
        for delay_s in (0.02, 0.1)
    ]
    rows += [
        Fault(
            title="up to 100 ms of jitter, each way",
            firmware=firmware,
            steps=_always(line(Channel(jitter_s=0.1), Channel(jitter_s=0.1))),
            expected=tracks_on(0.03),
        )
        for firmware in BOTH
    ]
    rows += [
        Fault(
            title=f"everything is 500 ms late, {way}",
            firmware=firmware,
            steps=_always(line(*channels)),
            expected=hands_over(1.05, modes=LEFT_ALONE[firmware]),
        )
        for way, channels in (("to the service", (late, SOUND)), ("each way", (late, late)))
        for firmware in BOTH
    ]
    rows += [
        Fault(
            title="everything is 500 ms late, to the autopilot",
            firmware=firmware,
            steps=_always(line(SOUND, late)),
            # The clock takes half of a round trip for each way: the state comes to seem too old.
            expected=hands_over(6.5, modes=LEFT_ALONE[firmware], within_m=2.0),
            seconds=10.0,
        )
        for firmware in BOTH
    ]
    rows.append(
        Fault(
            title="up to 500 ms of jitter, each way",
            firmware=PX4,
            steps=_always(line(Channel(jitter_s=0.5), Channel(jitter_s=0.5))),
            expected=tracks_on_or_hands_over(0.05, "estimator_reset", "rate_fell"),
        )
    )
    return rows


def _rates() -> list[Fault]:
    slow = Fault(
        title="the state comes at 5 Hz",
        firmware=PX4,
        steps=_always(lambda flight: flight.stage(thinned(STATE, 5.0))),
        expected=guarded(PX4, "rate", 3.0, "rate_fell", within_m=CALM_M),
    )
    return [
        slow,
        *(
            Fault(
                title="another program sets all rates to 5 Hz",
                firmware=firmware,
                steps=_always(_other_rates),
                expected=tracks_on(CALM_M),
            )
            for firmware in BOTH
        ),
    ]


def _other_rates(flight: Flight) -> None:
    for message_id in (30, 31, 32, 33, 331):
        flight.send(511, message_id, 200_000.0)


def _strangers() -> list[Fault]:
    def joined(system_id: int, component_id: int, firmware: Firmware = PX4) -> Action:
        options = VehicleOptions(firmware=firmware, system_id=system_id, component_id=component_id)

        def act(flight: Flight) -> None:
            flight.witness.deceived = (system_id, component_id) == (1, 1)
            flight.stage(with_another(options, flight.line.now_ns))

        return act

    return [
        Fault(
            title="an autopilot of another system on the line",
            firmware=PX4,
            steps=_always(joined(2, 1)),
            expected=tracks_on(CALM_M),
        ),
        Fault(
            title="another component of the same system speaks as an autopilot",
            firmware=PX4,
            steps=_always(joined(1, 2)),
            expected=tracks_on(CALM_M),
        ),
        *(
            Fault(
                title="a second autopilot of the same ids, disarmed",
                firmware=firmware,
                steps=_always(joined(1, 1, firmware)),
                expected=hands_over(4.0, "estimator_reset", "two_autopilots", "reboot", states=_TWINS),
            )
            for firmware in (PX4, ROVER)
        ),
        Fault(
            title="a PX4 takes the rover's ids",
            firmware=ROVER,
            steps=_always(joined(1, 1, PX4)),
            expected=hands_over(4.0, "estimator_reset", "two_autopilots", "reboot", states=_TWINS),
        ),
    ]


LINK_FAULTS: Final = (
    *_losses(),
    *_gaps(),
    *_damage(),
    *_delays(),
    *_rates(),
    *_strangers(),
)
