"""Named campaigns: the table that sets the laws side by side, from random and from hard starts."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from guidance.se3 import IDENTITY, Quaternion, Vec3, from_euler, from_yaw
from guidance.trajectory import Circle, Helix
from sitl.campaign.plan import Plan, Start

#: Flights of the table's first row; each of the other random rows has a tenth of it.
TABLE_FLIGHTS: Final = 1_000_000

_FORWARD: Final = (0.0, 0.0)


def hard_starts() -> tuple[Start, ...]:
    """Where a law for forward flight can be caught out, on the helix of section 4 with k = beta = 1.

    At t = 0 the reference is at (0, 1, 0) with velocity (0.1, 0, 0.1), so that Xr = (0.1, 1, 0.1) - x. The
    opposite field is so exactly, in floating point, and the orthogonal one to rounding.
    """
    starts = []
    for far in (1.0, 5.0, 20.0, 50.0):
        # Xr = (far, 0, 0)
        south = Vec3(0.1 - far, 1.0, 0.1)
        starts += [
            Start(f"exactly opposite, {far:g} m", south, Quaternion(0.0, 0.0, 0.0, 1.0)),
            Start(f"exactly opposite, on its back, {far:g} m", south, Quaternion(0.0, 0.0, 1.0, 0.0)),
            Start(f"field orthogonal, right, {far:g} m", south, from_yaw(-0.5 * math.pi)),
            Start(f"field orthogonal, above, {far:g} m", south, from_euler(0.0, -0.5 * math.pi, 0.0)),
            # Ahead of the reference on the helix's axis, flying away along it; and about to meet it.
            Start(
                f"ahead on the axis, away, {far:g} m",
                Vec3(0.0, 0.0, far),
                from_euler(0.0, -0.5 * math.pi, 0.0),
            ),
            Start(
                f"ahead on the axis, towards, {far:g} m",
                Vec3(0.0, 0.0, far),
                from_euler(0.0, 0.5 * math.pi, 0.0),
            ),
            # Ahead of the reference on its tangent, at rest, nose away from it.
            Start(
                f"ahead on the tangent, {far:g} m",
                Vec3(far * math.sqrt(0.5), 1.0, far * math.sqrt(0.5)),
                from_euler(0.0, -0.25 * math.pi, 0.0),
            ),
        ]
    zero = Vec3(0.1, 1.0, 0.1)
    starts += [
        Start("field zero", zero, IDENTITY),
        Start("field zero, on its tail", zero, from_euler(0.0, 0.5 * math.pi, 0.0)),
        Start("on the reference, backwards", Vec3(0.0, 1.0, 0.0), from_euler(0.0, 0.25 * math.pi, math.pi)),
    ]
    return tuple(starts)


def table(flights: int = TABLE_FLIGHTS, seed: int = 0) -> list[Plan]:
    """`global` from everywhere and in every difficulty, and the paper's law beside it."""
    random = Plan(
        name="global, random",
        flights=flights,
        seed=seed,
        law="global",
        speed_min_m_s=_FORWARD,
    )
    fewer = replace(random, flights=max(1, flights // 10))
    hard = hard_starts()
    on_hard = replace(random, flights=len(hard), starts=hard)
    return [
        random,
        replace(on_hard, name="global, hard starts"),
        replace(
            fewer,
            name="global, reference at 0.9 v_max",
            trajectory=Helix(radius_m=20.0, speed_m_s=math.sqrt(4.5**2 - 0.1**2), down_m_s=0.1),
            duration_s=150.0,
        ),
        replace(fewer, name="global, 100 ms of lag", rate_lag_s=(0.1, 0.1), speed_lag_s=(0.1, 0.1)),
        replace(
            on_hard, name="global, hard starts, 100 ms of lag", rate_lag_s=(0.1, 0.1), speed_lag_s=(0.1, 0.1)
        ),
        replace(
            fewer,
            name="global, v_min 1 m/s, circle at 2 m/s",
            trajectory=Circle(radius_m=10.0, speed_m_s=2.0),
            speed_min_m_s=(1.0, 1.0),
            duration_s=60.0,
        ),
        replace(fewer, name="paper, forward only", law="paper"),
        replace(fewer, name="paper, with reverse", law="paper", speed_min_m_s=(-5.0, -5.0)),
        replace(on_hard, name="paper, forward only, hard starts", law="paper"),
        replace(on_hard, name="paper, with reverse, hard starts", law="paper", speed_min_m_s=(-5.0, -5.0)),
    ]


#: Name -> (flights, seed) -> campaigns.
PRESETS: Final[dict[str, Callable[[int, int], list[Plan]]]] = {"table": table}
