"""Trajectories: t -> r, r', r'' in NED metres, relative to the trajectory's origin.

Each is a pure function of time and its parameters, with analytic derivatives, defined for all t (before
t = 0 it extends as it goes on after), and a Struct of the same parameters in the same order, which a
configuration names by `name = "helix"`.

Any of them may stop: its time then runs slower and slower, and stands still (`eased`).

To add one: write the function, write its Struct (with its `cycle_s`), and give both a row in `_FUNCTIONS`
(and the Struct a place in the union `Trajectory`, which type checkers read). Nothing else knows the list.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, hypot, isfinite, pi, radians, sin, sqrt
from typing import Annotated, Final, NamedTuple

import msgspec
from msgspec import Meta

from guidance.arc_length import phase_at, quarter_m
from guidance.se3 import ZERO, Vec3
from guidance.se3 import Reference as Reference  # the type is at home there; this is where users look for it

#: A helix levels off in so long, s.
LEVEL_OFF_S: Final = 4.0


class Eased(NamedTuple):
    """A clock that comes to rest, s(t), and its derivatives: s (s), s', s'' (1/s)."""

    time_s: float
    rate: float
    change_per_s: float


def eased(t_s: float, rest_s: float, over_s: float) -> Eased:
    """The clock t that stands still from `rest_s` on, and slows down in the `over_s` (> 0) s before.

    s' falls as the cubic 1 - 3 u^2 + 2 u^3, so that s'' is continuous, and at most 1.5/over: what is on this
    clock slows by at most 1.5 times its speed / over. Of the `over_s`, half is lost.
    """
    u = (t_s - rest_s) / over_s + 1.0
    if u <= 0.0:
        return Eased(t_s, 1.0, 0.0)
    if u >= 1.0:
        return Eased(rest_s - 0.5 * over_s, 0.0, 0.0)
    return Eased(
        rest_s - over_s + over_s * u * (1.0 - u * u * (1.0 - 0.5 * u)),
        1.0 - u * u * (3.0 - 2.0 * u),
        -6.0 * u * (1.0 - u) / over_s,
    )


def on_clock(planned: Reference, rate: float, rate_change: float) -> Reference:
    """r, r', r'' by flight time, of a reference by its own; `rate` is s', `rate_change` s'' (1/s)."""
    v, a = planned.velocity, planned.acceleration
    two = rate * rate
    return Reference(
        planned.position,
        Vec3(rate * v.x, rate * v.y, rate * v.z),
        Vec3(two * a.x + rate_change * v.x, two * a.y + rate_change * v.y, two * a.z + rate_change * v.z),
    )


def helix(
    t_s: float,
    radius_m: float,
    speed_m_s: float,
    down_m_s: float,
    down_m: float = 0.0,
    levels_off_m: float = 0.0,
) -> Reference:
    """The helix of section 4, r = (R sin wt, R cos wt, down t) with w = speed/R, from `down_m` on.

    `speed_m_s` is horizontal, `down_m_s` vertical (positive down). Starts R east of the origin, northbound;
    seen from above it turns counter-clockwise. Unless `levels_off_m` is 0, it is a circle once it has climbed
    or sunk by so much.
    """
    w = speed_m_s / radius_m
    s = sin(w * t_s)
    c = cos(w * t_s)
    climbing = Eased(t_s, 1.0, 0.0)
    if levels_off_m > 0.0 and down_m_s != 0.0:
        climbed_s = levels_off_m / abs(down_m_s)
        over_s = min(LEVEL_OFF_S, 2.0 * climbed_s)
        climbing = eased(t_s, climbed_s + 0.5 * over_s, over_s)
    return Reference(
        Vec3(radius_m * s, radius_m * c, down_m + down_m_s * climbing.time_s),
        Vec3(speed_m_s * c, -speed_m_s * s, down_m_s * climbing.rate),
        Vec3(-speed_m_s * w * s, -speed_m_s * w * c, down_m_s * climbing.change_per_s),
    )


