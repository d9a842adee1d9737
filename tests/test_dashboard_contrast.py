"""The two themes of the dashboard, computed: every colour of a text against what is behind texts."""

from __future__ import annotations

import re
from importlib import resources
from itertools import product

import pytest

#: What the style sheet promises; WCAG 2 asks for 4.5 of texts and for 3 of lines that mean something.
TEXT, LINE = 7.0, 3.0
INKS = ("ink", "soft", "a", "b", "c", "d", "good", "warn", "bad", "busy", "idle")
BACKS = ("back", "panel", "raised")
#: Pressed buttons, abort, and the alarm over the header.
REVERSED = (("back", "ink"), ("back", "bad"))
_SHEET = resources.files("guidance.dashboard").joinpath("static/page.css").read_text()


def themes() -> list[dict[str, str]]:
    """The colours of each block that names them: light, dark by the system, dark by the button."""
    blocks = re.findall(r":root[^{]*\{\s*color-scheme: \w+;([^}]*)\}", _SHEET)
    return [dict(re.findall(r"--([a-z]+): (#[0-9a-f]{6});", block)) for block in blocks]


def luminance(colour: str) -> float:
    """Relative luminance of an sRGB colour (WCAG 2)."""
    parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    red, green, blue = (v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    high, low = sorted((luminance(one), luminance(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_black_on_white_is_21_to_1() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)


def test_there_are_two_themes_and_the_dark_one_is_the_same_twice() -> None:
    light, dark, chosen = themes()
    assert light != dark == chosen
    assert set(light) == set(dark) >= {*INKS, *BACKS, "line", "edge"}


@pytest.mark.parametrize("theme", [0, 1])
def test_every_text_can_be_read_on_everything_that_is_behind_one(theme: int) -> None:
    colours = themes()[theme]
    pairs = [*product(INKS, BACKS), *REVERSED]
    ratios = {(ink, back): contrast(colours[ink], colours[back]) for ink, back in pairs}
    assert {pair: round(ratio, 2) for pair, ratio in ratios.items() if ratio < TEXT} == {}
    assert all(contrast(colours["edge"], colours[back]) >= LINE for back in BACKS)


def test_no_colour_is_used_that_is_not_of_the_themes() -> None:
    scripts = [
        file.read_text()
        for file in resources.files("guidance.dashboard").joinpath("static").iterdir()
        if file.name.endswith((".js", ".html"))
    ]
    outside = re.sub(r":root[^{]*\{[^}]*\}", "", _SHEET)
    for text in (outside, *scripts):
        assert re.findall(r"(?<!&)#[0-9a-f]{3,8}\b(?![\w-])(?=[;\"' ])|rgba?\(", text) == []
