"""`guidance check` beside the link: who has the port, the disk, zenoh; the screen, the JSON, the process."""

from __future__ import annotations

import io
import json
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import zenoh
from rich.console import Console
from typer.testing import CliRunner

from guidance import cli
from guidance.config import Config, load
from guidance.connection import parse_connection
from guidance.preflight import run
from guidance.preflight.checks import findings
from guidance.preflight.findings import Verdict
from guidance.preflight.run import check
from guidance.preflight.surroundings import (
    DiskLook,
    PortLook,
    ZenohLook,
    ZenohProbe,
    look_at_disk,
    look_at_port,
)
from guidance.preflight.view import as_json, show
from guidance.telemetry.zenoh_sink import zenoh_config
from guidance.transport import Lost
from guidance.transport.processes import Process, Processes
from tests.helpers import make_config
from tests.preflight_rig import Bench, only

DEPLOY = Path(__file__).parents[1] / "deploy"
CHECK = [sys.executable, "-m", "guidance", "check"]
SERIAL = 'link.connection="serial:///dev/serial/by-id/usb-Autopilot?baud=921600"'


class Machine:
    """A machine's /dev and /proc in a directory, with an autopilot's USB port on it."""

    def __init__(self, root: Path) -> None:
        self.root = root
        (root / "dev/serial/by-id").mkdir(parents=True)
        (root / "dev/ttyACM0").touch()
        (root / "dev/serial/by-id/usb-Autopilot").symlink_to("../../ttyACM0")
        (root / "proc/net").mkdir(parents=True)
        (root / "proc/net/udp6").write_text("  sl  local_address\n")

    def runs(self, pid: int, *command: str, name: str, opens: str = "/dev/null") -> Process:
        folder = self.root / "proc" / str(pid)
        (folder / "fd").mkdir(parents=True)
        (folder / "comm").write_text(name + "\n")
        (folder / "cmdline").write_text("\0".join(command))
        (folder / "fd" / "5").symlink_to(opens)
        return Process(name, pid, command)

    def look(self, connection: str = "serial:///dev/serial/by-id/usb-Autopilot") -> PortLook:
        return look_at_port(parse_connection(connection), Processes(self.root), self.root)


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def port_of(look: PortLook, **others: Any) -> Any:
    """What is said of the port alone."""
    bench = Bench(SERIAL, dead=True, seconds=0.1)
    return bench.findings(port=look, **others)["port"]


def test_nobody_has_the_port(machine: Machine) -> None:
    assert machine.look() == PortLook((), None, "/dev/ttyACM0")


def test_a_login_console_on_the_port_is_named_with_its_unit(machine: Machine) -> None:
    machine.runs(812, "/sbin/agetty", "-o", "ttyACM0", name="agetty", opens="/dev/ttyACM0")
    found = port_of(machine.look())
    assert found.verdict is Verdict.FAIL
    assert found.found == "a login console has it: agetty (pid 812)"
    assert found.todo == "sudo systemctl disable --now serial-getty@ttyACM0.service"


@pytest.mark.parametrize(
    "command",
    [
        ("/usr/bin/python3", "-m", "guidance", "run", "-c", "uuv.toml"),
        ("/opt/guidance/bin/python", "/opt/guidance/bin/guidance", "run", "--config", "uuv.toml"),
    ],
)
def test_the_service_itself_on_the_port_is_named(machine: Machine, command: tuple[str, ...]) -> None:
    machine.runs(99, *command, name="python3", opens="/dev/ttyACM0")
    found = port_of(machine.look())
    assert found.found == "the service itself runs on it: python3 (pid 99)"
    assert "systemctl stop guidance@" in found.todo


def test_another_program_on_the_port_is_named_and_the_line_is_left_alone(machine: Machine) -> None:
    machine.runs(7, "mavproxy.py", "--master=/dev/ttyACM0", name="mavproxy.py", opens="/dev/ttyACM0")
    machine.runs(8, "guidance", "watch", name="guidance")
    found = port_of(machine.look())
    assert found.found == "another program has it: mavproxy.py (pid 7)"
    bench = Bench(SERIAL, dead=True, seconds=0.1)
    assert bench.findings(port=machine.look())["bytes"] == ("bytes", Verdict.SKIP, "the line is not open", "")


def test_a_modem_manager_is_a_warning_and_only_for_modems(machine: Machine) -> None:
    running = machine.runs(5, "/usr/sbin/ModemManager", name="ModemManager")
    assert machine.look().modem_manager == running
    bench = Bench(SERIAL)
    found = only(bench, "modem manager", Verdict.WARN, port=machine.look())
    assert "ModemManager (pid 5)" in found.found
    (machine.root / "dev/ttyUSB0").touch()
    assert machine.look("serial:///dev/ttyUSB0").modem_manager is None


def test_who_has_the_udp_port_is_named(machine: Machine) -> None:
    row = "0: 00000000:38CC 00000000:0000 07 00000000:00000000 00:00000000 00000000 0 0 4711 2 0 0"
    (machine.root / "proc/net/udp").write_text(f"  sl  local_address\n{row}\n")
    holder = machine.runs(42, "mavlink-routerd", name="mavlink-routerd", opens="socket:[4711]")
    assert machine.look("udpin://0.0.0.0:14540").holders == (holder,)
    assert machine.look("udpin://0.0.0.0:14541").holders == ()
    assert machine.look("udpout://10.0.0.1:14540").holders == ()


