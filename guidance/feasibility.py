"""Whether a vehicle within its limits could follow the reference at all: refused before anything moves."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from guidance.checking import Problem, shown
from guidance.se3 import Vec3, cross, norm
from guidance.trajectory import Reference, Trajectory, sample
from guidance.tuning import LawConfig, LimitsConfig

#: Trajectories are looked at for so long, twice a second.
LOOKED_AT_S: Final = 600
#: Limits that are met exactly are met.
_ROUNDING: Final = 1.0 - 1e-9
_STANDS_M_S: Final = 1e-6


def infeasible(
    trajectory: Trajectory, limits: LimitsConfig, law: LawConfig, full_thrust_m_s: float, planar: bool
) -> Iterator[Problem]:
    """What of the reference no vehicle within these limits could follow.

    Speeds and turns are those in space, or in the plane for a `planar` vehicle, which turns by yaw alone.
    Elsewhere the rates that move b1 are those of the allocation; rolling does not.
    """
    if limits.speed_min_m_s >= limits.speed_max_m_s:
        yield Problem(
            "limits.speed_min_m_s",
            f" = {limits.speed_min_m_s:g}: must be below speed_max_m_s = {limits.speed_max_m_s:g}",
        )
        return
    if law.name == "paper" and limits.speed_min_m_s >= 0.0:
        yield Problem(
            "limits.speed_min_m_s",
            f' = {limits.speed_min_m_s:g}: the law "paper" reverses where the vehicle faces away, and never '
            'converges from there if it may not; set law.name = "global", which only goes forward, or '
            "a value below 0",
        )
    name = shown(str(trajectory.__struct_config__.tag))
    moving = [_in_its_space(sample(trajectory, 0.5 * i), planar) for i in range(2 * LOOKED_AT_S)]
    speeds = [norm(r.velocity) for r in moving]
    fastest = min(limits.speed_max_m_s, full_thrust_m_s)
    if max(speeds) * _ROUNDING > fastest:
        yield Problem(
            "trajectory.name",
            f" = {name}: it moves at {max(speeds):.3g} m/s, and the vehicle at most at {fastest:g} "
            "(limits.speed_max_m_s, vehicle.speed_at_full_thrust_m_s)",
        )
    elif min(speeds) < limits.speed_min_m_s * _ROUNDING:
        yield Problem(
            "trajectory.name",
            f" = {name}: it moves at {min(speeds):.3g} m/s, and the vehicle never slower than "
            f"limits.speed_min_m_s = {limits.speed_min_m_s:g}",
        )
    turns = [
        norm(cross(r.velocity, r.acceleration)) / (speed * speed)
        for r, speed in zip(moving, speeds, strict=True)
        if speed > _STANDS_M_S
    ]
    rates = {
        "yaw_rate_max_rad_s": limits.yaw_rate_max_rad_s,
        "pitch_rate_max_rad_s": limits.pitch_rate_max_rad_s,
    }
    if planar or law.allocation == "roll-yaw":
        del rates["pitch_rate_max_rad_s"]
    elif law.allocation == "roll-pitch":
        del rates["yaw_rate_max_rad_s"]
    fastest_turn = math.hypot(*rates.values())
    # An allocation whose only rate is zero is refused as such.
    if max(turns, default=0.0) * _ROUNDING > fastest_turn > 0.0:
        keys = ", ".join(f"limits.{key}" for key in rates)
        yield Problem(
            "trajectory.name",
            f" = {name}: it turns at {max(turns):.3g} rad/s, and the vehicle at most at {fastest_turn:.3g} "
            f"({keys})",
        )


def _in_its_space(reference: Reference, planar: bool) -> Reference:
    if not planar:
        return reference
    v, a = reference.velocity, reference.acceleration
    return reference._replace(velocity=Vec3(v.x, v.y, 0.0), acceleration=Vec3(a.x, a.y, 0.0))
