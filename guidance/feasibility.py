"""Whether a vehicle within its limits could follow the reference at all: refused before anything moves."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Final, NamedTuple

from guidance.checking import Problem, shown
from guidance.se3 import Vec3, cross, dot, norm
from guidance.trajectory import Reference, Trajectory, sample
from guidance.tuning import LawConfig, LimitsConfig, rates_of

#: A trajectory's cycle is looked at at so many instants, evenly spaced. A multiple of 8 meets the lemniscate
#: where it turns fastest if that is a matter of a moment (at the ends or the sides of a long and thin one);
#: with 800 all its extremes are found within 0.4 %, whatever its proportions. The speed and the turn of the
#: others are constant; so are the zigzag's but for its corners, which no vehicle could follow.
INSTANTS: Final = 800
#: Limits that are met exactly are met.
_ROUNDING: Final = 1.0 - 1e-9


def infeasible(
    trajectory: Trajectory, limits: LimitsConfig, law: LawConfig, full_thrust_m_s: float, planar: bool
) -> Iterator[Problem]:
    """What of the reference no vehicle within these limits could follow.

    Speeds and turns are those in space, or in the plane for a `planar` vehicle, which turns by yaw alone.
    Elsewhere the rates that move b1 are those of the allocation; rolling does not. Not looked at: how fast
    those rates have to change.

    Limits that are met exactly are let pass, and leave nothing to converge with: on a circle of 2 m at 2 m/s
    with rates of at most its 1 rad/s, 3.7 % of flights had not converged after 1000 s, and with 1.02 rad/s
    all had after 300 s. Pitch and yaw count together as the root of their squares' sum, which rates about the
    body axes give at one angle of roll alone.
    """
    if limits.speed_min_m_s >= limits.speed_max_m_s:
        yield Problem(
            "limits.speed_min_m_s",
            f" = {limits.speed_min_m_s:g}: must be below speed_max_m_s = {limits.speed_max_m_s:g}",
        )
        return
    motion = _motion(trajectory, planar)
    if law.name == "paper" and limits.speed_min_m_s >= 0.0:
        yield Problem(
            "limits.speed_min_m_s",
            f' = {limits.speed_min_m_s:g}: the law "paper" reverses where the vehicle faces away, and never '
            'converges from there if it may not; set law.name = "global", which only goes forward, or '
            f"below {-motion.fastest_m_s:.3g}, the trajectory's speed: reverse has to be "
            "as fast as it",
        )
    fastest = min(limits.speed_max_m_s, full_thrust_m_s)
    bounded_by = "(limits.speed_max_m_s, vehicle.speed_at_full_thrust_m_s)"
    for key in ("approach_m_s", "horizontal_m_s", "vertical_m_s"):
        approach_m_s = getattr(law.error_function, key, 0.0)
        if approach_m_s > fastest:
            yield Problem(
                f"law.error_function.{key}",
                f" = {approach_m_s:g}: the vehicle moves at most at {fastest:g} m/s {bounded_by}",
            )
    for found in (
        _too_fast_or_slow(motion, limits.speed_min_m_s, fastest, bounded_by),
        _too_sudden(motion, limits.acceleration_max_m_s2),
        _too_tight(motion, limits, rates_of(law.allocation, planar)),
    ):
        if found is not None:
            yield Problem("trajectory.name", f" = {shown(str(trajectory.__struct_config__.tag))}: it {found}")


class _Motion(NamedTuple):
    """The extremes of a trajectory's cycle."""

    slowest_m_s: float
    fastest_m_s: float
    change_m_s2: float
    turn_rad_s: float


@lru_cache(maxsize=16)
def _motion(trajectory: Trajectory, planar: bool) -> _Motion:
    """Looked at once: a limit that is set in flight is held against what is known by then."""
    step_s = trajectory.cycle_s / INSTANTS
    moving = [_in_its_space(sample(trajectory, step_s * i), planar) for i in range(INSTANTS)]
    speeds = [norm(r.velocity) for r in moving]
    going = [(r, speed) for r, speed in zip(moving, speeds, strict=True) if speed > 0.0]
    return _Motion(
        min(speeds),
        max(speeds),
        max((abs(dot(r.velocity, r.acceleration)) / speed for r, speed in going), default=0.0),
        max((norm(cross(r.velocity, r.acceleration)) / speed**2 for r, speed in going), default=0.0),
    )


def _too_fast_or_slow(motion: _Motion, slowest: float, fastest: float, bounded_by: str) -> str | None:
    if motion.fastest_m_s * _ROUNDING > fastest:
        return f"moves at {motion.fastest_m_s:.3g} m/s, and the vehicle at most at {fastest:g} {bounded_by}"
    if motion.slowest_m_s < slowest * _ROUNDING:
        return (
            f"moves at {motion.slowest_m_s:.3g} m/s, and the vehicle never slower than "
            f"limits.speed_min_m_s = {slowest:g}"
        )
    return None


def _too_sudden(motion: _Motion, acceleration_max: float | None) -> str | None:
    if acceleration_max is None or motion.change_m_s2 * _ROUNDING <= acceleration_max:
        return None
    return (
        f"gains or loses {motion.change_m_s2:.3g} m/s each second, and the vehicle at most "
        f"{acceleration_max:g} (limits.acceleration_max_m_s2)"
    )


def _too_tight(motion: _Motion, limits: LimitsConfig, rates: tuple[str, ...]) -> str | None:
    turning = [key for key in rates if key != "roll_rate_max_rad_s"]
    fastest = math.hypot(*(getattr(limits, key) for key in turning))
    # An allocation without its rates is refused as such.
    if motion.turn_rad_s * _ROUNDING <= fastest or fastest == 0.0:
        return None
    keys = ", ".join(f"limits.{key}" for key in turning)
    return f"turns at {motion.turn_rad_s:.3g} rad/s, and the vehicle at most at {fastest:.3g} ({keys})"


def _in_its_space(reference: Reference, planar: bool) -> Reference:
    if not planar:
        return reference
    v, a = reference.velocity, reference.acceleration
    return reference._replace(velocity=Vec3(v.x, v.y, 0.0), acceleration=Vec3(a.x, a.y, 0.0))
