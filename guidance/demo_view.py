"""What the demo shows: events as they come, below them one live block of figures, and the summary.

Everything goes to stderr and fits a terminal of 80 columns; the block keeps its height and its columns.
"""

from __future__ import annotations

import math
import signal
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from rich.console import Console
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from guidance.config import Config
from guidance.estimate import ATTITUDES, POSITIONS
from guidance.figures import (
    CONVERGED_M,
    FOR_GOOD_S,
    SETTLED_TIME_CONSTANTS,
    Goals,
    StreamFigures,
    TrackingFigures,
    missed,
)
from guidance.printable import printable
from guidance.records import Link, Record, Setpoint, Status, Timing, TrackingError

_PLAIN_EVERY: Final = 20  # looks; without a terminal a line every 2 s is enough
_COLOURS: Final = {"warning": "yellow", "error": "red", "critical": "bold red"}


class Result(NamedTuple):
    """How well it tracked, and where the log is; `interrupted_by` is a signal's number, 0 for none."""

    tracking: TrackingFigures
    stream: StreamFigures
    tracked_s: float
    log: str
    interrupted_by: int = 0
    goals: Goals = Goals()
    asked_s: float = 0.0
    last_error_m: float | None = None
    time_constant_s: float = 1.0

    @property
    def tracked(self) -> bool:
        """Below 0.1 m for good, and not cut short."""
        return self.tracking.converged_s is not None and not self.interrupted_by

    @property
    def exit_status(self) -> int:
        """0 if it tracked, 1 if it did not, 128 + N after signal N."""
        if self.interrupted_by:
            return 128 + self.interrupted_by
        return 0 if self.tracked else 1

    def as_json(self) -> dict[str, Any]:
        """The line for machines; null is what could not be measured."""
        return {
            "tracked": self.tracked,
            "converged_s": self.tracking.converged_s,
            "rms_error_m": self.tracking.rms_error_m,
            "max_error_m": self.tracking.max_error_m,
            "setpoint_rate_hz": self.stream.rate_hz,
            "max_setpoint_gap_s": self.stream.max_gap_s,
            "tracked_s": self.tracked_s,
            "missed": missed(self.tracking, self.stream, self.goals),
            "log": self.log,
        }

    def verdict(self) -> str:
        """In one sentence, and why if it is not a good one."""
        last_m = math.inf if self.last_error_m is None else self.last_error_m
        if self.interrupted_by:
            name = signal.Signals(self.interrupted_by).name
            return f"interrupted by {name} after {self.tracked_s:.1f} of {self.asked_s:g} s of tracking"
        if self.tracked:
            short = missed(self.tracking, self.stream, self.goals)
            return f"tracked, but missed a goal: {', '.join(short)}" if short else "tracked"
        if last_m < CONVERGED_M:
            return f"below {CONVERGED_M:g} m, but not for {FOR_GOOD_S:g} s yet: too short to say it tracks"
        return f"did NOT track: {last_m:.2f} m off after {self.tracked_s:.1f} s (is --seconds long enough?)"


def failure_json(why: str) -> dict[str, Any]:
    """The line for machines when there is nothing to judge: the same keys, and the reason."""
    nothing = Result(TrackingFigures(None, None, None), StreamFigures(None, None), 0.0, "")
    return {**nothing.as_json(), "log": None, "error": why}


def plain(value: float | None, unit: str, digits: int, factor: float = 1.0) -> str:
    """A figure with its unit, or a dash."""
    return "-" if value is None else f"{value * factor:.{digits}f} {unit}"


def summary(result: Result) -> Table:
    """The figures beside their goals."""
    t, s, goals = result.tracking, result.stream, result.goals
    settle_s = SETTLED_TIME_CONSTANTS * result.time_constant_s
    why = ""
    if t.converged_s is not None and t.rms_error_m is None:
        needed_s = math.ceil(t.converged_s + settle_s + FOR_GOOD_S)
        why = f"too short: --seconds {needed_s}"
    table = Table.grid(padding=(0, 2))
    rows = (
        (
            f"converged (below {CONVERGED_M:g} m for good)",
            plain(t.converged_s, "s", 2),
            goals.converged_s,
            "s",
            1.0,
        ),
        (
            f"RMS error from {settle_s:g} s later on",
            plain(t.rms_error_m, "mm", 3, 1e3),
            goals.rms_error_m,
            "mm",
            1e3,
        ),
        ("largest error from then on", plain(t.max_error_m, "mm", 3, 1e3), goals.max_error_m, "mm", 1e3),
        ("longest gap between setpoints", plain(s.max_gap_s, "ms", 1, 1e3), goals.max_gap_s, "ms", 1e3),
    )
    for name, value, goal, unit, factor in rows:
        of_error = name.startswith(("RMS", "largest"))
        shown = why if why and of_error else value
        table.add_row(
            name, Text(shown, "bold"), "" if goal is None else f"goal: at most {goal * factor:g} {unit}"
        )
    rate = "" if goals.rate_hz is None else f"goal: {goals.rate_hz:g} Hz"
    table.add_row("setpoints", Text(plain(s.rate_hz, "Hz", 2), "bold"), rate)
    return table


def coloured(source: str, text: str) -> Text:
    """A line that a process of the demo's wrote."""
    words = text.split(maxsplit=2)
    colour = _COLOURS.get(words[1], "") if len(words) > 1 else ""
    return Text(f"{source:<10}", "cyan") + Text(text.removeprefix(f"sitl {source}: "), colour)


