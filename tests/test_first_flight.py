"""The rehearsal at the desk, by the very commands of docs/first-flight.md, on ports that are free here."""

from __future__ import annotations

import shlex
import socket
import subprocess
import sys
import threading
from contextlib import ExitStack
from pathlib import Path
from typing import IO

from tests.pages import ROOT, fenced

#: What the service says once each order of the page is obeyed, in the page's order.
SAID = {"engage": "tracking:", "hold": "holding:", "resume": "tracking:", "abort": "aborted:"}


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
    block = next(each for each in fenced(ROOT / "docs" / "first-flight.md", "sh") if "sitl vehicle" in each)
    vehicle, service, *orders = block.strip().splitlines()
    assert [shlex.split(order)[-1] for order in orders] == list(SAID)
    link, network = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM)
    assert "127.0.0.1:14540" in vehicle
    vehicle = vehicle.replace("14540", str(link)) + " --port 0"
    service += f" --set link.connection=udpin://127.0.0.1:{link} --set log.directory={tmp_path}"
    service += f""" --set 'zenoh.listen=["tcp/127.0.0.1:{network}"]'"""
    with ExitStack() as ending:
        flying = [
            subprocess.Popen(argv(command), cwd=ROOT, stderr=subprocess.PIPE, text=True)
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
