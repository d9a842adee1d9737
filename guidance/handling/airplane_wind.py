"""The wind that an airplane flies in: from the autopilot, or from its own airspeed and heading.

An airspeed says how long v - w is, and so corrects w along the air's direction; in a turn that direction
comes round, and both parts of w become known without any heading. A heading corrects w across, where its
bias (1 to 2 degrees: 0.3 m/s at 10 m/s, and around the circle zero on average) makes it the weaker witness;
it is followed more slowly. Where nothing else tells of the wind any more it is the only one left, in turns
enough; where nothing else ever did, it is followed as fast as an airspeed would be. Straight on, the wind
along stays unknown then. The vertical wind is taken as
zero: nothing measures it.
"""

from __future__ import annotations

from math import cos, sin, sqrt
from typing import Final, NamedTuple

from guidance.limits import clamp
from guidance.se3 import Vec3


class Parameters(NamedTuple):
    """Rates (1/s) at which the estimate follows an airspeed, a heading and the autopilot's own estimate; the
    estimate's length is bounded."""

    along_per_s: float
    across_per_s: float
    given_per_s: float
    wind_max_m_s: float


class Memory(NamedTuple):
    """The estimate, NED, m/s, as it stands; `known` once an airspeed or the autopilot told of it."""

    north_m_s: float
    east_m_s: float
    known: bool


#: An airspeed that is further than this part from |v - w|, and this much (m/s), is not believed.
DOUBTED_PART: Final = 0.3
DOUBTED_M_S: Final = 3.0
#: Of the strongest wind that is flown with; from here on the estimate counts as bounded.
AT_BOUND_PART: Final = 0.98
#: A given wind that is off by more than this part of the airspeed is outvoted: a compass is 20 degrees wrong
#: at most, a third of it.
OUTVOTED_PART: Final = 0.5

UNKNOWN: Final = Memory(0.0, 0.0, False)


def believed_m_s(memory: Memory, velocity_ned_m_s: Vec3, airspeed_m_s: float, wind_max_m_s: float) -> float:
    """The airspeed, or 0 if there is none or it does not fit the wind that is known: its sensor is blocked,
    or jumps. No gust is so strong, and no wind changes so quickly that the estimate does not follow.

    Where the estimate is at its bound it is the wind that is doubted: it may be stronger.
    """
    at_bound = memory.north_m_s * memory.north_m_s + memory.east_m_s * memory.east_m_s >= (
        AT_BOUND_PART * AT_BOUND_PART * wind_max_m_s * wind_max_m_s
    )
    if not memory.known or at_bound:
        return airspeed_m_s
    north, east = velocity_ned_m_s.x - memory.north_m_s, velocity_ned_m_s.y - memory.east_m_s
    air = sqrt(north * north + east * east + velocity_ned_m_s.z * velocity_ned_m_s.z)
    return airspeed_m_s if abs(airspeed_m_s - air) <= max(DOUBTED_M_S, DOUBTED_PART * air) else 0.0


def wind_step(
    parameters: Parameters,
    memory: Memory,
    velocity_ned_m_s: Vec3,
    heading_rad: float,
    airspeed_m_s: float,
    given: bool,
    given_ned_m_s: Vec3,
    dt_s: float,
) -> Memory:
    """The estimate `dt_s` later. With `given` it follows the autopilot's; else, with an airspeed above 0, its
    own; else what the heading alone tells, slowly once it is known. What comes first is taken as it is.

    An airspeed that fits the estimate, with its heading, outvotes a given wind that is too far from theirs.
    """
    north, east, known = memory
    if given and known and airspeed_m_s > 0.0:
        off_north = velocity_ned_m_s.x - airspeed_m_s * cos(heading_rad) - given_ned_m_s.x
        off_east = velocity_ned_m_s.y - airspeed_m_s * sin(heading_rad) - given_ned_m_s.y
        off = sqrt(off_north * off_north + off_east * off_east)
        given = off <= max(DOUBTED_M_S, OUTVOTED_PART * airspeed_m_s)
    if given:
        part = clamp(parameters.given_per_s * dt_s, 0.0, 1.0) if known else 1.0
        north += part * (given_ned_m_s.x - north)
        east += part * (given_ned_m_s.y - east)
        known = True
    elif airspeed_m_s > 0.0:
        level2 = airspeed_m_s * airspeed_m_s - velocity_ned_m_s.z * velocity_ned_m_s.z
        level = sqrt(max(level2, 0.0))
        if not known:
            north = velocity_ned_m_s.x - level * cos(heading_rad)
            east = velocity_ned_m_s.y - level * sin(heading_rad)
            known = True
        air_north, air_east = velocity_ned_m_s.x - north, velocity_ned_m_s.y - east
        air = sqrt(air_north * air_north + air_east * air_east)
        if air > 0.0:
            c, s = air_north / air, air_east / air
            # v - w is too long by this much, and turned from the heading to the right by this much
            long = air - level
            turned = air * (cos(heading_rad) * s - sin(heading_rad) * c)
            along = clamp(parameters.along_per_s * dt_s, 0.0, 1.0) * long
            across = clamp(parameters.across_per_s * dt_s, 0.0, 1.0) * turned
            north += along * c - across * s
            east += along * s + across * c
    else:
        c, s = cos(heading_rad), sin(heading_rad)
        # v - w has this much across the nose, to the right
        across = (velocity_ned_m_s.y - east) * c - (velocity_ned_m_s.x - north) * s
        rate = parameters.across_per_s if known else parameters.along_per_s
        across *= clamp(rate * dt_s, 0.0, 1.0)
        north -= across * s
        east += across * c
    length = sqrt(north * north + east * east)
    if length > parameters.wind_max_m_s:
        north *= parameters.wind_max_m_s / length
        east *= parameters.wind_max_m_s / length
    return Memory(north, east, known)