class View:
    """A live block on a terminal, plain lines elsewhere."""

    def __init__(self, seconds: float, console: Console | None = None) -> None:
        self._seconds = seconds
        self._looks = 0
        self._console = Console(stderr=True, highlight=False) if console is None else console
        self._live = Live(console=self._console, auto_refresh=False, transient=True)

    def __enter__(self) -> View:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._live.stop()

    def head(self, config: Config, watch_at: str) -> None:
        """What is about to be flown, and where others can watch."""
        name = config.trajectory.__struct_config__.tag
        self._print(f"Flying the built-in {config.vehicle.profile} along the {name} for {self._seconds:g} s.")
        self._print(f"Telemetry: zenoh at {watch_at}, keys guidance/{config.vehicle.name}/*. Ctrl-C ends it.")
        self._print("With --dashboard it opens a page to watch and command it in a browser.")

    def line(self, source: str, text: str) -> None:
        """A line that a process wrote."""
        self._console.print(coloured(source, text), soft_wrap=True)

    def update(self, latest: Callable[[str], Record | None]) -> None:
        """Show the newest records."""
        if self._console.is_terminal:
            self._live.update(self._block(latest), refresh=True)
        elif self._looks % _PLAIN_EVERY == 0:
            self._print(_brief(latest, self._seconds))
        self._looks += 1

    def _print(self, text: str) -> None:
        self._console.print(text, soft_wrap=True, markup=False)

    def _block(self, latest: Callable[[str], Record | None]) -> Table:
        table = Table.grid(padding=(0, 2))
        table.add_column(style="bold", no_wrap=True)
        table.add_column(no_wrap=True, overflow="ellipsis")
        status = latest("status")
        flown_s = _flown_s(status)
        if flown_s is not None:
            bar = Table.grid(padding=(0, 1))
            part = min(flown_s, self._seconds)
            bar.add_row(f"{flown_s:5.1f} of {self._seconds:g} s", ProgressBar(self._seconds, part, width=30))
            table.add_row("tracking", bar)
        elif isinstance(status, Status):
            table.add_row(status.state, Text(printable(status.reason)))
        else:
            table.add_row("starting", "")
        for name, value in _rows(latest):
            table.add_row(name, value)
        return table


def _flown_s(status: Record | None) -> float | None:
    if not isinstance(status, Status) or status.trajectory_start_ns is None:
        return None
    return (status.t_ns - status.trajectory_start_ns) * 1e-9


def _brief(latest: Callable[[str], Record | None], seconds: float) -> str:
    """One line for a file or a pipe."""
    status, error, setpoint = latest("status"), latest("error"), latest("setpoint")
    if not isinstance(status, Status):
        return "starting"
    flown_s = _flown_s(status)
    if flown_s is None:
        return f"{status.state}: {printable(status.reason)}"
    text = f"tracking {flown_s:.1f} of {seconds:g} s"
    if isinstance(error, TrackingError):
        text += f", error {error.norm_m:.3f} m"
    if isinstance(setpoint, Setpoint):
        text += f", speed {setpoint.speed_m_s:+.2f} m/s"
    return text


def _rows(latest: Callable[[str], Record | None]) -> list[tuple[str, str]]:
    """Always the same rows, so that the block does not jump."""
    error, setpoint = latest("error"), latest("setpoint")
    timing, link = latest("timing"), latest("link")
    rows = dict.fromkeys(("error", "setpoint", "loop", "link"), "-")
    if isinstance(error, TrackingError):
        rows["error"] = f"{error.norm_m:8.3f} m      V1 {error.v1:<9.3g} V2 {error.v2:<9.3g}"
    if isinstance(setpoint, Setpoint):
        _, pitch, yaw = setpoint.body_rates_frd_rad_s
        limit = "  at a limit" if setpoint.saturated else ""
        rows["setpoint"] = (
            f"{setpoint.speed_m_s:+8.3f} m/s    pitch {pitch:+.3f}  yaw {yaw:+.3f} rad/s{limit}"
        )
    if isinstance(timing, Timing):
        late, gap = timing.lateness_max_s * 1e3, timing.setpoint_gap_max_s * 1e3
        rows["loop"] = f"{timing.setpoint_rate_hz:8.2f} Hz     longest gap {gap:.1f} ms, latest {late:.1f} ms"
    if isinstance(link, Link):
        rates = {stream.message: stream.rate_hz for stream in link.streams}
        attitude_hz, position_hz = (max(rates.get(name, 0.0) for name in of) for of in (ATTITUDES, POSITIONS))
        rows["link"] = (
            f"attitude {attitude_hz:3.0f} Hz  position {position_hz:3.0f} Hz  "
            f"round trip {plain(link.round_trip_s, 'ms', 2, 1e3)}  lost {link.lost}"
        )
    return list(rows.items())


def show(result: Result, console: Console | None = None) -> None:
    """Print the summary for people."""
    console = Console(stderr=True, highlight=False) if console is None else console
    console.print()
    good = result.tracked and not missed(result.tracking, result.stream, result.goals)
    colour = "bold green" if good else "bold yellow" if result.tracked else "bold red"
    console.print(Text(result.verdict(), colour), soft_wrap=True)
    if result.tracked_s > 0.0:
        console.print(summary(result))
    console.print(f"log: {result.log}", soft_wrap=True, markup=False)
    console.print(f"check it: guidance replay {result.log}", soft_wrap=True, markup=False)
