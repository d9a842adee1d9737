"""What the service needs to know of the autopilot's own parameters: one row for each, in tables.

A row says between what a value must lie, in numbers or as keys of the configuration, and what follows if it
does not; a value that is not even `plausible` is taken for a mistake. Rows without either only name what the
value means: it is the operator's choice, to be known. The tables stand in `px4_requirements` and
`ardupilot_requirements`, and a profile names its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from enum import StrEnum
from operator import attrgetter
from typing import Final, NamedTuple

#: A number, or the dotted key of the configuration that gives it.
Bound = float | str

#: An exact value may differ by this part: for the float32 that it was kept in, and for what is rounded.
SAME: Final = 0.01
#: The float32 alone differs by no more than this part.
FLOAT32: Final = 1e-7


class Requirement(NamedTuple):
    """One parameter. `scale` times its value is in the unit of the bounds; 0 or less may stand for no limit.

    `why` says what happens if it is out of bounds, or has one of the `doubtful` meanings. `serious` is false
    where the vehicle flies all the same. What is `required` must be there, and what is outside of `plausible`
    (in its own unit) must be corrected, before the vehicle is flown. What is `used` shapes the setpoints.

    What one of `doubtful` would do does not come about while another parameter has the value of `unless`.
    Of a `quiet` one there is nothing to show as long as it is good.

    `older` names, the newest first, are asked for as well; `older_scale` times their value is the value under
    this name.
    """

    parameter: str
    why: str
    low: Bound | None = None
    high: Bound | None = None
    scale: float = 1.0
    unit: str = ""
    zero_is_no_limit: bool = False
    serious: bool = True
    meanings: Mapping[int, str] = {}
    doubtful: frozenset[int] = frozenset()
    unless: tuple[str, int] | None = None
    quiet: bool = False
    older: tuple[str, ...] = ()
    older_scale: float = 1.0
    plausible: tuple[float, float] | None = None
    required: bool = False
    used: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Those to ask for, the newest first."""
        return (self.parameter, *self.older)

    def value(self, answers: Mapping[str, float]) -> tuple[str, float] | None:
        """The name that was answered and the value in this row's unit; None if there is no answer."""
        if self.parameter in answers:
            return self.parameter, answers[self.parameter]
        older = next((name for name in self.older if name in answers), None)
        return None if older is None else (older, answers[older] * self.older_scale)


class Grade(StrEnum):
    """What a value comes to."""

    GOOD = "good"
    DOUBTFUL = "doubtful"
    BAD = "bad"
    ABSENT = "absent"


class Judged(NamedTuple):
    """One parameter, by the name that the autopilot knows: what was found, and what to do about it."""

    name: str
    grade: Grade
    found: str
    todo: str = ""

    def __str__(self) -> str:
        return f"{self.name} = {self.found}: {self.todo}" if self.todo else f"{self.name} = {self.found}"


def names_of(table: Iterable[Requirement]) -> list[str]:
    """What to ask for and in which order: what a flight waits for, the other rows, older names."""
    rows = sorted(table, key=lambda row: not row.required)
    return [row.parameter for row in rows] + [name for row in rows for name in row.older]


def partners_of(table: Iterable[Requirement]) -> dict[str, tuple[str, ...]]:
    """Of a parameter that has several names, to each the others."""
    several = [row.names for row in table if row.older]
    return {name: tuple(o for o in names if o != name) for names in several for name in names}


def values_of(table: Iterable[Requirement], answers: Mapping[str, float]) -> dict[str, float]:
    """What was answered, under the newest names and in their units; what is no limit is left out."""
    found = ((row, row.value(answers)) for row in table)
    return {
        row.parameter: value[1]
        for row, value in found
        if value is not None and not (row.zero_is_no_limit and value[1] <= 0.0)
    }


def judged(row: Requirement, answers: Mapping[str, float], config: object) -> Judged:
    """One parameter against what is needed, of `answers` that are complete.

    `config` is what the keys of bounds are looked up in.
    """
    found = row.value(answers)
    if found is None:
        older = f", and no {' or '.join(row.older)}" if row.older else ""
        text = f"the autopilot has no such parameter{older}"
        if not row.required:
            return Judged(row.parameter, Grade.ABSENT, text)
        todo = f"is this the firmware that the profile is for? {_sentence(row.why)}"
        return Judged(row.parameter, Grade.BAD, text, todo)
    name, value = found
    own = 1.0 if name == row.parameter else row.older_scale
    if not math.isfinite(value):
        return Judged(
            name, Grade.BAD, f"{value:g} is no value", f"set {name} anew: the memory of it is damaged"
        )
    shown = f"{_number(value / own)} {row.unit if own == 1.0 else ''}".rstrip()
    if row.meanings:
        return _meaning(row, name, value, shown, answers)
    if value <= 0.0 and row.zero_is_no_limit:
        return Judged(name, Grade.GOOD, "no limit")
    if row.plausible is not None and not _within(value, *row.plausible):
        low, high = (_number(bound / own) for bound in row.plausible)
        return Judged(
            name,
            Grade.BAD,
            f"{shown}, which cannot be: {low} to {high} may",
            f"set {name} to what the vehicle can do: {row.why}",
        )
    problem = _out_of_bounds(row, name, value, own, config)
    if problem is None:
        return Judged(name, Grade.GOOD, shown)
    grade = Grade.BAD if row.serious else Grade.DOUBTFUL
    return Judged(name, grade, f"{shown}, needs {problem[0]}", f"{problem[1]}: {row.why}")


def _within(value: float, low: float, high: float) -> bool:
    """A bound itself is within, rounded to the float32 that a parameter is."""
    return low - FLOAT32 * abs(low) <= value <= high + FLOAT32 * abs(high)


def _meaning(row: Requirement, name: str, value: float, shown: str, answers: Mapping[str, float]) -> Judged:
    meaning = row.meanings.get(round(value))
    if meaning is None:
        todo = f"look it up in the firmware's own list: {row.why}"
        return Judged(name, Grade.DOUBTFUL, f"{shown}: a meaning that is not known here", todo)
    moot = row.unless is not None and answers.get(row.unless[0]) == row.unless[1]
    if round(value) in row.doubtful and not moot:
        return Judged(name, Grade.DOUBTFUL, f"{shown}: {meaning}", row.why)
    return Judged(name, Grade.GOOD, f"{shown}: {meaning}")


def _out_of_bounds(
    row: Requirement, name: str, value: float, own: float, config: object
) -> tuple[str, str] | None:
    """What it should be, and how to get there; None if it is."""
    low, high = _bound(row.low, config), _bound(row.high, config)
    scaled = value * row.scale
    too_low = low is not None and scaled < low - SAME * abs(low)
    too_high = high is not None and scaled > high + SAME * abs(high)
    if not too_low and not too_high:
        return None
    bound, key = (low, row.low) if too_low else (high, row.high)
    assert bound is not None
    wanted = _number(bound / row.scale / own)
    least = "" if low == high else "at least " if too_low else "at most "
    todo = f"set {name} to {least}{wanted}"
    if isinstance(key, str):
        return f"{least}{wanted} for {key} = {bound:g}", f"{todo}, or {key} = {scaled:g}"
    return f"{least}{wanted}", todo


def _bound(bound: Bound | None, config: object) -> float | None:
    """A key that is not set sets no bound."""
    found: float | None = attrgetter(bound)(config) if isinstance(bound, str) else bound
    return found


def _number(value: float) -> str:
    return f"{value:g}"


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]
