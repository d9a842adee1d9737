"""The service process under a fake service manager: a whole flight, a stalled loop, a bug."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from tests.manager_rig import Manager, listening
from tests.service_rig import PATIENCE_S, Bell
from tests.test_service_process import RUN, Service, flight, process

STALLING = """
import sys, threading
import guidance.core
def the_culprit(guide, now_ns):
    if guide.setpoints_sent == 10:
        print("stalled", file=sys.stderr, flush=True)
        threading.Event().wait()
    sound(guide, now_ns)
sound = guidance.core.Guide._setpoint
guidance.core.Guide._setpoint = the_culprit
from guidance.cli import main
main()
"""


@asynccontextmanager
async def managing(monkeypatch: pytest.MonkeyPatch, bell: Bell, watchdog_ms: int) -> AsyncIterator[Manager]:
    """The manager of the processes that the block starts."""
    async with listening(bell) as manager:
        monkeypatch.setenv("NOTIFY_SOCKET", manager.named)
        monkeypatch.setenv("WATCHDOG_USEC", str(watchdog_ms * 1000))
        monkeypatch.setenv("PYTHONFAULTHANDLER", "1")
        yield manager


def test_a_flight_as_the_manager_sees_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def main() -> None:
        bell = Bell()
        async with (
            managing(monkeypatch, bell, watchdog_ms=100) as manager,
            flight(tmp_path) as (service, _),
        ):
            await bell.until(
                lambda: any(text.startswith("tracking: ") for text in manager.all("STATUS")), "a flight"
            )
            fed = len(manager.all("WATCHDOG"))
            await bell.until(lambda: len(manager.all("WATCHDOG")) > fed + 3, "more signs of life")
            await service.ended_after(signal.SIGTERM)
            assert service.process.returncode == 0
            manager.read()
            assert "READY" in next(message for message in manager.told if "STATUS" in message)
            assert (manager.all("READY"), manager.all("STOPPING")) == (["1"], ["1"])
            said = manager.all("STATUS")
            assert said[0].startswith("disconnected: no bytes yet")
            assert said[-1] == "finished: manual confirmed"
            assert any(text.startswith("connected: ") for text in said)

    asyncio.run(main())


def test_a_shutdown_before_anything_is_connected_is_told_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        bell = Bell()
        async with (
            managing(monkeypatch, bell, watchdog_ms=0) as manager,
            process(tmp_path, "udpin://127.0.0.1:0") as (service, _),
        ):
            await bell.until(lambda: manager.all("READY"), "READY")
            await service.ended_after(signal.SIGTERM)
            manager.read()
            assert manager.told[-1]["STOPPING"] == "1"
            assert manager.told[-1]["STATUS"].startswith("finished: ")
            assert manager.all("WATCHDOG") == []

    asyncio.run(main())


def test_a_stalled_loop_stops_the_watchdog_messages_and_the_abort_says_where_it_stood(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def stalled(manager: Manager, service: Service) -> None:
        await service.says("stalled")
        manager.read()  # what was said before is in the queue
        assert len(manager.all("WATCHDOG")) > 5
        told = len(manager.told)
        await asyncio.sleep(
            0.2
        )  # twice the period, eight times that of the messages; the sinks' threads run on
        await service.ended_after(signal.SIGABRT)
        manager.read()
        assert manager.told[told:] == []
        assert service.process.returncode == -signal.SIGABRT
        await service.says("in the_culprit")

    async def main() -> None:
        command = [sys.executable, "-c", STALLING, *RUN[3:]]
        async with (
            managing(monkeypatch, Bell(), watchdog_ms=100) as manager,
            flight(tmp_path, command=command) as (service, _),
        ):
            await stalled(manager, service)

    asyncio.run(main())


def test_a_bug_is_told_before_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = STALLING.replace("threading.Event().wait()", "raise ZeroDivisionError")

    async def main() -> None:
        command = [sys.executable, "-c", broken, *RUN[3:]]
        async with (
            managing(monkeypatch, Bell(), watchdog_ms=100) as manager,
            flight(tmp_path, command=command) as (service, _),
        ):
            await asyncio.wait_for(service.process.wait(), PATIENCE_S)
            manager.read()
            assert service.process.returncode == 1
            assert manager.told[-1] == {"STOPPING": "1", "STATUS": "internal error, no setpoint follows"}

    asyncio.run(main())
