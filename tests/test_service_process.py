"""`guidance run` as a process: its signals, its exit status, and how soon it ends, whatever hangs."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from guidance.replay import replay
from guidance.telemetry.log import read_log
from tests.helpers import DEMO
from tests.service_rig import PATIENCE_S, Bell, VehicleEnd, a_socket

RUN = [sys.executable, "-m", "guidance", "run", "--config", str(DEMO)]
SETPOINT, COMMAND, DO_SET_MODE = "SET_ATTITUDE_TARGET", "COMMAND_LONG", 176
BROKEN = """
import guidance.core
def broken(*_):
    guidance.core.Guide._setpoint = sound  # whatever is called after this would work again
    raise ZeroDivisionError("a bug")
sound = guidance.core.Guide._setpoint
def counting(guide, now_ns):
    if guide.setpoints_sent == 30:
        guidance.core.Guide._setpoint = broken
    return sound(guide, now_ns)
guidance.core.Guide._setpoint = counting
from guidance.cli import main
main()
"""


class Service:
    """The process, and what it has written to stderr so far."""

    def __init__(self, process: asyncio.subprocess.Process, logs: Path, bell: Bell) -> None:
        self.process = process
        self.logs = logs
        self.text = ""
        self._bell = bell

    async def read(self) -> None:
        assert self.process.stderr is not None
        while line := await self.process.stderr.readline():
            self.text += line.decode()
            self._bell.ring()

    async def says(self, what: str) -> None:
        await self._bell.until(lambda: what in self.text, f"{what!r} in {self.text}")

    async def ended_after(self, number: int) -> float:
        """Send a signal; how long the process took to end, s."""
        sent = time.monotonic()
        self.process.send_signal(number)
        await asyncio.wait_for(self.process.wait(), PATIENCE_S)
        return time.monotonic() - sent

    def log(self) -> Path:
        (path,) = self.logs.glob("*.mcap")
        return path


@asynccontextmanager
async def process(
    logs: Path, connection: str, *overrides: str, command: Sequence[str] = RUN, stderr: int = subprocess.PIPE
) -> AsyncIterator[tuple[Service, Bell]]:
    settings = (f'link.connection="{connection}"', f'log.directory="{logs}"', *overrides)
    arguments = [part for setting in settings for part in ("--set", setting)]
    bell = Bell()
    child = await asyncio.create_subprocess_exec(*command, *arguments, stderr=stderr)
    service = Service(child, logs, bell)
    reading = asyncio.create_task(service.read()) if stderr == subprocess.PIPE else None
    try:
        yield service, bell
    finally:
        with suppress(ProcessLookupError):
            child.kill()
        await child.wait()
        if reading is not None:
            await reading


@asynccontextmanager
async def flight(logs: Path, *overrides: str, **options: Any) -> AsyncIterator[tuple[Service, VehicleEnd]]:
    """The service, writing first to the built-in vehicle on a socket of this loop."""
    with a_socket() as probe:
        port = probe.getsockname()[1]
    async with process(logs, f"udpout://127.0.0.1:{port}", *overrides, **options) as (service, bell):
        vehicle = VehicleEnd(None, bell.ring)
        await vehicle.open(port)
        try:
            yield service, vehicle
        finally:
            vehicle.close()


def refuses_to_leave(message: Any) -> bool:
    """The vehicle does not hear that it shall leave OFFBOARD."""
    return bool(message.get_type() == COMMAND and message.command == DO_SET_MODE and message.param2 != 6)


def test_a_flight_is_commanded_from_another_process(tmp_path: Path) -> None:
    async def run() -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"

        async def command(*words: str) -> tuple[int | None, str]:
            line = [sys.executable, "-m", "guidance", "command", "demo", *words, "--connect", endpoint]
            child = await asyncio.create_subprocess_exec(
                *line, "--seconds", str(PATIENCE_S), stdout=subprocess.PIPE
            )
            said, _ = await asyncio.wait_for(child.communicate(), PATIENCE_S)
            return child.returncode, said.decode()

        enabled = (f'zenoh.listen=["{endpoint}"]', "zenoh.commands=true", "supervisor.engage=pilot")
        async with flight(tmp_path, *enabled) as (service, vehicle):
            await service.says("ready: ")
            assert await command("resume") == (
                1,
                "resume refused: ready: nothing is held\n",
            )
            assert await command("engage") == (0, "engage accepted\n")
            await service.says("tracking: ")
            assert await command("set", "law.k=0.5") == (0, "set accepted: law.k: 1.0 -> 0.5\n")
            assert await command("hold") == (0, "hold accepted\n")
            await service.says("holding: ")
            assert vehicle.vehicle.mode == "MANUAL"
            assert await command("shutdown") == (0, "shutdown accepted\n")
            assert await asyncio.wait_for(service.process.wait(), PATIENCE_S) == 0
            found = replay(service.log())
            assert found.identical, found

    asyncio.run(run())


def test_sigusr1_engages_and_sigterm_leaves_with_fresh_setpoints_and_a_whole_log(tmp_path: Path) -> None:
    async def main() -> None:
        async with flight(tmp_path, 'supervisor.engage="pilot"') as (service, vehicle):
            await service.says("ready: waiting for the pilot")
            service.process.send_signal(signal.SIGUSR1)
            await service.says("tracking: ")
            vehicle.deaf_to = refuses_to_leave
            heard, sent_ns = len(vehicle.heard), time.monotonic_ns()
            took_s = await service.ended_after(signal.SIGTERM)
            assert 1.0 < took_s < 1.5
            assert service.process.returncode == 0
            after = list(zip(vehicle.heard[heard:], vehicle.heard_ns[heard:], strict=True))
            setpoints_ns = [t_ns for message, t_ns in after if message.get_type() == SETPOINT]
            assert len(setpoints_ns) > 45
            assert setpoints_ns[-1] - sent_ns > 0.95e9
            assert sum(refuses_to_leave(message) for message, _ in after) >= 4
        found = replay(service.log())
        assert found.identical, found
        assert found.tracked > 45

    asyncio.run(main())


def test_sigterm_while_tracking_ends_as_soon_as_the_exit_mode_is_seen(tmp_path: Path) -> None:
    async def main() -> None:
        async with flight(tmp_path) as (service, _):
            await service.says("tracking: ")
            assert await service.ended_after(signal.SIGTERM) < 1.0
            assert service.process.returncode == 0
            await service.says("finished: manual confirmed")

    asyncio.run(main())


def test_a_terminal_that_is_closed_leaves_like_sigterm(tmp_path: Path) -> None:
    """Its hang-up comes from the kernel, and from then on nothing can be written to stderr."""
    on_a_terminal = """
