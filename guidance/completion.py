"""What a shell offers behind an option or a command: keys of the configuration, names, orders.

Each function takes the word as far as it is typed. What is slow to import is imported when it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Annotated

import typer
from msgspec import inspect as types


def starting(words: Iterable[str], incomplete: str) -> list[str]:
    """Those that the word may become."""
    return [word for word in words if word.startswith(incomplete)]


def one_of(*words: str) -> Callable[[str], list[str]]:
    """A completion by fixed words."""

    def offered(incomplete: str) -> list[str]:
        return starting(words, incomplete)

    return offered


def setting(incomplete: str) -> list[str]:
    """`KEY=` of any key of the configuration, and then its values where they are words."""
    key, equals, _ = incomplete.partition("=")
    known = keys()
    if not equals:
        return starting((f"{name}=" for name in known), incomplete)
    return starting((f"{key}={value}" for value in known.get(key, ())), incomplete)


#: The option of every command that reads a configuration.
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override a configuration key, such as law.k=0.5 (repeatable).",
        autocompletion=setting,
    ),
]


def trajectory(incomplete: str) -> list[str]:
    """The name of a trajectory."""
    from guidance.trajectory import TRAJECTORIES

    return starting(TRAJECTORIES, incomplete)


def order(incomplete: str) -> list[str]:
    """What can be ordered."""
    from guidance.commands import VERBS

    return starting(VERBS, incomplete)


def words_of_order(context: typer.Context, incomplete: str) -> list[str]:
    """What stands behind an order: a key that can be set, a trajectory's, an allocation."""
    from guidance.tuning import ALLOCATIONS

    match context.params.get("verb"):
        case "allocate":
            return starting(ALLOCATIONS, incomplete)
        case "set":
            return [word for word in setting(incomplete) if word.startswith(("law.", "limits."))]
        case "load":
            head = "trajectory."
            return [word.removeprefix(head) for word in setting(head + incomplete)]
    return []


def keys() -> dict[str, tuple[str, ...]]:
    """Every key of the configuration; the words that it takes, if it takes some of a few."""
    from guidance.config import Config
    from guidance.mavlink.profiles import PROFILES

    return {**dict(_keys(types.type_info(Config), "")), "vehicle.profile": tuple(PROFILES)}


def _keys(kind: types.Type, key: str) -> Iterator[tuple[str, tuple[str, ...]]]:
    match kind:
        case types.Metadata(type=inner):
            yield from _keys(inner, key)
        case types.StructType(fields=fields):
            for field in fields:
                yield from _keys(field.type, f"{key}.{field.encode_name}".lstrip("."))
        case types.UnionType(types=choices) if isinstance(choices[0], types.StructType):
            tables = [choice for choice in choices if isinstance(choice, types.StructType)]
            yield f"{key}.{tables[0].tag_field}", tuple(str(table.tag) for table in tables)
            for table in tables:
                yield from _keys(table, key)
        case types.LiteralType(values=values):
            yield key, tuple(map(str, values))
        case types.BoolType():
            yield key, ("true", "false")
        case _:
            yield key, ()
