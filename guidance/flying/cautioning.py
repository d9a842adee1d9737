"""What no flight is refused for and must be known before it, of whatever class of vehicle."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final

from guidance.abilities import NEEDS, Abilities
from guidance.flying import Caution
from guidance.instants import looked_at
from guidance.se3 import ZERO, Vec3
from guidance.shortfall import shortfalls
from guidance.trajectory import Trajectory

#: A limit that is needed to within this part of it leaves nothing to catch up with: a rover on a circle at
#: the whole of its WP_SPEED stayed 0.4 m behind.
ROOM: Final = 0.05
#: An estimator's height is off by less.
_HEIGHT_M: Final = 1.0


def about_the_way(
    trajectory: Trajectory, abilities: Abilities, wind_ned_m_s: Vec3 = ZERO
) -> tuple[Caution, ...]:
    """Where the reference waits for the wind, runs away at a corner, or leaves little room to catch up."""
    found = []
    for short in shortfalls(trajectory, abilities, wind_ned_m_s):
        if not short.refuses:
            found.append(Caution(short.kind.what, short.text))
    tight = (short for short in shortfalls(trajectory, _less(abilities), wind_ned_m_s) if short.refuses)
    found += [Caution("room", f"little room to catch up: {short.text}") for short in tight][:1]
    return tuple(found)


def about_the_ground(
    trajectory: Trajectory, origin_ned_m: Vec3, ground_down_m: float | None
) -> tuple[Caution, ...]:
    """For what flies and keeps above no floor by itself."""
    if ground_down_m is None:
        text = (
            "where the ground is is not known (HOME_POSITION): nothing says that the trajectory is above it"
        )
        return (Caution("ground", f"{text}; guards.fence_down_max_m would"),)
    time_s, lowest_m = _lowest(trajectory)
    deep_m = origin_ned_m.z + lowest_m - ground_down_m
    if deep_m < _HEIGHT_M:
        return ()
    return (Caution("ground", f"the trajectory is {deep_m:.0f} m below home at t = {time_s:.3g} s"),)


def about_parameters(taken: str) -> tuple[Caution, ...]:
    """`taken` are names and values, empty if all are known."""
    return (Caution("parameters", f"not told by the autopilot, and taken to be: {taken}"),) if taken else ()


@lru_cache(maxsize=4)
def _lowest(trajectory: Trajectory) -> tuple[float, float]:
    """When, s, and how far below the origin, m."""
    lowest = max(looked_at(trajectory).instants, key=lambda instant: instant.position.z)
    return lowest.time_s, lowest.position.z


def _less(abilities: Abilities) -> Abilities:
    """With `ROOM` kept of every limit but those that are a least."""
    kinds = NEEDS[type(abilities)].kinds
    held: dict[str, Any] = {
        name: getattr(abilities, name).less(ROOM)
        for name, kind in zip(abilities._fields, kinds, strict=False)
        if not kind.is_least
    }
    return abilities._replace(**held)
