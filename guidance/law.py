"""The tracking law of Tabuada and Lima, "Position tracking for underactuated rigid bodies on SE(3)".

Symbols and equation numbers are the paper's: g = (x, R) is the pose, r the reference, b1, b2, b3 the
columns of R, u1, u2, u3 roll, pitch and yaw rate and u4 the forward velocity, all in the body frame (1):

    R' = R hat(u1, u2, u3)        x' = u4 b1

Any right-handed world frame will do; in flight it is NED. The metric (3) on translations is
<V, W> = beta V.W, and lambda = 1/beta; psi_1 and psi_2 of (9) are quadratic, phi(x, r) = 1/2 k |x - r|^2.
What follows from (11) and (14), wherever neither the branch below nor a limit on u2, u3 is active:

    y5' = -rho3 y5        y6' = -rho2 y6        e' = -lambda k e - (y5 b2 + y6 b3)/beta    (u4 unlimited)

**y4 = 0.** (11) divides by y4 = <Xr, X4>, which is zero where the field stands at a right angle to b1:
after a corner of the reference, but also in the middle of a flight, since the paper's claim after (13) that
y4 never decreases does not hold. With y4 < 0 the law is well defined again but turns -b1 into the field and
drives in reverse; a vehicle that cannot reverse (`speed_min_m_s >= 0`) does not converge from there. So:

- |y4| <= Y4_RATIO_MIN |beta Xr|: (11) is taken with y4 = +Y4_RATIO_MIN |beta Xr| and without feed-forward.
  That turns b1 *towards* the field, always (the fixed side), about as fast as (11) does at the edge of the
  band on the forward side; at the edge on the reverse side the turn changes its sign, as it must somewhere.
  The feed-forward is left out because where it outweighs the alignment, the full numerator turns b1 *away*
  and would hold it at y4 = 0.
- Everywhere, the rate vector (u2, u3) is shortened to at most max(rho2, rho3)/Y4_RATIO_MIN. The alignment
  part of (11) stays below that on its own; a/y4 does not when Xr comes close to zero.
- Xr = 0 has no direction: the rates are zero, the heading is held.

These three are what `Evaluation.singular` marks.
"""

from __future__ import annotations

from math import sqrt
from typing import Final, NamedTuple

from guidance.se3 import Pose, Reference, Vec3, body_axes, dot, from_yaw, subtract, yaw_of

#: Sine of the angle about the right angle between b1 and the field within which (11) gives way to the branch.
#: 2.9 degrees: wider than an attitude's noise, narrow enough for the error after a corner to be within 0.2 %
#: of what ever smaller values lead to. With rho = 10 it bounds the rates by 200 rad/s, which an integrator
#: resolves with steps of 1 ms.
Y4_RATIO_MIN: Final = 0.05


class Gains(NamedTuple):
    """All positive: k and beta scale (3) and phi (lambda k in 1/s), rho2 and rho3 are in 1/s (11)."""

    k: float
    rho2: float
    rho3: float
    beta: float


class Limits(NamedTuple):
    """What the vehicle can do; rates are bounded by +-, all at least 0 and speed_min <= speed_max.

    `speed_min_m_s` below zero allows reverse. Infinite values mean no limit.
    """

    speed_min_m_s: float
    speed_max_m_s: float
    roll_rate_rad_s: float
    pitch_rate_rad_s: float
    yaw_rate_rad_s: float


class Controls(NamedTuple):
    """u of (1): roll, pitch and yaw rate in rad/s about the body axes (FRD), forward speed in m/s."""

    u1: float
    u2: float
    u3: float
    u4: float


class Field(NamedTuple):
    """The desired field Xr in m/s, and a, its derivative at fixed x, in m/s^2; world coordinates."""

    Xr: Vec3
    a: Vec3


class Evaluation(NamedTuple):
    """Everything one evaluation of the law found, for the setpoint and for the record.

    `controls` are after the limits, `demanded` before; e = x - r in m, world; y4, y5, y6 are <Xr, X4>,
    <Xr, X5>, <Xr, X6>; V1 is phi and V2 is (9). `saturated`: a limit changed `demanded`. `singular`: (11)
    was replaced, see the module.
    """

    controls: Controls
    demanded: Controls
    e: Vec3
    y4: float
    y5: float
    y6: float
    V1: float
    V2: float
    saturated: bool
    singular: bool


