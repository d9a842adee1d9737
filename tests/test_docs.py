"""The pages in docs stay true: whatever they name in backticks exists, in tables as the column says."""

from __future__ import annotations

import importlib
import re
import shlex
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, Literal, get_args, get_type_hints

import msgspec
import pytest
import typer.main
from pymavlink.dialects.v20 import all as dialect
from typer.core import TyperGroup

from guidance import cli as guidance_cli
from guidance.config import Config
from guidance.guards import GUARDS
from guidance.mavlink.profiles import PROFILES
from guidance.records import TOPICS, StreamStatus
from guidance.trajectory import TRAJECTORIES
from guidance.tuning import ErrorFunction
from sitl import cli as sitl_cli

ROOT: Final = Path(__file__).parents[1]
PAGES: Final = [ROOT / "docs" / name for name in ("from-the-paper-to-the-vehicle.md", "tuning.md")]
EACH: Final = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
PROGRAMS: Final[dict[str, Any]] = {
    "guidance": typer.main.get_command(guidance_cli.app),
    "sitl": typer.main.get_command(sitl_cli.app),
}
SOURCES: Final = "\n".join(
    path.read_text(encoding="utf-8") for path in sorted((ROOT / "guidance").rglob("*.py"))
)
DEPLOYED: Final = "\n".join(
    path.read_text(encoding="utf-8") for path in sorted((ROOT / "deploy").glob("*.toml"))
)
#: What a formula in backticks is made of: the paper's symbols.
SYMBOLS: Final = frozenset(
    re.findall(r"\w+", "x r e R k u1 u2 u3 u4 y4 y5 y6 b1 Xr phi lambda beta hat H max rho2 rho3 v")
)


def keys_of(kind: type[msgspec.Struct], above: str) -> Iterator[tuple[str, Any]]:
    """Dotted key and type of each value in a table of the configuration, and of the tables in it."""
    hints = get_type_hints(kind, include_extras=True)
    for field in msgspec.structs.fields(kind):
        yield f"{above}{field.name}", hints[field.name]


def every_key() -> dict[str, list[Any]]:
    """Dotted key -> the types it may have: those of a choice differ by its name."""
    found: dict[str, list[Any]] = {}
    tables: list[tuple[str, type[msgspec.Struct]]] = [
        (f"{table.name}.", table.type)
        for table in msgspec.structs.fields(Config)
        if table.name != "trajectory"
    ]
    tables += [("trajectory.", kind) for kind in TRAJECTORIES.values()]
    tables += [("law.error_function.", kind) for kind in get_args(ErrorFunction)]
    for above, kind in tables:
        for key, hint in keys_of(kind, above):
            found.setdefault(key, []).append(hint)
    errors = tuple(str(kind.__struct_config__.tag) for kind in get_args(ErrorFunction))
    found["law.error_function.name"] = [Literal[errors]]
    found["trajectory.name"] = [Literal[tuple(TRAJECTORIES)]]
    return found


KEYS: Final = every_key()
SECTIONS: Final = {key.rpartition(".")[0] for key in KEYS}
FIELDS: Final = {
    f"{topic}.{field.name}" for kind, topic in TOPICS.items() for field in msgspec.structs.fields(kind)
}
COMMON_FIELDS: Final = {"t_ns", *(field.name for field in msgspec.structs.fields(StreamStatus))}


def is_key(text: str) -> bool:
    """`table.key`, or with a value that it takes."""
    key, equals, value = text.partition(" = ")
    if key not in KEYS:
        return False
    return not equals or any(takes(hint, value) for hint in KEYS[key])


def takes(hint: Any, literal: str) -> bool:
    """Whether a type takes a TOML literal."""
    try:
        msgspec.convert(msgspec.toml.decode(f"value = {literal}")["value"], hint)
    except (msgspec.MsgspecError, ValueError):
        return False
    return True


def is_field(text: str) -> bool:
    return text in FIELDS


def is_topic_or_field_name(text: str) -> bool:
    """A whole record, or a field spoken of after its record."""
    return text in TOPICS.values() or text in COMMON_FIELDS or any(f.endswith(f".{text}") for f in FIELDS)


def is_section(text: str) -> bool:
    return bool(re.fullmatch(r"\[[a-z_.]+\]", text)) and text[1:-1] in SECTIONS


def is_path(text: str) -> bool:
    return bool(re.fullmatch(r"[\w.@-]+(/[\w.@-]*)+", text)) and (ROOT / text).exists()


def is_program(text: str) -> bool:
    """`guidance VERB ...` or `sitl VERB ...`, as far as it is written."""
    words = text.split()
    name = words[0].removeprefix(".venv/bin/") if words else ""
    if name not in PROGRAMS or len(words) < 2:
        return False
    command = PROGRAMS[name]
    assert isinstance(command, TyperGroup)
    verb = command.commands.get(words[1])
    if verb is None:
        return False
    options = {option for parameter in verb.params for option in parameter.opts}
    return all(word.split("=")[0] in options for word in words[2:] if word.startswith("--"))


def is_object(text: str) -> bool:
    """`guidance.module.name`, a constant perhaps with its value."""
    path, equals, value = text.partition(" = ")
    if not re.fullmatch(r"(guidance|sitl)(\.\w+)+", path):
        return False
    names = path.split(".")
    for cut in range(len(names), 0, -1):
        try:
            found = importlib.import_module(".".join(names[:cut]))
        except ModuleNotFoundError:
            continue
        for name in names[cut:]:
            if not hasattr(found, name):
                return False
            found = getattr(found, name)
        return not equals or repr(found) == value
    return False


