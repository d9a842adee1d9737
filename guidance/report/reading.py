"""Several logs read and judged, with a bar on a terminal and a line for each elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from guidance.report.flight import Flight, NoFlightError, ReportError, read_flight
from guidance.report.judged import judged
from guidance.report.panels import Shown
from guidance.telemetry.log import NotALog

#: A name that fits beside an axis.
_SHORT = 20


def read_all(
    logs: Sequence[Path], converged_m: float | None, refuse: Callable[[object, int], typer.Exit]
) -> list[Shown]:
    """Each log with its figures, in order; `refuse` makes the exit for one that cannot be reported on."""
    console = Console(stderr=True, soft_wrap=True, highlight=False)
    bar = Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    read = []
    with bar:
        for path in logs:
            try:
                flight = _read(path, bar)
            except NoFlightError as error:
                raise refuse(error, 1) from None
            except (NotALog, ReportError) as error:
                raise refuse(error, 2) from None
            read.append((flight, [judged(flight, stretch, converged_m) for stretch in flight.stretches]))
            if flight.incomplete:
                sys.stderr.write(f"guidance: {flight.incomplete}; reporting on what is there\n")
            if not console.is_terminal:
                sys.stderr.write(f"{path}: {len(flight.columns.sent_ns)} setpoints read\n")
    labels = labels_of([flight for flight, _ in read])
    return [Shown(label, *one) for label, one in zip(labels, read, strict=True)]


def labels_of(flights: Sequence[Flight]) -> list[str]:
    """The vehicle's name for one flight; for several the files' names where they are short, else letters."""
    if len(flights) == 1:
        return [flights[0].session.vehicle]
    names = [flight.path.stem for flight in flights]
    if len(set(names)) == len(names) and max(map(len, names)) <= _SHORT:
        return names
    return [
        f"{chr(ord('A') + i % 26)}{i // 26 or ''} {flight.session.vehicle}"
        for i, flight in enumerate(flights)
    ]


def _read(path: Path, bar: Progress) -> Flight:
    tasks: dict[Path, int] = {}

    def passed(part: Path, done: int) -> None:
        if part not in tasks:
            tasks[part] = bar.add_task(part.name, total=part.stat().st_size)
        bar.update(tasks[part], completed=done)  # type: ignore[arg-type]

    return read_flight(path, passed)
