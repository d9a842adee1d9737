"""How much an object of ours keeps: the longest container that can be reached from it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sized
from typing import Any, NamedTuple

import msgspec

_CONTAINERS = (dict, list, set, frozenset, tuple, deque, str, bytes, bytearray)


class Longest(NamedTuple):
    """A container by the path of attributes that leads to it."""

    length: int
    path: str


def longest(
    thing: object, name: str = "", modules: tuple[str, ...] = ("guidance",), *, inside_records: bool = True
) -> Longest:
    """The longest container in `thing`, going through objects of these packages only.

    What one record holds, texts included, its own size bounds; without `inside_records` that is left out.
    """
    found = Longest(0, name)
    seen: set[int] = set()
    waiting: list[tuple[str, Any]] = [(name, thing)]
    while waiting:
        path, value = waiting.pop()
        if id(value) in seen:
            continue
        seen.add(id(value))
        if not inside_records and isinstance(value, msgspec.Struct | str):
            continue
        if isinstance(value, _CONTAINERS) and isinstance(value, Sized):
            found = max(found, Longest(len(value), path))
        waiting += _within(path, value, modules)
    return found


def _within(path: str, value: Any, modules: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield f"{path} key", key
            yield f"{path}[{key!r:.40}]", item
    elif isinstance(value, list | tuple | set | frozenset | deque):
        for item in value:
            yield f"{path}[]", item
    elif isinstance(value, msgspec.Struct):
        for name in value.__struct_fields__:
            yield f"{path}.{name}", getattr(value, name)
    elif type(value).__module__.split(".")[0] in modules:
        slots = [name for kind in type(value).__mro__ for name in getattr(kind, "__slots__", ())]
        for name in (*slots, *getattr(value, "__dict__", ())):
            if hasattr(value, name):
                yield f"{path}.{name}", getattr(value, name)
