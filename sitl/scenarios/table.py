"""Profile by task: what must be reached, what was, and what that allows when something is wrong.

A row is flown several times, with other noise; its figures are the worst of each.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from math import inf
from pathlib import Path
from typing import Any, Final

from sitl.scenarios.flight import DEPLOY, Figures, NotFlownError, Task, fly


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Of `Figures`' fields, the largest allowed; inf is none. For an airspeed, the smallest."""

    converged_s: float = inf
    rms_m: float = inf
    max_m: float = inf
    corner_m: float = inf
    back_s: float = inf
    reverse_m_s: float = inf
    saturated: float = inf
    airspeed_min_m_s: float = -inf

    def stretched(self, factor: float) -> Limits:
        """All that bound an error or a time, times `factor`."""
        names = ("converged_s", "rms_m", "max_m", "corner_m", "back_s")
        return replace(self, **{name: factor * getattr(self, name) for name in names})

    def missed(self, figures: Figures) -> tuple[str, ...]:
        """The names of those that are not kept."""
        below = self.airspeed_min_m_s > figures.airspeed_min_m_s
        over = [
            item.name
            for item in fields(self)
            if item.name != "airspeed_min_m_s" and not getattr(figures, item.name) <= getattr(self, item.name)
        ]
        return (*over, *(["airspeed_min_m_s"] if below else []))


@dataclass(frozen=True, kw_only=True)
class Variation:
    """Something that is wrong, and how much more that allows."""

    name: str
    factor: float = 1.0
    settings: tuple[str, ...] = ()
    vehicle: Mapping[str, Any] = field(default_factory=dict)
    speed_part: float = 1.0
    link_delay_s: float = 0.0

    def of(self, task: Task) -> Task:
        """The same task, so."""
        return replace(
            task,
            settings=(*task.settings, *self.settings),
            vehicle={**task.vehicle, **self.vehicle},
            speed_part=self.speed_part,
            link_delay_s=self.link_delay_s,
        )


#: What each figure is called, and its unit.
SAID: Final = {
    "converged_s": ("converged", " s"),
    "rms_m": ("RMS", " m"),
    "max_m": ("max", " m"),
    "corner_m": ("corner", " m"),
    "back_s": ("back", " s"),
    "reverse_m_s": ("reverse", " m/s"),
    "saturated": ("saturated", ""),
    "airspeed_min_m_s": ("least airspeed", " m/s"),
}
AS_IT_IS = Variation(name="as it is")


@dataclass(frozen=True, kw_only=True)
class Row:
    """A task, what must be reached, and what may be wrong meanwhile."""

    name: str
    task: Task
    limits: Limits
    variations: tuple[Variation, ...] = (AS_IT_IS,)


@dataclass(frozen=True)
class Result:
    """The worst figures of a row's flights, None if one was not flown; `missed` says what was not reached."""

    row: Row
    variation: Variation
    limits: Limits
    figures: Figures | None
    missed: tuple[str, ...]


Flights = Callable[[Task, int, Path], Figures]


def fly_row(row: Row, variation: Variation = AS_IT_IS, seeds: int = 3, directory: Path = DEPLOY) -> Result:
    """Flown `seeds` times."""
    task, limits = variation.of(row.task), row.limits.stretched(variation.factor)
    try:
        flown = [fly(task, seed, directory) for seed in range(seeds)]
    except NotFlownError as error:
        return Result(row, variation, limits, None, (str(error),))
    worst = worst_of(flown)
    return Result(row, variation, limits, worst, limits.missed(worst))


def worst_of(flown: list[Figures]) -> Figures:
    """Of each figure the worst; the trace is the first flight's."""
    names = [item.name for item in fields(Figures) if item.name not in ("trace", "airspeed_min_m_s")]
    worst = {name: max(getattr(figures, name) for figures in flown) for name in names}
    lowest = min(figures.airspeed_min_m_s for figures in flown)
    return replace(flown[0], **worst, airspeed_min_m_s=lowest)


def in_words(result: Result) -> str:
    """What was reached of what is allowed, and what was missed."""
    if result.figures is None:
        return f"not flown: {result.missed[0]}"
    parts = []
    for item in fields(Limits):
        limit = getattr(result.limits, item.name)
        if abs(limit) < inf:
            mark = " MISSED" if item.name in result.missed else ""
            said, unit = SAID[item.name]
            figure = max(getattr(result.figures, item.name), 0.0)
            parts.append(f"{said} {figure:.3g}/{limit:.3g}{unit}{mark}")
    return ", ".join(parts)
