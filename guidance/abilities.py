"""What a vehicle of each class can do, and what an instant of a trajectory needs of it, in the same order.

The trajectory is flown as planned, its speed over ground whatever the wind. No law, no error, no delay: what
is left for those is the margin that whoever fills in the abilities takes off (`Bound.less`).
"""

from __future__ import annotations

from collections.abc import Callable
from math import atan, atan2, cos, hypot, inf, sqrt, tan
from typing import Final, NamedTuple

from guidance.handling.airplane_bank import CARRIED_MIN, GRAVITY_M_S2
from guidance.instants import Instant, level_m_s, level_turn_rad_s
from guidance.se3 import Vec3, cross, dot, norm


class Bound(NamedTuple):
    """A limit in SI units, and where it comes from, such as "WP_SPEED 5". min() of two is the tighter one,
    max() of two where it is a least."""

    value: float
    source: str

    def less(self, part: float) -> Bound:
        """With `part` of it kept as a margin, and said to be."""
        return Bound(self.value * (1.0 - part), f"{self.source} less {100.0 * part:.3g} %")

    def more(self, part: float) -> Bound:
        """The same of a least."""
        return Bound(self.value * (1.0 + part), f"{self.source} and {100.0 * part:.3g} %")


FREE: Final = Bound(inf, "")
NO_LEAST: Final = Bound(-inf, "")

#: Of an airplane whose bank nobody bounds, rad.
_STEEPEST_RAD: Final = 1.5


class SpaceAbilities(NamedTuple):
    """A vehicle that moves along b1 and turns it in space by body rates; `turn` is how fast b1 turns."""

    speed_least_m_s: Bound = NO_LEAST
    speed_m_s: Bound = FREE
    turn_rad_s: Bound = FREE
    acceleration_m_s2: Bound = FREE


class GroundAbilities(NamedTuple):
    """A vehicle that drives in the plane. `acceleration` is along the path, `lateral` across; 0 is the least
    radius of one that turns at rest."""

    speed_least_m_s: Bound = NO_LEAST
    speed_m_s: Bound = FREE
    yaw_rate_rad_s: Bound = FREE
    yaw_acceleration_rad_s2: Bound = FREE
    lateral_m_s2: Bound = FREE
    radius_least_m: Bound = NO_LEAST
    acceleration_m_s2: Bound = FREE


class AirplaneAbilities(NamedTuple):
    """Airspeeds are true ones; the least is that of level flight and takes the root of the load times it.

    `floor_down_m` is relative to the trajectory's origin (positive below it); `effectiveness` is eta (> 0).
    A reference that waits for the airplane runs from `clock_least` to `clock_most` times as fast as planned.
    """

    airspeed_least_m_s: Bound = NO_LEAST
    airspeed_m_s: Bound = FREE
    bank_rad: Bound = FREE
    load: Bound = FREE
    climb_m_s: Bound = FREE
    sink_m_s: Bound = FREE
    roll_rate_rad_s: Bound = FREE
    floor_down_m: Bound = FREE
    effectiveness: float = 1.0
    clock_least: float = 1.0
    clock_most: float = 1.0


class VelocityAbilities(NamedTuple):
    """A vehicle that is told velocities, and yaws as it likes. Speed and accelerations are horizontal."""

    speed_m_s: Bound = FREE
    climb_m_s: Bound = FREE
    sink_m_s: Bound = FREE
    acceleration_m_s2: Bound = FREE
    jerk_m_s3: Bound = FREE


Abilities = SpaceAbilities | GroundAbilities | AirplaneAbilities | VelocityAbilities


class Kind(NamedTuple):
    """One need: what it is called, its unit ("deg" and "deg/s" are held in rad), whether the ability is a
    least, whether to fly slower (or, of a least, faster) helps, and whether the wind makes it."""

    what: str
    unit: str
    is_least: bool = False
    paced: bool = True
    windy: bool = False


class Needs(NamedTuple):
    """Of a class: its kinds, as the first fields of its abilities, and their values at an instant in a wind
    (NED, m/s), of a bank of an effectiveness; and what its speed is, for advice."""

    kinds: tuple[Kind, ...]
    of: Callable[[Instant, Vec3, float], tuple[float, ...]]
    speed_m_s: Callable[[Vec3], float] = level_m_s


def _space(i: Instant, wind_ned_m_s: Vec3, effectiveness: float) -> tuple[float, ...]:
    v, a = i.velocity, i.acceleration
    speed = norm(v)
    if speed == 0.0:
        return 0.0, 0.0, 0.0, norm(a)
    return speed, speed, norm(cross(v, a)) / speed**2, abs(dot(v, a)) / speed


