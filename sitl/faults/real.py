"""Faults over real sockets: processes killed, a disk that is full, a machine that is busy."""

from __future__ import annotations

import asyncio
import os
import resource
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from rich import box
from rich.table import Table

from sitl.faults.rig import Rig, free_port, tracking

#: What a busy machine may delay; the service itself waits 0.75 s at most before it hands over.
_SHORT_GAP_S: Final = 0.2
_ROUTER: Final = (sys.executable, "-m", "sitl.faults.router")


class RealFault(NamedTuple):
    """What is done to a flight that tracks; it gives what was not as expected, in words."""

    title: str
    expected: str
    act: Callable[[Rig], Awaitable[list[str]]]
    settings: tuple[str, ...] = ()


class RealOutcome(NamedTuple):
    """What came of it."""

    title: str
    expected: str
    problems: tuple[str, ...]
    seconds: float
    setpoints: int

    def as_json(self) -> dict[str, Any]:
        """One row."""
        return {**self._asdict(), "passed": not self.problems}


async def _kill_service(rig: Rig) -> list[str]:
    await rig.kill("service")
    killed_ns = time.monotonic_ns()
    rig.witness.restarted(killed_ns)
    said = len(rig.says)
    await rig.start_service()
    await rig.says_anew("withheld: ", said)
    await rig.until(lambda: rig.mode == "POSCTL", "PX4's failsafe")
    await asyncio.sleep(3.0)
    return [
        *_unless(rig.setpoints_since(killed_ns + 100_000_000) == 0, "setpoints came after the restart"),
        *_unless(rig.mode == "POSCTL", f"the vehicle is in {rig.mode}"),
    ]


async def _kill_vehicle(rig: Rig) -> list[str]:
    said = len(rig.says)
    await rig.kill("vehicle")
    await rig.says_anew("handed-over: ", said)
    handed_over_ns = time.monotonic_ns()
    rig.witness.rebooted()
    await rig.start_vehicle()
    await rig.says_anew("ready: ", said)
    await asyncio.sleep(6.5)
    return [
        *_unless(rig.setpoints_since(handed_over_ns) == 0, "setpoints came after the vehicle was back"),
        *_unless(not rig.armed, "the vehicle was armed again"),
    ]


async def _kill_router(rig: Rig) -> list[str]:
    begun_ns = time.monotonic_ns()
    for _ in range(2):
        router = await rig.start(
            "router", [*_ROUTER, rig.config.zenoh.connect[0]], stdout=asyncio.subprocess.PIPE
        )
        assert router.stdout is not None
        heard = await asyncio.wait_for(router.stdout.readline(), 20.0)
        if heard != b"heard\n":
            return ["the router did not hear the service"]
        await rig.kill("router")
    await asyncio.sleep(1.0)
    return _flies_on(rig, begun_ns, _SHORT_GAP_S)


async def _fill_disk(rig: Rig) -> list[str]:
    begun_ns = time.monotonic_ns()
    said = len(rig.says)
    # No file of the process may grow any more: to it the same as a full disk, and anybody may do it.
    size = sum(path.stat().st_size for path in rig.directory.glob("logs/*"))
    resource.prlimit(rig.pid("service"), resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
    await rig.says_anew("ends early", said)
    await asyncio.sleep(3.0)
    return _flies_on(rig, begun_ns, _SHORT_GAP_S)


async def _load(rig: Rig) -> list[str]:
    begun_ns = time.monotonic_ns()
    names = [f"load {number}" for number in range(os.cpu_count() or 1)]
    for name in names:
        await rig.start(name, [sys.executable, "-c", "while True: pass"])
    await asyncio.sleep(6.0)
    # Where a gap is too long it hands over, which is as safe; then nothing may follow.
    if "handed-over: " in rig.says:
        return []
    return _flies_on(rig, begun_ns, 0.75)


def _flies_on(rig: Rig, since_ns: int, gap_s: float) -> list[str]:
    longest_s = rig.longest_gap_s(since_ns)
    return [
        *_unless(rig.alive("service"), "the service has ended"),
        *_unless(rig.mode == "OFFBOARD" and rig.armed, f"the vehicle is in {rig.mode}"),
        *_unless("handed-over: " not in rig.says, "control was handed over"),
        *_unless(longest_s <= gap_s, f"{longest_s:.2f} s without a setpoint"),
    ]


def _unless(holds: bool, problem: str) -> list[str]:
    return [] if holds else [problem]


TABLE: Final = (
    RealFault(
        "the service is killed (-9) in flight and started again",
        "withheld: no setpoint follows, PX4's failsafe acts",
        _kill_service,
    ),
    RealFault(
        "the vehicle's process is killed and started again",
        "hands over; no setpoint follows, nothing is armed",
        _kill_vehicle,
    ),
    RealFault(
        "the zenoh router is killed and started again",
        "flies on, and the new router hears the service",
        _kill_router,
        (f'zenoh.connect=["tcp/127.0.0.1:{free_port()}"]',),
    ),
    RealFault("the disk is full in flight", "flies on, and says so", _fill_disk),
    RealFault("100 % CPU load beside it, one process a core", "flies on, or hands over", _load),
)


def fly(fault: RealFault) -> RealOutcome:
    """With everything that it starts gone afterwards."""
    begun_s = time.monotonic()
    problems, setpoints = asyncio.run(_fly(fault))
    return RealOutcome(fault.title, fault.expected, tuple(problems), time.monotonic() - begun_s, setpoints)


async def _fly(fault: RealFault) -> tuple[list[str], int]:
    with tempfile.TemporaryDirectory(prefix="sitl-faults-") as directory:
        try:
            async with tracking(Path(directory), *fault.settings) as rig:
                problems = await fault.act(rig)
                problems += _unless("internal error" not in rig.says, "the service met an internal error")
                rig.witness.finish()
                return [*problems, *rig.witness.broken], len(rig.witness.setpoints)
        except TimeoutError as error:
            return [str(error) or "it hung"], 0


def table(faults: Sequence[RealFault], outcomes: Sequence[RealOutcome]) -> Table:
    """One line a fault; without outcomes, what there is."""
    shown = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in ("fault", "expected", "took", "verdict"):
        shown.add_column(heading, overflow="fold")
    if not outcomes:
        for fault in faults:
            shown.add_row(fault.title, fault.expected, "", "")
    for outcome in outcomes:
        verdict = "[bold red]FAIL[/]" if outcome.problems else "pass"
        shown.add_row(outcome.title, outcome.expected, f"{outcome.seconds:.0f} s", verdict)
        for problem in outcome.problems:
            shown.add_row(f"  ! {problem}", "", "", "", style="red")
    return shown
