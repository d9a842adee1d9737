"""What docs/telemetry.md says of every record, order and key, made from the types themselves.

    python -m tests.telemetry_page

writes these parts of the page anew, between `<!-- NAME -->` and `<!-- end of NAME -->`; the prose around them
is written by hand.
"""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import msgspec
from msgspec import inspect as types

from guidance.commands import VERBS
from guidance.records import LOG_ONLY, RATES, Record
from guidance.telemetry.schema import RECORDS, encoding_schema
from guidance.telemetry.zenoh_orders import Reply

ROOT: Final = Path(__file__).parents[1]
PAGE: Final = ROOT / "docs" / "telemetry.md"
SUBSCRIBER: Final = ROOT / "tests" / "examples" / "subscriber.py"

#: The end of a field's name -> its unit; the longest that fits holds.
UNITS: Final = {
    "_m": "m",
    "_m_s": "m/s",
    "_m_s2": "m/s^2",
    "_s": "s",
    "_ms": "ms",
    "_ns": "ns",
    "_rad": "rad",
    "_rad_s": "rad/s",
    "_per_s": "1/s",
    "_hz": "Hz",
    "_ppm": "ppm",
    "_bytes_per_s": "bytes/s",
}
#: What no ending tells. "1" is a ratio, "count" counts since the start of the run, or what its text says.
UNITS_OF: Final = {
    "v1": "m^2/s",
    "v2": "m^2/s^2",
    "field_body": "m/s",
    "origin_geodetic": "deg, deg, m AMSL",
    "values": "the autopilot's own",
    "measured": "the channel's",
    "push": "the channel's, per s",
    "type_mask": "bits",
    **dict.fromkeys(
        ("attitude_wxyz", "thrust", "clock_rate", "load", "effectiveness", "throttle_trim", "hover_part"), "1"
    ),
    **dict.fromkeys(
        (
            *("seq", "input_seq", "resets", "setpoints_sent", "received", "lost", "reboots", "rejected"),
            *("counters", "ticks", "lateness_counts", "dropped_records", "dropped_packets", "count"),
        ),
        "count",
    ),
}
#: A part of a field's name -> the frame that it is in.
FRAMES: Final = {
    "_ned": "world, north east down",
    "_frd": "body, forward right down",
    "_body": "body, forward right down",
    "_wxyz": "rotation from body to world, w first",
}


def unit(name: str) -> str:
    """By a field's name or its ending; empty for what is no number."""
    if name in UNITS_OF:
        return UNITS_OF[name]
    fitting = [end for end in UNITS if name.endswith(end) or f"_{name}" == end]
    return UNITS[max(fitting, key=len)] if fitting else ""


def frame(name: str) -> str:
    """By what stands in a field's name."""
    return next((words for part, words in FRAMES.items() if re.search(rf"{part}(_|$)", name)), "")


def words(kind: types.Type) -> str:
    """A type as a reader of JSON meets it."""
    match kind:
        case types.BoolType():
            return "true or false"
        case types.IntType():
            return "integer"
        case types.FloatType():
            return "number"
        case types.StrType():
            return "text"
        case types.BytesType():
            return "bytes, as base64 text"
        case types.NoneType():
            return "null"
        case types.EnumType(cls=cls):
            return "text: " + ", ".join(str(member) for member in cls)
        case types.LiteralType(values=values):
            return "text: " + ", ".join(map(str, values))
        case types.TupleType(item_types=items):
            return f"{len(items)} {words(items[0])}s"
        case types.VarTupleType(item_type=item):
            return f"list: {words(item)}"
        case types.DictType(value_type=value):
            return f"object: name to {words(value)}"
        case types.UnionType(types=choices):
            return " or ".join(words(choice) for choice in choices)
        case types.StructType(cls=cls):
            return cls.__name__
    raise TypeError(f"no words for {kind}")


def prose(cls: type) -> str:
    """The docstring, its paragraphs wrapped as the pages are."""
    return "\n\n".join(map(wrapped, (inspect.getdoc(cls) or "").split("\n\n")))


