"""Whether the dashboard stays smooth and its memory flat: ten vehicles at 50 Hz, a real browser, an hour.

    python -m tests.dashboard_soak [MINUTES]

One line of figures a minute; exit status 1 if the page draws too slowly or something grows. No test: it takes
an hour. The server alone, in half a minute, is measured by `sitl bench dashboard`.
"""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import dataclass
from typing import Final

from playwright.sync_api import CDPSession, Page

from sitl.bench_dashboard import cpu_s_of, rss_mb
from tests.browser_rig import chromium, endpoint, free_port, process, visiting, wait_for

MINUTES: Final = 60
FRAMES_PER_S: Final = 10.0
#: Of server and of page, from the minute on in which all that is kept has filled.
GROWTH_MB: Final = 5.0
#: The longest history that a page shows, with room.
FULL_MIN: Final = 15
_LOADED_MS: Final = 20_000


@dataclass(frozen=True)
class Figures:
    """One minute; `cpu_percent` is the server's, of one core, `worst_ms` the slowest frame so far."""

    server_mb: float
    page_mb: float
    elements: int
    cpu_percent: float
    frames_per_s: float
    worst_ms: float


def faults(minutes: list[Figures]) -> list[str]:
    """What is not as it should be, in words."""
    found = [
        f"minute {k}: {row.frames_per_s:.1f} frames a second, at least {FRAMES_PER_S:g} wanted"
        for k, row in enumerate(minutes, 1)
        if row.frames_per_s < FRAMES_PER_S
    ]
    full, last = minutes[min(FULL_MIN, len(minutes) - 1)], minutes[-1]
    for what, growth_mb in (
        ("server", last.server_mb - full.server_mb),
        ("page", last.page_mb - full.page_mb),
    ):
        if growth_mb > GROWTH_MB:
            found.append(f"the {what} grew by {growth_mb:.1f} MB, at most {GROWTH_MB:g} wanted")
    return found


def main(minutes: int) -> int:
    place, port = endpoint(), free_port()
    server = ("guidance", "dashboard", "--connect", place, "--port", str(port))
    rows: list[Figures] = []
    with process("sitl.bench_fleet", place, "10", "50"), process(*server) as served, chromium() as browser:
        wait_for(port, served)
        with visiting(browser, f"http://127.0.0.1:{port}/") as page:
            page.wait_for_timeout(_LOADED_MS)
            inspector = page.context.new_cdp_session(page)
            for k in range(1, minutes + 1):
                rows.append(_minute(served, page, inspector))
                sys.stdout.write(f"{k:3d} min  {_line(rows[-1])}\n")
                sys.stdout.flush()
    found = faults(rows)
    sys.stdout.writelines(f"MISSED: {fault}\n" for fault in found)
    return 1 if found else 0


def _minute(served: subprocess.Popen[str], page: Page, inspector: CDPSession) -> Figures:
    frames, spent_s, at_s = page.evaluate("drawn.frames"), cpu_s_of(served.pid), time.monotonic()
    page.wait_for_timeout(60_000)
    took_s = time.monotonic() - at_s
    drawn = page.evaluate("drawn.frames") - frames
    cpu_s = cpu_s_of(served.pid) - spent_s
    inspector.send("HeapProfiler.collectGarbage")
    heap = inspector.send("Runtime.getHeapUsage")
    return Figures(
        server_mb=rss_mb(served.pid),
        page_mb=(heap["usedSize"] + heap.get("backingStorageSize", 0)) / 1e6,
        elements=page.evaluate("document.querySelectorAll('*').length"),
        cpu_percent=100.0 * cpu_s / took_s,
        frames_per_s=drawn / took_s,
        worst_ms=page.evaluate("drawn.worst"),
    )


def _line(row: Figures) -> str:
    return (
        f"server {row.server_mb:6.1f} MB {row.cpu_percent:4.1f} %   page {row.page_mb:5.1f} MB, "
        f"{row.elements} elements, {row.frames_per_s:4.1f} frames/s, slowest {row.worst_ms:.0f} ms"
    )


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if sys.argv[1:] else MINUTES))
