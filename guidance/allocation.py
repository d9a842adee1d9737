"""Which two of roll, pitch and yaw turn b1: the redundancy of the remark after Prop. 3.2.

The law wants b1 to move along the sphere: b1' = u3 b2 - u2 b3. Every allocation gives that b1' when it can:

- `PITCH_YAW`: the paper's, u1 = 0. Proved: everything that (11) and (14) promise.
- `ROLL_PITCH`: u3 = 0, for a yaw actuator that failed. Rolls until the wanted b1' lies in the plane in which
  pitching moves b1, b3's, and pitches meanwhile by as much of it as lies there already.
- `ROLL_YAW`: u2 = 0, for a pitch actuator that failed. Likewise into b2's plane, in which yawing moves b1.

To solve (10) with u3 = 0 for u1, as the remark suggests, gives u1 = -(rho3 dpsi_1 + a5)/y6, which is singular
on the very set that is to be reached (y6 = 0). Here instead the roll rate is bounded, rho times the angle
still to be rolled (at most a right angle: either end of the axis will do), and it fades as the wanted turn
becomes small against `TURN_MIN_RAD_S`, where that angle is noise: then the roll is held.

What is proved of the two: with the wanted turn at a standstill in the world, the angle to be rolled decays
at the rate rho while the fading lets it, and the part of the turn that is pitched (yawed) never turns b1
away. What is only measured (tests/test_allocation.py): that flights converge. They do from every start tried
on the paper's helix and on circles, to the same centimetre; a turn that itself turns (a helix's does, by its
torsion) leaves an angle of about torsion/rho to be rolled, and with it a misalignment, as does the fading.
"""

from __future__ import annotations

from math import atan2, sqrt
from typing import Final

PITCH_YAW: Final = 0
ROLL_PITCH: Final = 1
ROLL_YAW: Final = 2

#: The wanted turn (rad/s) at which the roll that leads into its plane has half its rate.
TURN_MIN_RAD_S: Final = 1e-3


def allocate(allocation: int, rho: float, u2: float, u3: float) -> tuple[float, float, float]:
    """Roll, pitch and yaw rate for the pitch and yaw rates that are wanted (rad/s); rho > 0 in 1/s."""
    if allocation == ROLL_PITCH:
        return _roll(rho, u3, -u2), u2, 0.0
    if allocation == ROLL_YAW:
        return -_roll(rho, -u2, u3), 0.0, u3
    return 0.0, u2, u3


def _roll(rho: float, across: float, along: float) -> float:
    """The roll rate that turns b2 (b3 is `along`), or for the opposite sign b3, off the wanted b1'.

    With b1' = across b2 + along b3 the angle off +-b3 changes by just the roll rate, and with the axes
    exchanged by minus that. At a right angle either way is as short; it is the one towards +b3.
    """
    if along < 0.0:
        across, along = -across, -along
    turn = sqrt(across * across + along * along)
    return -rho * atan2(across, along) * (turn / (turn + TURN_MIN_RAD_S))
