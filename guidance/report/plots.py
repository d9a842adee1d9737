"""The same panels as images, for a document: PNG by matplotlib."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from matplotlib import rc_context
from matplotlib.figure import Figure

from guidance.replacing import replacing
from guidance.report import looks
from guidance.report.columns import Floats
from guidance.report.panels import Section, Shown, sections_of
from guidance.report.paths import Path3, box_of, fences_of, lowest_m, paths_of
from guidance.report.timeline import Timeline, kinds_of, timeline_of

_DOTS_PER_INCH: Final = 150
_WIDTH_INCH: Final = 8.0
_STYLE: Final[dict[Any, Any]] = {
    "font.size": 9.0,
    "text.parse_math": False,  # a name may have dollars in it
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "axes.grid": True,
    "grid.color": "#e6eaee",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.edgecolor": "#8c959f",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
}


def write(shown: Sequence[Shown], directory: Path) -> list[Path]:
    """Draw plan.png, space.png, error.png, controls.png (one for each log), saturation.png, timeline.png and
    timing.png into `directory`.

    Raises:
        OSError: the directory or a file cannot be written.
        ValueError: nor can what has the name of one, such as a directory or a log.
    """
    directory.mkdir(parents=True, exist_ok=True)
    with rc_context(_STYLE):
        paths, fence = paths_of(shown), fences_of(shown)
        figures = {"plan": _plan(paths, fence), "space": _space(paths, fence)}
        titles = {"plan": "Path from above", "space": "Path", "timeline": "States and events"}
        for section in sections_of(shown):
            figures[section.key], titles[section.key] = section_figure(section), section.title
        figures["timeline"] = _timeline([timeline_of(one) for one in shown])
        made = []
        for name, figure in figures.items():
            whose = f"{shown[0].label}: " if len(shown) == 1 else ""
            figure.suptitle(f"{whose}{titles[name]}", x=0.01, horizontalalignment="left", fontsize=11.0)
            made.append(directory / f"{name}.png")
            with replacing(made[-1]) as fill:
                fill(partial(figure.savefig, dpi=_DOTS_PER_INCH))
    return made


def section_figure(section: Section) -> Figure:
    """The panels above one another, or in columns."""
    rows = math.ceil(len(section.panels) / section.columns)
    figure = Figure(figsize=(_WIDTH_INCH, 0.6 + 1.75 * rows), layout="constrained")
    shared = section.columns == 1
    grid = figure.subplots(rows, section.columns, sharex=shared, squeeze=False)
    legend: dict[str | int, Any] = {}
    for place, axes in enumerate(grid.flat):
        if place >= len(section.panels):
            axes.set_axis_off()
            continue
        panel = section.panels[place]
        for line in panel.lines:
            width = 1.8 if line.role == "demanded" else 1.0
            (drawn,) = axes.plot(line.x, line.y, color=looks.colour(line.role), linewidth=width)
            drawn.set_label(line.name)
            legend.setdefault(line.role, drawn)
        axes.set_title(panel.title)
        axes.set_ylabel(panel.y_label)
        if panel.log_y:
            axes.set_yscale("log")
            axes.yaxis.set_major_formatter("{x:g}")  # else it is a formula, and these are not parsed
            if panel.floor is not None:
                axes.set_ylim(panel.floor, 200.0)
                axes.set_xlim(left=0.0)
        if not shared or place == len(section.panels) - 1:
            axes.set_xlabel(panel.x_label)
    if len(legend) > 1:
        entries = [legend[role] for role in sorted(legend, key=looks.rank)]
        figure.legend(handles=entries, loc="outside lower left", ncols=min(len(legend), 4))
    return figure


def _plan(paths: Sequence[Path3], fence: Floats | None) -> Figure:
    figure = Figure(figsize=(6.0, 6.0), layout="constrained")
    axes = figure.add_subplot()
    if fence is not None:
        axes.plot(fence[:, 0], fence[:, 1], color=looks.FENCE, linestyle="--", linewidth=1.0, label="fence")
    for i, path in enumerate(paths):
        reference, flown = path.reference, path.flown
        axes.plot(reference[:, 0], reference[:, 1], color=looks.REFERENCE, linewidth=2.2, label="reference")
        axes.plot(flown[:, 0], flown[:, 1], color=looks.colour(i), linewidth=1.1, label=_named(path, paths))
        axes.plot(*path.start[:2], "o", color=looks.START, markersize=6.0, label="start")
        for mark in path.marks:
            shade = looks.LEVELS[mark.level]
            axes.plot(*mark.place[:2], "D", color=shade, markersize=4.0, label=mark.level)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    _explain(figure, axes)
    return figure


def _named(path: Path3, paths: Sequence[Path3]) -> str:
    return f"path {path.label}" if len(paths) > 1 else "path"


def _explain(figure: Figure, axes: Any) -> None:
    """A legend with each name once."""
    handles, names = axes.get_legend_handles_labels()
    entries = dict(zip(reversed(names), reversed(handles), strict=True))
    ordered = {name: entries[name] for name in names}
    figure.legend(ordered.values(), ordered.keys(), loc="outside lower left", ncols=4)


def _space(paths: Sequence[Path3], fence: Floats | None) -> Figure:
    figure = Figure(figsize=(6.5, 5.0))
    axes: Any = figure.add_axes((0.02, 0.02, 0.92, 1.0), projection="3d", computed_zorder=False)
    for i, path in enumerate(paths):
        axes.plot(*path.reference.T, color=looks.REFERENCE, linewidth=2.2, zorder=1, label="reference")
        label = _named(path, paths)
        axes.plot(*path.flown.T, color=looks.colour(i), linewidth=1.1, zorder=2, label=label)
        start = [[value] for value in path.start]
        axes.plot(*start, "o", color=looks.START, markersize=5.0, zorder=3, label="start")
    box = box_of([place for path in paths for place in (path.reference, path.flown)], fence)
    if fence is not None:
        axes.plot(
            *fence.T,
            lowest_m(paths),
            color=looks.FENCE,
            linestyle="--",
            linewidth=1.0,
            zorder=0,
            label="fence",
        )
    axes.set_box_aspect(box.sides)
    for axis, name, limits in zip("xyz", ("east", "north", "height"), box.ranges, strict=True):
        getattr(axes, f"set_{axis}lim")(limits)
        getattr(axes, f"set_{axis}label")(f"{name}, m")
        axes.locator_params(axis=axis, nbins=5)
    _explain(figure, axes)
    return figure


def _timeline(timelines: Sequence[Timeline]) -> Figure:
    figure = Figure(figsize=(_WIDTH_INCH, 1.3 + 0.5 * len(timelines)), layout="constrained")
    axes = figure.add_subplot()
    legend: dict[str, Any] = {}
    kinds = kinds_of(timelines)
    for row, line in enumerate(timelines):
        for bar in line.bars:
            shade = looks.shade(bar.state)
            drawn = axes.broken_barh([(bar.from_s, bar.to_s - bar.from_s)], (row - 0.25, 0.5), color=shade)
            legend.setdefault(kinds[shade], drawn)
        for dot in line.dots:
            axes.plot(
                dot.at_s, row, "D", color=looks.LEVELS[dot.level], markersize=4.0, markeredgecolor="white"
            )
    axes.set_yticks(range(len(timelines)), [line.label for line in timelines])
    axes.set_ylim(len(timelines) - 0.5, -0.5)
    axes.set_xlabel("time since tracking began, s")
    axes.grid(visible=False, axis="y")
    figure.legend(legend.values(), legend.keys(), loc="outside lower left", ncols=4)
    return figure
