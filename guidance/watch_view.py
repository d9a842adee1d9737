"""What `guidance watch` shows: a row for each vehicle, the latest notes, and how the connection does.

Everything fits 80 columns, where each vehicle takes two lines; from 160 on it is one. What must not be missed
is said in words, colour only helps.
"""

from __future__ import annotations

import textwrap
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

from rich.console import Group
from rich.text import Text

from guidance.fleet import Contact, Note, Seen, Source
from guidance.printable import printable
from guidance.records import SCHEMA_VERSION, Level

WIDE: Final = 160
_NAME_WIDTHS: Final = (10, 20)  # narrow, wide
_NOTES_AT_LEAST: Final = 3
_IGNORED_AT_MOST: Final = 3
_COLOURS: Final = {Level.WARNING: "yellow", Level.ERROR: "red", Level.CRITICAL: "bold red"}
_STATES: Final = {
    "tracking": "green",
    "withheld": "yellow",
    "handed-over": "yellow",
    "aborted": "yellow",
    "disconnected": "yellow",
}
_LOST: Final = {Contact.SILENT: "bold red", Contact.GONE: "magenta"}


class Connection(NamedTuple):
    """How the watcher itself does: `trouble` in words if it has no session, and where it looks."""

    trouble: str
    neighbours: int
    connect: Sequence[str] = ()
    listen: Sequence[str] = ()
    scouting: bool = False
    file: str = ""
    vehicle: str = "*"

    def words(self) -> str:
        """In one line."""
        if self.trouble:
            return f"{self.trouble} ({self.places()})"
        others = {0: "nobody yet", 1: "1 other"}.get(self.neighbours, f"{self.neighbours} others")
        return f"connected to {others} ({self.places()})"

    def places(self) -> str:
        """Where it looks."""
        if self.file:
            return self.file
        parts = [
            f"{name} {', '.join(at)}"
            for name, at in (("connect", self.connect), ("listen", self.listen))
            if at
        ]
        return "; ".join([*parts, "scouting"] if self.scouting else parts)


class _Column(NamedTuple):
    name: str
    unit: str
    width: int
    cell: Callable[[Seen], str]


