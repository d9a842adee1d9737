"""Faults of what the autopilot says: clock, estimate, numbers that are none, values that stand still."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from guidance.mavlink.signing import SigningClock, wall_timestamp
from guidance.supervisor import State
from sitl.faults.fault import Action, Fault, Step
from sitl.faults.flight import Flight
from sitl.faults.link_faults import CALM_M
from sitl.faults.outcomes import BOTH, PX4, ROVER, guarded, hands_over, stays_out, tracks_on
from sitl.faults.tampering import ATTITUDE, POSITION, Stage, frozen, later, moved, not_a_number, quaternions

_HOUR_S: Final = 3600


def tampered(stage: Stage) -> tuple[Step, ...]:
    """From the beginning of the fault to its end."""
    return (Step(0.0, lambda flight: flight.stage(stage)),)


def _for_a_while(stage: Stage, seconds: float) -> tuple[Step, ...]:
    return (*tampered(stage), Step(seconds, lambda flight: flight.stage(None)))


def _clocks() -> list[Fault]:
    jumps = [
        Fault(
            title=f"the autopilot's clock jumps by {jump_s:+g} s",
            firmware=PX4,
            steps=tampered(later(jump_s)),
            expected=tracks_on(0.03),
        )
        for jump_s in (0.04, -0.04)
    ]
    jumps += [
        Fault(
            title=f"the autopilot's clock jumps by {jump_s:+g} s",
            firmware=firmware,
            steps=tampered(later(jump_s)),
            expected=tracks_on(CALM_M),  # silent until the clock is known anew
        )
        for jump_s, firmware in ((10.0, PX4), (10.0, ROVER))
    ]
    jumps += [
        Fault(
            title="the autopilot's clock jumps by -1.5 s: it seems to have rebooted",
            firmware=firmware,
            steps=tampered(later(-1.5)),
            expected=hands_over(0.5, told=("reboot",), states=frozenset({State.WITHHELD})),
        )
        for firmware in BOTH
    ]
    drifts = [
        Fault(
            title=f"the autopilot's clock is {ppm / 1e4:g} % off",
            firmware=PX4,
            vehicle={"clock_drift_ppm": ppm},
            steps=(),
            expected=tracks_on(CALM_M),
        )
        for ppm in (1_000.0, -10_000.0)
    ]
    wall = [
        Fault(
            title=f"the companion's wall clock is set by {hours:+g} h, on a signed link",
            firmware=PX4,
            signed=True,
            steps=(Step(0.0, _set_wall(hours * _HOUR_S)),),
            expected=tracks_on(CALM_M),
        )
        for hours in (1, -1)
    ]
    return [*jumps, *drifts, *wall]


def _set_wall(seconds: int) -> Action:
    def act(flight: Flight) -> None:
        unix_ns = flight.line.vehicle.options.unix_at_zero_ns + flight.line.now_ns + seconds * 10**9
        flight.line.guide.signing_clock(SigningClock(wall_timestamp(unix_ns)), flight.line.now_ns)

    return act


def _glitch(north_m: float) -> tuple[Step, ...]:
    def jump(metres: float) -> Action:
        return lambda flight: flight.line.vehicle.reset_estimator(flight.line.now_ns, (metres, 0.0, 0.0))

    return (Step(0.0, jump(north_m)), Step(2.0, jump(0.0)))


def _glitches() -> list[Fault]:
    rows = []
    for firmware in BOTH:
        rows.append(
            Fault(
                title="a GPS glitch of 5 m for 2 s",
                firmware=firmware,
                steps=_glitch(5.0),
                expected=tracks_on(1.2, told=("estimator_reset",)),
            )
        )
        rows.append(
            Fault(
                title="a GPS glitch of 50 m for 2 s",
                firmware=firmware,
                steps=_glitch(50.0),
                expected=guarded(firmware, "jump", 0.1, "estimator_reset"),
            )
        )
    rows.append(
        Fault(
            title="the position jumps by 5 m and no reset is counted",
            firmware=PX4,
            steps=_for_a_while(moved(5.0, 0.0), 2.0),
            expected=tracks_on(1.2, told=("estimator_reset",)),
        )
    )
    rows.append(
        Fault(
            title="the heading jumps by 30 degrees",
            firmware=PX4,
            steps=(
                Step(
                    0.0,
                    lambda flight: flight.line.vehicle.reset_estimator(
                        flight.line.now_ns, turned_rad=math.radians(30.0)
                    ),
                ),
            ),
            expected=tracks_on(0.8, told=("estimator_reset",)),
        )
    )
    return rows


def _always(norm: float) -> Callable[[int], float]:
    return lambda count: norm


def _numbers() -> list[Fault]:
    def alternating(count: int) -> float:
        return -1.0 if count % 2 else 1.0

    rows = [
        Fault(
            title="the sign of the quaternion flips with every message",
            firmware=firmware,
            steps=tampered(quaternions(alternating)),
            expected=tracks_on(CALM_M),
        )
        for firmware in BOTH
    ]
    rows += [
        Fault(
            title=f"quaternions of norm {norm:g}",
            firmware=PX4,
            steps=tampered(quaternions(_always(norm))),
            expected=tracks_on(CALM_M),  # below half and above: by the Euler angles of ATTITUDE
        )
        for norm in (1.01, 2.0, 1e-30, 0.0)
    ]
    rows += [
        Fault(
            title=f"{what} is not a number",
            firmware=firmware,
            steps=tampered(not_a_number(names)),
            expected=hands_over(1.2),
        )
        for what, names in (("the attitude", ATTITUDE), ("the position", POSITION))
        for firmware in BOTH
    ]
    rows.append(
        Fault(
            title="the attitude is not a number for 0.3 s",
            firmware=PX4,
            steps=_for_a_while(not_a_number(ATTITUDE), 0.3),
            expected=tracks_on(CALM_M),
        )
    )
    return rows


def _standing() -> list[Fault]:
    return [
        Fault(
            title=f"{what} stands still, {how}",
            firmware=firmware,
            steps=tampered(frozen(names, stamped=stamped)),
            expected=guarded(firmware, "error", 10.0, within_m=9.0)
            if stamped
            else hands_over(1.6, within_m=0.05),
            seconds=14.0,
        )
        for what, names in (("the attitude", ATTITUDE), ("the position", POSITION))
        for how, stamped in (("with its time", False), ("its time goes on", True))
        for firmware in BOTH
    ]


def _not_ready() -> list[Fault]:
    return [
        Fault(
            title="the estimator is not ready",
            firmware=firmware,
            begin=State.DISCONNECTED,
            vehicle={"estimator_ready_s": 60.0},
            steps=(),
            expected=stays_out(State.CONNECTED),
        )
        for firmware in (PX4, ROVER)
    ]


STATE_FAULTS: Final = (*_clocks(), *_glitches(), *_numbers(), *_standing(), *_not_ready())
