"""MAVProxy as a ground station beside the running service: it takes the vehicle over, and keeps it."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest

from guidance.replay import replay
from guidance.telemetry.log import read_log
from sitl.vehicle import Firmware
from tests.helpers import ROVER
from tests.service_rig import PATIENCE_S, Bell, VehicleEnd, a_socket
from tests.test_service_process import COMMAND, DO_SET_MODE, SETPOINT, Service, process

MAVPROXY = [
    *(sys.executable, "-u", "-m", "MAVProxy.mavproxy", "--no-state"),
    "--default-modules=param,mode,cmdlong",  # its module for the terrain fetches tiles from the internet
    "--streamrate=-1",  # asking for slow streams would slow the service's own: the link is one
]
GROUND_STATION = 255
COMPANION = 191
HANDED_OVER = re.compile(r"handed-over: .*mode.* (loiter|hold)\b")


class RoutedVehicle(VehicleEnd):
    """The built-in vehicle as behind a router: everybody who has written hears everything."""

    def __init__(self, ring: Callable[[], None], **options: Any) -> None:
        super().__init__(None, ring, **options)
        self._listeners: set[tuple[str, int]] = set()

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        self._listeners.add((addr[0], addr[1]))
        super().datagram_received(data, addr)

    def say(self, datagram: bytes, to: tuple[str, int]) -> None:
        for listener in self._listeners:
            super().say(datagram, listener)

    def who_switched(self) -> list[int]:
        """The systems that asked for a mode, in order."""
        commands = [m for m in self.heard if m.get_type() == COMMAND and m.command == DO_SET_MODE]
        return [m.get_srcSystem() for m in commands]

    def service_heartbeats(self) -> int:
        """How often the service said that it is there."""
        beats = [m for m in self.heard if m.get_type() == "HEARTBEAT"]
        return sum(m.get_srcComponent() == COMPANION for m in beats)


class GroundStation:
    """MAVProxy's process, what it has written, and the keyboard."""

    def __init__(self, child: asyncio.subprocess.Process, bell: Bell) -> None:
        self.child = child
        self.text = ""
        self._bell = bell

    async def read(self) -> None:
        """Collect what it writes, to the end."""
        assert self.child.stdout is not None
        while some := await self.child.stdout.read(4096):
            self.text += some.decode()
            self._bell.ring()

    async def says(self, what: str) -> None:
        await self._bell.until(lambda: what in self.text, f"{what!r} in {self.text}")

    def type(self, line: str) -> None:
        assert self.child.stdin is not None
        self.child.stdin.write(f"{line}\n".encode())

    async def leave(self) -> None:
        """Ctrl-D; of its own accord MAVProxy always ends with status 1."""
        assert self.child.stdin is not None
        self.child.stdin.close()
        assert await asyncio.wait_for(self.child.wait(), PATIENCE_S) == 1
        await self.says("Unloading module")
        assert "Traceback" not in self.text, self.text


@asynccontextmanager
async def mavproxy(port: int, home: Path, bell: Bell) -> AsyncIterator[GroundStation]:
    """A ground station on the vehicle's port; `home` holds what it keeps of its own."""
    child = await asyncio.create_subprocess_exec(
        *MAVPROXY,
        f"--master=udpout:127.0.0.1:{port}",
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={**os.environ, "HOME": str(home)},
    )
    station = GroundStation(child, bell)
    reading = asyncio.create_task(station.read())
    try:
        yield station
    finally:
        with suppress(ProcessLookupError):
            child.kill()
        await child.wait()
        await reading


@asynccontextmanager
async def side_by_side(
    home: Path, firmware: Firmware, *settings: str
) -> AsyncIterator[tuple[Service, RoutedVehicle, GroundStation, Bell]]:
    """The service and MAVProxy as processes, and between them the vehicle on a socket of this loop."""
    with a_socket() as sock:
        port = sock.getsockname()[1]
        async with (
            process(home, f"udpout://127.0.0.1:{port}", *settings) as (service, bell),
            mavproxy(port, home, bell) as station,
        ):
            vehicle = RoutedVehicle(bell.ring, firmware=firmware)
            await vehicle.open(sock=sock)
            try:
                yield service, vehicle, station, bell
            finally:
                vehicle.close()


@pytest.mark.parametrize(
    ("firmware", "settings", "flown", "switch", "mode"),
    [
        # MAVProxy's own `mode` cannot pack the modes of PX4, which are three numbers.
        (Firmware.PX4_UUV, (), "Mode OFFBOARD", "long DO_SET_MODE 1 4 3", "AUTO.LOITER"),
        (Firmware.ARDUPILOT_ROVER, ROVER, "Mode GUIDED", "mode HOLD", "HOLD"),
    ],
    ids=["px4", "rover"],
)
def test_the_service_hands_over_to_mavproxy_and_stays_silent(
    firmware: Firmware, settings: tuple[str, ...], flown: str, switch: str, mode: str, tmp_path: Path
) -> None:
    async def main() -> None:
        async with side_by_side(tmp_path, firmware, *settings) as (service, vehicle, station, bell):
            await service.says("tracking: ")
            await station.says("parameters")  # it has read them all
            await station.says(flown)
            before = vehicle.who_switched()
            assert set(before) == {1}  # the service
            station.type(switch)
            await bell.until(lambda: HANDED_OVER.search(service.text), f"hand-over in {service.text}")
            beats = vehicle.service_heartbeats()
            await bell.until(lambda: vehicle.service_heartbeats() >= beats + 2, "the service alive")
            assert (vehicle.vehicle.mode, vehicle.vehicle.armed) == (mode, True)
            await station.says(f"Mode {mode.removeprefix('AUTO.')}")
            await station.leave()
            await service.ended_after(signal.SIGTERM)
            assert service.process.returncode == 0
            assert vehicle.who_switched() == [*before, GROUND_STATION]  # nobody takes it back
        records = list(read_log(service.log()))
        (handed_over,) = (at for at, (topic, text) in enumerate(records) if is_hand_over(topic, text))
        topics = [topic for topic, _ in records]
        assert "setpoint" not in topics[handed_over:]
        assert vehicle.count(SETPOINT) == topics[:handed_over].count("setpoint") > 0
        found = replay(service.log())
        assert found.identical, found

    asyncio.run(main())


def is_hand_over(topic: str, payload: bytes) -> bool:
    return topic == "event" and HANDED_OVER.match(msgspec.json.decode(payload)["text"]) is not None
