"""The README and the pages in docs: their commands, what stands in backticks, their tables, their links."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[1]
README: Final = ROOT / "README.md"
DOCS: Final = sorted((ROOT / "docs").glob("*.md"))
PAGES: Final = [README, *DOCS]


def read(page: Path) -> str:
    """The whole text."""
    return page.read_text(encoding="utf-8")


def fenced(page: Path, language: str) -> list[str]:
    """The fenced blocks of a language, without the indentation that a list gives them."""
    blocks = re.findall(rf"^( *)```{language}\n(.*?)^ *```$", read(page), re.DOTALL | re.MULTILINE)
    return [re.sub(rf"^{indent}", "", block, flags=re.MULTILINE) for indent, block in blocks]


def commands_of(page: Path) -> list[str]:
    """Each line of its shell blocks."""
    lines = [line.strip() for block in fenced(page, "sh") for line in block.splitlines()]
    return [line for line in lines if line]


def prose(page: Path) -> str:
    """The text without its fenced blocks."""
    return re.sub(r"^ *```.*?^ *```$", "", read(page), flags=re.DOTALL | re.MULTILINE)


def spans(text: str) -> list[str]:
    """What stands in backticks, in double ones too; indented formulas have none."""
    doubled = re.findall(r"``\s?(.+?)\s?``", text)
    return [*doubled, *re.findall(r"`([^`\n]+)`", re.sub(r"``.+?``", "", text))]


def tables(text: str) -> Iterator[dict[str, str]]:
    """Each row of each table, by the titles of its columns."""
    for table in re.findall(r"(?:^ *\|.*\|\n)+", text, re.MULTILINE):
        rows = [[cell.strip() for cell in cells(line)] for line in table.splitlines()]
        titles, rule, *rest = rows
        assert all(re.fullmatch(r"-{3,}", cell) for cell in rule), table
        for row in rest:
            assert len(row) == len(titles), row
            yield dict(zip(titles, row, strict=True))


def cells(line: str) -> list[str]:
    """Of a row: a bar in backticks parts none."""
    return re.split(r"\|(?=(?:[^`]*`[^`]*`)*[^`]*$)", line.strip())[1:-1]


def anchors(page: Path) -> set[str]:
    """What a link may name behind a `#`: the titles, as GitHub makes anchors of them."""
    titles = re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}


def links(page: Path) -> list[tuple[str, str]]:
    """Where each link leads: a file as it is written, and an anchor; those to the web are left out."""
    found = re.findall(r"\]\(([^)\s]+)\)", prose(page))
    return [target.partition("#")[::2] for target in found if "://" not in target]
