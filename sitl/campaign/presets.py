"""Named campaigns: the table that sets the laws side by side, from random and from hard starts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from guidance.se3 import IDENTITY, Quaternion, Vec3, from_euler, from_yaw, norm
from guidance.trajectory import Circle, Helix, Line, Trajectory, sample
from sitl.campaign import vehicle_presets
from sitl.campaign.plan import Plan, Start
from sitl.campaign.vehicle_plan import VehiclePlan

#: Flights of the table's first row and of the one with lag, which alone feels the motion at the start; each
#: of the other random rows has a tenth of it.
TABLE_FLIGHTS: Final = 1_000_000

_FORWARD: Final = (0.0, 0.0)
_AT_REST: Final = (0.0, 0.0)
_FAST_M_S: Final = 4.5
_DOWN_M_S: Final = 0.1
#: At 0.9 of the table's v_max. Of a helix up to this radius 20 s are enough from 50 m: one that stays behind
#: cuts the corner.
_FAST: Final = Helix(radius_m=10.0, speed_m_s=math.sqrt(_FAST_M_S**2 - _DOWN_M_S**2), down_m_s=_DOWN_M_S)
#: One that flees on a straight line leaves no corner to cut: from 50 m behind nobody is there before 100 s.
_FLEEING: Final = Line(speed_m_s=_FAST_M_S)
#: The law's bound there: once aligned, the distance shrinks by min(k |e|, v_max - |r'|) a second or faster,
#: which from 50 m to 1 cm is 49.5/0.5 + ln(0.5/0.01) = 103 s; to turn round first takes below 0.7 s, in which
#: the reference gains below 3 m: 6 s more.
_FLEEING_DUE_S: Final = 110.0


def hard_starts(trajectory: Trajectory, k: float = 1.0, beta: float = 1.0) -> tuple[Start, ...]:
    """Where a law for forward flight can be caught out at t = 0, for phi = 1/2 k |x - r|^2.

    The field Xr = r' - k/beta (x - r) is chosen (m/s), and the position follows from it. On a helix and a
    circle with k = beta the opposite field is so exactly, in floating point, and the orthogonal one to
    rounding. Their axis is the vertical through the origin, and ahead on it is below.
    """
    reference = sample(trajectory, 0.0)
    r, v = reference.position, reference.velocity

    def where_field_is(north: float, east: float, down: float) -> Vec3:
        per_m_s = beta / k
        return Vec3(r.x + per_m_s * (v.x - north), r.y + per_m_s * (v.y - east), r.z + per_m_s * (v.z - down))

    speed = norm(v)
    tangent = Vec3(v.x / speed, v.y / speed, v.z / speed)
    along = from_euler(0.0, -math.asin(tangent.z), math.atan2(tangent.y, tangent.x))
    back = from_euler(0.0, math.asin(tangent.z), math.atan2(-tangent.y, -tangent.x))
    starts = []
    for far in (1.0, 5.0, 20.0, 50.0):
        north = where_field_is(far, 0.0, 0.0)
        below = Vec3(0.0, 0.0, r.z + far)
        starts += [
            Start(f"exactly opposite, {far:g} m/s", north, Quaternion(0.0, 0.0, 0.0, 1.0)),
            Start(f"exactly opposite, on its back, {far:g} m/s", north, Quaternion(0.0, 0.0, 1.0, 0.0)),
            Start(f"field orthogonal, right, {far:g} m/s", north, from_yaw(-0.5 * math.pi)),
            Start(f"field orthogonal, above, {far:g} m/s", north, from_euler(0.0, -0.5 * math.pi, 0.0)),
            # Flying away along the axis; and about to meet the reference.
            Start(f"ahead on the axis, away, {far:g} m", below, from_euler(0.0, -0.5 * math.pi, 0.0)),
            Start(f"ahead on the axis, towards, {far:g} m", below, from_euler(0.0, 0.5 * math.pi, 0.0)),
            # Ahead of the reference on its tangent, nose away from it.
            Start(
                f"ahead on the tangent, {far:g} m/s",
                where_field_is(-far * tangent.x, -far * tangent.y, -far * tangent.z),
                along,
            ),
        ]
    zero = where_field_is(0.0, 0.0, 0.0)
    starts += [
        Start("field zero", zero, IDENTITY),
        Start("field zero, on its tail", zero, from_euler(0.0, 0.5 * math.pi, 0.0)),
        Start("on the reference, backwards", r, back),
    ]
    return tuple(starts)


def _hard(plan: Plan, name: str) -> Plan:
    """The same from the hard starts of its own reference, at rest."""
    starts = hard_starts(plan.trajectory, plan.k[0], plan.beta[0])
    return replace(
        plan,
        name=name,
        flights=len(starts),
        starts=starts,
        start_speed_m_s=_AT_REST,
        start_rate_rad_s=_AT_REST,
    )


def table(flights: int = TABLE_FLIGHTS, seed: int = 0) -> list[Plan]:
    """`global` from everywhere and in every difficulty, and the paper's law beside it."""
    random = Plan(
        name="global, random",
        flights=flights,
        seed=seed,
        law="global",
        speed_min_m_s=_FORWARD,
        start_speed_m_s=(0.0, 5.0),
        start_rate_rad_s=(0.0, 5.0),
    )
    fewer = replace(random, flights=max(1, flights // 10))
    lagging = replace(random, name="global, 100 ms of lag", rate_lag_s=(0.1, 0.1), speed_lag_s=(0.1, 0.1))
    fast = replace(fewer, name="global, helix at 0.9 v_max", trajectory=_FAST)
    circling = replace(
        fewer,
        name="global, v_min 1 m/s, circle at 2 m/s",
        trajectory=Circle(radius_m=10.0, speed_m_s=2.0),
        speed_min_m_s=(1.0, 1.0),
        duration_s=60.0,
    )
    paper = replace(fewer, name="paper, forward only", law="paper")
    reversing = replace(paper, name="paper, with reverse", speed_min_m_s=(-5.0, -5.0))
    return [
        random,
        _hard(random, "global, hard starts"),
        lagging,
        _hard(lagging, "global, hard starts, 100 ms of lag"),
        fast,
        _hard(fast, "global, hard starts, helix at 0.9 v_max"),
        replace(
            fewer,
            name="global, line at 0.9 v_max",
            trajectory=_FLEEING,
            duration_s=150.0,
            due_s=_FLEEING_DUE_S,
        ),
        circling,
        _hard(circling, "global, hard starts, v_min 1 m/s, circle"),
        paper,
        reversing,
        _hard(paper, "paper, forward only, hard starts"),
        _hard(reversing, "paper, with reverse, hard starts"),
    ]


#: Name -> campaigns, for as many flights as given, or as many as are usual, and a seed.
PRESETS: Final[dict[str, Callable[..., Sequence[Plan | VehiclePlan]]]] = {
    "table": table,
    "rover": vehicle_presets.rover,
    "airplane": vehicle_presets.airplane,
}
