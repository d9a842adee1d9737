"""How long a report on an hour of flight takes, what it needs, and how fast a log replays: measured.

The flight is the demo's in lockstep, at 50 Hz, with the raw traffic and what is made for viewers. Each figure
is of a process of its own, as a person starts it.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final, NamedTuple

from guidance.config import load
from guidance.demo import CONFIG_FILE
from sitl.bench import flight
from sitl.logbook import LogBook

GOAL_S: Final = 30.0
GOAL_MIB: Final = 1024.0
GOAL_FACTOR: Final = 50.0
_HOUR_S: Final = 3600.0
#: The flight, two reports and two replays.
PARTS: Final = 5


class Spent(NamedTuple):
    """What a command took: wall time, that of a core, and the most memory."""

    seconds: float
    cpu_s: float
    peak_mib: float


def measure(flight_s: float = _HOUR_S, advance: Callable[[], object] = lambda: None) -> dict[str, Any]:
    """All figures, and whether the goals are met; the report's are for an hour, in proportion for less.

    `advance` is called after each of the `PARTS`.
    """
    with tempfile.TemporaryDirectory() as directory:
        html = Path(directory) / "report.html"
        # A process's peak includes that of who started it, so what the flight keeps must not be here.
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as flying:
            log = flying.submit(_log, Path(directory), flight_s).result()
        advance()
        report = _spent("report", str(log), "--output", str(html))
        advance()
        page_mb = html.stat().st_size / 1e6
        images = _spent("report", str(log), "--output", str(html), "--png", directory)
        advance()
        again = _spent("replay", str(log))
        advance()
        otherwise = _spent("replay", str(log), "--set", "law.k=0.5")
        advance()
        log_mb = log.stat().st_size / 1e6
    factors = (flight_s / again.seconds, flight_s / otherwise.seconds)
    due_s = GOAL_S * max(flight_s / _HOUR_S, 0.1)
    return {
        "flight_s": flight_s,
        "log_mb": log_mb,
        "report_s": report.seconds,
        "report_cpu_s": report.cpu_s,
        "report_peak_mib": report.peak_mib,
        "page_mb": page_mb,
        "report_with_images_s": images.seconds,
        "report_with_images_cpu_s": images.cpu_s,
        "replay_factor": factors[0],
        "replay_cpu_factor": flight_s / again.cpu_s,
        "other_configuration_factor": factors[1],
        "other_configuration_cpu_factor": flight_s / otherwise.cpu_s,
        "met": report.seconds <= due_s and report.peak_mib <= GOAL_MIB and min(factors) >= GOAL_FACTOR,
    }


def rows(report: dict[str, Any]) -> list[tuple[str, str]]:
    """For people: what, the figure, and its goal."""
    return [
        ("log", f"{report['flight_s']:.0f} s of flight, {report['log_mb']:.0f} MB"),
        (
            "report",
            f"{report['report_s']:.1f} s, {report['report_cpu_s']:.1f} s of a core (an hour: {GOAL_S:.0f} s)",
        ),
        ("report, peak", f"{report['report_peak_mib']:.0f} MiB (at most {GOAL_MIB:.0f})"),
        ("page", f"{report['page_mb']:.1f} MB"),
        (
            "report with images",
            f"{report['report_with_images_s']:.1f} s, {report['report_with_images_cpu_s']:.1f} s of a core",
        ),
        ("replay", _factor(report, "replay")),
        ("other configuration", _factor(report, "other_configuration")),
    ]


def _factor(report: dict[str, Any], what: str) -> str:
    whole, core = report[f"{what}_factor"], report[f"{what}_cpu_factor"]
    return f"{whole:.0f} x real time, {core:.0f} x on a core of its own (at least {GOAL_FACTOR:.0f})"


def _log(directory: Path, flight_s: float) -> Path:
    config = load(CONFIG_FILE)
    with LogBook(config, directory) as book:
        flight(config, book.add).run(flight_s)
    return book.path


def _spent(*arguments: str) -> Spent:
    begin = time.perf_counter()
    process = subprocess.Popen(  # noqa: S603
        [sys.executable, "-m", "guidance", *arguments], stdout=subprocess.DEVNULL
    )
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - begin
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise RuntimeError(f"guidance {' '.join(arguments)}: exit status {process.returncode}")
    return Spent(seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024.0)
