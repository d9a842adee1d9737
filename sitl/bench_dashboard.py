"""What the dashboard's server costs: ten vehicles at 50 Hz over zenoh, and a page that shows one of them.

Three processes: the fleet, `guidance dashboard`, and this one, which reads what a page would. CPU and memory
are the kernel's, from /proc.
"""

from __future__ import annotations

import json
import os
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, TypedDict

from guidance.child import Child
from sitl.bench_latency import UnavailableError as UnavailableError  # raised here, so found here
from sitl.bench_latency import free_port

VEHICLES: Final = 10
RATE_HZ: Final = 50
GOAL_CPU: Final = 25.0
#: Memory is taken for all rows at once, and touched as they come; so much more is a leak.
GOAL_GROWTH_MB: Final = 20.0
_UP_S: Final = 30.0
_WARM_S: Final = 5.0


class Report(TypedDict):
    """What was measured; `cpu_percent` is of one core."""

    vehicles: int
    rate_hz: int
    seconds: float
    cpu_percent: float
    rss_start_mb: float
    rss_end_mb: float
    page_bytes_per_s: float
    page_rows_per_s: float
    vehicles_shown: int
    met: bool


def measure(seconds: float) -> Report:
    """All figures; raises UnavailableError if something does not come up."""
    endpoint = f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    port = free_port(socket.SOCK_STREAM)
    fleet = [sys.executable, "-m", "sitl.bench_fleet", endpoint, str(VEHICLES), str(RATE_HZ)]
    served = [sys.executable, "-m", "guidance", "dashboard", "--connect", endpoint, "--port", str(port)]
    with Child(fleet, "fleet", _unsaid) as flying, Child(served, "dashboard", _unsaid) as serving:
        for child in (flying, serving):
            child.listen(_unread)
        with _page(port, serving) as page:
            page.send(json.dumps({"ask": "see", "vehicle": "rover-0"}))
            _read(page, _WARM_S)
            pid = serving.process.pid
            rss_start_mb, cpu_s, at_s = rss_mb(pid), cpu_s_of(pid), time.monotonic()
            came, rows, shown = _read(page, seconds)
            took_s = time.monotonic() - at_s
            spent_s, rss_end_mb = cpu_s_of(pid) - cpu_s, rss_mb(pid)
        for child in (flying, serving):
            if child.ended:
                raise UnavailableError(child.obituary())
    cpu = 100.0 * spent_s / took_s
    return Report(
        vehicles=VEHICLES,
        rate_hz=RATE_HZ,
        seconds=took_s,
        cpu_percent=cpu,
        rss_start_mb=rss_start_mb,
        rss_end_mb=rss_end_mb,
        page_bytes_per_s=came / took_s,
        page_rows_per_s=rows / took_s,
        vehicles_shown=shown,
        met=cpu <= GOAL_CPU and rss_end_mb - rss_start_mb <= GOAL_GROWTH_MB and shown == VEHICLES,
    )


def rows(report: Report) -> list[tuple[str, str]]:
    """The report as lines to print."""
    cpu, growth_mb = report["cpu_percent"], report["rss_end_mb"] - report["rss_start_mb"]
    return [
        (
            f"{report['vehicles']} at {report['rate_hz']} Hz",
            f"{report['vehicles_shown']} shown, {report['seconds']:.0f} s",
        ),
        (
            "CPU of one core, %",
            f"{cpu:9.1f}  at most {GOAL_CPU:.0f} {'met' if cpu <= GOAL_CPU else 'MISSED'}",
        ),
        (
            "memory, MB",
            f"{report['rss_start_mb']:9.1f} to {report['rss_end_mb']:.1f}  at most {GOAL_GROWTH_MB:.0f} more "
            f"{'met' if growth_mb <= GOAL_GROWTH_MB else 'MISSED'}",
        ),
        ("to a page, kB/s", f"{report['page_bytes_per_s'] / 1e3:9.1f}"),
        ("rows/s", f"{report['page_rows_per_s']:9.1f}"),
    ]


@contextmanager
def _page(port: int, serving: Child) -> Iterator[Any]:
    from websockets.exceptions import InvalidHandshake
    from websockets.sync.client import connect
    from websockets.typing import Origin

    until_s = time.monotonic() + _UP_S
    while True:
        try:
            origin = Origin(f"http://127.0.0.1:{port}")
            page = connect(f"ws://127.0.0.1:{port}/live", origin=origin, max_size=None)
            break
        except (OSError, InvalidHandshake):
            if serving.ended or time.monotonic() > until_s:
                raise UnavailableError(serving.obituary()) from None
            time.sleep(0.2)
    with page:
        yield page


def _read(page: Any, seconds: float) -> tuple[int, int, int]:
    """Bytes and rows that came in so long, and how many vehicles the last word showed at nearly full rate."""
    from guidance.dashboard.rows import ROW

    came = made = shown = 0
    until_s = time.monotonic() + seconds
    while (left_s := until_s - time.monotonic()) > 0.0:
        try:
            message = page.recv(timeout=left_s)
        except TimeoutError:
            break
        came += len(message)
        if isinstance(message, bytes):
            made += len(message) // ROW.size
        elif (said := json.loads(message))["kind"] == "fleet":
            shown = sum((seen["setpoint_rate_hz"] or 0.0) > 0.9 * RATE_HZ for seen in said["fleet"])
    return came, made, shown


def cpu_s_of(pid: int) -> float:
    """What a process has spent, user and system time (man 5 proc)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def rss_mb(pid: int) -> float:
    """What a process holds in memory (man 5 proc)."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _unsaid(_: str, __: str) -> None:
    """What they write to stderr is in the obituary if it is the last."""


def _unread(_: str) -> None:
    """They write nothing to stdout."""
