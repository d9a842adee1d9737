"""Which two of roll, pitch and yaw turn b1: the redundancy of the remark after Prop. 3.2.

The law wants b1 to move along the sphere: b1' = u3 b2 - u2 b3. Every allocation gives that b1' when it can:

- `PITCH_YAW`: the paper's, u1 = 0. Proved: everything that (11) and (14) promise.
- `ROLL_PITCH`: u3 = 0, for a yaw actuator that failed. Rolls until the wanted b1' lies in the plane in which
  pitching moves b1, b3's, and pitches meanwhile by as much of it as lies there already.
- `ROLL_YAW`: u2 = 0, for a pitch actuator that failed. Likewise into b2's plane, in which yawing moves b1.

To solve (10) with u3 = 0 for u1, as the remark suggests, gives u1 = -(rho3 dpsi_1 + a5)/y6, which is singular
on the very set that is to be reached (y6 = 0). Here instead the roll rate is bounded, rho times the angle
still to be rolled (at most a right angle: either end of the axis will do) and no more than can be stopped in
time; and it fades as the wanted turn becomes small against `TURN_MIN_RAD_S`, where that angle is noise: then
the roll is held.

What can be said of the two beforehand: while the wanted b1' stands still in the world, the angle to be rolled
decays at the rate rho (less the fading). Linearised about a reference that turns, the misalignment waits for
the roll: s^2 + rho s + rho rho' = 0, with rho' that of the alignment. With a lag tau of the actuators that is
stable only for rho' tau < 1, whatever rho is, where pitch-yaw is stable with any; hence rho' is only
`ALIGNED_PART` rho.

What is only measured: that flights converge. They do from every start tried within 50 m of the paper's helix
and of circles, to the same centimetre as with pitch-yaw (rho 4 and 10, also with a lag of 0.1 s; a small set
is in tests/test_allocation.py). They do not where the roll can only be changed slowly against rho: at
5 rad/s^2, on a 10 m circle at 2 m/s with k = 1, rho = 4 converges and with rho = 10 about a quarter of the
starts ends in a limit cycle, of 0.2 m at worst. A turn whose axis itself turns by w rad/s (a helix's does, by
its torsion) leaves an angle of about w/rho to be rolled and with it a misalignment: on a helix of 5 m at
3 m/s, 1 m/s down, with k = 1, 4.3 cm with rho = 4 and 7.0 mm with rho = 10 (with k = 1.5, 2.9 cm and 4.7 mm).
"""

from __future__ import annotations

from math import atan2, sqrt
from typing import Final

from guidance.limits import stoppable

PITCH_YAW: Final = 0
ROLL_PITCH: Final = 1
ROLL_YAW: Final = 2

#: The wanted turn (rad/s) at which the roll that leads into its plane has half its rate.
TURN_MIN_RAD_S: Final = 0.02
#: How fast the redundant allocations align b1, as a part of rho2 and rho3.
ALIGNED_PART: Final = 0.5


def allocate(
    allocation: int, rho: float, roll_acceleration: float, u2: float, u3: float
) -> tuple[float, float, float]:
    """Roll, pitch and yaw rate for the pitch and yaw rates that are wanted (rad/s).

    `rho` > 0 in 1/s; the roll rate can change by `roll_acceleration` > 0 (rad/s^2, may be infinite).
    """
    if allocation == ROLL_PITCH:
        return -_roll(rho, roll_acceleration, u3, -u2), u2, 0.0
    if allocation == ROLL_YAW:
        return _roll(rho, roll_acceleration, -u2, u3), 0.0, u3
    return 0.0, u2, u3


def _roll(rho: float, roll_acceleration: float, across: float, along: float) -> float:
    """How fast to roll towards `across` = 0, with b1' = across b2 + along b3 (or across b3 + along b2).

    Rolling changes the angle of b1' off +-b3 by just the roll rate, off +-b2 by minus that. At a right
    angle either way is as short; the one towards the positive axis is taken.
    """
    if along < 0.0:
        across, along = -across, -along
    angle = atan2(across, along)
    turn = sqrt(across * across + along * along)
    rate = stoppable(rho * abs(angle), abs(angle), roll_acceleration) * (turn / (turn + TURN_MIN_RAD_S))
    return rate if angle > 0.0 else -rate
