"""Figures 1 to 4 drawn as in the paper, as PNG and SVG; needs matplotlib, of the extra `sitl`.

The same numbers give the same files. What the paper's figures cannot show at their scale (the error after
a corner of (15) is a hundredth of the one at the start) stands in an inset.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

_SIZE_INCH: Final = (6.4, 4.4)
_UPRIGHT_INCH: Final = (5.0, 7.2)
_DOTS_PER_INCH: Final = 150
#: Black first and told apart by their dashes too, as in print.
_STYLES: Final = (("black", "-"), ("tab:red", "--"), ("tab:blue", "-."))
#: How long after the start, and after each corner, an inset shows.
_START_S: Final = 10.0
_AFTER_CORNER_S: Final = 5.0
#: How much of the plane the inset at a corner shows.
_CORNER_M: Final = 1.5


def write(numbers: dict[str, Any], directory: Path) -> list[Path]:
    """Draw what `sitl.paper.report` gave into `directory`, as figure-N.png and figure-N.svg.

    Raises:
        OSError: the directory or a file cannot be written.
    """
    directory.mkdir(parents=True, exist_ok=True)
    with rc_context({"svg.hashsalt": "section 4", "svg.fonttype": "none", "font.size": 10.0}):
        figure = _location(numbers) if numbers["figure"] == 4 else _error(numbers)
        paths = [directory / f"figure-{numbers['figure']}.{suffix}" for suffix in ("png", "svg")]
        figure.savefig(paths[0], dpi=_DOTS_PER_INCH)
        figure.savefig(paths[1], metadata={"Date": None})
    return paths


def _sheet(numbers: dict[str, Any], size_inch: tuple[float, float] = _SIZE_INCH) -> tuple[Figure, Axes]:
    figure = Figure(figsize=size_inch, layout="constrained")
    axes = figure.add_subplot()
    caption = numbers["parameters"]["caption"].replace(", x(0)", ",\nx(0)")
    axes.set_title(f"Fig. {numbers['figure']}. {caption}", fontsize=8.0)
    axes.tick_params(direction="in", top=True, right=True)
    return figure, axes


def _error(numbers: dict[str, Any]) -> Figure:
    """Figures 1 to 3: the components of r - x over time."""
    figure, axes = _sheet(numbers)
    t, error = np.asarray(numbers["t"]), np.asarray(numbers["error"])
    for axis in range(error.shape[1]):
        color, dashes = _STYLES[axis]
        label = f"$r_{axis + 1} - x_{axis + 1}$"
        axes.plot(t, error[:, axis], color=color, linestyle=dashes, linewidth=1.2, label=label)
    axes.set_xlim(0.0, numbers["parameters"]["end_s"])
    axes.set_xlabel("t (s)")
    axes.set_ylabel("r(t) - x(t) (m)")
    corners = numbers["parameters"]["corners_s"]
    axes.legend(loc="upper right" if not corners else "lower right", frameon=False)
    if corners:
        for corner, left in zip(corners, (0.26, 0.66), strict=True):
            _inset(axes, (left, 0.36, 0.31, 0.32), t, error, corner - 1.0, corner + _AFTER_CORNER_S)
    else:
        _inset(axes, (0.3, 0.2, 0.6, 0.45), t, error, 0.0, _START_S)
    return figure


def _inset(
    axes: Axes,
    bounds: tuple[float, float, float, float],
    t: np.ndarray[Any, Any],
    error: np.ndarray[Any, Any],
    start_s: float,
    end_s: float,
) -> None:
    """The same curves from `start_s` to `end_s`, with a scale of their own."""
    shown = (t >= start_s) & (t <= end_s)
    inset = axes.inset_axes(bounds)
    for axis in range(error.shape[1]):
        color, dashes = _STYLES[axis]
        inset.plot(t[shown], error[shown, axis], color=color, linestyle=dashes, linewidth=1.0)
    inset.set_xlim(start_s, end_s)
    inset.tick_params(labelsize=7.0, direction="in")


def _location(numbers: dict[str, Any]) -> Figure:
    """Figure 4: reference and vehicle in the plane, to one scale, and how the first corner is cut."""
    figure, axes = _sheet(numbers, _UPRIGHT_INCH)
    reference, position = np.asarray(numbers["reference"]), np.asarray(numbers["position"])
    corner = numbers["parameters"]["reference"]["leg_m"]
    inset = axes.inset_axes((0.66, 0.08, 0.3, 0.2))
    for plot in (axes, inset):
        plot.plot(*reference.T, color="tab:red", alpha=0.4, linewidth=4.0, label="reference r")
        plot.plot(*position.T, color="black", linewidth=1.2, label="vehicle x")
        plot.set_aspect("equal")
    for name, start, color in (("x(0)", position[0], "black"), ("r(0)", reference[0], "tab:red")):
        axes.plot(*start, marker="o", color=color, markersize=5.0)
        axes.annotate(name, start, textcoords="offset points", xytext=(7, -2), fontsize=8.0)
    axes.set_xlim(-5.0, 55.0)
    axes.set_ylim(-5.0, 105.0)
    inset.set_xlim(corner - _CORNER_M, corner + 0.5 * _CORNER_M)
    inset.set_ylim(corner - 0.75 * _CORNER_M, corner + 0.75 * _CORNER_M)
    inset.tick_params(labelsize=7.0, direction="in")
    axes.set_xlabel("$x_1$ (m)")
    axes.set_ylabel("$x_2$ (m)")
    axes.legend(loc="center right", frameon=False)
    return figure
