"""`guidance check` as a process: its end, its screen, its JSON; lines that flood or break."""

from __future__ import annotations

import io
import json
import os
import re
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from typer.testing import CliRunner

from guidance import cli
from guidance.config import Config, load
from guidance.preflight import run
from guidance.preflight.checks import findings
from guidance.preflight.findings import Verdict, fail
from guidance.preflight.run import check
from guidance.preflight.view import as_json, show
from guidance.transport import Lost
from tests.helpers import make_config
from tests.preflight_rig import Bench, free_port

DEPLOY = Path(__file__).parents[1] / "deploy"
CHECK = [sys.executable, "-m", "guidance", "check"]


@pytest.fixture(scope="module")
def healthy() -> Bench:
    return Bench()


class Line:
    """A transport that gives what `receive` gives; always readable."""

    opened, address, dropped = "opened", None, 0

    def __init__(self, receive: Callable[[], tuple[bytes, tuple[()]]]) -> None:
        self.receive = receive
        self._ends = os.pipe()
        os.write(self._ends[1], b"readable")

    def fileno(self) -> int:
        return self._ends[0]

    def heard(self, address: object, now_ns: int) -> str:
        return ""

    def send(self, packet: bytes) -> None:
        pass

    def close(self) -> None:
        for end in self._ends:
            os.close(end)


def checked(line: Line, monkeypatch: pytest.MonkeyPatch, seconds: float) -> tuple[float, dict[str, Any]]:
    """How long a check over this line takes, and what it finds."""

    async def opens(*_: object) -> Line:
        return line

    monkeypatch.setattr(run, "open_transport", opens)
    result = check(make_config("zenoh.enabled=false", "log.enabled=false"), "file", seconds)
    return result.seconds, {finding.check: finding for _, finding in result.findings}


def test_a_flood_does_not_hold_up_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    seconds, found = checked(Line(lambda: (b"\0" * 100, ())), monkeypatch, 0.3)
    assert seconds < 5.0
    assert "no MAVLink frame" in found["bytes"].found


def test_a_line_that_is_lost_on_the_way_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone() -> tuple[bytes, tuple[()]]:
        raise Lost("the device is gone: unplugged, or without power?")

    _, found = checked(Line(gone), monkeypatch, 10.0)
    assert found["lost"].verdict is Verdict.FAIL
    assert found["lost"].found == "the device is gone"
    assert found["lost"].todo == "unplugged, or without power?"


@pytest.fixture
def stuck() -> Iterator[Callable[..., Any]]:
    """A call of the system that does not come back before the test has ended."""
    over = threading.Event()

    def hang(*_: object, **__: object) -> Any:
        over.wait(30.0)
        raise OSError("too late")

    yield hang
    over.set()


