"""Whether a vehicle within its limits could follow the reference at all: refused before anything moves."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from guidance.abilities import FREE, Abilities, Bound, GroundAbilities, SpaceAbilities
from guidance.checking import Problem, shown
from guidance.se3 import ZERO, Vec3
from guidance.shortfall import needed, shortfalls
from guidance.trajectory import Trajectory
from guidance.tuning import LawConfig, LimitsConfig, rates_of

#: Where both have it, in the needs of vehicles that move along b1.
_SPEED: Final = 1


def infeasible(
    trajectory: Trajectory, limits: LimitsConfig, law: LawConfig, full_thrust_m_s: float, planar: bool
) -> Iterator[Problem]:
    """What of the reference no vehicle within these limits could follow.

    Limits that are met exactly are let pass, and leave nothing to converge with: on a circle of 2 m at 2 m/s
    with rates of at most its 1 rad/s, 3.7 % of flights had not converged after 1000 s, and with 1.02 rad/s
    all had after 300 s.
    """
    if limits.speed_min_m_s >= limits.speed_max_m_s:
        yield Problem(
            "limits.speed_min_m_s",
            f" = {limits.speed_min_m_s:g}: must be below speed_max_m_s = {limits.speed_max_m_s:g}",
        )
        return
    abilities = abilities_of(limits, law, full_thrust_m_s, planar)
    if law.name == "paper" and limits.speed_min_m_s >= 0.0:
        fastest_m_s = needed(trajectory, type(abilities))[_SPEED]
        yield Problem(
            "limits.speed_min_m_s",
            f' = {limits.speed_min_m_s:g}: the law "paper" reverses where the vehicle faces away, and never '
            'converges from there if it may not; set law.name = "global", which only goes forward, or '
            f"below {-fastest_m_s:.3g}, the trajectory's speed: reverse has to be as fast as it",
        )
    for key in ("approach_m_s", "horizontal_m_s", "vertical_m_s"):
        approach_m_s = getattr(law.error_function, key, 0.0)
        if approach_m_s > abilities.speed_m_s.value:
            yield Problem(
                f"law.error_function.{key}",
                f" = {approach_m_s:g}: the vehicle moves at most at {abilities.speed_m_s.value:g} m/s "
                f"({abilities.speed_m_s.source})",
            )
    yield from unflyable(trajectory, abilities)


def unflyable(trajectory: Trajectory, abilities: Abilities, wind_ned_m_s: Vec3 = ZERO) -> Iterator[Problem]:
    """What of the reference is refused to a vehicle with these abilities."""
    for shortfall in shortfalls(trajectory, abilities, wind_ned_m_s):
        if shortfall.refuses:
            name = shown(str(trajectory.__struct_config__.tag))
            yield Problem("trajectory.name", f" = {name}: {shortfall.text}")


def abilities_of(
    limits: LimitsConfig, law: LawConfig, full_thrust_m_s: float, planar: bool
) -> SpaceAbilities | GroundAbilities:
    """Those of [limits], in space, or in the plane for a `planar` vehicle, which turns by yaw alone.

    Elsewhere the rates that move b1 are those of the allocation; rolling does not. Pitch and yaw count
    together as the root of their squares' sum, which rates about the body axes give at one angle of roll
    alone. How fast those change is not looked at in space.
    """
    least = Bound(limits.speed_min_m_s, "limits.speed_min_m_s")
    most = min(
        Bound(limits.speed_max_m_s, "limits.speed_max_m_s"),
        Bound(full_thrust_m_s, "vehicle.speed_at_full_thrust_m_s"),
    )
    acceleration = _bound(limits.acceleration_max_m_s2, "limits.acceleration_max_m_s2")
    if planar:
        return GroundAbilities(
            speed_least_m_s=least,
            speed_m_s=most,
            yaw_rate_rad_s=Bound(limits.yaw_rate_max_rad_s, "limits.yaw_rate_max_rad_s"),
            yaw_acceleration_rad_s2=_bound(
                limits.yaw_acceleration_max_rad_s2, "limits.yaw_acceleration_max_rad_s2"
            ),
            acceleration_m_s2=acceleration,
        )
    turning = [key for key in rates_of(law.allocation, planar) if key != "roll_rate_max_rad_s"]
    turn_rad_s = math.hypot(*(getattr(limits, key) for key in turning))
    keys = ", ".join(f"limits.{key}" for key in turning)
    # an allocation without its rates is refused as such
    turn = Bound(turn_rad_s, keys) if turn_rad_s > 0.0 else FREE
    return SpaceAbilities(least, most, turn, acceleration)


def _bound(limit: float | None, key: str) -> Bound:
    return FREE if limit is None else Bound(limit, key)
