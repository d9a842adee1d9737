"""What docs/first-flight.md has typed at the desk: each vehicle with its file, and the whole rehearsal."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import socket
import subprocess
import sys
import threading
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any, Final, NamedTuple

import pytest
from typer.testing import CliRunner

from guidance.config import load
from guidance.connection import Network, parse_connection
from guidance.mavlink.profiles import FLIES, PROFILES
from guidance.ordering import DEFAULT_CONNECT
from guidance.records import TrackingError
from guidance.supervisor import State
from sitl import cli as sitl_cli
from sitl.lockstep import Lockstep
from sitl.shell import ShellOptions
from sitl.vehicle import USUAL, Firmware, Vehicle, VehicleOptions
from tests.helpers import fly_until, fly_until_tracking, records_of, state_of
from tests.page_commands import COPIED
from tests.pages import ROOT, fenced, prose, spans, tables

PAGE: Final = ROOT / "docs" / "first-flight.md"
#: What the service says once each order of the page is obeyed, in the page's order.
SAID: Final = {"engage": "tracking:", "hold": "holding:", "resume": "tracking:", "abort": "aborted:"}
REHEARSAL: Final = next(block for block in fenced(PAGE, "sh") if "sitl vehicle" in block).strip().splitlines()


class Desk(NamedTuple):
    """A vehicle at the desk: the file that is copied, the first terminal, the name that orders go to."""

    file: str
    terminal: str
    name: str


DESKS: Final = [
    Desk(COPIED[shlex.split(REHEARSAL[1])[3]], REHEARSAL[0], shlex.split(REHEARSAL[2])[2]),
    *(
        Desk(spans(row["copy of"])[0], spans(row["the first terminal"])[0], row["name"])
        for row in tables(prose(PAGE))
        if "the first terminal" in row
    ),
]


def listens_at(file: str | Path) -> int:
    """The port on which the service waits as the file has it, on this machine's own address, too."""
    connection = parse_connection(load(ROOT / file).link.connection)
    assert isinstance(connection, Network)
    assert (connection.scheme, connection.host) == ("udpin", "0.0.0.0")
    return connection.port


def test_each_file_that_is_shipped_has_a_vehicle_at_the_desk() -> None:
    assert sorted(desk.file for desk in DESKS) == sorted(
        f"deploy/{p.name}" for p in ROOT.glob("deploy/*.toml")
    )


@pytest.mark.parametrize("desk", DESKS, ids=lambda desk: Path(desk.file).stem)
def test_the_vehicle_sends_to_where_its_file_listens_and_flies(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file as it ships, but that orders may arm; in lockstep, through the options of the very command."""
    started: list[tuple[ShellOptions, VehicleOptions]] = []

    async def start(shell: ShellOptions, vehicle: VehicleOptions) -> None:
        started.append((shell, vehicle))

    monkeypatch.setattr(sitl_cli, "run", start)
    outcome = CliRunner().invoke(sitl_cli.app, shlex.split(desk.terminal)[1:])
    assert outcome.exit_code == 0, outcome.output
    ((shell, options),) = started
    assert shell.to == (("127.0.0.1", listens_at(desk.file)),)
    config = load(ROOT / desk.file, ["supervisor.arm=true"])
    assert config.vehicle.name == desk.name
    assert options.firmware == config.vehicle.profile
    assert options.airborne == (PROFILES[config.vehicle.profile].handling in FLIES)
    start_ns = 1_000_000_000
    flight = Lockstep(config, Vehicle(options, boot_ns=start_ns), start_ns=start_ns)
    fly_until(flight, State.READY, 20.0)
    assert flight.guide.engagement.engage(flight.now_ns) is None
    fly_until_tracking(flight, 10.0)


def settings_of(block: str) -> list[str]:
    """A block of TOML as `--set` takes it."""

    def flat(table: dict[str, Any], above: str) -> Iterator[str]:
        for key, value in table.items():
            if isinstance(value, dict):
                yield from flat(value, f"{above}{key}.")
            else:
                yield f"{above}{key}={json.dumps(value)}"

    return list(flat(tomllib.loads(block), ""))


def test_the_gentle_trajectory_of_the_page_is_flown_within_its_limits() -> None:
    """Set into the copy, from where the built-in vehicle stands."""
    (block,) = fenced(PAGE, "toml")
    config = load(ROOT / DESKS[0].file, ["supervisor.arm=true", *settings_of(block)])
    assert config.guards.fence_deg
    start_ns = 1_000_000_000
    options = VehicleOptions(firmware=Firmware(config.vehicle.profile), model="rover", noise=USUAL)
    flight = Lockstep(config, Vehicle(options, boot_ns=start_ns), start_ns=start_ns)
    fly_until(flight, State.READY, 20.0)
    assert flight.guide.engagement.engage(flight.now_ns) is None
    flight.run(90.0)
    assert state_of(flight) is State.TRACKING, flight.guide.engagement.reason
    assert records_of(flight, TrackingError)[-1].norm_m < 0.5


def free_port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def argv(command: str) -> list[str]:
    program, *arguments = shlex.split(command)
    return [sys.executable, "-m", Path(program).name, *arguments]


def until(lines: IO[str], words: str) -> None:
    said = []
    for line in lines:
        said.append(line)
        if words in line:
            return
    raise AssertionError(f"never said {words!r}: " + "".join(said))


def test_the_rehearsal_at_the_desk_goes_as_it_is_written(tmp_path: Path) -> None:
    """The very commands, in a directory with the copy. Both ports are moved to free ones, as others may have
    them; before that they are those of the file, which nothing here names."""
    vehicle, service, *orders = REHEARSAL
    assert [shlex.split(order)[-1] for order in orders] == list(SAID)
    ((copy, original),) = COPIED.items()
    shutil.copy(ROOT / original, tmp_path / copy)
    shipped = load(tmp_path / copy)
    assert shlex.split(service)[3] == copy
    assert re.findall(r"--to (\S+)", vehicle) == [f"127.0.0.1:{listens_at(tmp_path / copy)}"]
    assert tuple(shipped.zenoh.listen) == tuple(DEFAULT_CONNECT)
    link, network = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM)
    vehicle = re.sub(r"(--to 127.0.0.1:)\d+", rf"\g<1>{link}", vehicle) + " --port 0"
    service += f" --set link.connection=udpin://0.0.0.0:{link}"
    service += f""" --set 'zenoh.listen=["tcp/127.0.0.1:{network}"]'"""
    with ExitStack() as ending:
        flying = [
            subprocess.Popen(argv(command), cwd=tmp_path, stderr=subprocess.PIPE, text=True)
            for command in (vehicle, service)
        ]
        for process in flying:
            ending.enter_context(process)  # closes its pipe and waits for it
            ending.callback(process.kill)
        killer = threading.Timer(50.0, flying[1].kill)
        ending.callback(killer.cancel)
        killer.start()
        lines = flying[1].stderr
        assert lines is not None
        until(lines, "ready: waiting for the pilot to switch to guided")
        for order, words in zip(orders, SAID.values(), strict=True):
            at = [*argv(order), "--connect", f"tcp/127.0.0.1:{network}"]
            answer = subprocess.run(at, cwd=ROOT, capture_output=True, text=True, timeout=20, check=False)
            assert answer.returncode == 0, answer.stderr
            until(lines, words)
        flying[1].terminate()
        flying[1].communicate(timeout=10)
        assert flying[1].returncode == 0
