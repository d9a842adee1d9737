"""The README and the pages in docs stay true: whatever they name exists, in tables as the column says."""

from __future__ import annotations

import configparser
import re
import tomllib
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Final

import pytest

from guidance.mavlink.profiles import PROFILES
from tests.code_texts import is_said
from tests.page_words import (
    FIELDS,
    KEYS,
    is_autopilot_word,
    is_field,
    is_key,
    is_known,
    is_known_elsewhere,
    is_path,
    is_program,
    is_topic_or_field_name,
)
from tests.pages import DOCS, PAGES, README, ROOT, anchors, fenced, links, prose, read, spans, tables

EACH: Final = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
FIRST_FLIGHT: Final = ROOT / "docs" / "first-flight.md"
VEHICLES: Final = ROOT / "docs" / "vehicles.md"
TROUBLESHOOTING: Final = ROOT / "docs" / "troubleshooting.md"
#: What mavlink-router's examples/config.sample knows of each kind of section.
ROUTER_KEYS: Final = {
    "General": {"TcpServerPort"},
    "UartEndpoint": {"Device", "Baud"},
    "UdpEndpoint": {"Mode", "Address", "Port"},
}


def test_there_are_pages_and_the_readme_leads_to_each() -> None:
    assert len(DOCS) >= 15
    listed = [
        name for row in tables(prose(README)) for name in re.findall(r"\(docs/(.*)\)", row.get("page", ""))
    ]
    assert sorted(listed) == sorted(page.name for page in DOCS)


def test_the_readme_is_a_front_page() -> None:
    assert len(read(README).splitlines()) <= 260


@EACH
def test_whatever_stands_in_backticks_exists(page: Path) -> None:
    assert prose(page).count("`") % 2 == 0
    assert not sorted({span for span in spans(prose(page)) if not is_known(span)})
    assert spans(prose(page))


@EACH
def test_keys_and_fields_in_formulas_exist(page: Path) -> None:
    """They stand there without backticks."""
    heads = {name.partition(".")[0] for name in (*KEYS, *FIELDS)}
    text = re.sub(r"\]\([^)]*\)", "]", prose(page))
    for word in re.findall(r"(?<![\w./\"(<-])[a-z_]+(?:\.[a-z_0-9]+)+(?![\w/]|\.md)", text):
        if word.partition(".")[0] in heads and not is_path(word):
            assert word in KEYS or word in FIELDS, word


@EACH
def test_parameters_and_messages_exist(page: Path) -> None:
    """In backticks or not: whatever looks like one."""
    for word in re.findall(r"(?<![\w./$-])[A-Z][A-Z0-9]*(?:_(?:[A-Z0-9]+|[nx]))+(?![\w*]|\.\w)", prose(page)):
        known = is_autopilot_word(word) or is_known_elsewhere(word) or is_known(word)
        assert known or is_autopilot_word(f"MAV_CMD_{word}"), word


@EACH
def test_columns_of_tables_hold_what_they_are_titled(page: Path) -> None:
    checks: dict[str, Callable[[str], bool]] = {
        "file": is_path,
        "key": is_key,
        "record": is_field,
        "topic": is_topic_or_field_name,
        "look at": lambda span: is_field(span) or is_program(span),
    }
    for row in tables(prose(page)):
        for title, cell in row.items():
            for end, check in checks.items():
                if title == end or title.endswith(f" {end}"):
                    assert all(map(check, spans(cell))), f"{title}: {cell}"


@EACH
def test_no_line_of_a_paragraph_reads_as_a_list_or_a_title(page: Path) -> None:
    """A formula that is wrapped at its plus does."""
    for before, line in pairwise(prose(page).splitlines()):
        if before and not re.match(r" *(-|\d+\.|[|]) |  |#|<!--", before):
            assert not re.match(r"(\+|\*|-|\d+[.)]|#+) |[=-]+$", line), line


@EACH
def test_lines_are_no_longer_than_a_screen(page: Path) -> None:
    long = [line for line in read(page).splitlines() if len(line) > 130 and "|" not in line]
    assert all(re.match(r" *(\.venv/bin/|python3 |mavproxy)| {4}", line) for line in long), long


@EACH
def test_links_lead_somewhere(page: Path) -> None:
    for name, anchor in links(page):
        there = page.parent / name if name else page
        assert there.exists(), name
        assert not anchor or anchor in anchors(there), f"{name}#{anchor}"