import fcntl, os, sys, termios
os.setsid()
fcntl.ioctl(2, termios.TIOCSCTTY, 0)
os.execv(sys.executable, [sys.executable, *sys.argv[1:]])
"""

    async def main() -> None:
        terminal, service_end = os.openpty()
        command = [sys.executable, "-c", on_a_terminal, *RUN[1:]]
        async with flight(tmp_path, command=command, stderr=service_end) as (service, vehicle):
            os.close(service_end)
            await service._bell.until(
                lambda: any(m.get_type() == SETPOINT and m.thrust > 0 for m in vehicle.heard), "a flight"
            )
            os.close(terminal)
            await asyncio.wait_for(service.process.wait(), PATIENCE_S)
            assert service.process.returncode == 0
            assert vehicle.vehicle.mode == "MANUAL"
        assert replay(service.log()).identical

    asyncio.run(main())


def test_a_hang_up_that_is_ignored_from_the_start_stays_so(tmp_path: Path) -> None:
    """So does `nohup`, for a service that shall outlive its terminal."""

    async def main() -> None:
        command = ["nohup", *RUN]
        async with process(tmp_path, "udpin://127.0.0.1:0", command=command) as (service, _):
            await service.says("listening on")
            service.process.send_signal(signal.SIGHUP)
            assert await service.ended_after(signal.SIGTERM) < 0.5
            assert service.process.returncode == 0
        events = [json.loads(payload) for topic, payload in read_log(service.log()) if topic == "event"]
        assert not [event for event in events if "SIGHUP" in event["text"]]

    asyncio.run(main())


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_before_anything_is_connected_ends_it_at_once(tmp_path: Path, number: int) -> None:
    async def main() -> None:
        async with process(tmp_path, "udpin://127.0.0.1:0") as (service, _):
            await service.says("listening on")
            assert await service.ended_after(number) < 0.5
            assert service.process.returncode == 0
        topics = [topic for topic, _ in read_log(service.log())]  # to its end, undamaged
        assert topics[0] == "session"

    asyncio.run(main())


def test_a_bug_is_loud_ends_with_status_1_and_leaves_a_whole_log_without_another_setpoint(
    tmp_path: Path,
) -> None:
    async def main() -> None:
        broken = [sys.executable, "-c", BROKEN, *RUN[3:]]
        async with flight(tmp_path, command=broken) as (service, vehicle):
            await asyncio.wait_for(service.process.wait(), PATIENCE_S)
            assert service.process.returncode == 1
            await service.says("internal error")
            await service.says("ZeroDivisionError: a bug")
            assert vehicle.count(SETPOINT) == 31
        topics = [topic for topic, _ in read_log(service.log())]
        assert topics.count("setpoint") == 31
        assert topics[-1] == "input"  # the very one that met the bug

    asyncio.run(main())


def test_a_stderr_that_nobody_reads_holds_up_neither_the_flight_nor_the_end(tmp_path: Path) -> None:
    async def main() -> None:
        read_end, write_end = os.pipe()
        os.set_blocking(write_end, False)
        with suppress(BlockingIOError):
            while True:
                os.write(write_end, b"x" * 4096)
        os.set_blocking(write_end, True)
        async with flight(tmp_path, stderr=write_end) as (service, vehicle):
            await service._bell.until(
                lambda: any(m.get_type() == SETPOINT and m.thrust > 0 for m in vehicle.heard), "a flight"
            )
            assert await service.ended_after(signal.SIGTERM) < 1.5
            assert service.process.returncode == 0
        os.close(read_end)
        os.close(write_end)
        assert replay(service.log()).identical

    asyncio.run(main())


def test_a_frozen_zenoh_neighbour_does_not_hold_up_the_end(tmp_path: Path) -> None:
    neighbour = """
