"""Whether an airplane can fly a trajectory at all: bank, airspeed, climb and power, with the numbers.

In still air: what the wind takes is the waiting clock's, and the guards'. `feasibility` knows only speeds and
rates of [limits]; here is what the airframe and the autopilot's own limits leave.
"""

from __future__ import annotations

from functools import lru_cache
from math import atan, cos, degrees, hypot, sqrt, tan
from typing import Final, NamedTuple

from guidance.handling import airplane, airplane_throttle
from guidance.handling.airplane_bank import GRAVITY_M_S2
from guidance.instants import INSTANTS
from guidance.trajectory import Trajectory, sample

#: Of the turn at the steepest bank, what a trajectory may take; the rest is for errors and gusts.
BANK_PART: Final = 0.9


class _Moment(NamedTuple):
    """A trajectory at one of its instants: speeds and the acceleration across, level, its size."""

    t_s: float
    speed_m_s: float
    climb_m_s: float
    across_m_s2: float


@lru_cache(maxsize=16)
def _moments(trajectory: Trajectory) -> tuple[_Moment, ...]:
    found = []
    for i in range(INSTANTS):
        t_s = trajectory.cycle_s / INSTANTS * i
        r = sample(trajectory, t_s)
        v, a = r.velocity, r.acceleration
        level = hypot(v.x, v.y)
        across = abs(v.x * a.y - v.y * a.x) / level if level > 0.0 else 0.0
        found.append(_Moment(t_s, hypot(level, v.z), -v.z, across))
    return tuple(found)


def cannot_fly(trajectory: Trajectory, p: airplane.Parameters, trims: airplane.Trims) -> str | None:
    """Where the trajectory first asks for more than the airplane has, by how much, and what would do."""
    envelope = p.envelope
    most = BANK_PART * trims.effectiveness * GRAVITY_M_S2 * tan(envelope.bank_max_rad)
    for at in _moments(trajectory):
        where = f"the trajectory, {at.t_s:.1f} s after its start,"
        bank = atan(at.across_m_s2 / (trims.effectiveness * GRAVITY_M_S2))
        if at.across_m_s2 > most:
            steepest = atan(BANK_PART * tan(envelope.bank_max_rad))
            radius = at.speed_m_s * at.speed_m_s / at.across_m_s2
            return (
                f"{where} takes a bank of {degrees(bank):.0f} deg, and with the limit of "
                f"{degrees(envelope.bank_max_rad):.0f} it may take {degrees(steepest):.0f}: fly it at "
                f"{sqrt(most * radius):.3g} m/s at most, or with a radius of "
                f"{at.speed_m_s * at.speed_m_s / most:.3g} m and more"
            )
        load = 1.0 / cos(bank)
        slowest = envelope.airspeed_min_m_s * sqrt(load)
        if at.speed_m_s < slowest:
            return (
                f"{where} is at {at.speed_m_s:.3g} m/s, and the least airspeed at a load of {load:.2f} is "
                f"{slowest:.3g}: fly it faster, or wider"
            )
        if at.speed_m_s > envelope.airspeed_max_m_s:
            return f"{where} is at {at.speed_m_s:.3g} m/s: {envelope.airspeed_max_m_s:.3g} at most"
        if not -envelope.sink_max_m_s <= at.climb_m_s <= envelope.climb_max_m_s:
            return (
                f"{where} climbs at {at.climb_m_s:.3g} m/s: must be from {-envelope.sink_max_m_s:.3g} to "
                f"{envelope.climb_max_m_s:.3g}"
            )
        powered = airplane_throttle.fastest_m_s(p.throttle, trims.throttle, load, at.climb_m_s)
        if at.speed_m_s > powered:
            return (
                f"{where} is at {at.speed_m_s:.3g} m/s in a climb of {at.climb_m_s:.3g} m/s, and full "
                f"throttle holds {powered:.3g} there"
            )
    return None
