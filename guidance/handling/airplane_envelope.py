"""What an airplane may be asked for: airspeed, climb and height, and the stall guard that goes before all.

In this order, so that the last word is the stall guard's:

1. climb and sink within their limits, and no sink that would pass the floor: towards it at most
   `floor_per_s` times the height above it, below it a climb of as much;
2. no climb that full throttle cannot hold;
3. within `margin_m_s` of the least airspeed the climb fades, and below it the nose goes down: at most level,
   then a sink. Then the throttle is full and the wings are level (`airplane_bank.bank_limit`), whatever the
   path wants. A pull-up is no sharper than what the wing carries at this speed (`airplane_pitch`), as if it
   stalled at `WING_PART` V_min. And the wing is asked for less than that (`unloaded`): a stalled one brakes
   more than full throttle can pull, and stays stalled for as long as the nose follows a path that is steep
   for that reason. Where the wing stalls is known badly, so that the nose goes down the further the longer
   the airplane stays too slow (`pushed_rad`).
"""

from __future__ import annotations

from math import sqrt
from typing import Final, NamedTuple

from guidance.limits import clamp

#: Sine of the path that the guard takes, whatever sink is allowed else, this part below the least airspeed.
DIVE_SINE: Final = 0.4
DIVE_BELOW: Final = 0.15
#: The wing still flies at this part of the least airspeed: what is left for gusts and pull-ups.
WING_PART: Final = 0.9
#: Of what the wing carries at that speed, so much is asked of it there: it stalls no more.
UNLOADED: Final = 0.5
#: For each second below the least airspeed the nose goes down by so much more, rad; so long at most.
PUSH_RAD_S: Final = 0.2
PUSHED_S: Final = 3.0
#: Part of the way down to the least airspeed that is asked for at once.
SOFTLY: Final = 0.5


class Parameters(NamedTuple):
    """Airspeeds are true ones, m/s; V_min is that of level flight, n times the load takes sqrt(n) times it.

    `margin_m_s` (> 0) above V_min is kept for gusts. `climb_max_m_s` and `sink_max_m_s` are > 0;
    `floor_down_m` is the least height, positive down (inf for none).
    """

    airspeed_min_m_s: float
    margin_m_s: float
    airspeed_max_m_s: float
    bank_max_rad: float
    load_max: float
    climb_max_m_s: float
    sink_max_m_s: float
    floor_down_m: float
    floor_per_s: float


class Climb(NamedTuple):
    """Climb, m/s up, after all of the above; whether it was changed, by the floor, and by the stall guard."""

    climb_m_s: float
    limited: bool
    floored: bool
    guarded: bool


def slowest_m_s(parameters: Parameters, load: float) -> float:
    """The least airspeed that is asked for at this load factor; never more than the greatest."""
    p = parameters
    return min(p.airspeed_min_m_s * sqrt(max(load, 1.0)) + p.margin_m_s, p.airspeed_max_m_s)


def missing_within(parameters: Parameters, missing_m_s: float, airspeed_m_s: float, load: float) -> float:
    """How much faster to fly, nearest to `missing_m_s`, for an airspeed within the envelope.

    What the path misses is known over ground, the airspeed from its sensor: gusts are in the second alone.
    The least airspeed is approached by `SOFTLY` of what is left, so that it is not passed.
    """
    p = parameters
    spare = slowest_m_s(p, load) - airspeed_m_s
    if spare < 0.0:
        spare *= SOFTLY
    return clamp(missing_m_s, spare, max(p.airspeed_max_m_s - airspeed_m_s, spare))


def most_load(parameters: Parameters, airspeed_m_s: float, part: float) -> float:
    """The load factor that the wing may carry at this airspeed, (V/(part V_min))^2 and `load_max` at most."""
    ratio = airspeed_m_s / (part * parameters.airspeed_min_m_s)
    return min(parameters.load_max, ratio * ratio)


def unloaded(parameters: Parameters, airspeed_m_s: float, load: float) -> float:
    """The load factor to choose the angle of attack by: from the least airspeed down, less of it."""
    ratio = airspeed_m_s / parameters.airspeed_min_m_s
    if ratio >= 1.0:
        return load
    part = 1.0 - (1.0 - UNLOADED) * min((1.0 - ratio) / DIVE_BELOW, 1.0)
    return min(load, part * ratio * ratio)


def slow_step(parameters: Parameters, slow_s: float, airspeed_m_s: float, dt_s: float) -> float:
    """For how long it has been slower than the least airspeed, s; above it that is forgotten as quickly."""
    slow_s += dt_s if stalling(parameters, airspeed_m_s) else -dt_s
    return clamp(slow_s, 0.0, PUSHED_S)


def pushed_rad(slow_s: float) -> float:
    """How far the nose is pushed down after that."""
    return PUSH_RAD_S * slow_s


def stalling(parameters: Parameters, airspeed_m_s: float) -> bool:
    """Slower than the least airspeed of level flight: full throttle."""
    return airspeed_m_s < parameters.airspeed_min_m_s


def climb_within(
    parameters: Parameters, wanted_m_s: float, airspeed_m_s: float, down_m: float, held_m_s: float
) -> Climb:
    """The climb that may be asked for at this airspeed and height; full throttle holds `held_m_s`."""
    p = parameters
    floor = p.floor_per_s * (down_m - p.floor_down_m)
    lowest = clamp(floor, -p.sink_max_m_s, p.climb_max_m_s)
    climb = clamp(wanted_m_s, lowest, p.climb_max_m_s)
    floored = floor > -p.sink_max_m_s and wanted_m_s < lowest
    climb = min(climb, max(held_m_s, -p.sink_max_m_s))
    spare = airspeed_m_s - p.airspeed_min_m_s
    if spare > 0.0:
        guard = p.climb_max_m_s * spare / p.margin_m_s
    else:
        guard = DIVE_SINE * airspeed_m_s * max(spare / (DIVE_BELOW * p.airspeed_min_m_s), -1.0)
    guarded = climb > guard
    if guarded:
        climb = guard
    return Climb(climb, climb != wanted_m_s, floored, guarded)
