"""The page's tables: figures, events, versions and settings, as HTML."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from html import escape
from typing import Final

from guidance.printable import printable
from guidance.report.flight import Flight
from guidance.report.judged import GROUPS, Figures, shown
from guidance.report.panels import Shown
from guidance.report.settings import Setting, settings_of

#: So many events of a log at most; it says how many more there are.
EVENTS_MOST: Final = 1000


def figures_table(flights: Sequence[Shown]) -> str:
    """One column for each stretch of each log, with the unit of each row."""
    columns = stretches(flights)
    rows = [
        ["<tr><th></th>", *(f'<th class="number">{text(name)}</th>' for name, _ in columns), "<th></th></tr>"]
    ]
    body = []
    for group, members in GROUPS.items():
        body.append(f'<tr class="group"><th colspan="{len(columns) + 2}">{text(group)}</th></tr>')
        for row in members:
            values = [getattr(figures, row.key) for _, figures in columns]
            if all(value is None for value in values):
                continue
            cells = "".join(
                f'<td class="number" data-key="{row.key}">{shown(value, row)}</td>' for value in values
            )
            body.append(f'<tr><th>{text(row.label)}</th>{cells}<td class="unit">{row.unit}</td></tr>')
    head = "".join(rows[0])
    table = f'<table id="figures"><thead>{head}</thead><tbody>{"".join(body)}</tbody></table>'
    return f'<div class="wide">{table}</div>'


def stretches(flights: Sequence[Shown]) -> list[tuple[str, Figures]]:
    """The columns of the figures: what was tracked, named by log and, where a log has several, by number."""
    return [
        (one.label if len(one.figures) == 1 else f"{one.label}, flight {n}", figures)
        for one in flights
        for n, figures in enumerate(one.figures, start=1)
    ]


def facts_table(flights: Sequence[Shown]) -> str:
    """What was flown, when, by which versions."""
    facts = [_facts(one.flight) for one in flights]
    names = dict.fromkeys(name for one in facts for name in one)
    body = "".join(
        f"<tr><th>{text(name)}</th>"
        + "".join(f"<td>{text(one.get(name, ''))}</td>" for one in facts)
        + "</tr>"
        for name in names
    )
    head = "<tr><th></th>" + "".join(f"<th>{text(one.label)}</th>" for one in flights) + "</tr>"
    return f'<div class="wide"><table><thead>{head}</thead><tbody>{body}</tbody></table></div>'


def events_table(flight: Flight) -> str:
    """The events in order, a thousand at most."""
    body = "".join(
        f'<tr class="level-{event.level}"><td class="number">{(event.t_ns - flight.zero_ns) * 1e-9:.2f}</td>'
        f'<td>{event.level}</td><td class="code">{text(event.code)}</td><td>{text(event.text)}</td></tr>'
        for event in flight.events[:EVENTS_MOST]
    )
    more = len(flight.events) - EVENTS_MOST
    note = f"<p>{more} more are in the log.</p>" if more > 0 else ""
    head = '<tr><th class="number">t, s</th><th>level</th><th>code</th><th>what</th></tr>'
    return f'<div class="wide"><table><thead>{head}</thead><tbody>{body}</tbody></table></div>{note}'


def settings_tables(flights: Sequence[Shown]) -> str:
    """What differs between the logs, what is not at its default, and all of it."""
    settings = settings_of([one.flight.config for one in flights])
    labels = [one.label for one in flights]
    differing = [setting for setting in settings if setting.differs]
    changed = [setting for setting in settings if setting.changed]
    made = []
    if len(flights) > 1:
        made.append("<h3>What differs between the logs</h3>")
        made.append(
            settings_table(differing, labels)
            if differing
            else "<p>Nothing: all flew the same configuration.</p>"
        )
    made.append(_details(f"Not at its default ({len(changed)} keys)", settings_table(changed, labels)))
    made.append(_details(f"The whole configuration ({len(settings)} keys)", settings_table(settings, labels)))
    return "".join(made)


def settings_table(settings: Iterable[Setting], labels: Sequence[str]) -> str:
    """One row for each key: its value in each of the configurations, and its default."""
    head = (
        "<tr><th>key</th>" + "".join(f"<th>{text(label)}</th>" for label in labels) + "<th>default</th></tr>"
    )
    body = "".join(
        f'<tr{" class=differs" if setting.differs else ""}><td class="code">{text(setting.key)}</td>'
        + "".join(f'<td class="code">{text(value)}</td>' for value in setting.values)
        + f'<td class="code soft">{text(setting.default)}</td></tr>'
        for setting in settings
    )
    return f'<div class="wide"><table><thead>{head}</thead><tbody>{body}</tbody></table></div>'


def parameters_table(flight: Flight) -> str:
    """The autopilot's parameters that were read, those that shape the setpoints first."""
    record = flight.parameters
    if record is None:
        return ""
    names = [*record.used, *(name for name in sorted(record.values) if name not in record.used)]
    body = "".join(
        f'<tr><td class="code">{text(name)}</td><td class="number">{record.values[name]:.7g}</td>'
        f"<td>{'used' if name in record.used else ''}</td></tr>"
        for name in names
        if name in record.values
    )
    head = '<tr><th>parameter</th><th class="number">value</th><th></th></tr>'
    return f'<div class="wide"><table><thead>{head}</thead><tbody>{body}</tbody></table></div>'


def text(words: object) -> str:
    """Words from a log, safe in HTML and on one line."""
    return escape(printable(str(words)))


def utc(flight: Flight, t_ns: int) -> str:
    """An instant of the companion's clock in UTC, as its wall clock had it."""
    unix_s = (t_ns + flight.session.unix_offset_ns) * 1e-9
    try:
        return datetime.fromtimestamp(unix_s, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    except (OverflowError, OSError, ValueError):
        return f"{unix_s:.3f} s after 1970"


def _facts(flight: Flight) -> dict[str, str]:
    session, link, config = flight.session, flight.last_link, flight.config
    facts = {
        "log": flight.path.name,
        "vehicle": f"{session.vehicle} ({session.profile})",
        "trajectory": _trajectory(flight),
        "tracking began": utc(flight, flight.zero_ns),
        "law": f"k = {config.law.k:g}, rho = {config.law.rho2_per_s:g}, {config.law.rho3_per_s:g} per s, "
        f"beta = {config.law.beta:g}",
        "guidance": session.guidance_version,
    }
    if link is not None:
        kind = link.vehicle_type.removeprefix("MAV_TYPE_").lower()
        parts = (link.autopilot.removeprefix("MAV_AUTOPILOT_"), link.autopilot_version, kind and f"({kind})")
        facts["autopilot"] = " ".join(filter(None, parts))
        facts["link"] = f"{config.link.connection}, {config.link.rate_hz:g} Hz"
    facts["session"] = session.session_id
    return facts


def _trajectory(flight: Flight) -> str:
    settings = settings_of([flight.config])
    parts = {
        s.key.removeprefix("trajectory."): s.values[0] for s in settings if s.key.startswith("trajectory.")
    }
    name = parts.pop("name", "").strip('"')
    return (
        f"{name}: {', '.join(f'{key} = {value}' for key, value in parts.items() if len(value) < 40)}".rstrip(
            ": "
        )
    )


def _details(summary: str, inside: str) -> str:
    return f"<details><summary>{text(summary)}</summary>{inside}</details>"
