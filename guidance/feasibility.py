"""Whether a vehicle within its limits could follow the reference at all: refused before anything moves."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Final

from guidance.abilities import FREE, Abilities, Bound, GroundAbilities, SpaceAbilities, VelocityAbilities
from guidance.checking import Problem, shown
from guidance.copter_config import CopterConfig
from guidance.handling.rover import ACCELERATION_PART, GRAVITY_M_S2, LATERAL_PART
from guidance.handling_config import GroundConfig
from guidance.se3 import ZERO, Vec3
from guidance.shortfall import needed, shortfalls
from guidance.trajectory import Trajectory
from guidance.tuning import LawConfig, LimitsConfig, rates_of

#: Where both have it, in the needs of vehicles that move along b1.
_SPEED: Final = 1


def infeasible(
    trajectory: Trajectory,
    limits: LimitsConfig,
    law: LawConfig,
    full_thrust_m_s: float,
    planar: bool,
    ground: GroundConfig | None = None,
    copter: CopterConfig | None = None,
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
    abilities = abilities_of(limits, law, full_thrust_m_s, planar, ground, copter)
    if not isinstance(abilities, VelocityAbilities) and law.name == "paper" and limits.speed_min_m_s >= 0.0:
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
    limits: LimitsConfig,
    law: LawConfig,
    full_thrust_m_s: float,
    planar: bool,
    ground: GroundConfig | None = None,
    copter: CopterConfig | None = None,
) -> SpaceAbilities | GroundAbilities | VelocityAbilities:
    """Those of [limits], in space, or in the plane for a `planar` vehicle, which turns by yaw alone, with
    those of [ground]; with [copter] those of a vehicle that takes velocities, whose rates do not count.

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
        lateral_m_s2 = None if ground is None else ground.lateral_acceleration_max_m_s2
        radius_m = 0.0 if ground is None else ground.turning_radius_m or 0.0
        return GroundAbilities(
            speed_least_m_s=least,
            speed_m_s=most,
            yaw_rate_rad_s=Bound(limits.yaw_rate_max_rad_s, "limits.yaw_rate_max_rad_s"),
            yaw_acceleration_rad_s2=_bound(
                limits.yaw_acceleration_max_rad_s2, "limits.yaw_acceleration_max_rad_s2"
            ),
            lateral_m_s2=_bound(lateral_m_s2, "ground.lateral_acceleration_max_m_s2"),
            radius_least_m=Bound(radius_m, "ground.turning_radius_m"),
            acceleration_m_s2=acceleration,
        )
    if copter is not None:
        return VelocityAbilities(
            speed_m_s=most,
            climb_m_s=_bound(copter.up_max_m_s, "copter.up_max_m_s"),
            sink_m_s=_bound(copter.down_max_m_s, "copter.down_max_m_s"),
            acceleration_m_s2=acceleration,
        )
    turning = [key for key in rates_of(law.allocation, planar) if key != "roll_rate_max_rad_s"]
    turn_rad_s = math.hypot(*(getattr(limits, key) for key in turning))
    keys = ", ".join(f"limits.{key}" for key in turning)
    # an allocation without its rates is refused as such
    turn = Bound(turn_rad_s, keys) if turn_rad_s > 0.0 else FREE
    return SpaceAbilities(least, most, turn, acceleration)


def within_autopilot(abilities: GroundAbilities, values: Mapping[str, float]) -> GroundAbilities:
    """The tighter of each and of an ArduPilot rover's parameters (`values`, in its units; 0 is no limit
    there), of which the handling asks only for a part. What the configuration says of the turning radius goes
    before TURN_RADIUS."""

    def tighter(ours: Bound, key: str, unit: float, part: float = 1.0) -> Bound:
        value = values.get(key) or math.inf
        theirs = Bound(unit * value, f"{key} {value:g}")
        return min(ours, theirs if part == 1.0 else theirs.less(1.0 - part))

    a = abilities
    radius_m = values.get("TURN_RADIUS", 0.0)
    gains_or_loses = min(("ATC_ACCEL_MAX", "ATC_DECEL_MAX"), key=lambda key: values.get(key) or math.inf)
    return a._replace(
        speed_m_s=tighter(a.speed_m_s, "WP_SPEED", 1.0),
        yaw_rate_rad_s=tighter(a.yaw_rate_rad_s, "ATC_STR_RAT_MAX", math.radians(1.0)),
        yaw_acceleration_rad_s2=tighter(a.yaw_acceleration_rad_s2, "ATC_STR_ACC_MAX", math.radians(1.0)),
        lateral_m_s2=tighter(a.lateral_m_s2, "ATC_TURN_MAX_G", GRAVITY_M_S2, LATERAL_PART),
        radius_least_m=a.radius_least_m
        if a.radius_least_m.value > 0.0
        else Bound(radius_m, f"TURN_RADIUS {radius_m:g}"),
        acceleration_m_s2=tighter(a.acceleration_m_s2, gains_or_loses, 1.0, ACCELERATION_PART),
    )


def _bound(limit: float | None, key: str) -> Bound:
    return FREE if limit is None else Bound(limit, key)
