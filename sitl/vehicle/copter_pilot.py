"""What flies a copter in the modes that fly by themselves: stand, climb, come home, land."""

from __future__ import annotations

from math import hypot, sqrt
from typing import Final, NamedTuple

from sitl.plant import Triple, euler_from_attitude
from sitl.vehicle.body import BodyState
from sitl.vehicle.controls import Velocity

#: Slower than this (m/s) it has stopped: the point where it is, is held.
STOPPED_M_S: Final = 0.5
#: How it slows down towards a point; both autopilots brake harder.
BRAKING_M_S2: Final = 1.0
HEIGHT_BRAKING_M_S2: Final = 0.5
#: So close (m) it is above its home.
HOME_M: Final = 0.5
#: Height (m) at which it counts as standing on the ground.
GROUND_M: Final = 0.02


class Manner(NamedTuple):
    """What the firmware's parameters say; `slow_m_s` is how it comes down below `slow_below_m`."""

    level_per_s: float
    height_per_s: float
    speed_m_s: float
    up_m_s: float
    down_m_s: float
    slow_m_s: float
    slow_below_m: float


class Stand(NamedTuple):
    """At a point, or where it stops."""

    position_ned_m: Triple | None = None


class Return(NamedTuple):
    """Up to this height, level to the home, and down."""

    home_ned_m: Triple
    height_m: float


class Land(NamedTuple):
    """Straight down."""


Plan = Stand | Return | Land


class CopterPilot:
    """Velocities towards where the plan wants it."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._held_ned_m: Triple | None = plan.position_ned_m if isinstance(plan, Stand) else None

    def fly(self, manner: Manner, state: BodyState) -> Velocity:
        """To be asked some 50 times a second."""
        match self._plan:
            case Stand():
                if self._held_ned_m is None:
                    if hypot(*state.velocity_ned_m_s) > STOPPED_M_S:
                        return Velocity()
                    self._held_ned_m = state.position_ned_m
                return toward(manner, state, self._held_ned_m)
            case Return((north, east, _), height):
                x, y, z = state.position_ned_m
                if hypot(north - x, east - y) < HOME_M:
                    return _down(manner, state, (north, east))
                if -z < height - HOME_M:
                    return toward(manner, state, (x, y, -height))
                return toward(manner, state, (north, east, min(z, -height)))
            case Land():
                if self._held_ned_m is None:
                    self._held_ned_m = state.position_ned_m
                return _down(manner, state, self._held_ned_m[:2])


def toward(manner: Manner, state: BodyState, position_ned_m: Triple) -> Velocity:
    """The velocity that leads to a point."""
    x, y, z = (to - at for to, at in zip(position_ned_m, state.position_ned_m, strict=True))
    way, height = hypot(x, y), abs(z)
    speed = min(manner.level_per_s * way, sqrt(2.0 * BRAKING_M_S2 * way), manner.speed_m_s)
    part = speed / way if way > 0.0 else 0.0
    rate = min(manner.height_per_s * height, sqrt(2.0 * HEIGHT_BRAKING_M_S2 * height))
    down = min(rate, manner.down_m_s) if z > 0.0 else -min(rate, manner.up_m_s)
    return Velocity((part * x, part * y, down))


def yaw_of(state: BodyState) -> float:
    """Heading of the nose, rad."""
    return euler_from_attitude(state.attitude_wxyz)[2]


def on_ground(state: BodyState) -> bool:
    """Whether it stands."""
    return -state.position_ned_m[2] < GROUND_M


def _down(manner: Manner, state: BodyState, above_ne_m: tuple[float, ...]) -> Velocity:
    level = toward(manner, state, (above_ne_m[0], above_ne_m[1], state.position_ned_m[2])).velocity_ned_m_s
    slow = -state.position_ned_m[2] < manner.slow_below_m
    return Velocity((level[0], level[1], manner.slow_m_s if slow else manner.down_m_s))
