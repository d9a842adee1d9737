"""The texts of the code, and whether what a page quotes is one of them."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from typing import Final

from guidance.guards import GUARDS
from guidance.requests import Order
from guidance.supervisor import State
from tests.pages import ROOT

#: What the service puts in front of a reason: who or what it is about.
HEADS: Final = "|".join([*(guard.name for guard in GUARDS), *State, *Order])


@cache
def texts() -> str:
    """All texts of the code: each between \\1, a place that is filled in as \\0; no docstrings."""
    found: list[str] = []
    for path in sorted([*(ROOT / "guidance").rglob("*.py"), *(ROOT / "sitl").rglob("*.py")]):
        found += _texts_in(ast.parse(path.read_text(encoding="utf-8")))
    return "\1" + "\1".join(found) + "\1"


def _texts_in(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return
    if isinstance(node, ast.Constant) and isinstance(node.value, str | bytes):
        yield node.value if isinstance(node.value, str) else node.value.decode("latin-1")
    elif isinstance(node, ast.JoinedStr):
        yield "".join(
            part.value if isinstance(part, ast.Constant) and isinstance(part.value, str) else "\0"
            for part in node.values
        )
        for part in node.values:
            if isinstance(part, ast.FormattedValue):
                yield from _texts_in(part.value)
    else:
        for child in ast.iter_child_nodes(node):
            yield from _texts_in(child)


def is_word_of_the_code(text: str) -> bool:
    """A whole text of the code: an event, a counter, a mode, a model, a name in JSON."""
    return bool(re.fullmatch(r"[a-z][a-z0-9_-]*", text)) and f"\1{text}\1" in texts()


def is_said(text: str) -> bool:
    """What the code says to people; `...` stands for what is filled in, and for what is left out."""
    said = re.sub(rf"^({HEADS})(: | )", "", text)
    if " " not in text and "..." not in text:
        return False
    parts = [part.strip(" :;,()") for part in said.split("...")]
    parts = [part for part in parts if part]
    if not parts:
        return said != text
    return max(map(len, parts)) >= 6 and all(map(_is_part_of_a_text, parts))


def _is_part_of_a_text(part: str) -> bool:
    """In one text, or at the end of one and the start of the next, which is filled in there."""
    if part in texts():
        return True
    cuts = [match.end() for match in re.finditer(r"[ (]", part)]
    ends = ((part[:cut], part[cut:]) for cut in cuts)
    return any(re.search(re.escape(a) + "[\0\1]", texts()) and f"\1{b}" in texts() for a, b in ends)