def wrapped(paragraph: str) -> str:
    """No line is broken within backticks."""
    whole = re.sub(r"`[^`]*`", lambda span: span[0].replace(" ", "\0"), " ".join(paragraph.split()))
    lines = textwrap.wrap(whole, 124, break_long_words=False, break_on_hyphens=False)
    return "\n".join(lines).replace("\0", " ")


def row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def field_table(cls: type[msgspec.Struct], skipped: Iterable[str] = ()) -> list[str]:
    """Each field with its type, unit and frame, and what holds where it is left out."""
    described = types.type_info(cls)
    assert isinstance(described, types.StructType)
    omits = bool(cls.__struct_config__.omit_defaults)
    lines = [row(("field", "type", "unit", "frame", "left out while")), row(["---"] * 5)]
    for field in described.fields:
        if field.encode_name not in skipped:
            name = field.encode_name
            absent = "" if field.required or not omits else shown(field.default)
            lines.append(row((f"`{name}`", words(field.type), unit(name), frame(name), absent)))
    return lines


def shown(value: Any) -> str:
    """As JSON."""
    return msgspec.json.encode(value).decode().replace(",", ", ")


def nested(cls: type[msgspec.Struct]) -> list[type[msgspec.Struct]]:
    """The structs that its fields hold lists of."""
    described = types.type_info(cls)
    assert isinstance(described, types.StructType)
    items = [field.type.item_type for field in described.fields if isinstance(field.type, types.VarTupleType)]
    return [item.cls for item in items if isinstance(item, types.StructType)]


def topics() -> Iterator[str]:
    """Every key, what is on it and when."""
    yield row(("on zenoh", "schema", "when"))
    yield row(["---"] * 3)
    for topic, record in RECORDS.items():
        if topic not in LOG_ONLY:
            key = f"`guidance/<vehicle>/{topic}`"
            yield row((key, f"`{encoding_schema(topic)}`", RATES[record]))


def records() -> Iterator[str]:
    """Every record with its fields; those that only the log gets are last."""
    for topic in sorted(RECORDS, key=lambda topic: topic in LOG_ONLY):
        yield from record_section(topic, RECORDS[topic])


def record_section(topic: str, record: type[Record]) -> Iterator[str]:
    only = "; in the log only" if topic in LOG_ONLY else ""
    yield from ("", f"### {topic}", "", f"{record.__name__}: {RATES[record]}{only}.", "", prose(record), "")
    yield from field_table(record, skipped=("t_ns",))
    for inner in nested(record):
        yield from ("", wrapped(f"{inner.__name__}, in {topic}: {prose(inner)}"), "")
        yield from field_table(inner)


def orders() -> Iterator[str]:
    """Every order: its key, payload and meaning, and the answer."""
    yield row(("on zenoh", "payload, beside id and source", "meaning"))
    yield row(["---"] * 3)
    for verb, order in VERBS.items():
        described = types.type_info(order)
        assert isinstance(described, types.StructType)
        own = [field for field in described.fields if field.name not in ("id", "source")]
        payload = "; ".join(f"{field.name}: {words(field.type)}" for field in own)
        yield row((f"`guidance/<vehicle>/command/{verb}`", payload, " ".join(prose(order).split())))
    yield from ("", "The answer:", "", *field_table(Reply))


def subscriber() -> Iterator[str]:
    """The example, to the letter."""
    yield from ("```python", SUBSCRIBER.read_text(encoding="utf-8").rstrip("\n"), "```")


PARTS: Final = {"topics": topics, "records": records, "orders": orders, "subscriber": subscriber}


def rewritten(page: str) -> str:
    """The page with its parts as they are now."""
    for name, lines in PARTS.items():
        start, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
        before, _, rest = page.partition(start)
        _, found, after = rest.partition(end)
        assert found, f"{PAGE}: has no {start} and {end}"
        page = before + start + "\n\n" + "\n".join(lines()).strip("\n") + "\n\n" + end + after
    return page


if __name__ == "__main__":
    PAGE.write_text(rewritten(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