def desired_field(gains: Gains, x: Vec3, reference: Reference) -> Field:
    """Xr = r' - lambda d1 phi (3.3) and a = r'' - lambda d/dt(d1 phi | x fixed), as (10) has it."""
    r, r_dot, r_ddot = reference
    lambda_k = gains.k / gains.beta
    return Field(
        Vec3(
            r_dot.x - lambda_k * (x.x - r.x),
            r_dot.y - lambda_k * (x.y - r.y),
            r_dot.z - lambda_k * (x.z - r.z),
        ),
        Vec3(
            r_ddot.x + lambda_k * r_dot.x,
            r_ddot.y + lambda_k * r_dot.y,
            r_ddot.z + lambda_k * r_dot.z,
        ),
    )


def clamp(value: float, lowest: float, highest: float) -> float:
    """The nearest value in [lowest, highest]."""
    if value < lowest:
        return lowest
    if value > highest:
        return highest
    return value


def evaluate(gains: Gains, limits: Limits, pose: Pose, reference: Reference) -> Evaluation:
    """The law `paper`: (11) and (14), then each control clamped on its own as in section 4.

    `pose` and `reference` hold for the same instant, in the same world frame. The caller has checked that
    all is finite and the attitude a unit quaternion; then nothing raises and, for magnitudes up to 1e70,
    every result is finite, with |(u2, u3)| <= max(rho2, rho3)/Y4_RATIO_MIN before the limits.
    """
    beta = gains.beta
    rho2 = gains.rho2
    rho3 = gains.rho3
    Xr, a = desired_field(gains, pose.position, reference)
    b1, b2, b3 = body_axes(pose.attitude)

    # <Xr, X4>, <Xr, X5>, <Xr, X6> and <a, X5>, <a, X6> with the metric (3)
    y4 = beta * dot(b1, Xr)
    y5 = beta * dot(b2, Xr)
    y6 = beta * dot(b3, Xr)
    a5 = beta * dot(b2, a)
    a6 = beta * dot(b3, a)

    # (11), with dpsi_1 = y5 and dpsi_2 = y6: the turn that is wanted, over y4
    turn5 = rho3 * y5 + a5
    turn6 = rho2 * y6 + a6
    divisor = y4
    y4_min = Y4_RATIO_MIN * sqrt(y4 * y4 + y5 * y5 + y6 * y6)
    singular = -y4_min <= y4 <= y4_min
    if singular:
        turn5 = rho3 * y5
        turn6 = rho2 * y6
        divisor = y4_min
    if y4_min > 0.0:
        turn = sqrt(turn5 * turn5 + turn6 * turn6)
        turn_max = (rho2 if rho2 > rho3 else rho3) / Y4_RATIO_MIN * abs(divisor)
        if turn > turn_max:
            singular = True
            turn5 *= turn_max / turn
            turn6 *= turn_max / turn
        u2 = -turn6 / divisor
        u3 = turn5 / divisor
    else:  # Xr = 0
        singular = True
        u2 = 0.0
        u3 = 0.0

    # (14); u1 = 0 keeps within any limit
    u4 = y4 / beta
    demanded = Controls(0.0, u2, u3, u4)
    controls = Controls(
        0.0,
        clamp(u2, -limits.pitch_rate_rad_s, limits.pitch_rate_rad_s),
        clamp(u3, -limits.yaw_rate_rad_s, limits.yaw_rate_rad_s),
        clamp(u4, limits.speed_min_m_s, limits.speed_max_m_s),
    )

    e = subtract(pose.position, reference.position)
    V1 = 0.5 * gains.k * dot(e, e)
    V2 = 0.5 * (y5 * y5 + y6 * y6)
    return Evaluation(controls, demanded, e, y4, y5, y6, V1, V2, controls != demanded, singular)


def planar(pose: Pose, reference: Reference) -> tuple[Pose, Reference]:
    """The SE(2) reading of section 4: yaw rate and forward speed over ground alone.

    The attitude keeps only its heading (`se3.yaw_of`, which also says what it is where b1 is vertical), and
    the reference is put at the vehicle's height with no vertical motion, so that errors live in the
    plane. `evaluate` then gives u1 = u2 = 0, and u4 is ground speed.
    """
    x = pose.position
    r, r_dot, r_ddot = reference
    return (
        Pose(x, from_yaw(yaw_of(pose.attitude))),
        Reference(Vec3(r.x, r.y, x.z), Vec3(r_dot.x, r_dot.y, 0.0), Vec3(r_ddot.x, r_ddot.y, 0.0)),
    )
