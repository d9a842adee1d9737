"""What rows of faults of the profiles as they ship are made of."""

from __future__ import annotations

import math
from typing import Any, Final

from guidance.supervisor import State
from sitl.faults.crafts import CRAFTS
from sitl.faults.fault import Action, Expected, Fault, Never, Step
from sitl.faults.outcomes import SILENCE
from sitl.faults.tampering import Stage
from sitl.vehicle import Firmware

#: Where it is guided,
TRACKING: Final = frozenset({State.TRACKING})
#: and where nobody guides it.
OUT: Final = frozenset(
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
    "guard_air",
    "parameter_changed",
    "parameters_unfit",
    "order_expired",
    "caution",
}  # fmt: skip
#: From the fault to its end, where nothing says how long.
A_WHILE_S: Final = 2.0


def expected(firmware: Firmware, states: frozenset[State], **more: Any) -> Expected:
    """In one of these states at the end, well tracked or told why."""
    return Expected(states, may=_TOLD | more.pop("may", frozenset()), again_m=CRAFTS[firmware].good_m, **more)


def tracks_on(firmware: Firmware, **more: Any) -> Expected:
    """It tracks on, and well."""
    return expected(firmware, TRACKING, never=frozenset({Never.LEAVES}), **more)


def given_up(firmware: Firmware, within_s: float = math.inf, **more: Any) -> Expected:
    """It is the autopilot's or the pilot's, so soon, and stays so."""
    return expected(firmware, OUT, out_within_s=within_s, never=frozenset({Never.TRACKS}), **more)


def either(firmware: Firmware, **more: Any) -> Expected:
    """It tracks well, or is not guided any more."""
    return expected(firmware, TRACKING | OUT, **more)


def staged(stage: Stage | None) -> Action:
    """This becomes of the vehicle's messages."""
    return lambda flight: flight.stage(stage)


def lasting(seconds: float, begin: Action, end: Action) -> tuple[Step, ...]:
    """From the first to the second, so long."""
    return (Step(0.0, begin), Step(seconds, end))


def fault_of(firmware: Firmware, title: str, expected: Expected, *steps: Step, **more: Any) -> Fault:
    """A row: of the profile as it ships, flown until it should track well again."""
    seconds = more.pop("seconds", CRAFTS[firmware].back_s)
    return Fault(
        title=title, firmware=firmware, steps=steps, expected=expected, seconds=seconds, ships=True, **more
    )
