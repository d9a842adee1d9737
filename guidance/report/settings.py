"""Configurations beside one another, each key with its default: what was set, and what differs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

import msgspec

from guidance.config import Config

#: Shown for a key that one configuration has and another lacks (another trajectory's, say).
ABSENT: Final = "\N{EN DASH}"
#: A key that must be written down has no default.
REQUIRED: Final = "required"


class Setting(NamedTuple):
    """One key, its value in each log, and its default, as JSON."""

    key: str
    values: tuple[str, ...]
    default: str

    @property
    def differs(self) -> bool:
        """Between the logs."""
        return len(set(self.values)) > 1

    @property
    def changed(self) -> bool:
        """It has a default and another value."""
        return self.default != REQUIRED and any(value not in (self.default, ABSENT) for value in self.values)


def settings_of(configs: Sequence[Config]) -> list[Setting]:
    """Every key that any of them has, in the order of the file."""
    found = [dict(_flat(config, "")) for config in configs]
    keys = dict.fromkeys(key for one in found for key in one)
    made = []
    for key in keys:
        values = tuple(one[key][0] if key in one else ABSENT for one in found)
        default = next(one[key][1] for one in found if key in one)
        made.append(Setting(key, values, default))
    return made


def _flat(table: msgspec.Struct, above: str) -> Iterator[tuple[str, tuple[str, str]]]:
    """Dotted key -> value and default."""
    tag = table.__struct_config__.tag
    if table.__struct_config__.tag_field is not None:
        yield f"{above}{table.__struct_config__.tag_field}", (_text(tag), REQUIRED)
    for field in msgspec.structs.fields(table):
        value = getattr(table, field.name)
        if isinstance(value, msgspec.Struct):
            yield from _flat(value, f"{above}{field.name}.")
        else:
            yield f"{above}{field.name}", (_text(value), _default(field))


def _default(field: msgspec.structs.FieldInfo) -> str:
    if field.default is not msgspec.NODEFAULT:
        return _text(field.default)
    if field.default_factory is not msgspec.NODEFAULT:
        return _text(field.default_factory())
    return REQUIRED


def _text(value: Any) -> str:
    return "none" if value is None else msgspec.json.encode(value).decode()
