"""`guidance check` beside the link: who has the port, the disk, zenoh."""

from __future__ import annotations

import os
import socket
import tempfile
from pathlib import Path
from typing import Any

import pytest
import zenoh

from guidance.connection import parse_connection
from guidance.preflight import run
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
from guidance.telemetry.zenoh_sink import zenoh_config
from guidance.transport.processes import Process, Processes
from tests.helpers import make_config
from tests.preflight_rig import Bench, free_port, only

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
    other = machine.runs(7, "mavproxy.py", name="mavproxy.py", opens="/dev/ttyUSB0")
    machine.runs(os.getpid(), "guidance", "check", name="guidance", opens="/dev/ttyUSB0")
    assert machine.look("serial:///dev/ttyUSB0").holders == (other,)
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


def test_a_directory_that_may_not_be_looked_into_is_a_finding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As under a home of another user: not even whether it exists is told."""

    def refuse(_: Path) -> bool:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "exists", refuse)
    look = look_at_disk(make_config(f"log.directory={tmp_path}/new").log)
    monkeypatch.undo()
    assert look.problem == f"{tmp_path}/new: Permission denied"


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


@pytest.mark.parametrize(
    ("overrides", "who"),
    [
        (['zenoh.listen=["tcp/0.0.0.0:7447"]'], "tcp/0.0.0.0:7447"),
        (['zenoh.connect=["tcp/10.0.0.1:7447"]', 'zenoh.listen=["tcp/127.0.0.1:1"]'], "tcp/10.0.0.1:7447"),
        (["zenoh.multicast_scouting=true"], "it by multicast"),
        (['zenoh.listen=["tcp/127.0.0.1:7447"]'], None),
        (['zenoh.listen=["tcp/localhost:7447", "tcp/[::1]:7447", "udp/127.0.1.1:7447"]'], None),
        (['zenoh.listen=["tcp/[::]:7447"]'], "tcp/[::]:7447"),
        (['zenoh.connect=["tcp/127.0.0.1.example.org:7447"]'], "tcp/127.0.0.1.example.org:7447"),
        (['zenoh.config_file="tls.json5"'], "it as tls.json5 says"),
    ],
)
def test_orders_that_a_network_may_give_are_worth_a_word(overrides: list[str], who: str | None) -> None:
    for commands in (True, False):
        bench = Bench(*overrides, f"zenoh.commands={str(commands).lower()}")
        finding = bench.findings(zenoh=ZenohLook("", 1)).get("zenoh orders")
        if who is None or not commands:
            assert finding is None
        else:
            assert finding is not None
            assert finding.verdict is Verdict.WARN
            assert finding.found == f"whoever reaches {who} may engage, retune and stop"


@pytest.mark.parametrize(
    ("file", "restricted"),
    [
        ("{}", False),
        ("{access_control: {enabled: false}}", False),
        ("{access_control: {enabled: true, default_permission: 'deny'}}", True),
        ("{transport: {link: {tls: {enable_mtls: true}}}}", True),
    ],
)
def test_a_file_of_zenohs_that_lets_not_everybody_in_is_worth_no_word(
    file: str, restricted: bool, tmp_path: Path
) -> None:
    path = tmp_path / "zenoh.json5"
    path.write_text(file)
    settings = (f'zenoh.config_file="{path}"', "zenoh.commands=true")
    probe = ZenohProbe(make_config(*settings), 1.0)
    assert probe.look.restricted is restricted
    assert ("zenoh orders" in Bench(*settings).findings(zenoh=probe.look)) is not restricted


def test_the_probe_finds_the_router_and_a_service_that_publishes() -> None:
    where = f"tcp/127.0.0.1:{free_port()}"
    with zenoh.open(zenoh_config(listen=[where])) as session:
        for alive in (False, True):
            token = session.liveliness().declare_token("guidance/demo/alive") if alive else None
            probe = ZenohProbe(make_config(f'zenoh.connect=["{where}"]'), 20.0)
            probe.start()
            assert probe.done.wait(20.0)
            assert probe.end(20.0)
            assert probe.look == ZenohLook("", 1, alive)
            del token


def test_a_router_that_is_not_there_leaves_the_probe_waiting_until_it_is_ended() -> None:
    probe = ZenohProbe(make_config(f'zenoh.connect=["tcp/127.0.0.1:{free_port()}"]'), 20.0)
    probe.start()
    assert not probe.done.wait(1.0)
    assert probe.end(20.0)
    assert probe.look.neighbours == 0


def test_a_port_that_another_service_has_is_told_in_words_and_what_to_do() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        listen = f'zenoh.listen=["tcp/127.0.0.1:{taken.getsockname()[1]}"]'
        probe = ZenohProbe(make_config(listen), 20.0)
        probe.start()
        assert probe.done.wait(20.0)
        assert probe.end(20.0)
    found = only(Bench(listen), "zenoh", Verdict.FAIL, zenoh=probe.look)
    assert "Address already in use" in found.found
    assert ".rs" not in found.found
    assert "if another service listens there, give each a port of its own in zenoh.listen" in found.todo


def test_a_router_that_is_not_there_is_not_waited_for_any_longer() -> None:
    probe = ZenohProbe(make_config(f'zenoh.connect=["tcp/127.0.0.1:{free_port()}"]'), 0.2)
    probe.start()
    assert probe.done.wait(20.0)
    assert probe.end(20.0)
    assert probe.look == ZenohLook()
