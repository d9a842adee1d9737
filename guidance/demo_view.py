"""What the demo shows while it flies: events as they come, and below them one live block of figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from guidance.records import Link, Record, Setpoint, Status, TrackingError

_PLAIN_EVERY: Final = 20  # looks; without a terminal a line every 2 s is enough

_console = Console(stderr=True, highlight=False)


def plain(value: float | None, unit: str, digits: int, factor: float = 1.0) -> str:
    """A figure with its unit, or a dash."""
    return "-" if value is None else f"{value * factor:.{digits}f} {unit}"


class View:
    """A live block on a terminal, plain lines elsewhere; everything goes to stderr."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._looks = 0
        self._live = Live(console=_console, refresh_per_second=10, transient=True)

    def __enter__(self) -> View:
        if _console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def line(self, source: str, text: str) -> None:
        """A line that a process wrote."""
        _console.print(Text(f"{source:<8}", "cyan") + Text(text))

    def update(self, latest: Callable[[str], Record | None]) -> None:
        """Show the newest records."""
        rows = self._rows(latest)
        if _console.is_terminal:
            table = Table.grid(padding=(0, 2))
            for name, value in rows:
                table.add_row(Text(name, "bold"), value)
            self._live.update(table)
        elif self._looks % _PLAIN_EVERY == 0:
            _console.print("; ".join(f"{name} {value}" for name, value in rows), soft_wrap=True)
        self._looks += 1

    def _rows(self, latest: Callable[[str], Record | None]) -> list[tuple[str, str]]:
        rows: list[tuple[str, str]] = []
        status, error = latest("status"), latest("error")
        setpoint, link = latest("setpoint"), latest("link")
        if not isinstance(status, Status):
            return [("phase", "starting")]
        flown = ""
        if status.trajectory_start_ns is not None:
            flown = f", {(status.t_ns - status.trajectory_start_ns) * 1e-9:.1f} of {self._seconds:g} s"
        rows.append(("phase", f"{status.state}{flown}"))
        if isinstance(error, TrackingError):
            rows.append(("error", f"{error.norm_m:.3f} m   V1 {error.v1:.3g}   V2 {error.v2:.3g}"))
        if isinstance(setpoint, Setpoint):
            _, pitch, yaw = setpoint.body_rates_frd_rad_s
            limit = "   at a limit" if setpoint.saturated else ""
            rows.append(
                ("setpoint", f"pitch {pitch:+.3f} yaw {yaw:+.3f} rad/s, {setpoint.speed_m_s:+.2f} m/s{limit}")
            )
        if isinstance(link, Link):
            streams = ", ".join(f"{s.rate_hz:.0f} Hz {s.message}" for s in link.streams if s.rate_hz > 0)
            trip = plain(link.round_trip_s, "ms", 2, 1e3)
            rows.append(("link", f"{streams}; round trip {trip}, {link.lost} lost"))
        return rows

    @staticmethod
    def summary(verdict: str, good: bool, rows: Sequence[tuple[str, str]]) -> None:
        """The end: the verdict and its figures."""
        table = Table.grid(padding=(0, 2))
        for name, value in rows:
            table.add_row(name, Text(value, "bold", overflow="fold"))
        _console.print()
        _console.print(Text(verdict, "bold green" if good else "bold red"))
        _console.print(table)