def circle(t_s: float, radius_m: float, speed_m_s: float, clockwise: bool, down_m: float) -> Reference:
    """A level circle about the origin, `down_m` below it; starts at its northernmost point.

    `clockwise` is as seen from above: to the east first.
    """
    w = (speed_m_s if clockwise else -speed_m_s) / radius_m
    s = sin(w * t_s)
    c = cos(w * t_s)
    return Reference(
        Vec3(radius_m * c, radius_m * s, down_m),
        Vec3(-radius_m * w * s, radius_m * w * c, 0.0),
        Vec3(-speed_m_s * speed_m_s / radius_m * c, -speed_m_s * speed_m_s / radius_m * s, 0.0),
    )


def line(
    t_s: float,
    north_m: float,
    east_m: float,
    down_m: float,
    heading_deg: float,
    speed_m_s: float,
    climb_m_s: float,
) -> Reference:
    """A straight line from (north_m, east_m, down_m) at t = 0.

    `speed_m_s` is horizontal along `heading_deg` (from north to the east), `climb_m_s` vertical, positive up.
    """
    vx = speed_m_s * cos(radians(heading_deg))
    vy = speed_m_s * sin(radians(heading_deg))
    return Reference(
        Vec3(north_m + vx * t_s, east_m + vy * t_s, down_m - climb_m_s * t_s),
        Vec3(vx, vy, -climb_m_s),
        ZERO,
    )


def zigzag(t_s: float, leg_m: float, speed_m_s: float) -> Reference:
    """The zigzag (15), level: (s, s), then (2 leg - s, s), then (s - 2 leg, s), with s = speed t.

    `leg_m` and `speed_m_s` are per axis, so that the point moves at sqrt(2) speed_m_s. The corners are at
    s = leg and s = 2 leg; there the position is continuous and the velocity is that of the leg that begins
    ((15) as printed leaves the second after each corner undefined). As in (15), the third leg has no end.
    r'' is zero throughout: at a corner, where r' jumps, it does not exist.
    """
    s = speed_m_s * t_s
    if s < leg_m:
        return Reference(Vec3(s, s, 0.0), Vec3(speed_m_s, speed_m_s, 0.0), ZERO)
    if s < 2.0 * leg_m:
        return Reference(Vec3(2.0 * leg_m - s, s, 0.0), Vec3(-speed_m_s, speed_m_s, 0.0), ZERO)
    return Reference(Vec3(s - 2.0 * leg_m, s, 0.0), Vec3(speed_m_s, speed_m_s, 0.0), ZERO)


def lemniscate(t_s: float, length_m: float, width_m: float, speed_m_s: float, down_m: float) -> Reference:
    """The figure eight of Gerono, r = (length/2 sin p, width/2 sin 2p, down) with p = w t.

    `length_m` is its extent to the north, `width_m` to the east. `speed_m_s` is the highest speed, reached
    where the eight crosses itself: above (or below) the origin, where it starts, north-eastbound.
    """
    w = speed_m_s / hypot(0.5 * length_m, width_m)
    p = w * t_s
    return Reference(
        Vec3(0.5 * length_m * sin(p), 0.5 * width_m * sin(2.0 * p), down_m),
        Vec3(0.5 * length_m * w * cos(p), width_m * w * cos(2.0 * p), 0.0),
        Vec3(-0.5 * length_m * w * w * sin(p), -2.0 * width_m * w * w * sin(2.0 * p), 0.0),
    )


def eight(
    t_s: float, length_m: float, width_m: float, speed_m_s: float, down_m: float, rise_m: float
) -> Reference:
    """The lemniscate at constant horizontal speed, `rise_m` higher at its north end and lower at its south.

    r = (length/2 sin p, width/2 sin 2p, down - rise sin p), with the phase p at which the level arc is
    speed t. It starts at the crossing, north-eastbound.
    """
    half = 0.5 * length_m
    p = phase_at(speed_m_s * t_s, half, width_m)
    s, c, s2, c2 = sin(p), cos(p), sin(2.0 * p), cos(2.0 * p)
    # p' = V/|dr/dp| (level), and p'' from it
    stretch2 = (half * c) ** 2 + (width_m * c2) ** 2
    rate2 = speed_m_s * speed_m_s / stretch2
    rate = sqrt(rate2)
    change = (half * half * s * c + 2.0 * width_m * width_m * s2 * c2) / stretch2 * rate2
    return Reference(
        Vec3(half * s, 0.5 * width_m * s2, down_m - rise_m * s),
        Vec3(half * c * rate, width_m * c2 * rate, -rise_m * c * rate),
        Vec3(
            half * (c * change - s * rate2),
            width_m * (c2 * change - 2.0 * s2 * rate2),
            -rise_m * (c * change - s * rate2),
        ),
    )


