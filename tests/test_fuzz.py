"""`sitl fuzz`: a short run of every door finds nothing, and bugs that are planted are found."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from pymavlink.dialects.v20 import all as dialect
from typer.testing import CliRunner

import guidance.core
import guidance.fleet
import guidance.steering
from guidance.mavlink.codec import FrameReader
from guidance.mavlink.sequence import SequenceWatch
from guidance.mavlink.setpoints import setpoint_message
from guidance.supervisor import State
from guidance.telemetry import arrivals
from sitl import cli
from sitl.fuzzing.dice import Dice
from sitl.fuzzing.frames import IDS, Signer, fitting, frame, payload
from sitl.fuzzing.run import DOORS, Episode, Outcome, episodes, run, run_episode
from sitl.fuzzing.sizes import longest

#: A few seconds each; the long run is the command's.
SHORT = {"bytes": 2100, "messages": 2100, "config": 60, "zenoh": 3000, "logs": 60}


def flown(door: str, inputs: int, seed: int = 0) -> list[Outcome]:
    """The episodes of a run, in this process, up to the first failure."""
    outcomes = []
    for episode in episodes([door], inputs, seed):
        outcomes.append(run_episode(episode))
        if outcomes[-1].failure is not None:
            break
    return outcomes


@pytest.mark.parametrize("door", DOORS)
def test_a_short_run_of_each_door_finds_nothing(door: str) -> None:
    outcomes = flown(door, SHORT[door])
    assert [outcome.failure for outcome in outcomes if outcome.failure is not None] == []
    assert sum(outcome.inputs for outcome in outcomes) == SHORT[door]


def test_the_inputs_are_shared_out_to_the_last_one() -> None:
    drawn = list(episodes([*DOORS], 12_345, 1))
    assert sum(episode.inputs for episode in drawn) == 12_345
    assert {episode.door for episode in drawn} == set(DOORS)
    assert len(set(drawn)) == len(drawn)
    assert sum(way.share for way in DOORS.values()) == 1_000_000


def test_one_seed_is_one_run_and_another_is_another() -> None:
    first, again, other = (run_episode(Episode("messages", seed, 3, 80)).digest for seed in (1, 1, 2))
    assert first == again != other


# What is planted is found ------------------------------------------------------------------------------


def with_no_empty_payloads(monkeypatch: pytest.MonkeyPatch) -> None:
    """The reader forgets that a payload can be empty."""
    feed = FrameReader.feed

    def trusting(self: FrameReader, data: bytes) -> Any:
        frames = feed(self, data)
        for found in frames:
            assert found.payload[0] >= 0
        return frames

    monkeypatch.setattr(FrameReader, "feed", trusting)


def with_a_list_of_all_that_came(monkeypatch: pytest.MonkeyPatch) -> None:
    place = SequenceWatch.place

    def remembering(self: Any, sequence: int, now_ns: int) -> Any:
        self.__dict__.setdefault("all", []).append((sequence, now_ns))
        return place(self, sequence, now_ns)

    monkeypatch.setattr(SequenceWatch, "place", remembering)


def with_setpoints_in_every_state(monkeypatch: pytest.MonkeyPatch) -> None:
    tick = guidance.core.Guide._tick

    def ticking(self: guidance.core.Guide, now_ns: int) -> None:
        tick(self, now_ns)
        if self.engagement.state is State.HANDED_OVER:
            self._setpoint(now_ns)

    monkeypatch.setattr(guidance.core.Guide, "_tick", ticking)


def with_limits_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    send = setpoint_message

    def wide(profile: Any, out: Any, *others: Any) -> Any:
        return send(profile, out._replace(thrust=out.thrust * 1.5), *others)

    monkeypatch.setattr(guidance.steering, "setpoint_message", wide)


def without_nesting(monkeypatch: pytest.MonkeyPatch) -> None:
    """A payload that nests too deeply is not expected."""
    monkeypatch.setattr(arrivals, "NOT_A_RECORD", (msgspec.MsgspecError, UnicodeDecodeError))


def with_any_number_of_vehicles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guidance.fleet, "VEHICLES_MAX", 10**9)


def with_any_number_of_kinds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guidance.fleet, "_MAX_KINDS", 10**9)


@pytest.mark.parametrize(
    ("door", "bug", "said"),
    [
        ("bytes", with_no_empty_payloads, "IndexError"),
        ("messages", with_a_list_of_all_that_came, "has grown to"),
        ("messages", with_setpoints_in_every_state, "a setpoint was sent in handed-over"),
        ("messages", with_limits_forgotten, "a setpoint is outside"),
        ("zenoh", without_nesting, "RecursionError"),
        ("zenoh", with_any_number_of_vehicles, "vehicles are kept"),
        ("zenoh", with_any_number_of_kinds, "kinds of what was ignored"),
    ],
)
def test_a_planted_bug_is_found(
    monkeypatch: pytest.MonkeyPatch, door: str, bug: Callable[[pytest.MonkeyPatch], None], said: str
) -> None:
    bug(monkeypatch)
    failure = flown(door, 20 * DOORS[door].inputs)[-1].failure
    assert failure is not None
    assert said in failure.error, failure
    assert f"--door {door} --seed 0 --episode {failure.episode.number}" in failure.episode.command
    again = run_episode(failure.episode).failure
    assert again is not None
    assert (again.input, again.error, again.shown) == (failure.input, failure.error, failure.shown)


# The command -------------------------------------------------------------------------------------------


def test_the_command_reports_as_json_and_one_episode_alone() -> None:
    outcome = CliRunner().invoke(
        cli.app, ["fuzz", "--door", "zenoh", "--episode", "2", "--seed", "9", "--json"]
    )
    assert outcome.exit_code == 0, outcome.output
    report = json.loads(outcome.stdout)
    assert report["inputs"] == {"zenoh": DOORS["zenoh"].inputs}
    assert report["failures"] == []
    assert report["digest"]


def test_a_failure_is_told_with_what_runs_it_again(monkeypatch: pytest.MonkeyPatch) -> None:
    without_nesting(monkeypatch)
    number = flown("zenoh", 20 * DOORS["zenoh"].inputs)[-1].episode.number
    outcome = CliRunner().invoke(
        cli.app, ["fuzz", "--door", "zenoh", "--seed", "0", "--episode", str(number)]
    )
    assert outcome.exit_code == 1
    assert "FAILED RecursionError" in outcome.stdout
    assert f"again: sitl fuzz --door zenoh --seed 0 --episode {number}" in outcome.stdout


@pytest.mark.parametrize("wrong", [["--door", "window"], ["--episode", "1"]])
def test_what_cannot_be_run_is_refused(wrong: list[str]) -> None:
    outcome = CliRunner().invoke(cli.app, ["fuzz", *wrong])
    assert outcome.exit_code == 2
    assert "sitl fuzz: --" in outcome.stderr


def test_processes_give_what_one_process_gives() -> None:
    told: list[tuple[str, int]] = []
    report = run(["bytes"], 120, 5, 2, lambda door, inputs: told.append((door, inputs)))
    again = run(["bytes"], 120, 5, 1)
    assert report.failures == again.failures == []
    assert (report.digest, report.inputs) == (again.digest, again.inputs) != ("", {})
    assert sum(inputs for _, inputs in told) == 120


# Its own tools -----------------------------------------------------------------------------------------


def test_the_frames_are_those_that_pymavlink_reads() -> None:
    dice, key = Dice("frames"), bytes(range(32))
    for message_id in IDS:
        content = payload(message_id, dice, {}, 1.0)
        for version, signer in ((1, None), (2, None), (2, Signer(key, 3, 10**12))):
            data = frame(message_id, content, 300, system=7, component=9, version=version, signer=signer)
            mav = dialect.MAVLink(None)
            mav.signing.secret_key = None if signer is None else key
            (message,) = mav.parse_buffer(data)
            assert (message.get_msgId(), message.get_seq()) == (message_id, 44)
            assert (message.get_srcSystem(), message.get_srcComponent()) == (7, 9)
            assert message.get_signed() == (signer is not None)


def test_what_is_known_of_a_message_is_in_it() -> None:
    known = {"q": (1.0, 0.0, 0.0, 0.0), "x": 2.5, "frame_id": 1, "lat": 5, "time_usec": 7}
    content = payload(331, Dice("x"), fitting(331, known), 0.0)
    (message,) = dialect.MAVLink(None).parse_buffer(frame(331, content, 0))
    assert (message.q, message.x, message.frame_id, message.time_usec) == ([1.0, 0.0, 0.0, 0.0], 2.5, 1, 7)


def test_the_longest_container_is_found_wherever_it_is() -> None:
    watch = SequenceWatch()
    assert longest(watch).length < 5
    watch.__dict__["kept"] = {"a": [(1, b"x" * 50)]}
    assert longest(watch, "watch") == (50, "watch.kept['a'][][]")
