"""`guidance tune` as a command: consent, the end of a flight, report, proposal, and a log again."""

from __future__ import annotations

import json
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any, Final

import msgspec
import pytest
from typer.testing import CliRunner

from guidance import steps_command
from guidance.cli import app
from guidance.commands import Order, Shutdown
from guidance.config import Config, ConfigError, load
from guidance.flying.around import Phase
from guidance.records import TOPICS, Answer, Event, Record, Setpoint, Status, Stepping
from guidance.steps_flight import SOURCE, Conductor
from guidance.steps_plan import planned
from guidance.steps_vehicle import told_by_autopilot
from guidance.supervisor import State
from guidance.telemetry.queue import Sample
from guidance.telemetry.sinks import Sinks, TakesOrders
from sitl.logbook import LogBook
from tests.helpers import make_flight
from tests.preflight_rig import free_port
from tests.test_tune_flight import FENCE, SHIPPED, flight_of, newest, shipped
from tests.tuning_flight import told

S: Final = 1_000_000_000


def sample(record: Record) -> Sample:
    return Sample(TOPICS[type(record)], record.t_ns, msgspec.json.encode(record))


def status(state: State, at_s: float, reason: str = "why") -> Sample:
    return sample(
        Status(
            t_ns=round(at_s * S),
            state=state,
            reason=reason,
            since_ns=0,
            armed=True,
            mode="GUIDED",
            intended_mode="",
            trajectory_start_ns=None,
            origin_ned_m=None,
            setpoints_sent=0,
        )
    )


def stepping(phase: Phase) -> Sample:
    return sample(Stepping(t_ns=5 * S, run="speed", phase=phase, into_s=1.0))


class Console:
    """What is printed."""

    dropped = 0
    problem = ""

    def __init__(self) -> None:
        self.said: list[str] = []

    def offer(self, sample: Sample) -> None:
        self.said.append(msgspec.json.decode(sample.payload, type=Event).text)

    def start(self) -> None:
        raise NotImplementedError

    def close(self, timeout_s: float) -> bool:
        raise NotImplementedError


@pytest.fixture
def orders() -> list[Order]:
    return []


@pytest.fixture
def conductor(orders: list[Order]) -> Conductor:
    made = Conductor(60.0)
    assert isinstance(made, TakesOrders)
    Sinks({"steps": made}).orders_to(lambda order, until_ns: _taken(orders, order, until_ns))
    return made


def _taken(orders: list[Order], order: Order, until_ns: int) -> None:
    assert until_ns > time.monotonic_ns()
    orders.append(order)


def test_it_ends_once_when_the_steps_are_done(conductor: Conductor, orders: list[Order]) -> None:
    conductor.offer(status(State.TRACKING, 1.0))
    conductor.offer(stepping(Phase.STEPPING))
    assert orders == []
    for _ in range(3):
        conductor.offer(stepping(Phase.DONE))
    assert orders == [Shutdown(source=SOURCE)]
    conductor.offer(status(State.HANDED_OVER, 6.0))
    assert (conductor.ended, conductor.flew, conductor.stopped) == ("", True, False)
    assert [type(record) for record in conductor.records()] == [Stepping] * 4


@pytest.mark.parametrize("state", [State.HANDED_OVER, State.ABORTED])
def test_it_ends_when_somebody_else_has_ended_it(
    conductor: Conductor, orders: list[Order], state: State
) -> None:
    conductor.offer(status(State.TRACKING, 1.0))
    conductor.offer(status(state, 2.0, "the pilot switched"))
    assert orders == [Shutdown(source=SOURCE)]
    assert conductor.ended == f"{state}: the pilot switched"


def test_it_does_not_wait_for_ever_and_says_for_what(conductor: Conductor, orders: list[Order]) -> None:
    console = Console()
    conductor.says_by(console)
    for second in range(60):
        conductor.offer(status(State.CONNECTED, float(second), f"{second}.5 m outside"))
    conductor.offer(status(State.SWITCHING, 59.5))
    assert console.said == ["waiting, connected: 0.5 m outside"]
    assert orders == []
    conductor.offer(status(State.CONNECTED, 61.0, "no position"))
    assert orders == [Shutdown(source=SOURCE)]
    assert conductor.ended == "not engaged within 60 s; connected: no position"
    assert not conductor.flew


def test_a_flight_takes_longer_than_the_wait(conductor: Conductor, orders: list[Order]) -> None:
    conductor.offer(status(State.TRACKING, 1.0))
    conductor.offer(status(State.TRACKING, 100.0))
    assert orders == []


def test_it_knows_that_it_was_stopped(conductor: Conductor) -> None:
    def answered(source: str) -> Sample:
        return sample(Answer(t_ns=S, order="shutdown", id="", source=source, accepted=True, reason=""))

    conductor.offer(answered(SOURCE))
    assert not conductor.stopped
    conductor.offer(answered("SIGINT"))
    assert conductor.stopped


@pytest.fixture
def autopilot(monkeypatch: pytest.MonkeyPatch) -> None:
    """That of the built-in rover, without a line to it."""
    monkeypatch.setattr(steps_command, "told_by_autopilot", lambda config, wait_s: told("ardupilot-rover"))


