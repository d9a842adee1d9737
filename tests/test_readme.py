"""Every command line in the README and in docs is known here and works; two stand in CI as well."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import threading
import tomllib
from pathlib import Path
from typing import Any

import pytest
import typer.main
from typer.testing import CliRunner

import guidance.demo
import sitl.bench
from guidance import cli as guidance_cli
from guidance import steps_command
from guidance.commands import read_payload
from guidance.config import load
from guidance.demo import CONFIG_FILE, Result
from guidance.figures import StreamFigures, TrackingFigures
from guidance.signing_files import read_key
from guidance.telemetry.zenoh_orders import Reply
from sitl import cli as sitl_cli
from sitl.logbook import LogBook
from sitl.scenarios.table import Result as Reached
from sitl.scenarios.table import Row, Variation
from tests.helpers import make_config, make_flight
from tests.page_commands import (
    CAMPAIGNS,
    CHECKS,
    COMMANDS,
    DASHBOARDS,
    DEMOS,
    FLOWN,
    FOXGLOVE,
    FUZZ,
    INSTALL_AND_TEST,
    MAKE_A_KEY,
    NOT_RUN,
    ON_THE_VEHICLE,
    ORDERS,
    PAPER,
    REPLAYS,
    RUN,
    SCENARIOS,
    TUNES,
    WATCHES,
    starting,
    words,
)
from tests.pages import ROOT
from tests.tuning_flight import told

RESULTS = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")


def test_every_command_is_run_by_a_test_here_or_it_is_said_why_not() -> None:
    assert sorted(COMMANDS) == sorted([*RUN, *NOT_RUN])
    assert len(DEMOS) >= 3
    assert REPLAYS
    assert all(map(len, NOT_RUN.values()))


@pytest.mark.parametrize("command", starting(".venv/bin/guidance", ".venv/bin/sitl"))
def test_each_of_our_own_is_parsed_by_its_program(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every option exists and takes its value, every file that is read is there, every key is one."""
    monkeypatch.chdir(ROOT)
    made = tmp_path / "made"  # what the page itself makes: a log, a key
    made.touch()
    name = Path(shlex.split(command)[0]).name
    arguments = [str(made) if re.search(r"\.mcap|^signing\.key$", w) else w for w in words(command)]
    parsed: Any = typer.main.get_command({"guidance": guidance_cli.app, "sitl": sitl_cli.app}[name])
    while arguments and arguments[0] in getattr(parsed, "commands", {}):
        parsed = parsed.commands[arguments.pop(0)]
    given = parsed.make_context(name, list(arguments)).params
    if "overrides" in given and given.get("config"):
        settings = [each for each in given.get("overrides", ()) if "signing_key" not in each]
        config = load(ROOT / given["config"], settings)
        by_hand = "supervisor.engage=auto" in command
        assert (config.supervisor.engage == "pilot") != by_hand
        assert not config.supervisor.arm or "supervisor.arm=true" in command
    for word in arguments:
        file = re.fullmatch(r"(deploy|docs|guidance|sitl|tests)/[^=]*", word)
        assert file is None or (ROOT / word).exists(), word


def test_ci_calls_the_very_test_command_of_the_readme() -> None:
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()
    assert script[-1] == INSTALL_AND_TEST
    assert os.access(ROOT / ".ci" / "run", os.X_OK)


def test_what_the_two_commands_install_exists() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert {"sitl", "test"} <= project["optional-dependencies"].keys()
    assert project["scripts"] == {"guidance": "guidance.cli:main", "sitl": "sitl.cli:main"}


