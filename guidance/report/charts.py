"""Panels, paths and timelines as charts of plotly.js: plain data, drawn by the page.

Numbers travel as little-endian float32 in base64, which plotly.js reads as it stands; NaN breaks a line.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from guidance.report import looks
from guidance.report.columns import Floats
from guidance.report.panels import Section
from guidance.report.paths import Path3, box_of, lowest_m
from guidance.report.timeline import Timeline, kinds_of

Chart = dict[str, Any]

_ROW_PX: Final = 190
_TOP_PX: Final = 54
_BOTTOM_PX: Final = 54
_FONT: Final = {"family": "system-ui, 'Segoe UI', 'Helvetica Neue', Arial, sans-serif", "size": 12}


def section_chart(section: Section, several: bool) -> Chart:
    """A section's panels above one another, or in columns; those above one another zoom together."""
    rows = math.ceil(len(section.panels) / section.columns)
    layout = _layout(_TOP_PX + _BOTTOM_PX + rows * _ROW_PX + (rows - 1) * 20)
    data: list[Chart] = []
    legend: set[str | int] = set()
    shared = section.columns == 1
    for i, panel in enumerate(section.panels):
        row, column = divmod(i, section.columns)
        n = "" if i == 0 else str(i + 1)
        left, right = _domain(column, section.columns, 0.075)
        bottom, top = _domain(rows - 1 - row, rows, 0.055 if shared else 0.16)
        x_axis: Chart = {**_axis(panel.x_label), "domain": [left, right], "anchor": f"y{n}"}
        y_axis: Chart = {**_axis(panel.y_label), "domain": [bottom, top], "anchor": f"x{n}"}
        if shared:
            x_axis["matches"] = "x"
            if row < rows - 1:
                x_axis |= {"showticklabels": False, "title": None}
        if panel.log_y:
            y_axis |= {"type": "log", "dtick": 1, "exponentformat": "power"}
            if panel.floor is not None:
                y_axis |= {"range": [math.log10(panel.floor), math.log10(200.0)]}
                x_axis |= {"rangemode": "tozero"}
        layout |= {f"xaxis{n}": x_axis, f"yaxis{n}": y_axis}
        title = {"text": panel.title, "x": left, "y": top, "xref": "paper", "yref": "paper"}
        layout["annotations"].append(
            {**title, "xanchor": "left", "yanchor": "bottom", "showarrow": False, "font": {"size": 12.5}}
        )
        for line in panel.lines:
            data.append(
                {
                    "type": "scatter",
                    "mode": "lines",
                    "name": _plain(line.name),
                    "legendgroup": str(line.role),
                    "showlegend": line.role not in legend,
                    "legendrank": looks.rank(line.role),
                    "x": packed(line.x),
                    "y": packed(line.y),
                    "xaxis": f"x{n}",
                    "yaxis": f"y{n}",
                    "line": {
                        "color": looks.colour(line.role),
                        "width": 2.2 if line.role == "demanded" else 1.3,
                    },
                    "hovertemplate": "%{y:.4g}<extra>" + _plain(line.name) + "</extra>",
                }
            )
            legend.add(line.role)
    layout["showlegend"] = len(legend) > 1 or several
    return {"data": data, "layout": layout}


def plan_chart(paths: Sequence[Path3], fence: Floats | None) -> Chart:
    """Seen from above: east to the right, north up, one scale."""
    data: list[Chart] = []
    if fence is not None:
        line = {"color": looks.FENCE, "width": 1.5, "dash": "dash"}
        data.append({"type": "scatter", "mode": "lines", "name": "fence", "line": line, **_east_north(fence)})
    data += _drawn(paths, space=False)
    layout = _layout(520)
    box = box_of([place for path in paths for place in (path.reference, path.flown)], fence)
    layout |= {
        "xaxis": {**_axis("east, m"), "constrain": "domain", "range": box.ranges[0]},
        "yaxis": {
            **_axis("north, m"),
            "range": box.ranges[1],
            "scaleanchor": "x",
            "scaleratio": 1.0,
            "constrain": "domain",
        },
        "hovermode": "closest",
    }
    return {"data": data, "layout": layout}


def space_chart(paths: Sequence[Path3], fence: Floats | None) -> Chart:
    """The same in space, to be turned."""
    data = _drawn(paths, space=True)
    if fence is not None:
        line = {"color": looks.FENCE, "width": 3, "dash": "dash"}
        up = [lowest_m(paths)] * len(fence)
        data.append(
            {
                "type": "scatter3d",
                "mode": "lines",
                "name": "fence",
                "line": line,
                "z": up,
                **_east_north(fence),
            }
        )
    layout = _layout(520)
    box = box_of([place for path in paths for place in (path.reference, path.flown)], fence)
    layout["scene"] = {
        "xaxis": {**_axis("east, m"), "range": box.ranges[0]},
        "yaxis": {**_axis("north, m"), "range": box.ranges[1]},
        "zaxis": {**_axis("height, m"), "range": box.ranges[2], "nticks": 5},
        "aspectmode": "manual",
        "aspectratio": dict(zip("xyz", box.sides, strict=True)),
        "camera": {"eye": {"x": -1.0, "y": -1.4, "z": 0.9}},
    }
    layout["margin"] = {"l": 0, "r": 0, "t": 40, "b": 0}
    return {"data": data, "layout": layout}