@pytest.fixture(scope="module")
def short_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flight whose first run is complete; without the raw traffic, which is for a replay."""
    config = planned(shipped("log.foxglove=false")).config
    flight = flight_of(config)

    def returning() -> bool:
        seen = newest(flight)
        return seen is not None and seen.phase == Phase.RETURNING

    assert flight.run(60.0, until=returning)
    with LogBook(config, tmp_path_factory.mktemp("logs")) as book:
        for record in flight.records:
            if isinstance(record, Setpoint | Stepping):
                book.add(record)
    return book.path


def run(*words: object, **options: Any) -> Any:
    return CliRunner().invoke(app, ["tune", *map(str, words)], **options)


def test_a_log_is_identified_again_and_the_proposal_written(short_log: Path, tmp_path: Path) -> None:
    output = tmp_path / "proposal.toml"
    found = run("--log", short_log, "--output", output, "--json")
    assert found.exit_code == 1  # one of two channels
    told = json.loads(found.stdout.splitlines()[-1])
    assert told["channels"]["speed_m_s"] == {"refused": "its run was not flown"}
    assert told["channels"]["yaw_rate_rad_s"]["answer"]["gain"] == pytest.approx(0.927, abs=0.01)
    assert tomllib.loads(output.read_text(encoding="utf-8")) == tomllib.loads(told["toml"])
    assert "speed_m_s: not identified: its run was not flown" in found.stderr
    plain = run("--log", short_log)
    assert "0.927 ±0.0" in plain.stdout  # whole, however narrow the terminal
    nowhere = run("--log", short_log, "--output", tmp_path / "no" / "such.toml")
    assert nowhere.exit_code == 1
    assert "cannot be written: No such file" in nowhere.stderr


def test_a_log_of_another_flight_is_refused(tmp_path: Path) -> None:
    flight = make_flight()
    flight.run(1.0)
    with LogBook(flight.guide.config, tmp_path) as book:
        for record in flight.records:
            book.add(record)
    found = run("--log", book.path)
    assert found.exit_code == 2
    assert "no tuning flight: its configuration has no steps" in found.stderr
    (tmp_path / "text.mcap").write_text("hello")
    assert run("--log", tmp_path / "text.mcap").exit_code == 2


@pytest.mark.usefixtures("autopilot")
def test_without_consent_nothing_is_flown(monkeypatch: pytest.MonkeyPatch) -> None:
    def fly(config: Config, wait_s: float) -> tuple[int, Conductor]:
        raise AssertionError

    monkeypatch.setattr(steps_command, "fly", fly)
    for answer in ("no\n", "y\n", ""):
        found = run("--config", SHIPPED, "--set", FENCE, input=answer)
        assert found.exit_code == 1
        assert "It needs 44 m ahead" in found.stderr
        assert "not flown" in found.stderr


@pytest.mark.usefixtures("autopilot")
@pytest.mark.parametrize("stopped", [False, True])
def test_what_was_flown_is_told(
    monkeypatch: pytest.MonkeyPatch, conductor: Conductor, *, stopped: bool
) -> None:
    def fly(config: Config, wait_s: float) -> tuple[int, Conductor]:
        assert wait_s == 7.0
        assert config.excitation.runs
        conductor.offer(status(State.TRACKING, 1.0))
        conductor.offer(status(State.HANDED_OVER, 2.0, "a mode that was not asked for"))
        conductor.stopped = stopped
        return 0, conductor

    monkeypatch.setattr(steps_command, "fly", fly)
    found = run("--config", SHIPPED, "--set", FENCE, "--yes", "--wait", 7)
    assert found.exit_code == (130 if stopped else 1)
    if stopped:
        assert "guidance tune --log LOG.mcap" in found.stderr
    else:
        assert "ended early: handed-over: a mode that was not asked for" in found.stderr
        assert "yaw_rate_rad_s: not identified: its run was not flown" in found.stdout


@pytest.mark.parametrize("words", [(), ("--config", SHIPPED, "--log", "x.mcap")])
def test_it_is_flown_or_read(words: tuple[object, ...]) -> None:
    found = run(*words)
    assert found.exit_code == 2
    assert "say what to fly" in found.stderr


@pytest.mark.parametrize(
    ("name", "settings"), [("px4-uuv", ()), ("px4-plane", ("--set", "airplane.output=rates"))]
)
def test_what_cannot_be_stepped_is_refused_before_anybody_is_asked(
    monkeypatch: pytest.MonkeyPatch, name: str, settings: tuple[str, ...]
) -> None:
    monkeypatch.setattr(steps_command, "told_by_autopilot", None)
    found = run("--config", SHIPPED.with_name(f"{name}.toml"), *settings, "--yes")
    assert found.exit_code == 2
    assert f"vehicle.profile = {name}, which is asked for body rates" in found.stderr
    assert "there are no steps of that" in found.stderr


def test_the_autopilot_tells_its_parameters_or_why_not() -> None:
    port = free_port()
    config = load(SHIPPED, (f'link.connection="udpin://127.0.0.1:{port}"',))
    with pytest.raises(ConfigError, match=r"the steps are planned by what it tells of itself"):
        told_by_autopilot(config, 0.3)
    vehicle = [sys.executable, "-m", "sitl", "vehicle", "--firmware", "ardupilot-rover"]
    vehicle += ["--to", f"127.0.0.1:{port}", "--port", "0"]
    with subprocess.Popen(vehicle, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            values = told_by_autopilot(config, 30.0)
        finally:
            process.terminate()
    assert values["TURN_RADIUS"] == pytest.approx(0.9)
    assert values == pytest.approx(told("ardupilot-rover"))


@pytest.mark.usefixtures("autopilot")
def test_wrong_settings_are_refused() -> None:
    found = run("--config", SHIPPED, "--yes")
    assert found.exit_code == 2
    assert "there is no fence" in found.stderr
