"""Service and vehicle as two processes over a serial port and over TCP, and the vehicle's end of either."""

from __future__ import annotations

import asyncio
import re
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from guidance.replay import replay
from tests.test_service_process import process

VEHICLE = [sys.executable, "-m", "sitl", "vehicle"]


@asynccontextmanager
async def vehicle(*arguments: str) -> AsyncIterator[tuple[asyncio.subprocess.Process, str]]:
    """The vehicle's process, and where it says that it is."""
    child = await asyncio.create_subprocess_exec(*VEHICLE, *arguments, stderr=subprocess.PIPE)
    assert child.stderr is not None
    try:
        yield child, (await child.stderr.readline()).decode()
    finally:
        with suppress(ProcessLookupError):
            child.terminate()
        await child.communicate()


def test_a_flight_over_a_serial_port_that_vanishes_and_comes_back(tmp_path: Path) -> None:
    port = tmp_path / "autopilot"

    async def main() -> None:
        logs = tmp_path / "logs"
        async with process(logs, f"serial://{port}?baud=921600") as (service, _):
            await service.says("there is no such device: is it plugged in and powered?")
            async with vehicle("--pty", str(port)) as (_, where):
                assert where == f"sitl vehicle: px4-uuv on {port}, a serial port\n"
                await service.says("tracking: ")
                assert "has it open too" not in service.text
            assert not port.is_symlink()
            await service.says("failed: the device is gone: unplugged, or without power?")
            seen = len(service.text)
            async with vehicle("--pty", str(port)):
                await service._bell.until(lambda: f"opened {port}" in service.text[seen:], "the port again")
                await service.says("the autopilot rebooted")
        assert replay(service.log()).difference is None

    asyncio.run(main())


def test_a_flight_over_tcp(tmp_path: Path) -> None:
    async def main() -> None:
        async with vehicle("--tcp", "--port", "0") as (_, where):
            found = re.search(r"on (127\.0\.0\.1:\d+) \(TCP\), serves whoever connects", where)
            assert found, where
            async with process(tmp_path, f"tcp://{found[1]}") as (service, _):
                await service.says(f"connected to {found[1]} (TCP)")
                await service.says("tracking: ")

    asyncio.run(main())


def test_a_port_of_a_vehicle_that_was_killed_is_made_anew_but_a_file_is_left_alone(tmp_path: Path) -> None:
    async def main() -> None:
        port = tmp_path / "autopilot"
        for _ in range(2):
            async with vehicle("--pty", str(port)) as (child, where):
                assert "a serial port" in where
                child.kill()
                await child.wait()
            assert port.is_symlink()
        port.unlink()
        port.touch()
        async with vehicle("--pty", str(port)) as (child, where):
            assert await child.wait() == 2
            assert "File exists" in where
        async with vehicle("--pty", str(port), "--tcp") as (child, where):
            assert await child.wait() == 2
            assert where == "sitl vehicle: --to, --tcp and --pty exclude each other\n"

    asyncio.run(main())
    assert (tmp_path / "autopilot").is_file()
