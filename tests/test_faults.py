"""The fault table: a part is flown here, the rest by `sitl faults`; and a broken service fails it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import pytest
from typer.testing import CliRunner

import guidance.law
import guidance.steering
import guidance.takeover
import guidance.view
import sitl.faults.table
from guidance.mavlink.setpoints import setpoint_message
from guidance.supervisor import State
from sitl import cli
from sitl.faults.fault import BEGINNINGS, Expected, Fault, Never
from sitl.faults.run import fly
from sitl.faults.table import TABLE

#: Every sixth, in the order of the table: all of its sections, in ten seconds.
PART: Final = TABLE[::6]


def row(title: str) -> Fault:
    """The fault with this title; the first of those that both firmwares have."""
    return next(fault for fault in TABLE if fault.title == title)


def test_the_table_has_enough_faults_each_with_a_name_and_an_outcome_of_its_own() -> None:
    assert len({fault.title for fault in TABLE}) >= 100
    assert len({(fault.title, fault.firmware) for fault in TABLE}) == len(TABLE)
    assert {fault.begin for fault in TABLE} == BEGINNINGS.keys() == set(State)
    for fault in TABLE:
        assert fault.expected.states < frozenset(State), fault.title
        safe = fault.expected.states - {State.TRACKING, State.HANDED_OVER}
        assert safe or fault.expected.within_m < 100.0 or fault.expected.never or fault.expected.modes


@pytest.mark.parametrize("fault", PART, ids=lambda fault: f"{fault.firmware}: {fault.title}")
def test_the_outcome_is_the_safe_one(fault: Fault) -> None:
    outcome = fly(fault)
    assert outcome.passed, (outcome.problems, outcome.states, outcome.reason)


def test_the_same_seed_gives_the_same_bytes_and_another_one_others() -> None:
    lossy = row("30 % of all datagrams are lost, each way")
    assert fly(lossy) == fly(lossy)
    assert fly(lossy).digest != fly(lossy, seed=1).digest


# The service is broken on purpose, and the table says so --------------------------------------------


def never(*_: Any, **__: Any) -> None:
    """Nothing."""


def old_state(estimate: Any, *_: Any) -> Any:
    return "no attitude or no position yet" if estimate is None else estimate


def unbounded(limits: Any, u1: float, u2: float, u3: float, *_: Any) -> tuple[float, float, float]:
    return u1, 7.0, u3


BROKEN: Final[dict[str, tuple[Any, str, Callable[..., Any], str, str]]] = {
    "no gap is too long": (
        guidance.view.Attempt, "silence", never,
        "ArduRover obeys any setpoint still: none comes after the gap", "ends tracking, not handed-over",
    ),
    "an old state will do": (
        guidance.steering, "young", old_state,
        "the attitude stands still, with its time", "a setpoint was made of a attitude",
    ),
    "the limits do not bind": (
        guidance.law, "limited_rates", unbounded,
        "a gap of 0.2 s both ways", "a pitch rate of 7 was sent",
    ),
    "the pilot is not seen": (
        guidance.takeover.PilotWatch, "unasked", never,
        "the pilot chooses another mode while tracking", "a setpoint was sent after a hand-over",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", BROKEN)
def test_a_service_that_is_broken_fails(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    where, name, instead, title, problem = BROKEN[what]
    monkeypatch.setattr(where, name, instead)
    outcome = fly(row(title))
    assert not outcome.passed
    assert any(problem in found for found in outcome.problems), outcome.problems


def test_a_setpoint_that_is_sent_again_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def repeated(profile: Any, out: Any, system: int, component: int, time_boot_ms: int) -> Any:
        return setpoint_message(profile, out, system, component, time_boot_ms // 100 * 100)

    monkeypatch.setattr(guidance.steering, "setpoint_message", repeated)
    assert "a setpoint was sent twice, or with an older time" in fly(row("a gap of 0.2 s both ways")).problems


def test_an_exception_is_an_outcome(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: Any) -> None:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(guidance.view.Contact, "look", broken)
    assert "raised ZeroDivisionError: a bug" in fly(row("a gap of 0.2 s both ways")).problems


# The command ----------------------------------------------------------------------------------------


def test_the_command_shows_a_table_and_gives_json() -> None:
    chosen = ["faults", "--only", "A gap of 0.5 s both", "--only", "refuses the mode"]
    shown = CliRunner().invoke(cli.app, chosen)
    assert shown.exit_code == 0, shown.output
    assert shown.output.count("pass") == 5  # four rows and the sum
    assert "4 flights of 2 faults: all passed" in shown.output
    told = CliRunner().invoke(cli.app, [*chosen, "--json", "--seed", "3"])
    report = json.loads(told.output)
    assert report["passed"]
    assert [found["seed"] for found in report["faults"]] == [3] * 4
    assert report["faults"][0]["expected"]["states"] == ["tracking"]
    assert report["faults"][0]["found"]["setpoints"] > 100


def test_an_outcome_that_is_not_as_expected_is_exit_status_1(monkeypatch: pytest.MonkeyPatch) -> None:
    gap = row("a gap of 2 s both ways")
    wrong = replace(
        gap,
        expected=Expected(
            frozenset({State.TRACKING}),
            frozenset({"reboot"}),
            within_m=0.0,
            out_within_s=0.1,
            modes=frozenset({"OFFBOARD"}),
            never=frozenset({Never.LEAVES}),
        ),
    )
    monkeypatch.setattr(sitl.faults.table, "TABLE", (wrong,))
    shown = CliRunner().invoke(cli.app, ["faults"])
    assert shown.exit_code == 1
    for problem in (
        "ends handed-over, not tracking",
        "not told: reboot",
        "told besides: silent",
        "m off, not within 0 m",
        "left tracking after 0.60 s, not within 0.1 s",
        "the vehicle is in POSCTL, not OFFBOARD",
        "it leaves tracking",
        "1 FAILED",
    ):
        assert problem in shown.output


def test_a_title_that_is_none_is_named_and_all_are_listed() -> None:
    outcome = CliRunner().invoke(cli.app, ["faults", "--only", "gremlins"])
    assert outcome.exit_code == 2
    assert "no fault's title holds 'gremlins'" in outcome.output
    listed = CliRunner().invoke(cli.app, ["faults", "--list"])
    assert listed.exit_code == 0
    assert f"{len(TABLE)} flights of" in listed.output
    assert "the service is killed (-9)" in CliRunner().invoke(cli.app, ["faults", "--list", "--real"]).output
