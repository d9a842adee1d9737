"""The tracking law of Tabuada and Lima, "Position tracking for underactuated rigid bodies on SE(3)".

Symbols and equation numbers are the paper's: g = (x, R) is the pose, r the reference, b1, b2, b3 the
columns of R, u1, u2, u3 roll, pitch and yaw rate and u4 the forward velocity, all in the body frame (1):

    R' = R hat(u1, u2, u3)        x' = u4 b1

Any right-handed world frame will do; in flight it is NED. The metric (3) on translations is
<V, W> = beta V.W, and lambda = 1/beta; psi_1 and psi_2 of (9) are quadratic. One step of the law is

1. the desired field Xr = r' - lambda d1 phi (3.3), for any error function (`error_function`);
2. the speed (14), u4 = lambda y4, or max(0, lambda y4) for `GLOBAL`, within its limits (`limits`);
3. the field's rate of change, Xr' = r'' - lambda (d/dt(d1 phi | x fixed) + H u4 b1), with the u4 of step 2
   as it is applied: with that, (10) holds for any phi, not only for those of Prop. 3.1, for which the last
   term has no part along X5 and X6;
4. the turn of b1 into the field (`alignment`): (11), or the shortest arc;
5. which of the rates do it (`allocation`), within their limits (`limits`).

What follows from (11) and (14), for the pitch-yaw allocation and wherever neither a named branch nor a
limit on u2, u3 is active:

    y5' = -rho3 y5        y6' = -rho2 y6        e' = -lambda d1 phi - (y5 b2 + y6 b3)/beta    (u4 unlimited)

Which law: `PAPER` for vehicles that can reverse, or that start facing their field; `GLOBAL` for all that
only go forward. `alignment` says what each does where it is singular.
"""

from __future__ import annotations

from math import inf
from typing import Final, NamedTuple

from guidance import error_function as phi
from guidance.alignment import Y4_RATIO_MIN as Y4_RATIO_MIN
from guidance.alignment import Gains as Gains
from guidance.alignment import global_turn, paper_turn
from guidance.allocation import ALIGNED_PART, PITCH_YAW, ROLL_PITCH, ROLL_YAW, allocate
from guidance.error_function import Derivatives, ErrorFunction, Symmetric, derivatives, times
from guidance.limits import Controls as Controls
from guidance.limits import Limits as Limits
from guidance.limits import clamp as clamp
from guidance.limits import limited_rates, limited_speed
from guidance.se3 import (
    ZERO,
    Pose,
    Reference,
    Twist,
    Vec3,
    body_axes,
    dot,
    from_yaw,
    subtract,
    yaw_of,
)

PAPER: Final = 0
GLOBAL: Final = 1


class Parameters(NamedTuple):
    """What a flight chooses: `law` is `PAPER` or `GLOBAL`, `allocation` one of `allocation`'s.

    The allocation may change from one step to the next, as when an actuator fails; so may all else.
    """

    law: int
    allocation: int
    gains: Gains
    error_function: ErrorFunction
    limits: Limits


class Memory(NamedTuple):
    """What one step leaves for the next: the controls that were applied. Only the limits on change use it."""

    started: bool
    controls: Controls


class Field(NamedTuple):
    """The desired field Xr in m/s, and a, its derivative at fixed x, in m/s^2; world coordinates."""

    Xr: Vec3
    a: Vec3


class Evaluation(NamedTuple):
    """Everything one evaluation of the law found, for the setpoint and for the record.

    `controls` are after the limits, `demanded` before; e = x - r in m, world; y4, y5, y6 are <Xr, X4>,
    <Xr, X5>, <Xr, X6>; V1 is phi and V2 is (9). `saturated`: a limit changed `demanded`. `singular`: a named
    branch of `alignment` was taken.
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


#: Before the first step.
UNSTARTED: Final = Memory(False, Controls(0.0, 0.0, 0.0, 0.0))
REST: Final = Twist(ZERO, ZERO)


def field_of(lambda_: float, d: Derivatives, reference: Reference) -> Field:
    """Xr = r' - lambda d1 phi (3.3) and a = r'' - lambda d/dt(d1 phi | x fixed), as (10) has it."""
    r_dot = reference.velocity
    r_ddot = reference.acceleration
    p = d.d1
    q = d.d1_dot
    return Field(
        Vec3(r_dot.x - lambda_ * p.x, r_dot.y - lambda_ * p.y, r_dot.z - lambda_ * p.z),
        Vec3(r_ddot.x - lambda_ * q.x, r_ddot.y - lambda_ * q.y, r_ddot.z - lambda_ * q.z),
    )


def desired_field(
    gains: Gains, x: Vec3, reference: Reference, error_function: ErrorFunction = phi.PAPER
) -> Field:
    """The field at x; for phi = 1/2 k |x - r|^2 unless another is given."""
    e = subtract(x, reference.position)
    d = derivatives(error_function, gains.k, gains.beta, e, reference)
    return field_of(1.0 / gains.beta, d, reference)


