"""A trajectory as it is looked at before a flight: at instants over its cycle, and where it is eased.

Between instants that lie too far apart to follow a bend others are put, until either the bend is followed or
there is none: then the velocity jumps, and no vehicle can follow it at any speed. That, and not how long it
lasts, tells a corner from a bend that is too sharp.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import pairwise
from math import hypot
from typing import Final, NamedTuple

from guidance.se3 import Reference, Vec3, add, norm, scale, subtract
from guidance.trajectory import Trajectory, sample

#: A cycle is looked at at so many instants, evenly spaced. A multiple of 8 meets the lemniscate where it
#: turns fastest if that is a matter of a moment (at the ends or the sides of a long and thin one); with 800
#: all its extremes are found within 0.4 %, whatever its proportions.
INSTANTS: Final = 800
#: And at so many while it is eased.
EASED_INSTANTS: Final = 100
#: What does not repeat, a climb, is looked at so far ahead, s.
AHEAD_S: Final = 600.0
#: A bend is followed if the velocity changes by what the acceleration says, to this part of the speed,
_FOLLOWED: Final = 0.02
#: which for this counts as no less than this part of the highest.
_SLOW: Final = 1e-3
#: Slower than this, m/s, nothing has a direction.
_AT_REST_M_S: Final = 1e-9
#: Halved so often, a span that is not followed is a corner.
_HALVED: Final = 36


class Instant(NamedTuple):
    """r, r', r'' at `time_s` of the trajectory's own clock; r''' (m/s^3) and how fast the level turn rate
    changes (rad/s^2), by differences of instants beside it."""

    time_s: float
    position: Vec3
    velocity: Vec3
    acceleration: Vec3
    jerk: Vec3
    turn_change_rad_s2: float

    def slower(self, factor: float) -> Instant:
        """The same place, if all is flown `factor` as fast."""
        two = factor * factor
        return self._replace(
            velocity=scale(factor, self.velocity),
            acceleration=scale(two, self.acceleration),
            jerk=scale(two * factor, self.jerk),
            turn_change_rad_s2=two * self.turn_change_rad_s2,
        )

    def wider(self, factor: float) -> Instant:
        """The same speed, if all is `factor` as large; not the position."""
        return self._replace(
            acceleration=scale(1.0 / factor, self.acceleration),
            jerk=scale(1.0 / (factor * factor), self.jerk),
            turn_change_rad_s2=self.turn_change_rad_s2 / (factor * factor),
        )


class Corner(NamedTuple):
    """Where the velocity jumps, in no time."""

    time_s: float
    position: Vec3
    before: Vec3
    after: Vec3


class Looked(NamedTuple):
    """All instants, by their time, and all corners."""

    instants: tuple[Instant, ...]
    corners: tuple[Corner, ...]


def level_m_s(velocity: Vec3) -> float:
    """The horizontal speed."""
    return hypot(velocity.x, velocity.y)


def level_turn_rad_s(velocity: Vec3, acceleration: Vec3) -> float:
    """How fast the course turns, to the right; 0 at rest."""
    v, a = velocity, acceleration
    level2 = v.x * v.x + v.y * v.y
    return (v.x * a.y - v.y * a.x) / level2 if level2 > _AT_REST_M_S**2 else 0.0


@lru_cache(maxsize=16)
def looked_at(trajectory: Trajectory) -> Looked:
    """Looked at once: what is set in flight is held against what is known by then."""
    instants: list[Instant] = []
    corners: list[Corner] = []
    spans = [(0.0, trajectory.cycle_s, INSTANTS)]
    spans += [(begin_s, end_s, EASED_INSTANTS) for begin_s, end_s in trajectory.eased_s]
    for begin_s, end_s, count in spans:
        step_s = (end_s - begin_s) / count
        seen = [_seen(trajectory, begin_s + step_s * i) for i in range(-1, count + 2)]
        instants += [_instant(*beside) for beside in zip(seen, seen[1:], seen[2:], strict=False)]
        slow_m_s = _SLOW * max(norm(beside.reference.velocity) for beside in seen)
        for this, that in pairwise(seen[1:-1]):
            for found in _between(trajectory, this, that, slow_m_s, _HALVED):
                if isinstance(found, Corner):
                    corners.append(found)
                else:
                    instants.append(found)
    step_s = trajectory.cycle_s / INSTANTS
    instants.append(_instant(*(_seen(trajectory, AHEAD_S + i * step_s) for i in (-1, 0, 1))))
    return Looked(tuple(sorted(instants)), tuple(sorted(corners)))


class _Seen(NamedTuple):
    time_s: float
    reference: Reference


def _seen(trajectory: Trajectory, t_s: float) -> _Seen:
    return _Seen(t_s, sample(trajectory, t_s))


def _instant(before: _Seen, now: _Seen, after: _Seen) -> Instant:
    position, velocity, acceleration = now.reference
    per_s = 1.0 / (after.time_s - before.time_s)
    changed = subtract(after.reference.acceleration, before.reference.acceleration)
    turned = level_turn_rad_s(*after.reference[1:]) - level_turn_rad_s(*before.reference[1:])
    return Instant(now.time_s, position, velocity, acceleration, scale(per_s, changed), per_s * turned)


def _between(
    trajectory: Trajectory, this: _Seen, that: _Seen, slow_m_s: float, halvings: int
) -> Iterator[Instant | Corner]:
    """What lies between two instants that are too far apart; nothing if they are not."""
    span_s = that.time_s - this.time_s
    (v, a), (v_after, a_after) = this.reference[1:], that.reference[1:]
    unexplained = subtract(subtract(v_after, v), scale(0.5 * span_s, add(a, a_after)))
    if norm(unexplained) <= _FOLLOWED * max(norm(v), norm(v_after), slow_m_s):
        return
    middle = _seen(trajectory, 0.5 * (this.time_s + that.time_s))
    if halvings == 0 or not this.time_s < middle.time_s < that.time_s:
        yield Corner(that.time_s, that.reference.position, v, v_after)
        return
    yield _instant(this, middle, that)
    yield from _between(trajectory, this, middle, slow_m_s, halvings - 1)
    yield from _between(trajectory, middle, that, slow_m_s, halvings - 1)
