"""The service and the vehicle as processes, and a witness on the wire between them."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import sys
import time
from asyncio.subprocess import DEVNULL, PIPE
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, cast

from guidance.config import Config
from guidance.mavlink.profiles import PROFILES
from guidance.trajectory import sample
from sitl.faults.fault import AUTO
from sitl.faults.flight import CONTROL_MODES, DEMO, configured, settings
from sitl.faults.witness import Witness
from sitl.vehicle import Firmware

FIRMWARE: Final = Firmware.PX4_UUV
#: So soon after the message that shows it: a loop period, and what processes wait for each other.
HAND_OVER_NS: Final = 100_000_000
_LATE_S: Final = 0.1
_PATIENCE_S: Final = 20.0


class Wire(asyncio.DatagramProtocol):
    """Passes datagrams on, to wherever the other end wrote from last, and shows them to the witness."""

    def __init__(self, witness: Witness, *, from_vehicle: bool) -> None:
        self.far: tuple[str, int] | None = None
        self.other: Wire | None = None
        self._witness = witness
        self._from_vehicle = from_vehicle

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        if self._from_vehicle:
            self.far = (addr[0], addr[1])
        now_ns = time.monotonic_ns()
        self._witness.arrived(data, now_ns, now_ns, to_guide=self._from_vehicle)
        if self.other is not None and self.other.far is not None:
            self.other.transport.sendto(data, self.other.far)

    def error_received(self, exc: Exception) -> None:
        """The other end is not there: it was killed."""


class Rig:
    """Two processes, which may be killed and started again, and what is known of them.

    `says` is what the service wrote to stderr, `mode` and `armed` the vehicle's truth.
    """

    def __init__(self, directory: Path, *overrides: str) -> None:
        self.directory = directory
        self.config: Config = configured(FIRMWARE, *AUTO, *overrides)
        self.witness = Witness(self.config, PROFILES[FIRMWARE], HAND_OVER_NS)
        self.witness.slack_s = _LATE_S
        self.says = ""
        self.mode, self.armed = "", False
        self._overrides = overrides
        self._processes: dict[str, asyncio.subprocess.Process] = {}
        self._readers: list[asyncio.Task[None]] = []

    async def open(self) -> None:
        """Lay the wire."""
        loop = asyncio.get_running_loop()
        self._service_port = free_port()
        _, self._to_service = await loop.create_datagram_endpoint(
            lambda: Wire(self.witness, from_vehicle=False), local_addr=("127.0.0.1", 0)
        )
        _, self._to_vehicle = await loop.create_datagram_endpoint(
            lambda: Wire(self.witness, from_vehicle=True), local_addr=("127.0.0.1", 0)
        )
        self._to_service.far = ("127.0.0.1", self._service_port)
        self._to_service.other, self._to_vehicle.other = self._to_vehicle, self._to_service

    async def start_service(self) -> None:
        """`guidance run`."""
        chosen = (
            *settings(FIRMWARE),
            *AUTO,
            f'link.connection="udpin://127.0.0.1:{self._service_port}"',
            f'log.directory="{self.directory / "logs"}"',
            *self._overrides,
        )
        arguments = [part for setting in chosen for part in ("--set", setting)]
        command = [sys.executable, "-m", "guidance", "run", "--config", str(DEMO), *arguments]
        process = await self.start("service", command, stderr=PIPE)
        self._read(process.stderr, self._hear)

    async def start_vehicle(self) -> None:
        """`sitl vehicle`, which tells its truth."""
        port = self._to_vehicle.transport.get_extra_info("sockname")[1]
        command = [sys.executable, "-m", "sitl", "vehicle", "--firmware", FIRMWARE, "--port", "0"]
        start = ",".join(map(str, sample(self.config.trajectory, 0.0).position))
        command += ["--to", f"127.0.0.1:{port}", "--truth", "-", "--position", start]
        process = await self.start("vehicle", command, stdout=PIPE)
        self._read(process.stdout, self._see)

    async def start(
        self, name: str, command: Sequence[str], *, stdout: int = DEVNULL, stderr: int = DEVNULL
    ) -> asyncio.subprocess.Process:
        """Any process of this rig."""
        environment = {**os.environ, "STATE_DIRECTORY": str(self.directory)}
        process = await asyncio.create_subprocess_exec(
            *command, stdin=DEVNULL, stdout=stdout, stderr=stderr, env=environment
        )
        self._processes[name] = process
        return process

    def pid(self, name: str) -> int:
        """The process id."""
        return self._processes[name].pid

    def alive(self, name: str) -> bool:
        """Whether it still runs."""
        return self._processes[name].returncode is None

    async def kill(self, name: str, number: int = signal.SIGKILL) -> None:
        """End it at once."""
        process = self._processes[name]
        with suppress(ProcessLookupError):
            process.send_signal(number)
        await process.wait()

    async def until(self, holds: Callable[[], bool], what: str, patience_s: float = _PATIENCE_S) -> None:
        """Wait; TimeoutError that names `what`."""
        end_s = time.monotonic() + patience_s
        while not holds():
            if time.monotonic() > end_s:
                raise TimeoutError(f"waited {patience_s:g} s in vain for: {what}")
            await asyncio.sleep(0.02)

    async def says_anew(self, text: str, since: int = 0) -> None:
        """Wait until the service has said so, after so many characters."""
        await self.until(lambda: text in self.says[since:], f"{text!r} of the service")

    def setpoints_since(self, now_ns: int) -> int:
        """How many came to the vehicle after that."""
        return sum(setpoint.sent_ns > now_ns for setpoint in self.witness.setpoints)

    def longest_gap_s(self, since_ns: int) -> float:
        """Between two setpoints, to this instant."""
        came = [s.sent_ns for s in self.witness.setpoints if s.sent_ns > since_ns]
        times = [since_ns, *came, time.monotonic_ns()]
        return max(b - a for a, b in pairwise(times)) * 1e-9

    async def close(self) -> None:
        """Nothing of it outlives this."""
        for name in self._processes:
            await self.kill(name)
        for reader in self._readers:
            await reader
        self._to_service.transport.close()
        self._to_vehicle.transport.close()

    def _read(self, stream: asyncio.StreamReader | None, take: Callable[[str], None]) -> None:
        assert stream is not None

        async def read(stream: asyncio.StreamReader) -> None:
            while line := await stream.readline():
                take(line.decode("utf-8", "replace"))

        self._readers.append(asyncio.create_task(read(stream)))

    def _hear(self, line: str) -> None:
        self.says += line

    def _see(self, line: str) -> None:
        with suppress(ValueError):  # the last line of a vehicle that was killed
            truth = json.loads(line)
            self.mode, self.armed = truth["mode"], truth["armed"]
            self.witness.look(self.mode == CONTROL_MODES[FIRMWARE], self.armed)


@asynccontextmanager
async def tracking(directory: Path, *overrides: str) -> AsyncIterator[Rig]:
    """A flight that has tracked for a second."""
    rig = Rig(directory, *overrides)
    await rig.open()
    try:
        await rig.start_vehicle()
        await rig.start_service()
        await rig.says_anew("tracking: ")
        await asyncio.sleep(1.0)
        yield rig
    finally:
        await rig.close()


def free_port() -> int:
    """A UDP port that was free a moment ago."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
