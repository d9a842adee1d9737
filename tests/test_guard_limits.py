"""The guards' table, and settings of [guards] that make no sense."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import pytest

from guidance.checking import ConfigError
from guidance.guard_limits import ACTIONS
from guidance.guards import GUARDS, table_markdown
from tests.helpers import (
    ROVER,
    make_config,
)

PAGE: Final = Path(__file__).parents[1] / "docs" / "supervisor.md"


def test_every_guard_has_an_action_and_every_key_belongs_to_one() -> None:
    assert {f"{guard.name}_action" for guard in GUARDS} == set(ACTIONS)


def test_an_action_that_the_profile_lacks_is_refused_with_those_it_has() -> None:
    with pytest.raises(ConfigError, match=r'guards.tilt_action = "land": ardupilot-rover has no such mode; '):
        make_config(*ROVER, "guards.tilt_action=land")
    with pytest.raises(ConfigError, match='"silence", "manual"'):
        make_config(*ROVER, "guards.tilt_action=guided")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["fence_ned_m=[[0.0,0.0],[1.0,0.0]]"], "2 corners make no fence"),
        (["fence_ned_m=[[0.0,0.0],[1.0,1.0],[1.0,0.0],[0.0,1.0]]"], "its edges cross"),
        (["fence_ned_m=[[0.0,0.0],[1.0,1.0],[2.0,2.0]]"], "nothing inside"),
        (["fence_ned_m=[[0.0,0.0],[9.0,0.0],[0.0,9.0],[0.0,0.0]]"], "a corner comes twice: leave it out"),
        (["fence_ned_m=[[0.0,nan],[1.0,1.0],[2.0,2.0]]"], "a list of pairs of numbers"),
        (["fence_deg=[[0.0,0.0],[91.0,1.0],[2.0,0.0]]"], "latitude -90 to 90"),
        (["fence_deg=[[0.0,0.0],[1.0,1.0],[2.0,0.0]]", "fence_ned_m=[[0.0,0.0]]"], "set only one"),
        (["fence_down_min_m=2", "fence_down_max_m=1"], "below fence_down_max_m"),
        (["fence_down_max_m=1"], "outside the fence after 10.25 s; make the fence larger"),
    ],
)
def test_a_fence_that_makes_no_sense_is_refused(settings: list[str], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        make_config("flight.origin=ekf", *(f"guards.{setting}" for setting in settings))


def test_the_page_shows_the_guards_as_they_are() -> None:
    begin, end = "<!-- guards table: begin -->", "<!-- guards table: end -->"
    page = PAGE.read_text(encoding="utf-8")
    shown = page.split(begin)[1].split(end)[0].strip()
    assert shown == table_markdown().strip(), f"docs/supervisor.md should say:\n\n{table_markdown()}"


def test_a_limit_on_the_delay_that_could_never_act_is_refused() -> None:
    words = r"guards.delay_max_s = 0.3: .* below link.attitude_timeout_s = 0.3"
    with pytest.raises(ConfigError, match=words):
        make_config("link.attitude_timeout_s=0.3", "guards.delay_max_s=0.3")
