"""Bank and load factor for a wanted acceleration, and how effective a bank is, learned in flight.

Lift L stands at the bank phi to the vertical: its upright part carries and climbs, the other turns:

    L cos(phi) = a_ver        eta L sin(phi) = a_lat        phi = atan2(a_lat/eta, a_ver)        n = L/g

eta is 1 in a coordinated turn; autopilots leave some slip (ArduPlane gave 0.74), and a bank computed without
it turns by too little, always.
"""

from __future__ import annotations

from math import atan, atan2, cos, sqrt, tan
from typing import Final, NamedTuple

from guidance.limits import clamp
from guidance.se3 import Vec3

GRAVITY_M_S2: Final = 9.80665
#: No turn is computed for a steeper bank (rad) than this.
STEEPEST_RAD: Final = 1.3
#: The least part of g that is carried: a bank is never computed for a fall.
CARRIED_MIN: Final = 0.3


class Bank(NamedTuple):
    """Bank, rad to the right, after its limit; the load factor that carries it; whether the limit bit."""

    bank_rad: float
    load: float
    saturated: bool


def bank_for(lateral_m_s2: float, vertical_m_s2: float, effectiveness: float, bank_max_rad: float) -> Bank:
    """The bank that gives these accelerations (to the right; against gravity, g in level flight)."""
    carried = max(vertical_m_s2, CARRIED_MIN * GRAVITY_M_S2)
    wanted = atan2(lateral_m_s2 / effectiveness, carried)
    bank = clamp(wanted, -bank_max_rad, bank_max_rad)
    return Bank(bank, carried / (GRAVITY_M_S2 * cos(bank)), bank != wanted)


def rolled(bank: Bank, before_rad: float, change_rad: float) -> Bank:
    """At most `change_rad` from the one that was asked for before: it rolls no farther meanwhile."""
    near = clamp(bank.bank_rad, before_rad - change_rad, before_rad + change_rad)
    return Bank(near, bank.load * cos(bank.bank_rad) / cos(near), bank.saturated)


def bank_limit(bank_max_rad: float, load: float) -> float:
    """The largest bank (rad) that this load factor carries in level flight, at most `bank_max_rad`; with less
    than a load of 1 it is 0: level first."""
    if load <= 1.0:
        return 0.0
    return min(bank_max_rad, atan(sqrt(load * load - 1.0)))


class Parameters(NamedTuple):
    """eta stays within [`lowest`, `highest`], both > 0, and is learned at `per_s` (0 for not at all).

    Only turns teach it: `excited_m_s2` is the least lateral acceleration by the bank. `lag_s` (> 0) smooths
    what is compared.
    """

    lowest: float
    highest: float
    per_s: float
    excited_m_s2: float
    lag_s: float


class Memory(NamedTuple):
    """eta, and the smoothed velocity (NED) and lateral acceleration by the bank at eta = 1; `started` after
    the first step."""

    effectiveness: float
    north_m_s: float
    east_m_s: float
    banked_m_s2: float
    started: bool


def unlearned(effectiveness: float) -> Memory:
    """Before the first step of a flight, with this start value: 1, or what the last flight learned."""
    return Memory(effectiveness, 0.0, 0.0, 0.0, False)


def effectiveness_step(
    parameters: Parameters,
    memory: Memory,
    velocity_ned_m_s: Vec3,
    wind_ned_m_s: Vec3,
    bank_rad: float,
    vertical_m_s2: float,
    frozen: bool,
    dt_s: float,
) -> Memory:
    """eta `dt_s` later: the turn that was seen over the turn that the bank should have given.

    Velocity over ground and bank of one instant; both sides are smoothed alike, so that the lag cancels.
    `frozen` while a limit bites.
    """
    p = parameters
    north_m_s, east_m_s = velocity_ned_m_s.x, velocity_ned_m_s.y
    banked = vertical_m_s2 * tan(clamp(bank_rad, -STEEPEST_RAD, STEEPEST_RAD))
    if not memory.started:
        return Memory(memory.effectiveness, north_m_s, east_m_s, banked, True)
    part = clamp(dt_s / p.lag_s, 0.0, 1.0)
    north = memory.north_m_s + part * (north_m_s - memory.north_m_s)
    east = memory.east_m_s + part * (east_m_s - memory.east_m_s)
    smooth = memory.banked_m_s2 + part * (banked - memory.banked_m_s2)
    eta = memory.effectiveness
    if not frozen and abs(smooth) >= p.excited_m_s2:
        # (v - smoothed v)/lag is the smoothed acceleration; exact on a ramp with the v before this step
        change_north, change_east = north_m_s - memory.north_m_s, east_m_s - memory.east_m_s
        air_north, air_east = north_m_s - wind_ned_m_s.x, east_m_s - wind_ned_m_s.y
        air = sqrt(air_north * air_north + air_east * air_east)
        if air > 0.0:
            seen = (change_east * air_north - change_north * air_east) / (air * p.lag_s)
            # the step of least squares: a weak turn teaches little
            gain = p.per_s * dt_s * smooth / (smooth * smooth + p.excited_m_s2 * p.excited_m_s2)
            eta = clamp(eta + gain * (seen - eta * smooth), p.lowest, p.highest)
    return Memory(eta, north, east, smooth, True)
