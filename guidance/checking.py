"""What is wrong with an operator's text, said so that it can be put right: key, value, place, allowed.

`problems` compares plain data (what TOML gives) with the Structs that it must become and names every
fault, not only the first. `override` puts a `KEY=VALUE` of the command line into it. `Places`
knows the line of each key. `allowed` puts a type into words; the commented examples use the same words.
"""

from __future__ import annotations

import json
import math
import re
import reprlib
import tomllib
import types
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from typing import Annotated, Any, Final, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import msgspec
from msgspec import Meta

_KEY: Final = r"""(?:[A-Za-z0-9_-]+|"[^"]*"|'[^']*')"""
_PATH: Final = rf"{_KEY}(?:\s*\.\s*{_KEY})*"
_HEADER: Final = re.compile(rf"\s*\[\[?\s*({_PATH})\s*\]")
_ASSIGNMENT: Final = re.compile(rf"\s*({_PATH})\s*=")


#: The keys that choose what the others in their table are.
_CHOICES: Final = (["trajectory", "name"], ["law", "error_function", "name"])


class ConfigError(Exception):
    """The operator's configuration is refused; the text says what, where, and what is allowed."""


class Problem(NamedTuple):
    """One fault: the dotted key it is about, and what is wrong, beginning behind the key."""

    key: str
    text: str


class Places:
    """Where keys stand in a TOML text."""

    def __init__(self, where: str, text: str) -> None:
        self._where = where
        self._lines: dict[str, int] = {}
        table = ""
        for number, line in enumerate(text.splitlines(), start=1):
            if header := _HEADER.match(line):
                table = _plain(header[1])
                self._lines.setdefault(table, number)
            elif key := _ASSIGNMENT.match(line):
                self._lines.setdefault(f"{table}.{_plain(key[1])}".strip("."), number)

    def of(self, dotted: str) -> str:
        """`file:line` of a key; of the table that lacks it; or only the file."""
        while dotted:
            if dotted in self._lines:
                return f"{self._where}:{self._lines[dotted]}"
            dotted = dotted.rpartition(".")[0]
        return self._where


def _plain(path: str) -> str:
    return ".".join(key.strip("\"'") for key in re.findall(_KEY, path))


def problems(data: Mapping[str, Any], kind: type[msgspec.Struct], above: str = "") -> Iterator[Problem]:
    """Every reason why `data` is not a `kind`; `above` is the dotted key of its table."""
    hints = get_type_hints(kind, include_extras=True)
    dot = f"{above}." if above else ""
    tag_field = kind.__struct_config__.tag_field
    for key in data:
        if key not in hints and key != tag_field:
            yield Problem(f"{dot}{key}", f"{_value(data[key])}: {_unknown(key, kind, hints, above)}")
    for field in msgspec.structs.fields(kind):
        if field.name in data:
            yield from _value_problems(data[field.name], hints[field.name], f"{dot}{field.name}")
        elif field.required:
            yield Problem(f"{dot}{field.name}", f" is missing: {_wanted(hints[field.name])}")


def _value_problems(value: Any, hint: Any, key: str) -> Iterator[Problem]:
    structs = _structs(hint)
    if not structs:
        if not _fits(value, hint):
            yield Problem(key, f"{_value(value)}: must be {allowed(hint)}")
    elif not isinstance(value, Mapping):
        yield Problem(key, f"{_value(value)}: must be a table, [{key}]")
    elif len(structs) == 1:
        yield from problems(value, structs[0], key)
    else:
        tags = {str(struct.__struct_config__.tag): struct for struct in structs}
        tag_field = str(structs[0].__struct_config__.tag_field)
        name = value.get(tag_field)
        if isinstance(name, str) and name in tags:
            yield from problems(value, tags[name], key)
        elif tag_field in value:
            yield Problem(f"{key}.{tag_field}", f"{_value(name)}: must be {one_of(tags, name)}")
        else:
            yield Problem(f"{key}.{tag_field}", f" is missing: must be {one_of(tags)}")


def _fits(value: Any, hint: Any) -> bool:
    try:
        converted = msgspec.convert(value, hint)
    except (msgspec.ValidationError, ValueError, OverflowError):
        return False
    return all(math.isfinite(number) for number in _numbers(converted))


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, tuple):
        for part in value:
            yield from _numbers(part)
    elif isinstance(value, float):
        yield value


def _structs(hint: Any) -> list[type[msgspec.Struct]]:
    parts = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    return [part for part in parts if isinstance(part, type) and issubclass(part, msgspec.Struct)]


def _unknown(key: str, kind: type[msgspec.Struct], hints: Mapping[str, Any], above: str) -> str:
    tag = kind.__struct_config__.tag
    what = "key" if above else "table"
    who = f"{above} {json.dumps(tag)}" if tag else f"[{above}]" if above else "a configuration"
    return f"unknown {what}{_meant(key, hints)}; {who} has {', '.join(hints)}"


def _meant(wrong: object, known: Iterable[str]) -> str:
    close = get_close_matches(wrong, list(known), n=1) if isinstance(wrong, str) else []
    return f" (did you mean {close[0]}?)" if close else ""


