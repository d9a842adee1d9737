"""The region of attraction: which starts converge, and how soon."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sitl.campaign.plan import Plan
from sitl.campaign.run import Result

#: Cells along each axis for a hundred thousand flights and more; fewer flights have larger cells.
_MOST_CELLS: Final = 60
_FLIGHTS_PER_CELL: Final = 12


def write(results: list[Result], path: Path) -> None:
    """One row of panels per campaign: part that converged, median time, and the slowest in each cell.

    Start distance is across, the angle between nose and field up (of vehicles: between nose and the
    reference's course). Grey cells had no flight (or, for the times, none that converged).
    """
    matplotlib.rcParams["svg.hashsalt"] = "sitl"
    figure = Figure(figsize=(15.0, 3.6 * len(results) + 0.4), layout="constrained")
    axes = figure.subplots(len(results), 3, squeeze=False)
    for row, result in zip(axes, results, strict=True):
        _region(figure, row, result)
    figure.savefig(path, dpi=110)


def _region(figure: Figure, row: list[Axes], result: Result) -> None:
    distance = result.outcome("start_error_m")
    angle = np.degrees(result.outcome("start_heading_error_rad"))
    converged = result.converged()
    settled = result.outcome("settled_s")
    cells = int(np.clip(np.sqrt(len(distance) / _FLIGHTS_PER_CELL), 4, _MOST_CELLS))
    farthest = float(np.max(distance)) or 1.0
    x = np.linspace(0.0, farthest, cells + 1)
    y = np.linspace(0.0, 180.0, cells + 1)
    column = np.clip(np.searchsorted(x, distance, side="right") - 1, 0, cells - 1)
    line = np.clip(np.searchsorted(y, angle, side="right") - 1, 0, cells - 1)
    cell = line * cells + column
    count = np.bincount(cell, minlength=cells * cells)
    good = np.bincount(cell[converged], minlength=cells * cells)
    part = np.where(count > 0, good / np.maximum(count, 1), np.nan)
    median = np.full(cells * cells, np.nan)
    slowest = np.full(cells * cells, np.nan)
    order = np.lexsort((settled[converged], cell[converged]))
    times = settled[converged][order]
    ends = np.cumsum(good)
    has = good > 0
    median[has] = times[(ends - good + (good - 1) // 2)[has]]
    slowest[has] = times[(ends - 1)[has]]
    panels = (
        (part, f"{result.plan.name}: part that converged", "viridis", 0.0, 1.0),
        (median, "median time to settle, s", "magma_r", None, None),
        (slowest, "longest time to settle, s", "magma_r", None, None),
    )
    for axis, (values, title, colours, low, high) in zip(row, panels, strict=True):
        axis.set_facecolor("0.85")
        grid = np.ma.masked_invalid(values.reshape(cells, cells))
        image = axis.pcolormesh(x, y, grid, cmap=colours, vmin=low, vmax=high)
        figure.colorbar(image, ax=axis)
        axis.set_title(title, fontsize=10)
        axis.set_xlabel("distance from the reference at the start, m")
        from_what = "field" if isinstance(result.plan, Plan) else "course"
        axis.set_ylabel(f"nose off the {from_what}, deg")
        axis.set_yticks(range(0, 181, 45))
