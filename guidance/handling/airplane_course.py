"""Where an airplane is to go: course, climb and their rates from the field, and the turn to get there.

The rates of (11) turn the velocity, not the nose, and not by the shortest arc: that may be a loop. So the
field is read as an airplane flies it, level direction and climb apart. The level turn is

    chi' = max(0, cos(chi_w - chi)) chi_w' + rho (chi_w - chi)

with the field's own turn faded out where it is of no use yet, and the second term at most what the roll rate
can still end in time (`limits.stoppable`). Beyond `LATCHED_RAD` off the side to turn to is kept, as long as
that lasts: about the opposite course noise would choose it anew at every step.
"""

from __future__ import annotations

from math import atan2, copysign, cos, pi, sqrt, tau
from typing import Final, NamedTuple

from guidance.limits import clamp, stoppable
from guidance.se3 import Vec3

#: More than this off the wanted course the side is kept.
LATCHED_RAD: Final = 2.6
#: A field that is slower than this (m/s) has no direction that an airplane could follow.
FIELD_MIN_M_S: Final = 0.5


class Wanted(NamedTuple):
    """The field's level speed (m/s) and course (rad from north to the east), its climb (m/s, up), and how
    fast these change: m/s^2, rad/s, m/s^2."""

    speed_m_s: float
    course_rad: float
    climb_m_s: float
    acceleration_m_s2: float
    course_rate_rad_s: float
    climb_rate_m_s2: float


class Turn(NamedTuple):
    """Course rate that is asked for, rad/s; how far the course is off, rad, by the side that is turned to;
    the side (1 right, -1 left) that is latched, or 0; how much the feed-forward counts, 0 to 1; whether the
    rate was limited."""

    course_rate_rad_s: float
    off_rad: float
    side: int
    aligned: float
    saturated: bool


def wanted_of(Xr: Vec3, Xr_dot: Vec3, course_rad: float) -> Wanted:
    """The field as an airplane flies it. One too slow to have a direction keeps the course, `course_rad`."""
    speed = sqrt(Xr.x * Xr.x + Xr.y * Xr.y)
    if speed < FIELD_MIN_M_S:
        return Wanted(speed, course_rad, -Xr.z, 0.0, 0.0, -Xr_dot.z)
    return Wanted(
        speed,
        atan2(Xr.y, Xr.x),
        -Xr.z,
        (Xr.x * Xr_dot.x + Xr.y * Xr_dot.y) / speed,
        (Xr.x * Xr_dot.y - Xr.y * Xr_dot.x) / (speed * speed),
        -Xr_dot.z,
    )


def wrapped(angle_rad: float) -> float:
    """The same direction in [-pi, pi]."""
    while angle_rad > pi:
        angle_rad -= tau
    while angle_rad < -pi:
        angle_rad += tau
    return angle_rad


def turn_to(
    rho_per_s: float,
    turn_acceleration_rad_s2: float,
    rate_max_rad_s: float,
    side: int,
    wanted: Wanted,
    course_rad: float,
    bank_rad: float,
) -> Turn:
    """The turn from `course_rad` to the wanted course; `side` as the step before left it.

    `turn_acceleration_rad_s2` is how fast the turn can change, by rolling; `rate_max_rad_s` bounds it. A new
    side is the one to which the airplane banks already, if it banks, and else the shorter way.
    """
    off = wrapped(wanted.course_rad - course_rad)
    if abs(off) <= LATCHED_RAD:
        side = 0
    elif side == 0:
        side = 1 if (bank_rad if abs(bank_rad) > 0.1 else off) > 0.0 else -1
    if side != 0 and off * side < 0.0:
        off += tau * side
    aligned = max(0.0, cos(off))
    back = copysign(stoppable(rho_per_s * abs(off), abs(off), turn_acceleration_rad_s2), off)
    asked = aligned * wanted.course_rate_rad_s + back
    rate = clamp(asked, -rate_max_rad_s, rate_max_rad_s)
    return Turn(rate, off, side, aligned, rate != asked)