def guide_step(
    parameters: Parameters, memory: Memory, pose: Pose, twist: Twist, reference: Reference, dt: float
) -> tuple[Memory, Evaluation]:
    """One step of the law, `dt` s after the step that `memory` comes from.

    `pose`, `twist` (body axes, used by the first step alone, in place of a memory) and `reference` hold for
    the same instant, in the same world frame. The caller has checked that all is finite, the attitude a
    unit quaternion and dt >= 0; then nothing raises and, for magnitudes up to 1e70, every result is finite,
    with |(u2, u3)| <= max(rho2, rho3)/Y4_RATIO_MIN and |u1| <= max(rho2, rho3) pi/2 before the limits.
    """
    gains = parameters.gains
    limits = parameters.limits
    beta = gains.beta
    lambda_ = 1.0 / beta
    e = subtract(pose.position, reference.position)
    d = derivatives(parameters.error_function, gains.k, beta, e, reference)
    Xr, a = field_of(lambda_, d, reference)
    b1, b2, b3 = body_axes(pose.attitude)
    # <Xr, X4>, <Xr, X5>, <Xr, X6> with the metric (3)
    y = Vec3(beta * dot(b1, Xr), beta * dot(b2, Xr), beta * dot(b3, Xr))

    previous = memory.controls
    if not memory.started:
        w = twist.angular
        previous = Controls(w.x, w.y, w.z, twist.linear.x)
    slowest = min(limits.pitch_acceleration_rad_s2, limits.yaw_acceleration_rad_s2)
    # A failed actuator rests at once, and how slowly it changed is nothing to those that work.
    if parameters.allocation == ROLL_PITCH:
        previous = Controls(previous.u1, previous.u2, 0.0, previous.u4)
        slowest = limits.pitch_acceleration_rad_s2
    elif parameters.allocation == ROLL_YAW:
        previous = Controls(previous.u1, 0.0, previous.u3, previous.u4)
        slowest = limits.yaw_acceleration_rad_s2

    # (14)
    u4 = lambda_ * y.x
    if parameters.law == GLOBAL and u4 < 0.0:
        u4 = 0.0
    speed = limited_speed(limits, u4, previous.u4, dt)

    # <Xr', X4>, <Xr', X5>, <Xr', X6>. The part of H that is a multiple of 1 has none along X5 and X6: it is
    # taken out first, so that for the functions of Prop. 3.1 nothing is left there, not even rounding.
    H = d.hessian
    rest = times(Symmetric(0.0, H.yy - H.xx, H.zz - H.xx, H.xy, H.xz, H.yz), b1)
    y_dot = Vec3(
        beta * dot(b1, a) - speed * (H.xx + dot(b1, rest)),
        beta * dot(b2, a) - speed * dot(b2, rest),
        beta * dot(b3, a) - speed * dot(b3, rest),
    )

    rho = gains.rho2 if gains.rho2 > gains.rho3 else gains.rho3
    if parameters.allocation != PITCH_YAW:
        gains = Gains(gains.k, ALIGNED_PART * gains.rho2, ALIGNED_PART * gains.rho3, beta)
    turn = global_turn(gains, slowest, y, y_dot) if parameters.law == GLOBAL else paper_turn(gains, y, y_dot)
    u1, u2, u3 = allocate(parameters.allocation, rho, limits.roll_acceleration_rad_s2, turn.u2, turn.u3)
    demanded = Controls(u1, u2, u3, u4)
    u1, u2, u3 = limited_rates(limits, u1, u2, u3, previous, dt)
    controls = Controls(u1, u2, u3, speed)

    V2 = 0.5 * (y.y * y.y + y.z * y.z)
    return Memory(True, controls), Evaluation(
        controls, demanded, e, y.x, y.y, y.z, d.phi, V2, controls != demanded, turn.singular
    )


def evaluate(gains: Gains, limits: Limits, pose: Pose, reference: Reference) -> Evaluation:
    """The paper's law alone: (11) and (14) for phi = 1/2 k |x - r|^2 with u1 = 0, in one pose.

    Without a step before it there is no rate of change to be limited.
    """
    parameters = Parameters(PAPER, PITCH_YAW, gains, phi.PAPER, limits)
    return guide_step(parameters, UNSTARTED, pose, REST, reference, inf)[1]


def planar(pose: Pose, reference: Reference) -> tuple[Pose, Reference]:
    """The SE(2) reading of section 4: yaw rate and forward speed over ground alone.

    The attitude keeps only its heading (`se3.yaw_of`, which also says what it is where b1 is vertical), and
    the reference is put at the vehicle's height with no vertical motion, so that errors live in the
    plane. The law then gives u1 = u2 = 0 (in the pitch-yaw allocation), and u4 is ground speed.
    """
    x = pose.position
    r, r_dot, r_ddot = reference
    return (
        Pose(x, from_yaw(yaw_of(pose.attitude))),
        Reference(Vec3(r.x, r.y, x.z), Vec3(r_dot.x, r_dot.y, 0.0), Vec3(r_ddot.x, r_ddot.y, 0.0)),
    )
