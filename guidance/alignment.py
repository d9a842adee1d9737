"""How to turn b1 into the field Xr: the law (11) of the paper, and the forward-only law `global`.

Both take the field in body axes, y = (<Xr, X4>, <Xr, X5>, <Xr, X6>), and its rate of change along the motion,
a = (<Xr', X4>, <Xr', X5>, <Xr', X6>) with Xr' = r'' - lambda d/dt d1 phi, and give the pitch and yaw rates
that are wanted; b1 moves by b1' = u3 b2 - u2 b3.

**Paper.** (11) divides by y4, which is zero where the field stands at a right angle to b1: after a corner of
the reference, but also in the middle of a flight, since the paper's claim after (13) that y4 never decreases
does not hold. With y4 < 0 the law is well defined again but turns -b1 into the field and drives in reverse; a
vehicle that cannot reverse (`speed_min_m_s >= 0`) does not converge from there. So:

- |y4| <= Y4_RATIO_MIN |beta Xr|: (11) is taken with y4 = +Y4_RATIO_MIN |beta Xr| and without feed-forward.
  That turns b1 *towards* the field, always (the fixed side), about as fast as (11) does at the edge of the
  band on the forward side; at the edge on the reverse side the turn changes its sign, as it must somewhere.
  The feed-forward is left out because where it outweighs the alignment, the full numerator turns b1 *away*
  and would hold it at y4 = 0.
- Everywhere, the rate vector (u2, u3) is shortened to at most max(rho2, rho3)/Y4_RATIO_MIN. The alignment
  part of (11) stays below that on its own; a/y4 does not when Xr comes close to zero.
- Xr = 0 has no direction: the rates are zero, the heading is held.

**Global.** b1 turns to d = Xr/|Xr| along the shortest arc at the rate rho theta, theta being the angle
between the two, plus the turn rate of d itself, omega = d x d' = d x Xr'/|Xr|:

    (u2, u3) = theta/sin(theta) (-rho2 d6, rho3 d5) + (b2.omega, b3.omega)

With rho2 = rho3 = rho and no limits theta' = -rho theta, exactly and from every attitude but the opposite
one, whatever reference and speed do: what omega adds to b1 and to d is the same. (Its part along b1 would
only roll.) With rho2 != rho3, theta still decreases. Near alignment theta/sin(theta) = 1 and this is (11);
what differs vanishes with theta: theta <Xr', X4>/|beta Xr|, which (11) leaves to y4, and terms in theta^2.
What has no direction is decided as follows:

- b1 exactly opposite to the field: it turns to the right (yaw), at rho3 pi.
- |Xr| below FIELD_MIN_M_S: the rates fade in proportion, so that they are zero at Xr = 0 (the heading is
  held) and the noise of a position does not spin a vehicle that has arrived where nothing moves.
- As above, the rates are shortened to at most max(rho2, rho3)/Y4_RATIO_MIN.
- Where pitch or yaw can only change slowly (`turn_acceleration`, rad/s^2, finite), rho theta is taken no
  greater than `limits.stoppable` allows, so that the turn can still be stopped at theta = 0.

These cases, but the last, are what `Turn.singular` marks.
"""

from __future__ import annotations

from math import atan2, inf, pi, sqrt
from typing import Final, NamedTuple

from guidance.limits import stoppable
from guidance.se3 import Vec3

#: Sine of the angle about the right angle between b1 and the field within which (11) gives way to the branch.
#: 2.9 degrees: wider than an attitude's noise, narrow enough for the error after a corner to be within 0.2 %
#: of what ever smaller values lead to. With rho = 10 it bounds the rates by 200 rad/s, which an integrator
#: resolves with steps of 1 ms.
Y4_RATIO_MIN: Final = 0.05
#: A field that is slower than this (m/s) has less and less of a direction for `global`.
FIELD_MIN_M_S: Final = 1e-3


class Gains(NamedTuple):
    """All positive: k and beta scale (3) and phi (lambda k in 1/s), rho2 and rho3 are in 1/s (11)."""

    k: float
    rho2: float
    rho3: float
    beta: float


class Turn(NamedTuple):
    """Wanted pitch and yaw rate, rad/s; `singular`: the module says where and why."""

    u2: float
    u3: float
    singular: bool


def paper_turn(gains: Gains, y: Vec3, a: Vec3) -> Turn:
    """(11), with dpsi_1 = y5 and dpsi_2 = y6; y and a as the module says."""
    y4, y5, y6 = y
    rho2 = gains.rho2
    rho3 = gains.rho3
    # the turn that is wanted, over y4
    turn5 = rho3 * y5 + a.y
    turn6 = rho2 * y6 + a.z
    divisor = y4
    y4_min = Y4_RATIO_MIN * sqrt(y4 * y4 + y5 * y5 + y6 * y6)
    if not y4_min > 0.0:  # Xr = 0
        return Turn(0.0, 0.0, True)
    singular = -y4_min <= y4 <= y4_min
    if singular:
        turn5 = rho3 * y5
        turn6 = rho2 * y6
        divisor = y4_min
    turn_max = (rho2 if rho2 > rho3 else rho3) / Y4_RATIO_MIN * abs(divisor)
    part = 1.0 / divisor
    turn = sqrt(turn5 * turn5 + turn6 * turn6)
    if turn > turn_max:
        singular = True
        part *= turn_max / turn
    return Turn(-part * turn6, part * turn5, singular)


def global_turn(gains: Gains, turn_acceleration: float, y: Vec3, a: Vec3) -> Turn:
    """The shortest arc and the field's own turn; arguments as the module says."""
    y4, y5, y6 = y
    rho2 = gains.rho2
    rho3 = gains.rho3
    field = sqrt(y4 * y4 + y5 * y5 + y6 * y6)
    if not field > 0.0:
        return Turn(0.0, 0.0, True)
    d4, d5, d6 = y4 / field, y5 / field, y6 / field
    singular = False
    sine = sqrt(d5 * d5 + d6 * d6)
    if sine > 0.0:
        theta = atan2(sine, d4)
        arc = theta / sine
        if turn_acceleration < inf:
            wanted = arc * sqrt((rho2 * d6) ** 2 + (rho3 * d5) ** 2)
            if wanted > 0.0:  # a sine below 1e-154 has a square of 0
                arc *= stoppable(wanted, theta, turn_acceleration) / wanted
        u2 = -rho2 * arc * d6
        u3 = rho3 * arc * d5
    elif d4 > 0.0:
        u2 = 0.0
        u3 = 0.0
    else:
        singular = True
        u2 = 0.0
        u3 = stoppable(rho3 * pi, pi, turn_acceleration)

    field_min = FIELD_MIN_M_S * gains.beta
    part = 1.0
    if field < field_min:
        singular = True
        part = field / field_min
        field = field_min
    u2 = part * (u2 + (d6 * a.x - d4 * a.z) / field)
    u3 = part * (u3 + (d4 * a.y - d5 * a.x) / field)

    rate = sqrt(u2 * u2 + u3 * u3)
    rate_max = (rho2 if rho2 > rho3 else rho3) / Y4_RATIO_MIN
    if rate > rate_max:
        singular = True
        u2 *= rate_max / rate
        u3 *= rate_max / rate
    return Turn(u2, u3, singular)