def timeline_chart(timelines: Sequence[Timeline]) -> Chart:
    """States as bars, one row for each log, events as marks on it."""
    data: list[Chart] = []
    kinds = kinds_of(timelines)
    for row, line in enumerate(timelines):
        for shade, states in kinds.items():
            bars = [bar for bar in line.bars if looks.shade(bar.state) == shade]
            if row and not bars:
                continue
            data.append(
                {
                    "type": "bar",
                    "orientation": "h",
                    "name": _plain(states),
                    "legendgroup": shade,
                    "showlegend": row == 0,
                    "y": [_plain(line.label)] * len(bars),
                    "base": [bar.from_s for bar in bars],
                    "x": [max(bar.to_s - bar.from_s, 0.0) for bar in bars],
                    "text": [_plain(f"{bar.state}: {bar.reason}") for bar in bars],
                    "textposition": "none",
                    "width": 0.5,
                    "marker": {"color": shade, "line": {"width": 0}},
                    "hovertemplate": "%{base:.2f} s, for %{x:.2f} s: %{text}<extra></extra>",
                }
            )
        dots = line.dots
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": "event",
                "showlegend": False,
                "x": [dot.at_s for dot in dots],
                "y": [_plain(line.label)] * len(dots),
                "text": [_plain(f"{dot.level}: {dot.text}") for dot in dots],
                "marker": {
                    "symbol": "diamond",
                    "size": 9,
                    "color": [looks.LEVELS[dot.level] for dot in dots],
                    "line": {"width": 1, "color": "white"},
                },
                "hovertemplate": "%{x:.2f} s: %{text}<extra></extra>",
            }
        )
    layout = _layout(130 + 62 * len(timelines))
    layout |= {
        "barmode": "overlay",
        "hovermode": "closest",
        "xaxis": _axis("time since tracking began, s"),
        "yaxis": {**_axis(""), "autorange": "reversed", "type": "category"},
    }
    return {"data": data, "layout": layout}


def packed(values: Floats) -> Chart:
    """Numbers as plotly.js takes them without parsing."""
    return {"dtype": "f4", "bdata": base64.b64encode(values.astype("<f4").tobytes()).decode()}


def _drawn(paths: Sequence[Path3], *, space: bool) -> list[Chart]:
    kind = "scatter3d" if space else "scatter"
    several = len(paths) > 1
    data: list[Chart] = []
    for i, path in enumerate(paths):
        ending = f" {_plain(path.label)}" if several else ""
        reference = {"color": looks.REFERENCE, "width": 4 if space else 2.6}
        flown = {"color": looks.LOGS[i % len(looks.LOGS)], "width": 3 if space else 1.4}
        once = {"showlegend": i == 0}
        lines: tuple[tuple[Chart, Floats, Chart], ...] = (
            (
                {"name": "reference", "legendgroup": "reference", "showlegend": i == 0},
                path.reference,
                reference,
            ),
            ({"name": f"path{ending}"}, path.flown, flown),
        )
        for named, places, line in lines:
            chart = {"type": kind, "mode": "lines", **named, "line": line}
            data.append({**chart, "hoverinfo": "x+y+z" if space else "x+y", **_places(places, space=space)})
        start: Chart = {"type": kind, "mode": "markers", "name": "start", "hoverinfo": "name"}
        start |= {"legendgroup": "start", **once}
        marker = {"color": looks.START, "size": 5 if space else 10, "symbol": "circle"}
        data.append({**start, "marker": marker, **_places(np.array([path.start]), space=space)})
        if path.marks:
            marks: Chart = {
                "type": kind,
                "mode": "markers",
                "name": f"events{ending}",
                "x": [mark.place[0] for mark in path.marks],
                "y": [mark.place[1] for mark in path.marks],
                "text": [_plain(f"{mark.after_s:.2f} s: {mark.text}") for mark in path.marks],
                "hoverinfo": "text",
                "marker": {
                    "color": [looks.LEVELS[mark.level] for mark in path.marks],
                    "size": 4 if space else 9,
                    "symbol": "diamond",
                },
            }
            data.append(marks | ({"z": [mark.place[2] for mark in path.marks]} if space else {}))
    return data


def _places(places: Floats, *, space: bool) -> Chart:
    found = {"x": packed(places[:, 0]), "y": packed(places[:, 1])}
    return found | {"z": packed(places[:, 2])} if space else found


def _east_north(corners: Floats) -> Chart:
    return {"x": packed(corners[:, 0]), "y": packed(corners[:, 1]), "hoverinfo": "name"}


def _layout(height_px: int) -> Chart:
    return {
        "height": height_px,
        "margin": {"l": 70, "r": 16, "t": _TOP_PX, "b": _BOTTOM_PX},
        "font": dict(_FONT),
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "hovermode": "x",
        "legend": {"orientation": "h", "x": 0.0, "y": 1.0, "yref": "container", "yanchor": "top"},
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": "#8c959f", "activecolor": "#2a7fc1"},
        "annotations": [],
    }


def _axis(title: str) -> Chart:
    return {"title": {"text": title, "standoff": 8}, "zeroline": False, "ticks": "outside", "ticklen": 4}


def _domain(place: int, count: int, between: float) -> tuple[float, float]:
    width = (1.0 - between * (count - 1)) / count
    start = place * (width + between)
    return start, min(start + width, 1.0)


def _plain(text: str) -> str:
    """Words of a log as plotly.js shows them, which reads some tags and templates."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace("%{", "% {")