def _ground(i: Instant, wind_ned_m_s: Vec3, effectiveness: float) -> tuple[float, ...]:
    v, a = i.velocity, i.acceleration
    speed = level_m_s(v)
    turn = abs(level_turn_rad_s(v, a))
    along = abs(v.x * a.x + v.y * a.y) / speed if speed > 0.0 else hypot(a.x, a.y)
    radius = speed / turn if turn > 0.0 else inf
    return speed, speed, turn, abs(i.turn_change_rad_s2), speed * turn, radius, along


def _velocity(i: Instant, wind_ned_m_s: Vec3, effectiveness: float) -> tuple[float, ...]:
    v, a, j = i.velocity, i.acceleration, i.jerk
    return level_m_s(v), -v.z, v.z, hypot(a.x, a.y), hypot(j.x, j.y)


def _airplane(i: Instant, wind_ned_m_s: Vec3, effectiveness: float) -> tuple[float, ...]:
    """As `handling.airplane_bank` has it; a steady wind changes no acceleration, but what is across."""
    v, a, j = i.velocity, i.acceleration, i.jerk
    x, y = v.x - wind_ned_m_s.x, v.y - wind_ned_m_s.y
    level = hypot(x, y)
    airspeed = sqrt(level * level + (v.z - wind_ned_m_s.z) ** 2)
    carried = max(GRAVITY_M_S2 - a.z, CARRIED_MIN * GRAVITY_M_S2)
    if level == 0.0:
        return 0.0, airspeed, 0.0, carried / GRAVITY_M_S2, -v.z, v.z, 0.0
    lateral = (x * a.y - y * a.x) / level
    along = (x * a.x + y * a.y) / level
    lateral_change = (x * j.y - y * j.x) / level - lateral * along / level
    steep = lateral / (effectiveness * carried)
    bank = atan(steep)
    load = carried / (GRAVITY_M_S2 * cos(bank))
    rolls = lateral_change / (effectiveness * carried) / (1.0 + steep * steep)
    return airspeed / sqrt(max(load, 1.0)), airspeed, abs(bank), load, -v.z, v.z, abs(rolls)


NEEDS: Final[dict[type[Abilities], Needs]] = {
    SpaceAbilities: Needs(
        (
            Kind("speed", "m/s", is_least=True),
            Kind("speed", "m/s"),
            Kind("turn", "rad/s"),
            Kind("change of speed", "m/s^2"),
        ),
        _space,
        norm,
    ),
    GroundAbilities: Needs(
        (
            Kind("speed", "m/s", is_least=True),
            Kind("speed", "m/s"),
            Kind("yaw rate", "rad/s"),
            Kind("change of yaw rate", "rad/s^2"),
            Kind("lateral acceleration", "m/s^2"),
            Kind("radius", "m", is_least=True, paced=False),
            Kind("change of speed", "m/s^2"),
        ),
        _ground,
    ),
    AirplaneAbilities: Needs(
        (
            Kind("airspeed by the root of the load", "m/s", is_least=True, windy=True),
            Kind("airspeed", "m/s", windy=True),
            Kind("bank", "deg"),
            Kind("load factor", ""),
            Kind("climb", "m/s", paced=False),
            Kind("sink", "m/s", paced=False),
            Kind("roll rate", "deg/s"),
        ),
        _airplane,
    ),
    VelocityAbilities: Needs(
        (
            Kind("horizontal speed", "m/s"),
            Kind("climb", "m/s", paced=False),
            Kind("sink", "m/s", paced=False),
            Kind("horizontal acceleration", "m/s^2"),
            Kind("horizontal jerk", "m/s^3"),
        ),
        _velocity,
    ),
}


def turning_s(abilities: Abilities, before: Vec3, after: Vec3) -> float:
    """How long the vehicle takes from one velocity to another at a corner; 0 if nothing bounds it."""
    angle = angle_rad(before, after)
    match abilities:
        case SpaceAbilities():
            return angle / abilities.turn_rad_s.value
        case GroundAbilities():
            slew = abilities.yaw_acceleration_rad_s2.value
            fastest = min(abilities.yaw_rate_rad_s.value, sqrt(angle * slew))
            return angle / fastest + fastest / slew if 0.0 < fastest < inf else 0.0
        case VelocityAbilities():
            return hypot(after.x - before.x, after.y - before.y) / abilities.acceleration_m_s2.value
        case AirplaneAbilities():
            bank = min(abilities.bank_rad.value, _STEEPEST_RAD)
            turn = GRAVITY_M_S2 * abilities.effectiveness * tan(bank) / norm(before)
            return angle / turn + bank / abilities.roll_rate_rad_s.value


def angle_rad(a: Vec3, b: Vec3) -> float:
    """Between two directions, 0 to pi."""
    return atan2(norm(cross(a, b)), dot(a, b))