@pytest.mark.parametrize(
    ("connection", "hanging"),
    [
        ("tcp://autopilot:5760", "socket.getaddrinfo"),
        ("udpout://autopilot:14550", "socket.getaddrinfo"),
        ('"serial:///dev/ttyUSB9"', "serial.Serial"),
    ],
)
def test_a_name_server_or_a_device_that_hangs_does_not_hold_up_the_end(
    connection: str, hanging: str, stuck: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = set(threading.enumerate())
    monkeypatch.setattr(hanging, stuck)
    config = make_config(f"link.connection={connection}", "zenoh.enabled=false", "log.enabled=false")
    result = check(config, "file", 0.3)
    assert 0.3 <= result.seconds < 5.0
    (port,) = (finding for _, finding in result.findings if finding.check == "port")
    assert port.found.endswith("it did not open in time")
    left = set(threading.enumerate()) - before
    assert left
    assert all(thread.daemon for thread in left), "the interpreter would wait for it"


def printed(bench: Bench, width: int) -> list[str]:
    out = io.StringIO()
    show(findings(bench.seen()), bench.took_s, Console(file=out, width=width, highlight=False))
    return out.getvalue().splitlines()


def test_it_fits_on_one_screen_of_80_columns(healthy: Bench) -> None:
    lines = printed(healthy, 80)
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 80
    assert lines[-1].startswith("passed: ")
    assert lines[-1].endswith("in 3.0 s")


def test_what_to_do_stands_below_what_is_wrong() -> None:
    lines = printed(Bench(vehicle={"parameters": {"MAV_FWDEXTSP": 0}}), 120)
    (at,) = (i for i, line in enumerate(lines) if "FAIL" in line and "MAV_FWDEXTSP" in line)
    assert lines[at + 1].strip().startswith("-> set MAV_FWDEXTSP to 1")
    assert lines[-1].startswith("FAILED: ")


def test_the_json(healthy: Bench) -> None:
    data = json.loads(json.dumps(as_json(findings(healthy.seen()), "demo", 3.0)))
    assert data.keys() == {"vehicle", "passed", "seconds", "findings"}
    assert data["passed"] is True
    for finding in data["findings"]:
        assert finding.keys() == {"group", "check", "verdict", "found", "todo"}
        assert finding["verdict"] in ("ok", "warn", "fail", "skip")
        assert finding["found"]


def test_a_wrong_configuration_is_told_as_run_tells_it(tmp_path: Path) -> None:
    file = tmp_path / "wrong.toml"
    file.write_text((DEPLOY / "px4-uuv.toml").read_text(encoding="utf-8") + "\nnonsense = 1\n")
    told = [CliRunner().invoke(cli.app, [verb, "--config", str(file)]) for verb in ("check", "run")]
    assert [outcome.exit_code for outcome in told] == [2, 2]
    assert told[0].stderr == told[1].stderr


def shipped(*overrides: str) -> Config:
    return load(DEPLOY / "px4-uuv.toml", overrides)


def test_a_port_that_does_not_exist_ends_at_once(tmp_path: Path) -> None:
    config = shipped(
        f'link.connection="serial://{tmp_path}/none"', f"log.directory={tmp_path}", "zenoh.enabled=false"
    )
    checked = check(config, "file", 10.0)
    assert checked.seconds < 3.0
    found = {finding.check: finding for _, finding in checked.findings}
    assert found["port"].found.endswith("there is no such device")
    assert found["port"].todo.startswith("is it plugged in and powered?")


def test_a_udp_port_that_somebody_has_is_not_taken(tmp_path: Path) -> None:
    port = free_port(socket.SOCK_DGRAM)
    holder = (
        f"import socket; s = socket.socket(2, 2); s.bind(('127.0.0.1', {port})); print(flush=True); input()"
    )
    with subprocess.Popen([sys.executable, "-c", holder], stdin=-1, stdout=-1) as program:
        assert program.stdout is not None
        program.stdout.readline()
        config = shipped(
            f"link.connection=udpin://127.0.0.1:{port}", "zenoh.enabled=false", "log.enabled=false"
        )
        found = {finding.check: finding for _, finding in check(config, "file", 10.0).findings}
        assert f"(pid {program.pid})" in found["port"].found
        program.kill()


def test_the_process_passes_a_healthy_vehicle_within_ten_seconds(tmp_path: Path) -> None:
    port = free_port(socket.SOCK_DGRAM)
    vehicle = [sys.executable, "-m", "sitl", "vehicle", "--to", f"127.0.0.1:{port}", "--port", "0"]
    settings = [f"link.connection=udpin://127.0.0.1:{port}", f"log.directory={tmp_path}/logs"]
    arguments = ["--config", str(DEPLOY / "px4-uuv.toml"), "--json"]
    arguments += [word for setting in settings for word in ("--set", setting)]
    with subprocess.Popen(vehicle, stderr=subprocess.DEVNULL) as flying:
        try:
            outcome = subprocess.run([*CHECK, *arguments], capture_output=True, text=True, timeout=40)
        finally:
            flying.kill()
    assert outcome.stderr == "guidance check: looking for at most 10 s\n"
    data = json.loads(outcome.stdout)
    assert outcome.returncode == 0, data
    assert data["passed"]
    assert data["seconds"] < 10.0
    assert list(tmp_path.iterdir()) == []  # it left nothing behind


def test_the_process_ends_at_its_deadline_on_a_dead_line_with_a_diagnosis(tmp_path: Path) -> None:
    port = free_port(socket.SOCK_DGRAM)
    arguments = ["--config", str(DEPLOY / "px4-uuv.toml"), "--seconds", "1"]
    arguments += ["--set", f"link.connection=udpin://127.0.0.1:{port}", "--set", f"log.directory={tmp_path}"]
    outcome = subprocess.run([*CHECK, *arguments], capture_output=True, text=True, timeout=40)
    assert outcome.returncode == 1
    assert "no bytes yet" in outcome.stdout
    assert "-> does the autopilot" in outcome.stdout
    assert outcome.stdout.splitlines()[-1].startswith("FAILED: ")


def test_what_the_autopilot_says_does_not_steer_the_terminal() -> None:
    said = "the autopilot says: \x1b[2J\x1b]0;title\x07PreArm:\n[red]compass"
    out = io.StringIO()
    console = Console(file=out, width=120, highlight=False, force_terminal=True, no_color=True)
    show([("vehicle", fail("arming", said, said))], 1.0, console)
    shown = re.sub("\x1b\\[[0-9;]*m", "", out.getvalue())  # the colours are ours
    assert shown.count("says: \ufffd[2J\ufffd]0;title\ufffdPreArm: [red]compass") == 2
    assert all(line.isprintable() for line in shown.splitlines())
    assert len(shown.splitlines()) == 3