class _Parameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="name"):
    """Parameters of a trajectory; `cycle_s` of each: in so long it shows every velocity that it ever has, but
    for those while it is `eased_s`.

    Decoding refuses what the `Meta` of a field excludes (msgspec.ValidationError with the key); NaN, which
    TOML can spell and comparisons let through, is refused here.
    """

    stop_at_s: Annotated[
        float, Meta(ge=0.0, le=1e6, description="stop at this time and stay, s; 0 is never")
    ] = 0.0
    stop_over_s: Annotated[
        float, Meta(ge=0.1, le=1e3, description="slow down over so long before it stops, s")
    ] = 4.0

    def __post_init__(self) -> None:
        for field in self.__struct_fields__:
            value = getattr(self, field)
            if not isfinite(value):
                raise ValueError(f"{field} must be a finite number, not {value}")

    @property
    def eased_s(self) -> tuple[tuple[float, float], ...]:
        """From when to when (s) it stops, or levels off: what it does then it does but once."""
        if self.stop_at_s == 0.0:
            return ()
        return ((self.stop_at_s - min(self.stop_over_s, self.stop_at_s), self.stop_at_s),)


class Helix(_Parameters, frozen=True, kw_only=True, tag="helix"):
    """Parameters of `helix`; the defaults are those of figure 1."""

    radius_m: Annotated[float, Meta(ge=0.01, le=1e5, description="radius, m")] = 1.0
    speed_m_s: Annotated[float, Meta(ge=1e-3, le=1e3, description="horizontal speed, m/s")] = 0.1
    down_m_s: Annotated[float, Meta(ge=-1e3, le=1e3, description="vertical speed, m/s, positive down")] = 0.1
    down_m: Annotated[float, Meta(ge=-1e5, le=1e5, description="start, m below the origin")] = 0.0
    levels_off_m: Annotated[
        float, Meta(ge=0.0, le=1e5, description="go on level after so much climbed or sunk, m; 0 is never")
    ] = 0.0

    @property
    def eased_s(self) -> tuple[tuple[float, float], ...]:
        """When it levels off, beside when it stops, s."""
        if self.levels_off_m == 0.0 or self.down_m_s == 0.0:
            return super().eased_s
        climbed_s = self.levels_off_m / abs(self.down_m_s)
        half_s = min(0.5 * LEVEL_OFF_S, climbed_s)
        return (*super().eased_s, (climbed_s - half_s, climbed_s + half_s))

    @property
    def cycle_s(self) -> float:
        """One turn, s."""
        return 2.0 * pi * self.radius_m / self.speed_m_s


class Circle(_Parameters, frozen=True, kw_only=True, tag="circle"):
    """Parameters of `circle`."""

    radius_m: Annotated[float, Meta(ge=0.01, le=1e5, description="radius, m")] = 10.0
    speed_m_s: Annotated[float, Meta(ge=1e-3, le=1e3, description="speed, m/s")] = 1.0
    clockwise: Annotated[bool, Meta(description="clockwise, seen from above")] = True
    down_m: Annotated[float, Meta(ge=-1e5, le=1e5, description="height below the origin, m")] = 0.0

    @property
    def cycle_s(self) -> float:
        """One turn, s."""
        return 2.0 * pi * self.radius_m / self.speed_m_s


