"""What a check says: a verdict, what was found, and what to do about it."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple


class Verdict(StrEnum):
    """OK passes; WARN flies, but should be known; FAIL does not fly; SKIP could not be looked at."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"
    SKIP = "skip"


class Finding(NamedTuple):
    """One line. `todo` is empty where there is nothing to do."""

    check: str
    verdict: Verdict
    found: str
    todo: str = ""


def ok(check: str, found: str) -> Finding:
    """It is as it should be."""
    return Finding(check, Verdict.OK, found)


def warn(check: str, found: str, todo: str) -> Finding:
    """It flies all the same."""
    return Finding(check, Verdict.WARN, found, todo)


def fail(check: str, found: str, todo: str) -> Finding:
    """It does not fly like that."""
    return Finding(check, Verdict.FAIL, found, todo)


def skip(check: str, why: str) -> Finding:
    """It could not be looked at."""
    return Finding(check, Verdict.SKIP, why)


def parted(words: str) -> tuple[str, str]:
    """What is wrong and what to do, which the words of a transport or an event put behind a first ": "."""
    what, _, todo = words.partition(": ")
    return what, todo