@pytest.mark.parametrize("command", DEMOS)
def test_each_demo_is_accepted_and_flies_in_lockstep(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The real demo flies in test_demo; here the same configuration does, on virtual time."""

    def fly(seconds: float, overrides: list[str]) -> Result:
        config = load(CONFIG_FILE, overrides)
        flight = make_flight(config=config)
        assert flight.run(10.0, until=lambda: flight.guide.tracker.start_ns is not None)
        assert seconds >= 10.0
        return Result(TrackingFigures(9.0, 1e-4, 1e-3), StreamFigures(50.0, 0.02), seconds, "log", False)

    def attend(seconds: float | None, overrides: list[str], *, open_browser: bool) -> int:
        fly(10.0 if seconds is None else seconds, overrides)
        return 0

    monkeypatch.setattr(guidance.demo, "fly", fly)
    monkeypatch.setattr("guidance.demo_page.attend", attend)
    outcome = CliRunner().invoke(guidance_cli.app, words(command))
    assert outcome.exit_code == 0, outcome.output


@pytest.mark.parametrize("command", CHECKS)
def test_a_check_without_a_vehicle_says_so(command: str, tmp_path: Path) -> None:
    silent = ["--set", "link.connection=udpin://127.0.0.1:0", "--set", f"log.directory={tmp_path}"]
    outcome = CliRunner().invoke(guidance_cli.app, [*words(command), *silent, "--seconds", "1"])
    assert outcome.exit_code == 1, outcome.output
    assert "no bytes yet" in outcome.output


@pytest.mark.parametrize("command", TUNES)
def test_tuning_says_what_it_will_do_and_asks(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is flown after a yes, and written, is in test_tune_flight and test_tune_command."""
    monkeypatch.setattr(steps_command, "told_by_autopilot", lambda config, wait_s: told("ardupilot-rover"))
    outcome = CliRunner().invoke(guidance_cli.app, words(command), input="no\n")
    assert outcome.exit_code == 1, outcome.output
    assert "It needs 44 m ahead" in outcome.output
    assert "not flown" in outcome.output


@pytest.mark.parametrize("command", REPLAYS)
def test_replay_of_a_log_is_identical(command: str, tmp_path: Path) -> None:
    with LogBook(make_config(), tmp_path) as book:
        flight = make_flight()
        flight.on_record = book.add
        flight.run(3.0)
    *verb, log = words(command)
    assert ".mcap" in log
    outcome = CliRunner().invoke(guidance_cli.app, [*verb, str(book.path)])
    assert outcome.exit_code == 0, outcome.output
    assert "identical" in outcome.output


@pytest.mark.parametrize("command", WATCHES)
def test_watch_watches(command: str) -> None:
    """For a moment, and without looking around on the network of whoever runs the tests."""
    arguments = [*words(command), "--no-multicast", "--seconds", "0.1"]
    outcome = subprocess.run(
        [sys.executable, "-m", "guidance", *arguments],
        capture_output=True,
        text=True,
        timeout=40,
        check=False,
    )
    assert outcome.returncode == 0, outcome.stderr


@pytest.mark.parametrize("command", CAMPAIGNS)
def test_campaigns_run(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = re.sub(r"--flights \d+", "--flights 50", command)
    assert arguments != command
    outcome = CliRunner().invoke(sitl_cli.app, words(arguments))
    assert outcome.exit_code == 0, outcome.output


@pytest.mark.parametrize("command", SCENARIOS)
def test_scenarios_are_flown_and_all_rows_are_in_the_table(
    command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[Row, Variation]] = []

    def flown(jobs: list[tuple[Row, Variation]], seeds: int, directory: Path) -> list[Reached]:
        asked.extend(jobs)
        return []

    monkeypatch.setattr("sitl.scenarios.command.flown", flown)
    outcome = CliRunner().invoke(sitl_cli.app, words(command))
    assert outcome.exit_code == 0, outcome.output
    assert asked
    for row, variation in asked:
        if variation.name in ("as it is", "5 m/s wind", "5 m/s wind and gusts"):
            name = row.name if variation.name == "as it is" else f"{row.name}; {variation.name}"
            assert f"| {row.task.profile} | {name} | " in RESULTS


@pytest.mark.parametrize("command", FUZZ)
def test_the_fuzzer_runs(command: str) -> None:
    arguments = words(re.sub(r"--inputs \d+", "--inputs 50", command))
    outcome = CliRunner().invoke(sitl_cli.app, arguments)
    assert outcome.exit_code == 0, outcome.output
    assert "nothing found" in outcome.stdout


@pytest.mark.parametrize("command", FOXGLOVE)
def test_foxglove_is_bridged_to(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The bridge itself is seen by a viewer in test_foxglove_bridge; here nothing listens."""
    shown = []

    def run(**settings: object) -> int:
        shown.append(settings["vehicle"])
        return 0

    monkeypatch.setattr("guidance.bridge.bridge", run)
    outcome = CliRunner().invoke(guidance_cli.app, words(command))
    assert outcome.exit_code == 0, outcome.output
    assert shown == [tomllib.loads((ROOT / "deploy" / "px4-uuv.toml").read_text())["vehicle"]["name"]]


@pytest.mark.parametrize("command", DASHBOARDS)
def test_the_dashboard_is_understood(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page itself is seen in test_dashboard_server; here nothing listens."""
    shown = []

    def run(**settings: object) -> int:
        shown.append(settings["port"])
        return 0

    monkeypatch.setattr("guidance.dashboard.command.dashboard", run)
    outcome = CliRunner().invoke(guidance_cli.app, words(command))
    assert outcome.exit_code == 0, outcome.output
    assert len(shown) == 1


@pytest.mark.parametrize("command", ORDERS)
def test_orders_are_understood(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A vehicle obeys them in test_service_process; here nobody is asked."""
    asked = []
    shipped = {load(path).vehicle.name for path in (ROOT / "deploy").glob("*.toml")}

    def ask(vehicle: str, verb: str, fields: dict[str, object], **settings: object) -> Reply:
        assert vehicle in shipped
        asked.append(read_payload(verb, json.dumps(fields).encode()))
        return Reply(accepted=True, reason="")

    monkeypatch.setattr("guidance.ordering.ask", ask)
    outcome = CliRunner().invoke(guidance_cli.app, words(command))
    assert outcome.exit_code == 0, outcome.output
    assert len(asked) == 1


@pytest.mark.parametrize("command", PAPER)
def test_the_papers_figures_are_made(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = CliRunner().invoke(sitl_cli.app, [*words(command), "--step", "0.1", "--sample", "0.5"])
    assert outcome.exit_code == 0, outcome.output


def test_bench_prints_every_figure_with_its_goal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sitl.bench, "FLIGHT_S", 3.0)
    outcome = CliRunner().invoke(sitl_cli.app, ["bench"])
    assert outcome.output.count("at most") == 3
    assert "at least 50" in outcome.output
    assert "flat" in outcome.output


def kill(*processes: subprocess.Popen[str]) -> None:
    """End them, whatever they do."""
    for process in processes:
        process.kill()
        process.wait()


def test_vehicle_and_service_started_by_hand_fly(tmp_path: Path) -> None:
    """The two terminals of the README, on a port that is free here."""
    vehicle, service = FLOWN
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    assert "14540" in vehicle
    vehicle = vehicle.replace("14540", str(port)) + " --port 0"
    service += f" --set link.connection=udpin://127.0.0.1:{port} --set log.directory={tmp_path}"
    flying = [
        subprocess.Popen(
            [sys.executable, "-m", shlex.split(command)[0].rpartition("/")[2], *words(command)],
            cwd=ROOT,
            stderr=subprocess.PIPE,
            text=True,
        )
        for command in (vehicle, service)
    ]
    killer = threading.Timer(40.0, kill, flying)
    killer.start()
    try:
        assert flying[1].stderr is not None
        said = []
        for line in flying[1].stderr:
            said.append(line)
            if "tracking:" in line:
                break
        assert "tracking:" in said[-1], "".join(said)
        flying[1].send_signal(signal.SIGTERM)
        said = flying[1].communicate(timeout=20)[1].splitlines()
        assert any("manual confirmed" in line for line in said)
        assert flying[1].returncode == 0
        flying[0].terminate()
        flying[0].communicate(timeout=20)
        assert flying[0].returncode == 0
    finally:
        killer.cancel()
        kill(*flying)


def test_what_is_installed_on_the_vehicle_is_where_the_unit_looks_for_it(tmp_path: Path) -> None:
    """The lines that copy are run, into another root; the others are compared with the unit."""
    unit = (ROOT / "deploy" / "guidance@.service").read_text(encoding="utf-8")
    (started,) = re.findall(r"^ExecStart=(.*)", unit, re.MULTILINE)
    program, *_, config = shlex.split(started.replace("%E", "/etc").replace("%i", "uuv-1"))
    venv = program.removesuffix("/bin/guidance")
    install, check, enable, status = (ON_THE_VEHICLE[i] for i in (1, 4, 5, 6))
    assert check == f"sudo {program} check --config {config}"
    assert install == f"sudo python3 -m venv {venv} && sudo {venv}/bin/pip install -q ."
    assert (enable, status) == (
        "sudo systemctl enable --now guidance@uuv-1",
        "systemctl status guidance@uuv-1",
    )
    (tmp_path / "etc/systemd/system").mkdir(parents=True)
    copies = [part for line in ON_THE_VEHICLE for part in line.split(" && ") if re.search("mkdir|cp", part)]
    for copy in copies:
        words_there = [re.sub("^/etc", f"{tmp_path}/etc", word) for word in shlex.split(copy)[1:]]
        subprocess.run(words_there, cwd=ROOT, check=True)
    load(tmp_path / config.lstrip("/"))
    assert (tmp_path / "etc/systemd/system/guidance@.service").read_text(encoding="utf-8") == unit


def test_the_key_that_is_made_is_taken(tmp_path: Path) -> None:
    subprocess.run(MAKE_A_KEY, shell=True, cwd=tmp_path, check=True)
    assert len(read_key(tmp_path / "signing.key")) == 32
