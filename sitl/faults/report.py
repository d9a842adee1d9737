"""What came of the faults, as a table for people and as JSON for scripts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from rich import box
from rich.table import Table

from sitl.faults.fault import Expected, Fault
from sitl.faults.run import Outcome


def as_json(fault: Fault, outcome: Outcome, seed: int) -> dict[str, Any]:
    """One row with what was expected and what came."""
    found = outcome._asdict()
    return {
        "title": found.pop("title"),
        "firmware": found.pop("firmware"),
        "passed": outcome.passed,
        "seed": seed,
        "begins": fault.begin.value,
        "expected": _expected(fault.expected),
        "found": found,
    }


def _expected(expected: Expected) -> dict[str, Any]:
    """Sets as sorted lists; what is not bounded is left out."""
    listed: dict[str, Any] = {}
    for name, value in expected._asdict().items():
        if isinstance(value, frozenset):
            if value:
                listed[name] = sorted(value)
        elif math.isfinite(value):
            listed[name] = value
    return listed


def table(faults: Sequence[Fault], outcomes: Sequence[Outcome]) -> Table:
    """One line a fault, and one more for each thing that is not as it should be."""
    shown = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in ("fault", "vehicle", "goes"):
        shown.add_column(heading, overflow="fold")
    for heading in ("left after", "off by"):
        shown.add_column(heading, justify="right")
    shown.add_column("verdict")
    for fault, outcome in zip(faults, outcomes, strict=True):
        left = "-" if outcome.left_after_s is None else f"{outcome.left_after_s:.2f} s"
        shown.add_row(
            fault.title,
            fault.vehicle_name,
            " > ".join(_briefly(outcome.states)),
            left,
            f"{outcome.deviation_m:.3f} m",
            "pass" if outcome.passed else "[bold red]FAIL[/]",
        )
        for problem in outcome.problems:
            shown.add_row(f"  ! {problem}", "", "", "", "", "", style="red")
    return shown


def _briefly(states: Sequence[str]) -> Sequence[str]:
    return states if len(states) <= 4 else (states[0], "...", *states[-2:])


def listed(faults: Sequence[Fault]) -> Table:
    """What there is, and what is expected of each."""
    shown = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in ("fault", "vehicle", "begins", "ends", "must tell", "never"):
        shown.add_column(heading, overflow="fold")
    for fault in faults:
        expected = fault.expected
        columns = (expected.states, expected.told, expected.never)
        shown.add_row(
            fault.title, fault.vehicle_name, fault.begin, *(", ".join(sorted(column)) for column in columns)
        )
    return shown
