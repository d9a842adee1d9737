"""What a campaign found, as figures and as a table."""

from __future__ import annotations

from typing import Final, TypedDict

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from sitl.campaign.flight import Rows
from sitl.campaign.run import Result

_QUANTILES: Final = {"median": 0.5, "p90": 0.9, "p99": 0.99, "p999": 0.999, "max": 1.0}

Quantiles = dict[str, float | None]


class Summary(TypedDict):
    """`converged`: the part of the flights below the radius for good; `in_time`: within `due_s`.

    `left`: those that were below it and are not for good. Times are of those that converged, excursions
    (largest error after the first entry) of those that entered, errors of all.
    """

    name: str
    flights: int
    converged: float
    due_s: float
    in_time: float
    entered: float
    left: float
    not_finite: int
    settled_s: Quantiles
    final_error_m: Quantiles
    excursion_m: Quantiles
    rms_m: Quantiles
    singular_flights: float
    not_converged: list[int]


def summary(result: Result) -> Summary:
    """The figures of one campaign; `not_converged` names up to twenty of those flights by index."""
    converged = result.converged()
    entered = np.isfinite(result.outcome("entered_s"))
    settled_s = result.outcome("settled_s")
    return Summary(
        name=result.plan.name,
        flights=result.plan.flights,
        converged=float(converged.mean()),
        due_s=result.plan.due_s,
        in_time=float((settled_s <= result.plan.due_s).mean()),
        entered=float(entered.mean()),
        left=float((entered & ~converged).mean()),
        not_finite=int((result.outcome("finite") == 0.0).sum()),
        settled_s=_quantiles(settled_s[converged]),
        final_error_m=_quantiles(result.outcome("final_error_m")),
        excursion_m=_quantiles(result.outcome("excursion_m")[entered]),
        rms_m=_quantiles(result.outcome("rms_m")),
        singular_flights=float((result.outcome("singular_steps") > 0.0).mean()),
        not_converged=[int(index) for index in np.flatnonzero(~converged)[:20]],
    )


def _quantiles(values: Rows) -> Quantiles:
    finite = values[np.isfinite(values)]
    if not len(finite):
        return dict.fromkeys(_QUANTILES)
    found = np.quantile(finite, list(_QUANTILES.values()))
    return dict(zip(_QUANTILES, map(float, found), strict=True))


def show(summaries: list[Summary], within_m: float, console: Console) -> None:
    """The table."""
    title = (
        f"Converged: below {_metres(within_m)} for good. In time: by the time that the campaign sets. "
        "Left to: the largest error after a first entry."
    )
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("campaign")
    for heading in ("flights", "converged", "in time"):
        table.add_column(heading, justify="right")
    for heading in ("median", "99 %", "last"):
        table.add_column(f"{heading}, s", justify="right")
    for heading in ("median error", "worst", "left to"):
        table.add_column(heading, justify="right")
    for found in summaries:
        times, final, excursion = found["settled_s"], found["final_error_m"], found["excursion_m"]
        table.add_row(
            found["name"],
            f"{found['flights']:,}",
            _part(found["converged"], found["flights"]),
            f"{_part(found['in_time'], found['flights'])} in {found['due_s']:g} s",
            _seconds(times["median"]),
            _seconds(times["p99"]),
            _seconds(times["max"]),
            _metres(final["median"]),
            _metres(final["max"]),
            _metres(excursion["max"]),
        )
    console.print(table)


def _part(part: float, flights: int) -> str:
    """In percent, never rounded up to all: one flight of a million that fails must show."""
    if part == 1.0:
        return "all"
    missing = round((1.0 - part) * flights)
    return f"{100.0 * part:.2f} %" if missing * 1000 > flights else f"all but {missing}"


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _metres(value: float | None) -> str:
    if value is None:
        return "-"
    for factor, unit in ((1.0, "m"), (1e3, "mm"), (1e6, "um")):
        if value * factor >= 1.0 or unit == "um":
            return f"{value * factor:.3g} {unit}"
    raise AssertionError