class Line(_Parameters, frozen=True, kw_only=True, tag="line"):
    """Parameters of `line`."""

    north_m: Annotated[float, Meta(ge=-1e5, le=1e5, description="start, m north of the origin")] = 0.0
    east_m: Annotated[float, Meta(ge=-1e5, le=1e5, description="start, m east of the origin")] = 0.0
    down_m: Annotated[float, Meta(ge=-1e5, le=1e5, description="start, m below the origin")] = 0.0
    heading_deg: Annotated[float, Meta(ge=-360, le=360, description="course, degrees from north")] = 0.0
    speed_m_s: Annotated[float, Meta(ge=1e-3, le=1e3, description="horizontal speed, m/s")] = 1.0
    climb_m_s: Annotated[float, Meta(ge=-1e3, le=1e3, description="vertical speed, m/s, positive up")] = 0.0

    @property
    def cycle_s(self) -> float:
        """Any time will do: its velocity is constant."""
        return 1.0


class Zigzag(_Parameters, frozen=True, kw_only=True, tag="zigzag"):
    """Parameters of `zigzag`; the defaults are those of (15)."""

    leg_m: Annotated[float, Meta(ge=0.01, le=1e5, description="length of a leg along each axis, m")] = 30.0
    speed_m_s: Annotated[float, Meta(ge=1e-3, le=1e3, description="speed along each axis, m/s")] = 1.0

    @property
    def cycle_s(self) -> float:
        """The first leg and the second, s; the third is the first again."""
        return 2.0 * self.leg_m / self.speed_m_s


class Lemniscate(_Parameters, frozen=True, kw_only=True, tag="lemniscate"):
    """Parameters of `lemniscate`."""

    length_m: Annotated[float, Meta(ge=0.01, le=1e5, description="extent to the north, m")] = 20.0
    width_m: Annotated[float, Meta(ge=0.01, le=1e5, description="extent to the east, m")] = 10.0
    speed_m_s: Annotated[float, Meta(ge=1e-3, le=1e3, description="highest speed, at the crossing, m/s")] = (
        1.0
    )
    down_m: Annotated[float, Meta(ge=-1e5, le=1e5, description="height below the origin, m")] = 0.0

    @property
    def cycle_s(self) -> float:
        """One eight, s."""
        return 2.0 * pi * hypot(0.5 * self.length_m, self.width_m) / self.speed_m_s


class Eight(_Parameters, frozen=True, kw_only=True, tag="eight"):
    """Parameters of `eight`."""

    length_m: Annotated[float, Meta(ge=0.01, le=1e5, description="extent to the north, m")] = 40.0
    width_m: Annotated[float, Meta(ge=0.01, le=1e5, description="extent to the east, m")] = 20.0
    speed_m_s: Annotated[float, Meta(ge=1e-3, le=1e3, description="horizontal speed, m/s")] = 2.0
    down_m: Annotated[float, Meta(ge=-1e5, le=1e5, description="height below the origin, m")] = 0.0
    rise_m: Annotated[
        float,
        Meta(ge=-1e5, le=1e5, description="how much the north end is higher, and the south end lower, m"),
    ] = 0.0

    @property
    def cycle_s(self) -> float:
        """One eight, s."""
        return 4.0 * quarter_m(0.5 * self.length_m, self.width_m) / self.speed_m_s


Trajectory = Helix | Circle | Line | Zigzag | Lemniscate | Eight

#: The one table: parameters -> function of time and those parameters, in the order of the Struct's fields.
_FUNCTIONS: Final[dict[type[Trajectory], Callable[..., Reference]]] = {
    Helix: helix,
    Circle: circle,
    Line: line,
    Zigzag: zigzag,
    Lemniscate: lemniscate,
    Eight: eight,
}

#: Name in the configuration -> Struct.
TRAJECTORIES: Final[dict[str, type[Trajectory]]] = {
    str(parameters.__struct_config__.tag): parameters for parameters in _FUNCTIONS
}


def sample(trajectory: Trajectory, t_s: float) -> Reference:
    """The trajectory `t_s` seconds after its start."""
    rest_s, over_s, *shape = msgspec.structs.astuple(trajectory)
    function = _FUNCTIONS[type(trajectory)]
    if rest_s == 0.0:
        return function(t_s, *shape)
    clock = eased(t_s, rest_s, min(over_s, rest_s))
    return on_clock(function(clock.time_s, *shape), clock.rate, clock.change_per_s)
