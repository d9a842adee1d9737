"""What a rover must reach: tasks, limits, and how far these stretch when something is wrong.

A row is flown several times, with other noise; its figures are the worst of each. From `AWAY_M` off, the
distance is straight away from the circle, the farthest to go for a place at that distance but one behind it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import atan2, inf, pi, sqrt
from typing import Final

from guidance import error_function
from guidance.allocation import PITCH_YAW
from guidance.handling import ground
from guidance.handling.rover import Autopilot, handling
from guidance.law import PAPER, Gains, Parameters, desired_field
from guidance.se3 import Vec3
from guidance.trajectory import Circle, Lemniscate, Zigzag, sample
from sitl.models.files import load_rover
from sitl.scenarios.ground import Figures, Setting, Task, fly

CIRCLE: Final = Circle(radius_m=10.0, speed_m_s=2.0)
AWAY_M: Final = 15.0
LEG_M: Final = 20.0
ZIGZAG: Final = Zigzag(leg_m=LEG_M, speed_m_s=1.4 / sqrt(2.0))
CORNER_S: Final = LEG_M / ZIGZAG.speed_m_s
#: What the guide takes the time from a command to motion to be, s: the delay and the lag of the yaw rate.
KNOWN_DELAY_S: Final = 0.1


@dataclass(frozen=True)
class Limits:
    """Of `Figures`' fields, the largest allowed; inf is none."""

    converged_s: float = inf
    rms_m: float = inf
    max_m: float = inf
    corner_m: float = inf
    back_s: float = inf

    def stretched(self, factor: float) -> Limits:
        """All of them times `factor`."""
        return Limits(*(factor * getattr(self, item.name) for item in fields(self)))


@dataclass(frozen=True)
class Row:
    """A task, whether the reference waits in it, and what must be reached."""

    name: str
    task: Task
    limits: Limits
    waits: bool = False


@dataclass(frozen=True)
class Variation:
    """Something that is wrong, and how much more that allows."""

    name: str
    factor: float
    thrust_part: float = 1.0
    extra_delay_s: float = 0.0
    rate_hz: float = 50.0


@dataclass(frozen=True)
class Result:
    """The worst figures of a row's flights; `missed` names those beyond their limit."""

    row: Row
    variation: Variation
    figures: Figures
    limits: Limits
    missed: tuple[str, ...]


def _opposite_heading_rad(north_m: float, east_m: float) -> float:
    """The heading exactly opposite to the field of the circle's first instant there."""
    law = handling(Autopilot(), KNOWN_DELAY_S).law
    position = Vec3(north_m, east_m, 0.0)
    Xr = desired_field(law.gains, position, sample(CIRCLE, 0.0), law.error_function).Xr
    return atan2(Xr.y, Xr.x) + pi


_OUT: Final = CIRCLE.radius_m + AWAY_M

ROVER: Final = (
    Row(
        "circle r 10 m at 2 m/s",
        Task(CIRCLE, (8.0, 0.0, 0.5 * pi), 40.0, 12.0),
        Limits(converged_s=6.0, rms_m=0.03, max_m=0.06),
    ),
    Row(
        "lemniscate 20 x 10 m at 2 m/s",
        Task(Lemniscate(length_m=20.0, width_m=10.0, speed_m_s=2.0), (0.0, 0.0, 0.25 * pi), 55.0, 12.0),
        Limits(rms_m=0.05, max_m=0.12),
    ),
    Row(
        "zigzag, 90 degrees, 1.4 m/s",
        Task(ZIGZAG, (0.0, 0.0, 0.25 * pi), 55.0, 0.0, (CORNER_S, 2.0 * CORNER_S)),
        Limits(corner_m=2.6, back_s=4.0),
    ),
    Row(
        "zigzag, the reference waits",
        Task(ZIGZAG, (0.0, 0.0, 0.25 * pi), 55.0, 0.0, (CORNER_S, 2.0 * CORNER_S)),
        Limits(corner_m=1.5, back_s=4.0),
        waits=True,
    ),
    Row(
        "15 m off facing away",
        Task(CIRCLE, (_OUT, 0.0, 0.0), 25.0, 20.0),
        Limits(converged_s=9.0),
        waits=True,
    ),
    Row(
        "15 m off, exactly opposite",
        Task(CIRCLE, (_OUT, 0.0, _opposite_heading_rad(_OUT, 0.0)), 25.0, 20.0),
        Limits(converged_s=13.0),
        waits=True,
    ),
)

VARIATIONS: Final = (
    Variation("as it is", 1.0),
    Variation("WP_SPEED 30 % less", 1.5, thrust_part=0.7),
    Variation("WP_SPEED 30 % more", 1.5, thrust_part=1.3),
    Variation("160 ms more delay", 2.0, extra_delay_s=0.16),
    Variation("10 Hz", 1.5, rate_hz=10.0),
)


def fly_row(row: Row, variation: Variation, seeds: int = 3, model: str = "rover") -> Result:
    """Flown `seeds` times."""
    setting = Setting(
        load_rover(model),
        handling(Autopilot(), KNOWN_DELAY_S + variation.extra_delay_s, waits=row.waits),
        KNOWN_DELAY_S,
        rate_hz=variation.rate_hz,
        extra_delay_s=variation.extra_delay_s,
        thrust_part=variation.thrust_part,
    )
    flown = [fly(row.task, replace(setting, seed=seed)) for seed in range(seeds)]
    worst = replace(
        flown[0],
        **{
            item.name: max(getattr(figures, item.name) for figures in flown)
            for item in fields(Figures)
            if item.name != "trace"
        },
    )
    limits = row.limits.stretched(variation.factor)
    missed = tuple(
        item.name for item in fields(Limits) if not getattr(worst, item.name) <= getattr(limits, item.name)
    )
    return Result(row, variation, worst, limits, missed)


def in_words(result: Result) -> str:
    """One line: what was reached of what is allowed, and what was missed."""
    parts = []
    for item in fields(Limits):
        limit = getattr(result.limits, item.name)
        if limit < inf:
            mark = " MISSED" if item.name in result.missed else ""
            parts.append(f"{item.name} {getattr(result.figures, item.name):.3g}/{limit:.3g}{mark}")
    return f"{result.row.name:30} {result.variation.name:20} " + ", ".join(parts)


def paper_handling() -> ground.Parameters:
    """The paper's law and gains (section 4) on the rover's ranges, and nothing around them."""
    plain = handling(Autopilot(), KNOWN_DELAY_S)
    limits = plain.law.limits._replace(
        speed_min_m_s=-plain.law.limits.speed_max_m_s,
        acceleration_m_s2=inf,
        yaw_acceleration_rad_s2=inf,
    )
    return plain._replace(
        law=Parameters(PAPER, PITCH_YAW, Gains(1.0, 10.0, 10.0, 1.0), error_function.PAPER, limits),
        crawl_m_s=0.0,
        lateral_acceleration_m_s2=inf,
        yaw_gain=1.0,
        smoothing=plain.smoothing._replace(time_constant_s=0.0),
        slip=plain.slip._replace(bound_rad=0.0),
        speed_loop=plain.speed_loop._replace(kp=0.0, ki=0.0),
    )