def test_a_port_that_is_in_use_is_not_opened(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    machine.runs(7, "mavproxy.py", name="mavproxy.py", opens="/dev/ttyUSB0")
    machine.runs(os.getpid(), "guidance", "check", name="guidance", opens="/dev/ttyUSB0")
    monkeypatch.setattr(run, "open_transport", None)
    config = make_config(
        'link.connection="serial:///dev/ttyUSB0"', "zenoh.enabled=false", "log.enabled=false"
    )
    found = {f.check: f for _, f in check(config, "file", 10.0, Processes(machine.root)).findings}
    assert found["port"].found == "another program has it: mavproxy.py (pid 7)"
    assert [name for name, f in found.items() if f.verdict is Verdict.FAIL] == ["port"]


@pytest.mark.parametrize(
    ("refused", "todo"),
    [
        (
            "not allowed (root:dialout, mode 0660): sudo usermod -aG dialout pi, then log in anew",
            "sudo usermod",
        ),
        ("Connection refused: nobody listens there", "nobody listens there"),
        ("No route to host", "see link.connection"),
    ],
)
def test_why_the_line_is_not_open_is_said_with_what_to_do(refused: str, todo: str) -> None:
    found = port_of(PortLook(), refused=refused)
    assert found.verdict is Verdict.FAIL
    assert found.found.endswith(refused.partition(": ")[0])
    assert found.todo.startswith(todo)


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


# The companion -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def healthy() -> Bench:
    return Bench()


def test_the_disk(tmp_path: Path, healthy: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    log = make_config(f"log.directory={tmp_path}/a/b").log
    look = look_at_disk(log)
    assert look.problem == ""
    assert look.free_bytes > 0
    assert not (tmp_path / "a").exists()
    assert healthy.findings(disk=look)["log"].verdict is Verdict.OK
    (tmp_path / "a").write_text("a file")
    found = only(healthy, "log", Verdict.FAIL, disk=look_at_disk(log))
    assert "is not a directory" in found.found
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    log = make_config(f"log.directory={tmp_path}/new").log
    assert "may not be written to" in look_at_disk(log).problem


def test_a_directory_that_may_not_be_written_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    assert look_at_disk(make_config(f"log.directory={tmp_path}").log).problem.endswith("Permission denied")


def test_a_disk_that_is_full_or_soon_will_be(healthy: Bench) -> None:
    def look(free_mb: float) -> DiskLook:
        return DiskLook(Path("/logs"), "", round(free_mb * 1e6))

    found = only(healthy, "log", Verdict.FAIL, disk=look(150.0))
    assert found.found == "150 MB free in /logs, log.min_free_mb keeps 200"
    found = only(healthy, "log", Verdict.WARN, disk=look(260.0))
    assert "enough for " in found.found
    assert found.found.endswith(" min")
    assert healthy.findings(disk=look(5000.0))["log"].verdict is Verdict.OK


@pytest.mark.parametrize(
    ("overrides", "look", "verdict", "found"),
    [
        (['zenoh.connect=["tcp/10.0.0.1:7447"]'], ZenohLook("", 1), "ok", "1 reached at tcp/10.0.0.1:7447"),
        (['zenoh.connect=["tcp/10.0.0.1:7447"]'], ZenohLook(), "fail", "nobody answers at tcp/10.0.0.1:7447"),
        (['zenoh.listen=["tcp/0.0.0.0:7447"]'], ZenohLook(), "ok", "nobody there yet; listens at"),
        (["zenoh.multicast_scouting=true"], ZenohLook(), "warn", "nobody found by multicast"),
        (["zenoh.enabled=true"], ZenohLook(), "skip", "nowhere to connect to or to listen"),
        (["zenoh.enabled=false"], None, "skip", "zenoh.enabled = false"),
        ([], ZenohLook("no session can be opened: x"), "fail", "no session can be opened: x"),
        (
            ["vehicle.name=sub-1"],
            ZenohLook("", 2, True),
            "warn",
            "2 reached; a service publishes as sub-1 already",
        ),
    ],
)
def test_zenoh(overrides: list[str], look: ZenohLook | None, verdict: str, found: str) -> None:
    bench = Bench(*overrides, dead=True, seconds=0.1)
    finding = bench.findings(zenoh=look)["zenoh"]
    assert finding.verdict == verdict
    assert finding.found.startswith(found)
    assert bool(finding.todo) == (verdict in ("warn", "fail"))


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_the_probe_finds_the_router_and_a_service_that_publishes() -> None:
    where = f"tcp/127.0.0.1:{free_port()}"
    with zenoh.open(zenoh_config(listen=[where])) as session:
        for alive in (False, True):
            token = session.liveliness().declare_token("guidance/demo/alive") if alive else None
            probe = ZenohProbe(make_config(f'zenoh.connect=["{where}"]'))
            probe.start()
            assert probe.done.wait(20.0)
            assert probe.end(20.0)
            assert probe.look == ZenohLook("", 1, alive)
            del token


def test_a_router_that_is_not_there_leaves_the_probe_waiting_until_it_is_ended() -> None:
    probe = ZenohProbe(make_config(f'zenoh.connect=["tcp/127.0.0.1:{free_port()}"]'))
    probe.start()
    assert not probe.done.wait(1.0)
    assert probe.end(20.0)
    assert probe.look.neighbours == 0


# The screen, the JSON and the process -----------------------------------------------------------------------


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
    assert outcome.stderr == ""
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
