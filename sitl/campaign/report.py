"""What a campaign found, as figures and as a table."""

from __future__ import annotations

from typing import Final, TypedDict

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from sitl.campaign.flight import Rows
from sitl.campaign.plan import Plan
from sitl.campaign.run import Result

_QUANTILES: Final = {"median": 0.5, "p90": 0.9, "p99": 0.99, "p999": 0.999, "max": 1.0}

#: So many flights are named with what was drawn for them.
_WORST: Final = 5

Quantiles = dict[str, float | None]


class Summary(TypedDict):
    """`converged`: the part of the flights below the radius for good; `in_time`: within `due_s`.

    `left`: those that were below it and are not for good. Times are of those that converged, excursions
    (largest error after the first entry) of those that entered, errors of all; `saturated` is the part of
    a flight's setpoints at a limit, `reversed` that of the flights that were asked backwards. Largest
    errors and slowest airspeeds are of vehicles. `outcome` counts flights by what became of them, `worst`
    has what was drawn for a few that did not converge, or else of the largest RMS.
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
    max_m: Quantiles
    saturated: Quantiles
    reversed: float
    airspeed_min_m_s: float | None
    singular_flights: float
    not_converged: list[int]
    outcome: dict[str, int]
    worst: list[dict[str, float]]


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
        max_m=_quantiles(result.outcome("max_m")),
        saturated=_quantiles(_saturated(result)),
        reversed=float(((result.outcome("reverse_steps") > 0) | (result.outcome("reverse_m_s") > 0)).mean()),
        airspeed_min_m_s=_lowest(result.outcome("airspeed_min_m_s")),
        singular_flights=float((result.outcome("singular_steps") > 0.0).mean()),
        not_converged=[int(index) for index in np.flatnonzero(~converged)[:20]],
        outcome=outcomes(result),
        worst=_worst(result),
    )


def outcomes(result: Result) -> dict[str, int]:
    """How many flights ended how: the first that holds of each, in this order."""
    entered = np.isfinite(result.outcome("entered_s"))
    left = {
        "not finite": result.outcome("finite") == 0.0,
        "in the ground": result.outcome("height_min_m") <= 0.0,
        "stuck": result.outcome("stuck") > 0.0,
        "converged": result.converged(),
        "left again": entered,
        "never there": ~entered,
    }
    found: dict[str, int] = {}
    open_ = np.ones(result.plan.flights, np.bool_)
    for name, holds in left.items():
        found[name] = int((open_ & holds).sum())
        open_ &= ~holds
    return found


def _saturated(result: Result) -> Rows:
    """The part of a flight's setpoints."""
    if isinstance(result.plan, Plan):
        return result.outcome("saturated_steps") / (result.plan.steps + 1)
    return result.outcome("saturated")


def _worst(result: Result) -> list[dict[str, float]]:
    """Up to five flights with what was drawn for them."""
    rms_m = np.where(np.isnan(result.outcome("rms_m")), np.inf, result.outcome("rms_m"))
    order = np.lexsort((-rms_m, result.converged()))[:_WORST]
    return [
        {"flight": int(i), **{name: float(values[i]) for name, values in result.parameters.items()}}
        for i in order
    ]


def _lowest(values: Rows) -> float | None:
    finite = values[np.isfinite(values)]
    return float(finite.min()) if len(finite) else None


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
    driven = [found for found in summaries if found["max_m"]["max"] is not None]
    if driven:
        _show_driven(driven, console)


def _show_driven(summaries: list[Summary], console: Console) -> None:
    """What is known of vehicles beside: how well they track once there, and what they ran into."""
    table = Table(
        title="After convergence, or over the second half; flights in the order of their RMS and maximum.",
        title_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    table.add_column("campaign")
    for heading in (
        "RMS median",
        "99 %",
        "worst",
        "largest error",
        "99 %",
        "saturated",
        "slowest in the air",
    ):
        table.add_column(heading, justify="right")
    table.add_column("ended")
    for found in summaries:
        rms, largest, slowest = found["rms_m"], found["max_m"], found["airspeed_min_m_s"]
        table.add_row(
            found["name"],
            *(_metres(rms[part]) for part in ("median", "p99", "max")),
            *(_metres(largest[part]) for part in ("median", "p99")),
            f"{100.0 * (found['saturated']['median'] or 0.0):.1f} %",
            "-" if slowest is None else f"{slowest:.1f} m/s",
            ", ".join(f"{count} {name}" for name, count in found["outcome"].items() if count),
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
