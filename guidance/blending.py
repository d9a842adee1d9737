"""How the reference goes along with a jump of the autopilot's estimator, and how it comes back.

The vehicle has not moved when its estimator jumps by D, only its coordinates have. So the reference is moved
by D too, at the same instant: the error x - r is as before, and no setpoint shows the jump. What is tracked
then is r + d with d = D, and d has to fall to zero again, as slowly as the vehicle can follow:

    tau^2 d''' + 2 tau d'' + d' = w(d),     w(d) = -V kappa d / sqrt(V^2 + kappa^2 |d|^2)

(the field of a bounded error function, behind a critically damped filter). d' and d'' are part of the r' and
r'' that the law is given. What follows, for every sequence of jumps, because a jump changes d alone and
|w| <= V whatever d is:

    |d'| <= V        |d''| <= 2 V/(e tau)        |d'''| <= 4 V/tau^2

(the filter's impulse response t e^(-t/tau)/tau^2 is positive, with integral 1). With kappa tau = 4/27 the
poles close to d = 0 are -1/(3 tau), twice, and -4/(3 tau): it does not overshoot. Jumps add up, and one that
is taken back leaves only what had been worked off in between.

V is half of what the reference leaves (`spare_speed_m_s`), so that r + d is as feasible as r; where r leaves
nothing, or stands, d stays. The trajectory's coordinates hold, wherever its origin came from: nobody can know
whether the frame was right before the jump or is now, and of a glitch that passes nothing must be left.

A turn of the heading is another matter: the new one is what the vehicle steers by, and flying by the old one
leads astray. It is let in within a second (`turn_step`), so that the rates change quickly and do not jump.
"""

from __future__ import annotations

from math import exp, inf, sqrt
from typing import Final, NamedTuple

from guidance.se3 import ZERO, Reference, Vec3, add, dot, norm, scale

#: kappa tau: the fastest without an overshoot.
_KAPPA_TAU: Final = 4.0 / 27.0
#: 2/e, of |d''| <= 2 V/(e tau).
_PEAK: Final = 2.0 * exp(-1.0)
#: tau is at least this: many setpoints, at any rate that flies.
LEAST_TIME_S: Final = 0.4
#: 1/e of a turn is left after 2.1 of these, 1 % after 6.6.
TURN_TIME_S: Final = 0.15
#: What is left of an offset when it is dropped: m, m/s and m/s^2; rad and rad/s.
_NOTHING: Final = 1e-6

#: Nothing to blend. An offset is a `Reference` too: d, d', d''.
NO_OFFSET: Final = Reference(ZERO, ZERO, ZERO)


class Blending(NamedTuple):
    """What the vehicle can do, and tau in s; inf is no limit.

    `turn_rate_rad_s` > 0 is the slowest of the rates that turn b1, `approach_m_s` what the error function
    allows at most.
    """

    speed_min_m_s: float
    speed_max_m_s: float
    turn_rate_rad_s: float
    acceleration_m_s2: float
    approach_m_s: float
    time_s: float


def blending(
    speed_min_m_s: float,
    speed_max_m_s: float,
    turn_rate_rad_s: float,
    acceleration_m_s2: float = inf,
    turn_acceleration_rad_s2: float = inf,
    approach_m_s: float = inf,
) -> Blending:
    """With tau so long that neither the turns nor the changes of the rates that d asks for reach the limits.

    At a speed of at least V beside d', d'' turns the reference by 2/(e tau) rad/s and d''' changes that by
    4/tau^2.
    """
    time_s = max(1.0 / turn_rate_rad_s, 2.0 / sqrt(turn_acceleration_rad_s2), LEAST_TIME_S)
    return Blending(speed_min_m_s, speed_max_m_s, turn_rate_rad_s, acceleration_m_s2, approach_m_s, time_s)


def spare_speed_m_s(blending: Blending, reference: Reference) -> float:
    """V: half of what keeps r' + d' within the speeds and its turns and accelerations within theirs."""
    speed, bend = norm(reference.velocity), norm(reference.acceleration)
    if speed <= 0.0:
        return 0.0
    # d' turns r' by at most V/speed, which brings so much of r'' along the path; d'' comes on top.
    along = abs(dot(reference.velocity, reference.acceleration)) / speed
    spare = min(
        blending.speed_max_m_s - speed,
        speed - blending.speed_min_m_s,
        speed - bend / blending.turn_rate_rad_s,
        (blending.acceleration_m_s2 - along) / (bend / speed + _PEAK / blending.time_s),
        2.0 * blending.approach_m_s,
    )
    return max(0.5 * spare, 0.0)


def shifted(offset: Reference, jump_m: Vec3) -> Reference:
    """The estimator jumped by so much (m): so does d, and neither d' nor d''."""
    return offset._replace(position=add(offset.position, jump_m))


def blended(reference: Reference, offset: Reference) -> Reference:
    """r + d, r' + d', r'' + d''."""
    return Reference(
        add(reference.position, offset.position),
        add(reference.velocity, offset.velocity),
        add(reference.acceleration, offset.acceleration),
    )


def offset_step(blending: Blending, offset: Reference, spare_m_s: float, dt: float) -> Reference:
    """The offset `dt` s (>= 0) later, where w is held for the step and the filter is solved exactly.

    So the bounds hold for any steps. Of one longer than tau only tau counts: the offset waits.
    """
    d, v, a = offset
    if norm(d) < _NOTHING and norm(v) < _NOTHING and norm(a) < _NOTHING:
        return NO_OFFSET
    tau = blending.time_s
    t = min(dt, tau)
    w = _towards_zero(d, spare_m_s, _KAPPA_TAU / tau)
    left = exp(-t / tau)
    # Of y = d' - w: y(t) = (y + c t) left with c = y' + y/tau
    y = Vec3(v.x - w.x, v.y - w.y, v.z - w.z)
    c = add(a, scale(1.0 / tau, y))
    of_y, of_c = tau * (1.0 - left), tau * (tau * (1.0 - left) - t * left)
    return Reference(
        add(d, add(scale(t, w), add(scale(of_y, y), scale(of_c, c)))),
        add(w, scale(left, add(y, scale(t, c)))),
        scale(left, add(a, scale(-t / tau, c))),
    )


def _towards_zero(d: Vec3, speed: float, kappa: float) -> Vec3:
    if speed <= 0.0:
        return ZERO
    return scale(-speed * kappa / sqrt(speed * speed + kappa * kappa * dot(d, d)), d)


class Turn(NamedTuple):
    """The rotation (vector in the world, rad) still kept from the law, and its rate of change (rad/s)."""

    angle_rad: Vec3
    rate_rad_s: Vec3


NO_TURN: Final = Turn(ZERO, ZERO)


def turn_step(turn: Turn, dt: float) -> Turn:
    """`dt` s (>= 0) later: critically damped, angle and rate are both continuous."""
    angle, rate = turn
    if norm(angle) < _NOTHING and norm(rate) < _NOTHING:
        return NO_TURN
    left = exp(-dt / TURN_TIME_S)
    c = add(rate, scale(1.0 / TURN_TIME_S, angle))
    return Turn(scale(left, add(angle, scale(dt, c))), scale(left, add(rate, scale(-dt / TURN_TIME_S, c))))
