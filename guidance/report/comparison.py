"""What another configuration would have commanded, for the page: words, tables, commands overlaid."""

from __future__ import annotations

import numpy as np

from guidance.report.columns import known
from guidance.report.flight import Flight
from guidance.report.panels import TIME, Line, Panel, Section
from guidance.report.settings import settings_of
from guidance.report.tables import settings_table, text
from guidance.report.thin import thin
from guidance.what_if import Comparison


def drawn(found: Comparison, flight: Flight, name: str) -> tuple[str, list[Section]]:
    """HTML, and the panels behind it; `name` is that of the other configuration."""
    made = [
        f"<h2>What {text(name)} would have commanded</h2>",
        '<p class="caption">The same inputs through the core with another configuration, and its commands at '
        "the same instants. The path below is the flown one in any case, and so are the errors: the other "
        "commands moved nothing. A difference is that of one decision, not of a flight.</p>",
    ]
    if found.refused:
        made.append(f'<p class="warning">It would not have engaged: {text(found.refused)}</p>')
    if found.stopped:
        made.append(f'<p class="warning">The comparison ended early: {text(found.stopped)}</p>')
    if found.asked_otherwise:
        made.append(f'<p class="warning">{text(found.asked_otherwise.capitalize())}.</p>')
    made.append(_differences(found))
    made.append(_partings(found))
    differing = [one for one in settings_of([found.flown, found.other]) if one.differs]
    made.append("<h3>What differs in the configuration</h3>")
    made.append(settings_table(differing, ["flown", "other"]) if differing else "<p>Nothing.</p>")
    return "".join(made), [_section(found, flight)] if found.t_ns and found.commands else []


def _section(found: Comparison, flight: Flight) -> Section:
    x = flight.seconds(np.frombuffer(found.t_ns, dtype=np.int64))
    panels = []
    for one in found.commands:
        lines = []
        for role, (label, values) in enumerate((("flown", one.flown), ("other", one.other))):
            lines.append(Line(label, *thin(x, known(np.frombuffer(values, dtype=np.float64))), role))
        panels.append(Panel(one.name, TIME, f"{one.name}, {one.unit}" if one.unit else one.name, lines))
    caption = "After all limits, as each would have been sent."
    return Section("comparison", "Commands, flown and other", caption, panels)


def _differences(found: Comparison) -> str:
    if not found.t_ns:
        return "<p>There is no instant at which both commanded.</p>"
    rows = "".join(
        f'<tr><th>{text(one.channel)}</th><td class="number">{one.rms:.4g}</td>'
        f'<td class="number">{one.largest:.4g}</td><td class="unit">{one.unit}</td>'
        f'<td class="number">{one.largest_at_s:.2f}</td></tr>'
        for one in found.differences
    )
    head = (
        '<tr><th>difference</th><th class="number">RMS</th><th class="number">largest</th><th></th>'
        '<th class="number">after, s</th></tr>'
    )
    count = len(found.t_ns)
    limits = (
        f"<p>At {count} instants. At a limit: flown {100.0 * found.saturated_flown / count:.4g} %, "
        f"other {100.0 * found.saturated_other / count:.4g} %. Only the flown one commanded at "
        f"{found.only_flown}, only the other at {found.only_other}.</p>"
    )
    if not found.commands:
        return limits
    table = f'<table id="differences"><thead>{head}</thead><tbody>{rows}</tbody></table>'
    return f'{limits}<div class="wide">{table}</div>'


def _partings(found: Comparison) -> str:
    if not found.partings:
        return ""
    rows = "".join(
        f'<tr><td class="number">{one.at_s:.2f}</td><td>{text(one.flown)}</td><td>{text(one.other)}</td>'
        f"<td>{text(one.other_reason)}</td></tr>"
        for one in found.partings
    )
    head = '<tr><th class="number">after, s</th><th>flown</th><th>other</th><th>why the other</th></tr>'
    more = f"<p>And {found.partings_more} more.</p>" if found.partings_more else ""
    return f"<h3>Where they part</h3><table><thead>{head}</thead><tbody>{rows}</tbody></table>{more}"
