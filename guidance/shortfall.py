"""What of a trajectory a vehicle cannot fly: where, how much, and what it could.

For the configuration, with the limits of the file; and before engaging, with those of the autopilot and the
wind. What is needed is looked for once for a trajectory and a wind (rounded), so that other limits cost
nothing; what is found for all of them together is kept as well.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise
from math import ceil, degrees, floor, inf, isnan, log10, nan, sqrt
from typing import Final, NamedTuple

import msgspec

from guidance.abilities import (
    NEEDS,
    Abilities,
    AirplaneAbilities,
    Bound,
    Kind,
    Needs,
    angle_rad,
    turning_s,
)
from guidance.instants import Instant, level_m_s, level_turn_rad_s, looked_at
from guidance.se3 import ZERO, Vec3, norm, subtract
from guidance.trajectory import Lemniscate, Trajectory, sample

#: Winds are told apart by so much, each component, m/s.
WIND_STEP_M_S: Final = 0.5
#: And the effectiveness of a bank by so much.
EFFECTIVENESS_STEP: Final = 0.01
#: Limits that are met exactly are met.
_ROUNDING: Final = 1e-9
#: What would be feasible is looked for between this and 1, and between 1 and its inverse.
_LEAST_FACTOR: Final = 1e-3
_BISECTIONS: Final = 40


class Shortfall(NamedTuple):
    """One need that is not met, where it is worst. SI units, angles in rad; NaN where there is no such thing.

    Two are no reason to refuse: a corner, which no vehicle flies and who plans it knows (`needed` is its
    angle, `off_m` about how far a reference that does not wait runs away meanwhile); and an airspeed in a
    wind for which the reference can wait or hasten, at `pace` of its speed there, and for
    `waits_s` of a cycle.

    What would be feasible there: `speed_m_s`, over ground, at most this (of `is_least`: at least), or
    `radius_m`, of the turn, at least this at the planned speed; each without harm to what is met now. If it
    is only the stop that asks too much, `over_s` is how long to take for it, inf not to stop. `instead` is
    another trajectory of this shape that does not ask for it.
    """

    kind: Kind
    time_s: float
    position: Vec3
    needed: float
    available: float
    source: str
    speed_m_s: float = nan
    radius_m: float = nan
    over_s: float = nan
    off_m: float = nan
    pace: float = nan
    waits_s: float = nan
    instead: str = ""

    @property
    def refuses(self) -> bool:
        """Whether this cannot be flown; otherwise it is a warning."""
        return isnan(self.off_m) and isnan(self.pace)

    @property
    def text(self) -> str:
        """One line, without a full stop."""
        k, p = self.kind, self.position
        at = f"at t = {self.time_s:.3g} s (north {_place(p.x)} m, east {_place(p.y)} m)"
        source = f" ({self.source})" if self.source else ""
        if k is _CORNER:
            turn = f"{degrees(self.needed):.3g} deg"
            return f"{k.what}: {turn} at once {at}: the reference runs away by {self.off_m:.2g} m or more"
        if k is _HEIGHT:
            deep_m = self.needed - self.available
            floor_m = f"{self.available:.5g} m below the origin"
            return (
                f"{k.what}: sinks to the floor{source}, {floor_m}, {at}, and {deep_m:.3g} m below it: "
                f"start at least {_upward(deep_m):g} m higher"
            )
        least = "at least " if k.is_least else ""
        needed, available = _shown(k, self.needed, 3), _shown(k, self.available, 5)
        text = f"{k.what}: {needed} needed {at}, {least}{available} available{source}"
        return ": ".join((text, *self._advice()))

    def _advice(self) -> tuple[str, ...]:
        if not isnan(self.pace):
            for_s = f"for {self.waits_s:.2g} s of each round"
            return (f"the reference runs at {self.pace:.2g} of its speed there, and off its plan {for_s}",)
        if self.over_s == inf:
            return ("leave out trajectory.stop_at_s",)
        if not isnan(self.over_s):
            return (f"take at least {_upward(self.over_s):g} s to stop (trajectory.stop_over_s)",)
        could = []
        if not isnan(self.speed_m_s):
            bound = (
                f"at least {_upward(self.speed_m_s):g}"
                if self.kind.is_least
                else f"at most {_downward(self.speed_m_s):g}"
            )
            could.append(f"fly {bound} m/s there")
        if not isnan(self.radius_m):
            could.append(f"a radius of at least {_upward(self.radius_m):g} m")
        if self.instead:
            could.append(self.instead)
        return (", or ".join(could),) if could else ()


_CORNER: Final = Kind("corner", "deg")
_HEIGHT: Final = Kind("height", "m")


class _Air(NamedTuple):
    """What else needs depend on: the wind, NED, and the effectiveness of a bank."""

    wind_ned_m_s: Vec3
    effectiveness: float


def shortfalls(
    trajectory: Trajectory, abilities: Abilities, wind_ned_m_s: Vec3 = ZERO
) -> tuple[Shortfall, ...]:
    """Everything that is needed and not available, in the order of the abilities, corners last.

    The wind is steady, of the air over ground; only airplanes mind it.
    """
    air = _Air(ZERO, 1.0)
    if isinstance(abilities, AirplaneAbilities):
        wind = Vec3(*(WIND_STEP_M_S * round(part / WIND_STEP_M_S) for part in wind_ned_m_s))
        steps = max(round(abilities.effectiveness / EFFECTIVENESS_STEP), 1)
        air = _Air(wind, EFFECTIVENESS_STEP * steps)
    return _shortfalls(trajectory, abilities, air)


def needed(trajectory: Trajectory, vehicle: type[Abilities]) -> tuple[float, ...]:
    """In calm air, the value of each of this class's `Kind`s that is hardest to meet."""
    return tuple(value for value, _ in _worst(trajectory, NEEDS[vehicle], _Air(ZERO, 1.0)))


