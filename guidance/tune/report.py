"""Answers and proposals, as text for a terminal and as JSON for a script."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import Any

from rich.console import Console
from rich.table import Table

from guidance.tune.answer import Form, character
from guidance.tune.identify import Identified, Refused
from guidance.tune.propose import Line, Results, toml


def table(results: Results) -> Table:
    """One row a channel: each number with its standard error; below it, why there is none."""
    columns = ("channel", "form", "delay s", "gain", "slew /s", "tau s", "tau2 s", "late s", "over %", "rms")
    shown = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
    for number, column in enumerate(columns):
        shown.add_column(column, justify="left" if number < 2 else "right", no_wrap=True)
    for channel, result in results.items():
        if isinstance(result, Identified):
            shown.add_row(channel, *_cells(result))
    return shown


def show(results: Results, lines: Sequence[Line], console: Console) -> None:
    """Print table, refusals and the lines for the configuration file."""
    if any(isinstance(result, Identified) for result in results.values()):
        console.print(table(results))
    for channel, result in results.items():
        if isinstance(result, Refused):
            console.print(f"{channel}: not identified: {result.reason}", markup=False, soft_wrap=True)
    console.print()
    console.print(toml(lines), markup=False, highlight=False, soft_wrap=True, end="")


def as_json(results: Results, lines: Sequence[Line]) -> dict[str, Any]:
    """The same for a script; a slew limit that was not reached, and an unknown error, are null."""
    return {
        "channels": {
            channel: _object(result) if isinstance(result, Identified) else {"refused": result.reason}
            for channel, result in results.items()
        },
        "proposals": [line._asdict() for line in lines],
        "toml": toml(lines),
    }


def _cells(found: Identified) -> tuple[str, ...]:
    a, errors = found.answer, found.errors
    step = character(a, found.step)
    return (
        str(a.form),
        f"{a.delay_s:.3f} ±{errors.delay_s:.3f}",
        f"{a.gain:.3f} ±{errors.gain:.3f}",
        f"{a.slew:.2f} ±{errors.slew:.2f}" if a.slew < inf else "not reached",
        f"{a.tau_s:.3f} ±{errors.tau_s:.3f}",
        "-" if a.form is Form.ONE_LAG else f"{a.tau2_s:.3f}",
        f"{a.delay_s + step.lag_s:.2f}",
        f"{100.0 * step.overshoot:.0f}",
        f"{found.rms:.2g}",
    )


def _object(found: Identified) -> dict[str, Any]:
    step = character(found.answer, found.step)
    return {
        "answer": _finite(found.answer._asdict()),
        "errors": _finite(found.errors._asdict()),
        "spread": found.spread._asdict(),
        "rms": found.rms,
        "noise": found.noise,
        "step": found.step,
        "lag_s": step.lag_s,
        "overshoot": step.overshoot,
    }


def _finite(values: dict[str, Any]) -> dict[str, Any]:
    return {key: None if value == inf else value for key, value in values.items()}
