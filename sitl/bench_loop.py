"""How late the service's loop is: idle, and with its sinks under load (`design.md`, rule 10).

Lateness is the time from a state's being sent by the timing autopilot to its being read by the loop, which
the log tells for each: both are on the same clock, and nothing in the service is changed for it. It holds the
way through the kernel and the wake-up of the process. Idle is `guidance run` with log and telemetry on and
nobody listening. Under load it is `sitl.bench_loaded`, with a `guidance watch` that takes all that zenoh has.
The two take turns, in rounds; a figure is the median over the rounds of each round's percentile.
"""

from __future__ import annotations

import math
import socket
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple, TypedDict

from guidance.child import Child
from guidance.records import Input
from guidance.telemetry.log import LogDamaged, NotALog, read_records
from sitl.bench_latency import UnavailableError, fly, free_port, run_command, service_settings
from sitl.stopwatch import Flight, answered_us, never, typical, worst

#: The fastest: most is to be done, and most is seen in a short time.
RATE_HZ: Final = 200
ROUNDS: Final = 4
SECONDS: Final = 5.0
GOAL_IDLE_P999_US: Final = 2000.0
GOAL_ADDED_P99_US: Final = 1000.0


class Lateness(TypedDict):
    """Of the loop, us, each the median over the rounds, and the latest of all; one that is infinite is None.

    `answer_p50_us` and `answer_p99_us`: from the state's being sent to the setpoint. `unread`: states that
    the log does not hold; they count as infinitely late.
    """

    p50_us: float | None
    p99_us: float | None
    p999_us: float | None
    worst_us: float | None
    answer_p50_us: float | None
    answer_p99_us: float | None
    states: int
    unread: int


class Report(TypedDict):
    """None where it could not be measured, and then it is not met; `notes` says why."""

    rate_hz: int
    idle: Lateness | None
    loaded: Lateness | None
    added_p99_us: float | None
    notes: list[str]
    met: bool


class Round(NamedTuple):
    """One process: how late each state was read and answered, us; infinite for never."""

    read_us: list[float]
    answered_us: list[float]


def measure(rounds: int = ROUNDS, step: Callable[[], object] = lambda: None) -> Report:
    """All figures; takes about a minute. `step` is called after each of two turns a round."""
    flown: dict[str, list[Round]] = {"idle": [], "loaded": []}
    notes: list[str] = []
    missing: set[str] = set()
    for number in range(rounds):
        for name in sorted(flown, reverse=bool(number % 2)):
            try:
                if name not in missing:
                    flown[name].append(_fly_round(loaded=name == "loaded"))
            except UnavailableError as reason:
                missing.add(name)
                notes.append(f"{name} not measured: {reason}")
            step()
    return report({name: [] if name in missing else found for name, found in flown.items()}, notes)


def _fly_round(*, loaded: bool) -> Round:
    """Raises UnavailableError if the service does not answer, or leaves no log."""
    port, zenoh_port = free_port(), free_port(socket.SOCK_STREAM)
    with tempfile.TemporaryDirectory() as directory:
        settings = service_settings(port, zenoh_port, RATE_HZ, Path(directory))
        if loaded:
            flight = _fly_watched(settings, port, zenoh_port)
        else:
            flight = fly("service", run_command(settings), port, RATE_HZ, SECONDS)
        return Round(read_us(flight, _read(Path(directory))), answered_us(flight))


def _fly_watched(settings: Sequence[str], port: int, zenoh_port: int) -> Flight:
    """The flight under load; raises UnavailableError also if nobody took what zenoh had."""
    command = [sys.executable, "-m", "sitl.bench_loaded", *settings]
    watch = [sys.executable, "-m", "guidance", "watch", "--json"]
    watch += ["--connect", f"tcp/127.0.0.1:{zenoh_port}"]
    seen: list[str] = []
    with Child(watch, "watch", lambda *_: None) as watching:
        watching.listen(seen.append)
        flight = fly("service", command, port, RATE_HZ, SECONDS)
        if watching.ended:
            raise UnavailableError(watching.obituary())
    if len(seen) < SECONDS / 2:  # it says one line a second of a vehicle that it sees
        raise UnavailableError(f"the watch saw the service in {len(seen)} of {SECONDS:.0f} s")
    return flight