@lru_cache(maxsize=16)
def _shortfalls(trajectory: Trajectory, abilities: Abilities, air: _Air) -> tuple[Shortfall, ...]:
    needs = NEEDS[type(abilities)]
    bounds = tuple(bound for bound in abilities if isinstance(bound, Bound))[: len(needs.kinds)]
    limits = tuple(bound.value for bound in bounds)
    unstopped = msgspec.structs.replace(trajectory, stop_at_s=0.0)
    found = []
    for n, (value, at) in enumerate(_worst(trajectory, needs, air)):
        kind, bound = needs.kinds[n], bounds[n]
        if _met(kind, value, bound.value):
            continue
        shortfall = Shortfall(kind, at.time_s, at.position, value, bound.value, bound.source)
        if kind.is_least and isinstance(trajectory, Lemniscate):
            shortfall = shortfall._replace(instead='"eight", which keeps its speed')
        if trajectory != unstopped and _met(kind, _worst(unstopped, needs, air)[n][0], bound.value):
            slower = inf if kind.is_least else value / bound.value
            found.append(shortfall._replace(over_s=slower * trajectory.stop_over_s))
            continue
        speed, radius = _feasible(needs, n, at, limits, air)
        shortfall = shortfall._replace(speed_m_s=speed, radius_m=radius)
        if kind.windy and isinstance(abilities, AirplaneAbilities):
            calm = needs.of(at, ZERO, air.effectiveness)[n]
            pace = speed / needs.speed_m_s(at.velocity)
            if _met(kind, calm, bound.value) and abilities.clock_least <= pace <= abilities.clock_most:
                waits_s = _unmet_s(trajectory, needs, n, bound.value, air)
                shortfall = shortfall._replace(pace=pace, waits_s=waits_s)
        found.append(shortfall)
    if isinstance(abilities, AirplaneAbilities):
        found += _too_low(trajectory, abilities.floor_down_m)
    return (*found, *_corner(trajectory, abilities))


@lru_cache(maxsize=32)
def _worst(trajectory: Trajectory, needs: Needs, air: _Air) -> tuple[tuple[float, Instant], ...]:
    """Of each kind the value that is hardest to meet, and where first: of the trajectory, whatever the
    limits."""
    instants = looked_at(trajectory).instants
    rows = [needs.of(instant, *air) for instant in instants]
    worst = []
    for n, kind in enumerate(needs.kinds):
        column = [row[n] for row in rows]
        value = min(column) if kind.is_least else max(column)
        alike = _ROUNDING * abs(value)
        first = next(i for i, other in enumerate(column) if abs(other - value) <= alike or other == value)
        worst.append((value, instants[first]))
    return tuple(worst)


def _unmet_s(trajectory: Trajectory, needs: Needs, n: int, available: float, air: _Air) -> float:
    """How long of a cycle the need `n` is not met."""
    kind, instants = needs.kinds[n], looked_at(trajectory).instants
    return sum(
        after.time_s - before.time_s
        for before, after in pairwise(instants)
        if after.time_s <= trajectory.cycle_s and not _met(kind, needs.of(before, *air)[n], available)
    )