@EACH
def test_configurations_shown_have_no_key_that_does_not_exist(page: Path) -> None:
    for block in fenced(page, "toml"):
        values = tomllib.loads(block)
        flat = {f"{table}.{key}" for table, keys in values.items() if isinstance(keys, dict) for key in keys}
        assert flat <= set(KEYS)
        assert flat or "off_deg" in values, "a plan of a campaign is read in test_campaign_vehicles"
    for block in fenced(page, "ini"):
        router = configparser.RawConfigParser()
        router.optionxform = str  # type: ignore[assignment,method-assign]
        router.read_string(block)
        for section in router.sections():
            assert set(router[section]) <= ROUTER_KEYS[section.split()[0]], section


def test_every_text_that_troubleshooting_quotes_is_one_of_the_code() -> None:
    """In the first column; the others are held as on every page."""
    quoted = [span for row in tables(prose(TROUBLESHOOTING)) for span in spans(row["you see"])]
    said = [span for span in quoted if " " in span and not is_program(span) and not is_key(span)]
    assert len(said) > 80
    assert not [span for span in said if not is_said(span)]
    assert all(
        re.fullmatch(r"[a-z_]+|[a-z]+: \.\.\.|.*\.toml", span) or is_program(span)
        for span in quoted
        if span not in said
    )


@pytest.mark.parametrize(
    ("column", "names"),
    [
        ("ArduPilot rover", ("ardupilot-rover",)),
        ("ArduPilot airplane", ("ardupilot-plane",)),
        ("ArduPilot copter", ("ardupilot-copter",)),
        ("PX4", ("px4-uuv", "px4-plane", "px4-copter", "px4-rover")),
    ],
)
def test_the_failsafes_that_check_reads_are_bold(column: str, names: tuple[str, ...]) -> None:
    rows = [row for row in tables(prose(FIRST_FLIGHT)) if "what fails" in row]
    bold = {name for row in rows for name in re.findall(r"\*\*`(\w+)`\*\*", row[column])}
    named = {name for row in rows for name in spans(row[column]) if is_parameter(name)}
    for profile in names:
        read_by_check = {each.parameter for each in PROFILES[profile].requirements}
        assert named & read_by_check == bold, profile


def test_the_table_of_profiles_has_each_with_its_mode() -> None:
    shown = [row for row in tables(prose(VEHICLES)) if "control mode" in row]
    assert sorted(spans(row["profile"])[0] for row in shown) == sorted(PROFILES)
    for row in shown:
        assert row["control mode"] == PROFILES[spans(row["profile"])[0]].control_mode.name.upper()
    to_take = [row for row in tables(prose(VEHICLES)) if "begins with" in row]
    assert {name for row in to_take for name in spans(row["profile"])} == set(PROFILES)


def is_parameter(text: str) -> bool:
    return bool(re.fullmatch(r"[A-Z0-9]+(_[A-Z0-9]+)+", text))


@pytest.mark.parametrize(
    "wrong",
    [
        "ground.no_such_key",
        "ground.waits = 3",
        'law.error_function.name = "cubic"',
        "guidance/no_such_file.py",
        "tests/no_such_*.py",
        "guidance.limits.SLEW_PART = 0.8",
        "guidance.limits.no_such_name",
        "guidance nosuchverb",
        "guidance watch --nosuchoption",
        "--nosuchoption",
        "[nosuchtable]",
        '"nosuchvalue"',
        "NO_SUCH_PARAMETER",
        "nosuchword",
        "setpoint.nosuchfield",
        "guidance/<vehicle>/nosuchtopic",
        "udpinn://0.0.0.0:14540",
        "no bytes yet, and nobody to ask",
        "error: ... km off the trajectory",
        '{"nosuchname": 1}',
    ],
)
def test_what_does_not_exist_is_found(wrong: str) -> None:
    assert not is_known(wrong)


@pytest.mark.parametrize(
    "right",
    [
        "error: ... m off the trajectory",
        "handed-over: the mode was changed to ...",
        "heard ..., but the autopilot does not sign: give it the key of link.signing_key_file",
        "no bytes yet: ... is it on, RX wired to TX...",
    ],
)
def test_what_is_said_is_found(right: str) -> None:
    assert is_said(right)
    first, second, *rest = right.removesuffix("...").split()
    assert not is_said(" ".join([first, second, "never", *rest]))
