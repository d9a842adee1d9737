"""The supervisor's table: every state with every event, what may be reached, and its copy for people."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Final

import pytest

from guidance.supervisor import (
    BRIEFS,
    CAUSES,
    GUARDED,
    MEANINGS,
    SETPOINTS,
    TRANSITIONS,
    Event,
    Setpoints,
    State,
    status_text,
    table_markdown,
    transition,
)

PAGE: Final = Path(__file__).parents[1] / "docs" / "supervisor.md"

#: Written out apart from the code: the state after an event, or the state itself where none is named.
EXPECTED: Final[dict[str, dict[str, str]]] = {
    "disconnected": {"found": "connected", "found-in-control": "withheld", "shutdown": "finished"},
    "connected": {"conditions-met": "ready", "lost": "disconnected", "shutdown": "finished"},
    "withheld": {
        "released": "connected",
        "commanded": "connected",
        "lost": "disconnected",
        "shutdown": "finished",
    },
    "ready": {
        "conditions-lost": "connected",
        "engage": "streaming",
        "pilot-switched": "arming",
        "lost": "disconnected",
        "shutdown": "finished",
    },
    "streaming": {
        "pilot-switched": "arming",
        "stream-established": "switching",
        "step-timeout": "aborted",
        "mode-left": "handed-over",
        "disarmed": "handed-over",
        "interrupted": "handed-over",
        "lost": "disconnected",
        "abort": "cancelling",
        "shutdown": "backing-out",
    },
    "switching": {
        "mode-confirmed": "arming",
        "step-timeout": "aborted",
        "mode-left": "handed-over",
        "disarmed": "handed-over",
        "interrupted": "handed-over",
        "lost": "handed-over",
        "abort": "cancelling",
        "shutdown": "backing-out",
    },
    "arming": {
        "in-control": "tracking",
        "step-timeout": "aborted",
        "mode-left": "handed-over",
        "disarmed": "handed-over",
        "interrupted": "handed-over",
        "lost": "handed-over",
        "abort": "cancelling",
        "shutdown": "backing-out",
    },
    "tracking": {
        "hold": "pausing",
        "abort": "aborting",
        "guard-tripped": "aborting",
        "guard-silences": "aborted",
        "mode-left": "handed-over",
        "disarmed": "handed-over",
        "interrupted": "handed-over",
        "lost": "handed-over",
        "shutdown": "leaving",
    },
    "pausing": {
        "hold-confirmed": "holding",
        "step-timeout": "aborted",
        "abort": "aborting",
        "guard-tripped": "aborting",
        "guard-silences": "aborted",
        "mode-left": "handed-over",
        "disarmed": "handed-over",
        "lost": "handed-over",
        "shutdown": "leaving",
    },
    "holding": {
        "resume": "streaming",
        "pilot-switched": "arming",
        "abort": "aborted",
        "mode-left": "handed-over",
        "disarmed": "handed-over",
        "lost": "handed-over",
        "shutdown": "finished",
    },
    "aborting": {
        "left": "aborted",
        "mode-left": "handed-over",
        "disarmed": "handed-over",
        "lost": "handed-over",
    },
    "cancelling": {
        "left": "aborted",
        "mode-left": "handed-over",
        "disarmed": "handed-over",
        "lost": "handed-over",
    },
    "backing-out": {"left": "finished", "mode-left": "finished", "disarmed": "finished", "lost": "finished"},
    "leaving": {"left": "finished", "mode-left": "finished", "disarmed": "finished", "lost": "finished"},
    "handed-over": {
        "commanded": "connected",
        "pilot-switched": "arming",
        "released": "connected",
        "lost": "disconnected",
        "shutdown": "finished",
    },
    "aborted": {
        "commanded": "connected",
        "pilot-switched": "arming",
        "retry": "connected",
        "lost": "disconnected",
        "shutdown": "finished",
    },
    "finished": {},
}

STREAMED: Final = {
    "disconnected": "none",
    "connected": "none",
    "withheld": "none",
    "ready": "neutral",
    "streaming": "neutral",
    "switching": "neutral",
    "arming": "neutral",
    "tracking": "law",
    "pausing": "law",
    "holding": "none",
    "aborting": "law",
    "cancelling": "neutral",
    "backing-out": "neutral",
    "leaving": "law",
    "handed-over": "none",
    "aborted": "none",
    "finished": "none",
}


@pytest.mark.parametrize("state", State)
@pytest.mark.parametrize("event", Event)
def test_every_event_in_every_state_leads_where_it_should(state: State, event: Event) -> None:
    assert transition(state, event) == EXPECTED[state].get(event, state)


def test_the_expected_table_is_complete_and_has_no_other_rows() -> None:
    assert set(EXPECTED) == set(State)
    rows = {(state, event): after for state, ways in EXPECTED.items() for event, after in ways.items()}
    assert rows == TRANSITIONS
    assert {event for _, event in rows} == set(Event)
    assert not any(state == after for (state, _), after in rows.items())


def reachable(start: State, without: Collection[Event] = ()) -> set[State]:
    """Every state that any sequence of events leads to, `start` among them."""
    found, waiting = {start}, [start]
    while waiting:
        state = waiting.pop()
        for event in Event:
            after = transition(state, event)
            if event not in without and after not in found:
                found.add(after)
                waiting.append(after)
    return found


def test_every_state_is_reached_from_the_start() -> None:
    assert reachable(State.DISCONNECTED) == set(State)


def test_finished_is_the_end_and_can_be_reached_from_everywhere() -> None:
    assert reachable(State.FINISHED) == {State.FINISHED}
    for state in State:
        assert State.FINISHED in reachable(state)


def test_what_is_streamed_is_defined_for_every_state() -> None:
    assert SETPOINTS == STREAMED


#: Nobody has asked this service to fly, or the pilot has control.
NOT_OURS: Final = (
    State.DISCONNECTED,
    State.CONNECTED,
    State.WITHHELD,
    State.READY,
    State.HOLDING,
    State.HANDED_OVER,
    State.ABORTED,
)
FRESH: Final = {Event.ENGAGE, Event.COMMANDED, Event.RESUME, Event.PILOT_SWITCHED}


@pytest.mark.parametrize("state", NOT_OURS)
def test_only_a_command_or_a_switch_leads_from_the_pilots_hands_to_the_law(state: State) -> None:
    flown = {state for state in State if SETPOINTS[state] is Setpoints.LAW}
    assert flown == {State.TRACKING, State.PAUSING, State.ABORTING, State.LEAVING}
    assert flown <= reachable(state)
    assert not flown & reachable(state, without=FRESH)


def test_once_handed_over_or_withheld_nothing_flows_without_a_command_a_switch_or_a_release() -> None:
    for state in (State.HANDED_OVER, State.WITHHELD):
        over = reachable(state, without={*FRESH, Event.RELEASED, Event.LOST})
        assert all(SETPOINTS[after] is Setpoints.NONE for after in over)


#: READY streams too, but only where it takes nothing from anybody.
ENGAGED: Final = [s for s in State if SETPOINTS[s] is not Setpoints.NONE and s is not State.READY]


@pytest.mark.parametrize("state", ENGAGED)
def test_in_every_engaged_state_the_pilots_act_ends_the_stream_at_once(state: State) -> None:
    for event in (Event.MODE_LEFT, Event.DISARMED, Event.LOST):
        assert SETPOINTS[transition(state, event)] is Setpoints.NONE


def test_the_table_for_people_names_every_state_event_and_transition() -> None:
    table = table_markdown()
    assert set(MEANINGS) == set(State)
    assert set(CAUSES) == set(Event)
    rows = {line.split("**")[1]: line for line in table.splitlines() if line.startswith("| **")}
    for (state, event), after in TRANSITIONS.items():
        ways = [way for way in rows[state].split("<br>") if f"`{event}`" in way]
        assert len(ways) == 1
        assert ways[0].rstrip(" |").endswith(f"→ **{after}**")
    for event in Event:
        assert f"| `{event}` | {CAUSES[event]} |" in table


def test_every_change_fits_into_a_status_text_whole_or_in_brief() -> None:
    assert set(BRIEFS) == set(Event)
    for (_, event), after in TRANSITIONS.items():
        assert status_text(after, event, "short") == f"guidance: {after}: short"
        guard = " failsafe" if event in GUARDED else ""
        brief = status_text(after, event, f"failsafe: {50 * 'x'}")
        assert brief == f"guidance: {after}: {BRIEFS[event]}{guard}"
        assert len(brief.encode("ascii")) <= 50


def test_the_page_shows_the_table_as_it_is() -> None:
    begin, end = "<!-- supervisor table: begin -->", "<!-- supervisor table: end -->"
    page = PAGE.read_text(encoding="utf-8")
    assert begin in page, f"docs/supervisor.md lacks, between {begin} and {end}:\n\n{table_markdown()}"
    shown = page.split(begin)[1].split(end)[0].strip()
    assert shown == table_markdown().strip(), f"docs/supervisor.md should say:\n\n{table_markdown()}"
