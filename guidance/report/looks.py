"""Colours that are told apart by everyone (Okabe and Ito), on paper and on a dark screen."""

from __future__ import annotations

from typing import Final

#: One for each log, then again from the first.
LOGS: Final = ("#2a7fc1", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
ROLES: Final = {"demanded": "#999999", "sent": "#2a7fc1", "measured": "#d55e00", "other": "#009e73"}
REFERENCE: Final = "#888888"
FENCE: Final = "#c1272d"
START: Final = "#009e73"
LEVELS: Final = {
    "info": "#999999",
    "notice": "#56b4e9",
    "warning": "#e69f00",
    "error": "#d55e00",
    "critical": "#c1272d",
}
STATES: Final = {
    "tracking": "#009e73",
    "holding": "#56b4e9",
    "pausing": "#56b4e9",
    "aborting": "#d55e00",
    "aborted": "#c1272d",
    "handed-over": "#e69f00",
    "withheld": "#e69f00",
    "disconnected": "#c1272d",
}
OTHER_STATE: Final = "#b9c0c7"


def shade(state: str) -> str:
    """Of a state; states of one colour are one entry of a legend."""
    return STATES.get(state, OTHER_STATE)


def rank(role: str | int) -> int:
    """Its place in a legend."""
    return role if isinstance(role, int) else list(ROLES).index(role)


def colour(role: str | int) -> str:
    """Of a line."""
    return LOGS[role % len(LOGS)] if isinstance(role, int) else ROLES[role]