def duration(seconds: float) -> str:
    """Short and coarse: 3 s, 12 min, 5 h."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.0f} h"


def presence(seen: Seen) -> str:
    """The state, or that there is none any more."""
    if seen.contact is not Contact.LIVE:
        return f"{seen.contact} {duration(seen.quiet_s)}"
    if seen.state is None and seen.versions:
        return f"schema {seen.versions[-1]}"
    return "no status" if seen.state is None else printable(seen.state)


def explanation(seen: Seen) -> str:
    """Why it is in its state, and what else must be known of it."""
    parts = []
    if seen.doubled:
        parts.append("TWO SERVICES publish under this name")
    if seen.state is not None:
        was = "" if seen.contact is Contact.LIVE else f"was {seen.state} ({_mode(seen)}): "
        parts.append(printable(f"{was}{seen.reason}"))
        if seen.contact is Contact.LIVE:
            parts += [printable(f"caution: {text}") for text in seen.cautions]
    elif not seen.versions:
        parts.append("nothing is known of it yet" if seen.contact is Contact.LIVE else "it never said a word")
    if seen.versions:
        numbers = ", ".join(map(str, seen.versions))
        parts.append(f"publishes schema version {numbers}, this reads {SCHEMA_VERSION}: update the older")
    return "; ".join(parts)


def clock(note: Note, unix_offset_ns: int) -> str:
    """Local time of a note by the clock here: Unix time less monotonic is the offset."""
    return time.strftime("%H:%M:%S", time.localtime((note.when_ns + unix_offset_ns) // 1_000_000_000))


def line(seen: Seen) -> str:
    """One vehicle in one line, for a file or a pipe."""
    parts = [f"{seen.vehicle} {presence(seen)}: {explanation(seen)}"]
    if seen.contact is Contact.LIVE:
        if seen.state is not None:
            parts.append(printable(_mode(seen)))
        if seen.error_m is not None:
            parts.append(f"error {_metres(seen.error_m)} m")
        if seen.setpoint_rate_hz is not None:
            parts.append(f"setpoints {seen.setpoint_rate_hz:.1f} Hz")
        parts.append(_link(seen))
    return "; ".join(part for part in parts if part)


def ignored_line(ignored: Mapping[tuple[str, str], tuple[int, str]]) -> str:
    """What came that is no record of ours, newest detail included; empty if nothing did."""
    if not ignored:
        return ""
    return "ignored: " + "; ".join(
        printable(f"{vehicle}: {what} x {count}" + (f" ({detail})" if detail else ""))
        for (vehicle, what), (count, detail) in ignored.items()
    )


def screen(
    fleet: Sequence[Seen],
    notes: Sequence[Note],
    ignored: Mapping[tuple[str, str], tuple[int, str]],
    connection: Connection,
    *,
    width: int,
    height: int,
    unix_offset_ns: int,
) -> Group:
    """The whole screen, `height` lines at most."""
    bottom = _wrapped(connection.words(), width, "yellow" if connection.trouble else "dim")
    bottom += _wrapped(ignored_line(ignored), width, "yellow")[:_IGNORED_AT_MOST]
    if not fleet:
        return _cut([*_empty(connection), Text(), *bottom], height)
    wide = width >= WIDE
    room = height - len(bottom) - _NOTES_AT_LEAST - 4
    rows_at_most = max(1, room // (1 if wide else 2))
    shown = fleet if len(fleet) <= rows_at_most else fleet[: max(1, rows_at_most - 1)]
    lines = _table(shown, width, wide)
    if len(shown) < len(fleet):
        hidden = len(fleet) - len(shown)
        lines.append(Text(f"and {hidden} more: enlarge the terminal, or choose with --vehicle", "yellow"))
    space = max(0, height - len(lines) - len(bottom) - 2)
    latest = list(notes)[max(0, len(notes) - space) :]
    happened = [text for note in latest for text in _note(note, unix_offset_ns, width)]
    lines += [Text(), *happened[max(0, len(happened) - space) :], Text(), *bottom]
    return _cut(lines, height)


def _cut(lines: Sequence[Text], height: int) -> Group:
    for text in lines:
        text.no_wrap, text.overflow = True, "ellipsis"
    return Group(*lines[:height])


def _table(fleet: Sequence[Seen], width: int, wide: bool) -> list[Text]:
    names = max(len(seen.vehicle) for seen in fleet)
    columns = _columns(min(max(names, 7), _NAME_WIDTHS[wide])) + (_LINK_COLUMNS if wide else [])
    gap = "  " if wide else " "
    heads = [_fit(column.name, column) for column in columns] + (["reason"] if wide else [])
    lines = [
        Text(gap.join(heads), "bold"),
        Text(gap.join(_fit(column.unit, column) for column in columns), "dim"),
    ]
    for seen in fleet:
        row = Text(style="" if seen.contact is Contact.LIVE else "dim")
        for i, column in enumerate(columns):
            known = i < 2 or (seen.contact is Contact.LIVE and seen.state is not None)
            style = ("bold", _presence_style(seen))[i] if i < 2 else ""
            row.append(_fit(column.cell(seen) if known else "", column), style).append(gap)
        reason = Text(explanation(seen), _explanation_style(seen))
        if wide:
            lines.append(row.append(reason))
        else:
            link = _link(seen)
            reason.truncate(max(width - 4 - len(link), 20), overflow="ellipsis", pad=True)
            lines += [row, Text("  ").append(reason).append(f"  {link}", "dim")]
    return lines


def _columns(name_width: int) -> list[_Column]:
    return [
        _Column("vehicle", "", -name_width, lambda s: _short(s.vehicle, name_width)),
        _Column("state", "", -12, presence),
        _Column("mode", "", -10, lambda s: printable(s.mode or "")),
        _Column("armed", "", -5, lambda s: _ARMED_SHORT[s.armed]),
        _Column("error", "m", 8, lambda s: "-" if s.error_m is None else _metres(s.error_m)),
        _Column("setpoints", "Hz", 9, lambda s: _number(s.setpoint_rate_hz, 1)),
        _Column("attitude", "Hz   ms", 9, lambda s: _source(s.attitude)),
        _Column("position", "Hz   ms", 9, lambda s: _source(s.position)),
    ]


_LINK_COLUMNS: Final = [
    _Column("round trip", "ms", 10, lambda s: _number(s.round_trip_s, 1, 1e3)),
    _Column("lost", "", 6, lambda s: _number(s.lost, 0)),
    _Column("heartbeat", "s", 9, lambda s: _number(s.heartbeat_age_s, 1)),
]
_ARMED: Final = {True: "armed", False: "disarmed", None: "arming unknown"}
_ARMED_SHORT: Final = {True: "yes", False: "no", None: "?"}


def _mode(seen: Seen) -> str:
    return f"{seen.mode or 'mode unknown'}, {_ARMED[seen.armed]}"


def _empty(connection: Connection) -> list[Text]:
    name = "vehicle" if connection.vehicle == "*" else connection.vehicle
    return [
        Text(f"no {name} yet", "bold"),
        Text("A service publishes where [zenoh] of its configuration says. Look there:"),
        Text('  listen = ["tcp/HOST:PORT"]      guidance watch --connect tcp/HOST:PORT'),
        Text('  connect = ["tcp/ROUTER:PORT"]   guidance watch --connect tcp/ROUTER:PORT'),
        Text("  multicast_scouting = true       guidance watch --multicast"),
        Text("With none of these it publishes to nobody; the last needs its listen as well."),
    ]


def _note(note: Note, unix_offset_ns: int, width: int) -> list[Text]:
    """As many lines as it takes; those after the first are indented."""
    head = f"{clock(note, unix_offset_ns)} {note.vehicle} "
    first, *others = _wrapped(head + printable(note.text), width, _COLOURS.get(note.level, ""), indent=9)
    first.stylize("not bold dim", 0, 9)
    first.stylize("not dim bold", 9, len(head))
    return [first, *others]


def _wrapped(text: str, width: int, style: str, indent: int = 0) -> list[Text]:
    pieces = textwrap.wrap(text, width, subsequent_indent=" " * indent)
    return [Text(piece, style) for piece in pieces]


def _presence_style(seen: Seen) -> str:
    if seen.contact is not Contact.LIVE:
        return f"not dim {_LOST[seen.contact]}"
    return _STATES.get(seen.state or "", "yellow" if seen.state is None else "")


def _explanation_style(seen: Seen) -> str:
    return "not dim red" if seen.doubled or seen.versions else "" if seen.contact is Contact.LIVE else "dim"


def _link(seen: Seen) -> str:
    parts = []
    if seen.round_trip_s is not None:
        parts.append(f"round trip {seen.round_trip_s * 1e3:.1f} ms")
    if seen.lost:
        parts.append(f"lost {seen.lost}")
    if seen.heartbeat_age_s is not None:
        parts.append(f"heartbeat {seen.heartbeat_age_s:.1f} s")
    return ", ".join(parts)


def _fit(text: str, column: _Column) -> str:
    """Exactly as wide as the column, left-aligned if its width is negative."""
    width = abs(column.width)
    if len(text) > width:
        text = text[: width - 1] + "\N{HORIZONTAL ELLIPSIS}"
    return text.ljust(width) if column.width < 0 else text.rjust(width)


def _short(name: str, width: int) -> str:
    """The end of a name tells vehicles apart more often than its middle."""
    return name if len(name) <= width else f"{name[: width - 5]}\N{HORIZONTAL ELLIPSIS}{name[-4:]}"


def _metres(value: float) -> str:
    return f"{value:.3f}" if value < 1000.0 else f"{value:.0f}" if value < 1e7 else f"{value:.1e}"


def _number(value: float | None, digits: int, factor: float = 1.0) -> str:
    return "-" if value is None else f"{value * factor:.{digits}f}"


def _source(source: Source | None) -> str:
    if source is None:
        return "-"
    age = f"{source.age_s * 1e3:.0f}" if source.age_s < 9.9995 else "old"
    return f"{_number(source.rate_hz, 0)}{age:>5}"