def is_value(text: str) -> bool:
    """`"name"`, one that some key takes; a profile."""
    return text in PROFILES or (bool(re.fullmatch(r'"[a-z-]+"', text)) and text in DEPLOYED)


def is_autopilot_word(text: str) -> bool:
    """A parameter that the code knows, or a message."""
    if not re.fullmatch(r"[A-Z][A-Z0-9]*(_[A-Z0-9]+)*", text):
        return False
    return bool(re.search(rf"\b{text}\b", SOURCES)) or f"MAVLINK_MSG_ID_{text}" in vars(dialect)


def is_guard(text: str) -> bool:
    return text in {guard.name for guard in GUARDS}


def is_profile_column(text: str) -> bool:
    return text in next(iter(PROFILES.values()))._fields


def is_formula(text: str) -> bool:
    """Of the paper's symbols and numbers alone."""
    words = re.findall(r"[A-Za-z]\w*", text)
    return bool(words) and all(word in SYMBOLS for word in words)


KINDS: Final[tuple[Callable[[str], bool], ...]] = (
    is_key,
    is_field,
    is_section,
    is_path,
    is_program,
    is_object,
    is_value,
    is_autopilot_word,
    is_guard,
    is_profile_column,
    is_topic_or_field_name,
    is_formula,
)


def blocks_of(page: Path) -> tuple[str, list[str]]:
    """The text without its fenced blocks, and the commands in these."""
    text = page.read_text(encoding="utf-8")
    commands = [
        line
        for block in re.findall(r"^```sh\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
        for line in block.splitlines()
    ]
    return re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE), commands


def spans(text: str) -> list[str]:
    """What stands in backticks; indented formulas have none."""
    return re.findall(r"`([^`\n]+)`", text)


def tables(text: str) -> Iterator[dict[str, str]]:
    """Each row of each table, by the titles of its columns."""
    for table in re.findall(r"(?:^\|.*\|\n)+", text, re.MULTILINE):
        rows = [[cell.strip() for cell in line.strip("|\n").split("|")] for line in table.splitlines()]
        titles, rule, *rest = rows
        assert all(re.fullmatch(r"-{3,}", cell) for cell in rule), table
        for row in rest:
            assert len(row) == len(titles), row
            yield dict(zip(titles, row, strict=True))


def test_there_are_pages_and_the_readme_leads_to_each() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(PAGES) >= 2
    for page in PAGES:
        assert f"(docs/{page.name})" in readme, page.name


@EACH
def test_whatever_stands_in_backticks_exists(page: Path) -> None:
    text, _ = blocks_of(page)
    assert text.count("`") % 2 == 0
    unknown = sorted({span for span in spans(text) if not any(kind(span) for kind in KINDS)})
    assert not unknown
    assert len(spans(text)) > 50


@EACH
def test_keys_and_fields_in_formulas_exist(page: Path) -> None:
    """They stand there without backticks."""
    heads = {name.partition(".")[0] for name in (*KEYS, *FIELDS)}
    text, _ = blocks_of(page)
    for word in re.findall(r"(?<![\w./\"(-])[a-z_]+(?:\.[a-z_0-9]+)+(?![\w/]|\.md)", text):
        if word.partition(".")[0] in heads:
            assert word in KEYS or word in FIELDS, word


@EACH
def test_columns_of_tables_hold_what_they_are_titled(page: Path) -> None:
    text, _ = blocks_of(page)
    checks: dict[str, Callable[[str], bool]] = {"file": is_path, "key": is_key, "record": is_field}
    rows = 0
    for row in tables(text):
        for title, check in checks.items():
            for span in spans(row.get(title, "")):
                assert check(span), f"{title}: {span}"
        for title, cell in row.items():
            if title.endswith("look at"):
                assert all(map(is_field, spans(cell))), cell
        rows += 1
    assert rows > 10


@EACH
def test_no_line_of_a_paragraph_reads_as_a_list_or_a_title(page: Path) -> None:
    """A formula that is wrapped at its plus does."""
    lines = blocks_of(page)[0].splitlines()
    for before, line in pairwise(lines):
        if before and not re.match(r"(-|\d\.| ) |#", before):
            assert not re.match(r"(\+|\*|-|\d+[.)]|#+) |[=-]+$", line), line


@EACH
def test_every_command_is_understood(page: Path) -> None:
    """Parsed by the very command, and the files that it names exist; the README's tests run its kind."""
    _, commands = blocks_of(page)
    for line in commands:
        program, verb, *arguments = shlex.split(line)
        group = PROGRAMS[program.removeprefix(".venv/bin/")]
        assert isinstance(group, TyperGroup)
        group.commands[verb].make_context(verb, list(arguments)).close()
        for word in arguments:
            assert "/" not in word or "://" in word or (ROOT / word).exists(), word
        for word in arguments:
            key, equals, value = word.partition("=")
            assert not equals or word.startswith("--") or is_key(f"{key} = {value}"), word


@EACH
def test_links_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        name, _, anchor = target.partition("#")
        there = page.parent / name if name else page
        assert there.exists(), target
        if anchor:
            titles = re.findall(r"^#+ (.+)$", there.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize(
    "wrong",
    [
        "ground.no_such_key",
        "ground.waits = 3",
        'law.error_function.name = "cubic"',
        "guidance/no_such_file.py",
        "guidance.limits.SLEW_PART = 0.8",
        "guidance.limits.no_such_name",
        "guidance nosuchverb",
        "guidance watch --nosuchoption",
        "[nosuchtable]",
        '"nosuchvalue"',
        "NO_SUCH_PARAMETER",
        "nosuchword",
        "setpoint.nosuchfield",
    ],
)
def test_what_does_not_exist_is_found(wrong: str) -> None:
    assert not any(kind(wrong) for kind in KINDS)