def _met(kind: Kind, value: float, available: float) -> bool:
    if available in (inf, -inf):
        return True
    if kind.is_least:
        return value >= available - _ROUNDING * abs(available)
    return value <= available + _ROUNDING * abs(available)


def _feasible(needs: Needs, n: int, at: Instant, limits: tuple[float, ...], air: _Air) -> tuple[float, float]:
    """Speed (m/s) and radius (m) that would meet the need `n` at this instant; NaN where none would."""
    kind = needs.kinds[n]

    def met(changed: Instant) -> list[bool]:
        return [_met(*each) for each in zip(needs.kinds, needs.of(changed, *air), limits, strict=True)]

    met_now = met(at)

    def harmless(changed: Instant) -> bool:
        return all(then or not now for now, then in zip(met_now, met(changed), strict=True))

    speed = radius = nan
    if kind.paced:
        end = 1.0 / _LEAST_FACTOR if kind.is_least else _LEAST_FACTOR
        pace = _nearest(lambda factor: met(at.slower(factor))[n], end)
        if not isnan(pace) and harmless(at.slower(pace)):
            speed = pace * needs.speed_m_s(at.velocity)
    turn = abs(level_turn_rad_s(at.velocity, at.acceleration))
    if turn > 0.0:
        wider = _nearest(lambda factor: met(at.wider(factor))[n], 1.0 / _LEAST_FACTOR)
        if not isnan(wider) and harmless(at.wider(wider)):
            radius = wider * level_m_s(at.velocity) / turn
    return speed, radius


def _nearest(feasible: Callable[[float], bool], end: float) -> float:
    """The factor nearest to 1, between it and `end`, that is feasible; NaN if not even `end` is."""
    if not feasible(end):
        return nan
    bad, good = 1.0, end
    for _ in range(_BISECTIONS):
        middle = sqrt(bad * good)
        if feasible(middle):
            good = middle
        else:
            bad = middle
    return good


def _too_low(trajectory: Trajectory, bound: Bound) -> list[Shortfall]:
    instants = looked_at(trajectory).instants
    lowest = max(instant.position.z for instant in instants)
    if lowest <= bound.value + _ROUNDING * abs(bound.value):
        return []
    first = next(n for n, instant in enumerate(instants) if instant.position.z > bound.value)
    below_s = above_s = instants[first].time_s
    if first > 0:
        above_s = instants[first - 1].time_s
    for _ in range(_BISECTIONS):
        middle_s = 0.5 * (above_s + below_s)
        if sample(trajectory, middle_s).position.z > bound.value:
            below_s = middle_s
        else:
            above_s = middle_s
    place = sample(trajectory, below_s).position
    return [Shortfall(_HEIGHT, below_s, place, lowest, bound.value, bound.source)]


def _corner(trajectory: Trajectory, abilities: Abilities) -> list[Shortfall]:
    """The corner that leaves the vehicle farthest off; its velocity changes evenly in `turning_s`."""
    found = []
    for corner in looked_at(trajectory).corners:
        before, after = corner.before, corner.after
        off_m = 0.5 * norm(subtract(after, before)) * turning_s(abilities, before, after)
        if off_m > 0.0:
            angle = angle_rad(before, after)
            found.append(Shortfall(_CORNER, corner.time_s, corner.position, angle, 0.0, "", off_m=off_m))
    return [max(found, key=lambda shortfall: shortfall.off_m)] if found else []


def _place(value_m: float) -> str:
    """To the centimetre, and no -0."""
    return f"{round(value_m, 2) + 0.0:.4g}"


def _shown(kind: Kind, value: float, digits: int) -> str:
    if kind.unit in ("deg", "deg/s"):
        value = degrees(value)
    return f"{value:.{digits}g} {kind.unit}".rstrip()


def _downward(value: float) -> float:
    """To three digits, no more than it is."""
    return _rounded(value * (1.0 + _ROUNDING), floor)


def _upward(value: float) -> float:
    """To three digits, no less than it is."""
    return _rounded(value * (1.0 - _ROUNDING), ceil)


def _rounded(value: float, to: Callable[[float], int]) -> float:
    if not 0.0 < value < inf:
        return value
    digit = 10.0 ** (floor(log10(value)) - 2)
    return to(value / digit) * digit