def _read(directory: Path) -> dict[bytes, int]:
    """When each datagram of the only log was read, ns."""
    logs = list(directory.glob("*.mcap"))
    if len(logs) != 1:
        raise UnavailableError(f"the service left {len(logs)} logs")
    read: dict[bytes, int] = {}
    try:
        for record in read_records(logs[0], "input"):
            if isinstance(record, Input) and record.data:
                read.setdefault(record.data, record.t_ns)
    except (LogDamaged, NotALog) as damage:
        raise UnavailableError(str(damage)) from None
    return read


def read_us(flight: Flight, read_ns: Mapping[bytes, int]) -> list[float]:
    """From each state's being sent to its being read, us; infinite for one that never was."""
    return [
        (read_ns[state] - stamp.t_ns) * 1e-3 if state in read_ns else math.inf
        for state, stamp in zip(flight.states, flight.sent, strict=True)
    ]


def lateness(rounds: Sequence[Round]) -> Lateness | None:
    """The figures of some rounds, None if there are none."""
    if not rounds:
        return None
    read, answered = [r.read_us for r in rounds], [r.answered_us for r in rounds]
    return Lateness(
        p50_us=typical(read, 50.0),
        p99_us=typical(read, 99.0),
        p999_us=typical(read, 99.9),
        worst_us=worst(read),
        answer_p50_us=typical(answered, 50.0),
        answer_p99_us=typical(answered, 99.0),
        states=sum(map(len, read)),
        unread=never(read),
    )


def report(flown: Mapping[str, Sequence[Round]], notes: list[str]) -> Report:
    """The goals held against the rounds."""
    idle, loaded = lateness(flown["idle"]), lateness(flown["loaded"])
    idle_p999_us = None if idle is None else idle["p999_us"]
    added_p99_us = None
    if (
        idle is not None
        and loaded is not None
        and idle["p99_us"] is not None
        and loaded["p99_us"] is not None
    ):
        added_p99_us = loaded["p99_us"] - idle["p99_us"]
    return Report(
        rate_hz=RATE_HZ,
        idle=idle,
        loaded=loaded,
        added_p99_us=added_p99_us,
        notes=notes,
        met=_within(idle_p999_us, GOAL_IDLE_P999_US) and _within(added_p99_us, GOAL_ADDED_P99_US),
    )


def rows(report: Report) -> list[tuple[str, str]]:
    """The report as lines to print: what, and the figures with the goals they are held against."""
    heads = ("50 %", "99 %", "99.9 %", "worst")
    lines = [(f"late at {report['rate_hz']} Hz, us", "".join(f"{head:>9}" for head in heads))]
    for name, found in (("idle", report["idle"]), ("sinks under load", report["loaded"])):
        if found is None:
            lines.append((f"  {name}", "not measured"))
            continue
        figures = (found["p50_us"], found["p99_us"], found["p999_us"], found["worst_us"])
        lost = f"  {found['unread']} of {found['states']} never read" if found["unread"] else ""
        lines.append((f"  {name}", _shown(*figures) + lost))
        lines.append(("  to the setpoint", _shown(found["answer_p50_us"], found["answer_p99_us"])))
    idle_p999_us = None if report["idle"] is None else report["idle"]["p999_us"]
    for what, value, goal in (
        ("99.9 % idle", idle_p999_us, GOAL_IDLE_P999_US),
        ("added to the 99 %", report["added_p99_us"], GOAL_ADDED_P99_US),
    ):
        verdict = "met" if _within(value, goal) else "MISSED"
        lines.append((f"  {what}", f"{_shown(value)}  at most {goal:.0f} {verdict}"))
    return lines


def _within(value: float | None, goal: float) -> bool:
    return value is not None and value <= goal


def _shown(*values: float | None) -> str:
    return "".join("     none" if value is None else f"{value:9.0f}" for value in values)
