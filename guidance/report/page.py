"""One HTML file that needs nothing else: plotly.js is written into it once."""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib import resources
from typing import Any, Final

from plotly.offline import get_plotlyjs

from guidance.report import charts, tables
from guidance.report.judged import as_json
from guidance.report.panels import Section, Shown, sections_of
from guidance.report.paths import fences_of, paths_of
from guidance.report.timeline import timeline_of

#: The browser itself refuses to ask anyone. plotly.js compiles its WebGL helpers: unsafe-eval.
_POLICY: Final = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:"
)


def page(shown: Sequence[Shown], comparison: tuple[str, list[Section]] | None = None) -> str:
    """The page of these flights. `comparison` is HTML of what another configuration would have commanded,
    and its panels."""
    several = len(shown) > 1
    drawn: dict[str, charts.Chart] = {}
    body = [_head(shown)]
    if comparison is not None:
        body.append(comparison[0])
        body += [_section(section, drawn, several=True) for section in comparison[1]]
    body.append("<h2>Figures</h2>")
    body.append(
        '<p class="caption">From all samples. Settled counts from five time constants (beta/k) after '
        "convergence; along and cross track are level, by the reference's course, and vertical is height.</p>"
    )
    body.append(tables.figures_table(shown))
    paths, fence = paths_of(shown), fences_of(shown)
    drawn["plan"], drawn["space"] = charts.plan_chart(paths, fence), charts.space_chart(paths, fence)
    body.append("<h2>Path</h2>")
    body.append(
        '<p class="caption">Plan and space: the reference grey, the path as the estimator saw it, the start, '
        "warnings as diamonds, the fence dashed. Local frame of the vehicle.</p>"
    )
    body.append(
        '<div class="pair"><div class="chart" id="plan"></div><div class="chart" id="space"></div></div>'
    )
    body += [_section(section, drawn, several) for section in sections_of(shown)[:-1]]
    drawn["timeline"] = charts.timeline_chart([timeline_of(one) for one in shown])
    body.append("<h2>States and events</h2>")
    body.append('<p class="caption">The supervisor\'s state; a diamond is an event.</p>')
    body.append('<div class="chart" id="timeline"></div>')
    for one in shown:
        name = f"Events of {one.label}" if several else "Events"
        body.append(
            f"<details><summary>{tables.text(name)} ({len(one.flight.events)})</summary>"
            f"{tables.events_table(one.flight)}</details>"
        )
    body.append(_section(sections_of(shown)[-1], drawn, several))
    body.append("<h2>Configuration</h2>")
    body.append(tables.settings_tables(shown))
    for one in shown:
        if (table := tables.parameters_table(one.flight)) != "":
            name = f"Parameters of the autopilot, {one.label}" if several else "Parameters of the autopilot"
            body.append(f"<details><summary>{tables.text(name)}</summary>{table}</details>")
    files = resources.files("guidance.report")
    style, script = (files.joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    title = tables.text(", ".join(one.label for one in shown))
    figures = as_json([(one.flight, one.figures) for one in shown])
    return "".join(
        (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n',
            f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n',
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n',
            f"<title>Flight report: {title}</title>\n<style>\n{style}</style>\n</head>\n<body>\n",
            "\n".join(body),
            f'\n<script type="application/json" id="json">{_json(figures)}</script>',
            f'\n<script type="application/json" id="charts">{_json(drawn)}</script>',
            f"\n<script>{get_plotlyjs()}</script>\n<script>\n{script}</script>\n</body>\n</html>\n",
        )
    )


def _head(shown: Sequence[Shown]) -> str:
    names = dict.fromkeys(one.flight.session.vehicle for one in shown)
    what = f"{len(shown)} flights of" if len(shown) > 1 else "Flight of"
    made = [f"<h1>{what} {tables.text(', '.join(names))}</h1>"]
    made += [
        f'<p class="warning">Incomplete: {tables.text(one.flight.incomplete)}. The report is of the rest.</p>'
        for one in shown
        if one.flight.incomplete
    ]
    made += [
        f'<p class="warning">{tables.text(one.label)}: the recorder dropped {one.flight.dropped} '
        "records; gaps in the plots may be theirs.</p>"
        for one in shown
        if one.flight.dropped
    ]
    return "".join(made) + tables.facts_table(shown)


def _section(section: Section, drawn: dict[str, charts.Chart], several: bool) -> str:
    drawn[section.key] = charts.section_chart(section, several)
    return (
        f'<h2>{tables.text(section.title)}</h2><p class="caption">{tables.text(section.caption)}</p>'
        f'<div class="chart" id="{section.key}"></div>'
    )


def _json(data: Any) -> str:
    """JSON that ends no script element."""
    return json.dumps(data, allow_nan=False).replace("<", "\\u003c")