def _wanted(hint: Any) -> str:
    structs = _structs(hint)
    if len(structs) > 1:
        return f"the table must have {structs[0].__struct_config__.tag_field}"
    if structs:
        keys = [field.name for field in msgspec.structs.fields(structs[0]) if field.required]
        return f"the table must have {', '.join(keys)}"
    return f"there is no default; must be {allowed(hint)}"


def allowed(hint: Any) -> str:
    """What a type takes, in words, such as `a number above 0`."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        metas = [meta for meta in arguments[1:] if isinstance(meta, Meta)]
        return allowed(arguments[0]) + "".join(_range(meta) + _described(meta) for meta in metas)
    if origin is Literal:
        return one_of(arguments)
    if origin in (Union, types.UnionType):
        return " or ".join(allowed(part) for part in arguments if part is not type(None))
    if origin is tuple:
        if arguments[-1] is Ellipsis and get_origin(arguments[0]) is tuple:
            return "a list of pairs of numbers"
        if arguments[-1] is Ellipsis:
            of, *rest = get_args(arguments[0]) if get_origin(arguments[0]) is Annotated else arguments[:1]
            metas = [meta for meta in rest if isinstance(meta, Meta)]
            which = {int: "whole numbers", str: "texts"}[of]
            return f"a list of {which}" + "".join(_range(meta) + _described(meta) for meta in metas)
        return f"a list of {len(arguments)} numbers"
    return {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}[hint]


def _range(meta: Meta) -> str:
    low, high = meta.ge, meta.le
    if low is not None and high is not None:
        return f" from {low:g} to {high:g}"
    parts = [
        f"{word} {bound:g}"
        for word, bound in (
            ("above", meta.gt),
            ("of at least", low),
            ("below", meta.lt),
            ("of at most", high),
        )
        if bound is not None
    ]
    return f" {' and '.join(parts)}" if parts else ""


def _described(meta: Meta) -> str:
    return f" ({meta.description})" if meta.description else ""


def one_of(names: Iterable[str], wrong: object = None) -> str:
    """The names that are allowed, and which of them was likely meant by a `wrong` one."""
    names = list(names)
    *most, last = [json.dumps(name) for name in names]
    return (f"{', '.join(most)} or {last}" if most else last) + (_meant(wrong, names) if wrong else "")


def _value(value: Any) -> str:
    return "" if isinstance(value, Mapping) else f" = {shown(value)}"


def shown(value: object) -> str:
    """A value as TOML writes it, cut to a length that a terminal can show."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        value = value if len(value) <= 60 else f"{value[:57]}..."
        return json.dumps(value, ensure_ascii=False)
    if value is None or isinstance(value, int | float | list):
        try:
            return reprlib.repr(value)
        except ValueError:  # more digits than Python prints
            return "a number of thousands of digits"
    return str(value)


def override(data: dict[str, Any], setting: str) -> str:
    """Put a `KEY=VALUE` of the command line into the data; the dotted key. Raises ConfigError."""
    key, equals, text = setting.partition("=")
    path = [part.strip() for part in key.split(".")]
    dotted = ".".join(path)
    if not equals or not all(path):
        raise _refusal(setting, "expected KEY=VALUE with a dotted key, such as law.k=1.0")
    value = _value_of(text.strip(), setting)
    table = data
    for above, part in enumerate(path[:-1], start=1):
        below = table.setdefault(part, {})
        if not isinstance(below, dict):
            raise _refusal(setting, f"{'.'.join(path[:above])} is a value, not a table")
        table = below
    inside = table.get(path[-1])
    if isinstance(inside, dict) and not isinstance(value, dict):
        raise _refusal(
            setting, f"{dotted} is a table; name a key in it, such as {dotted}.{next(iter(inside), 'KEY')}"
        )
    if path in _CHOICES and table.get("name") != value:
        table.clear()  # another one's parameters mean nothing to this one
    table[path[-1]] = value
    return dotted


def _value_of(text: str, setting: str) -> object:
    """A TOML value, or the text itself as a string: `profile=px4-uuv` needs no quotes."""
    try:
        setting.encode()
        parsed = tomllib.loads(f"value = {text}")
    except UnicodeEncodeError:
        raise _refusal(setting, "not UTF-8 text") from None
    except RecursionError:
        raise _refusal(setting, "nested too deeply") from None
    except tomllib.TOMLDecodeError:
        if not text:
            raise _refusal(setting, "the value is missing") from None
        return text
    except ValueError as error:  # a number of thousands of digits
        raise _refusal(setting, str(error)) from None
    return parsed["value"] if len(parsed) == 1 else text


def _refusal(setting: str, why: str) -> ConfigError:
    return ConfigError(f"{named(setting)}: {why}")


def named(setting: str) -> str:
    """An override as the operator wrote it, on one line of a message."""
    line = setting.encode("utf-8", "backslashreplace").decode().replace("\n", "\\n")
    return f"--set {line if len(line) <= 100 else f'{line[:97]}...'}"