import sys, threading, zenoh
from guidance.telemetry.zenoh_sink import zenoh_config
seen = threading.Event()
session = zenoh.open(zenoh_config(listen=[sys.argv[1]]))
subscriber = session.declare_subscriber("guidance/demo/*", lambda sample: seen.set())
print("listening", flush=True)
assert seen.wait(20)
print("connected", flush=True)
threading.Event().wait(60)
"""

    async def main() -> None:
        with a_socket() as probe:
            endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
        router = await asyncio.create_subprocess_exec(
            sys.executable, "-c", neighbour, endpoint, stdout=subprocess.PIPE
        )
        assert router.stdout is not None
        try:
            assert await router.stdout.readline() == b"listening\n"
            async with flight(tmp_path, f'zenoh.connect=["{endpoint}"]') as (service, _):
                assert await router.stdout.readline() == b"connected\n"
                await service.says("tracking: ")
                router.send_signal(signal.SIGSTOP)
                assert await service.ended_after(signal.SIGTERM) < 1.5
                assert service.process.returncode == 0
            found = replay(service.log())  # it may be told to stop before the first tick of tracking
            assert (found.difference, found.stopped) == (None, "")
            assert found.setpoints > 0
        finally:
            router.kill()
            await router.wait()

    asyncio.run(main())
