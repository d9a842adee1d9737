"""State sent to setpoint received: the service, MAVSDK doing the same job, and an echo, in one run.

Each answers the same timing autopilot over UDP as a process of its own, one at a time, in short rounds that
take turns: what else the machine does meets all of them. A figure is the median over the rounds of each
round's percentile, so that one bad round decides nothing. The service is `guidance run` as it flies, with
telemetry (zenoh, with an endpoint to connect to) and log.
"""

from __future__ import annotations

import importlib.util
import socket
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final, Literal, NamedTuple, TypedDict

from guidance.child import Child
from guidance.config import load
from guidance.demo import CONFIG_FILE
from sitl.stopwatch import Flight, answered_us, never, percentile, typical, worst
from sitl.timing_autopilot import SETTINGS, TimingAutopilot, yaw_rates

RATES_HZ: Final = (50, 200)
ROUNDS: Final = 4
#: Of one round of one of them.
SECONDS: Final = {50: 3.0, 200: 2.0}
GOAL_MEDIAN: Final = 0.7
GOAL_99TH: Final = 0.8

#: From the start of a process to setpoints.
_PATIENCE_S: Final = 15.0


class UnavailableError(Exception):
    """What is to be measured is not on this machine, or does not answer; the text says why."""


class Latency(TypedDict):
    """Percentiles in us, each the median over the rounds, and the slowest answer of all.

    A round has 150 states at 50 Hz and 400 at 200: no percentile beyond the 99th can be told from it.

    `unanswered` states, from which no setpoint was computed, nor from a newer one, count as infinitely late;
    a figure that would be infinite is None.
    """

    p50_us: float | None
    p90_us: float | None
    p99_us: float | None
    worst_us: float | None
    states: int
    unanswered: int


class AtRate(TypedDict):
    """All at one rate; None where it could not be measured. `late_p99_us`: the autopilot's own lateness."""

    rate_hz: int
    service: Latency | None
    mavsdk: Latency | None
    echo: Latency | None
    ratio_p50: float | None
    ratio_p99: float | None
    late_p99_us: float | None
    met: bool


class Report(TypedDict):
    """`met` only if both goals are met at every rate; what could not be measured is not met."""

    rates: list[AtRate]
    notes: list[str]
    met: bool


class Round(NamedTuple):
    """One process at one rate: the times to answer, us, and the autopilot's own lateness, ns."""

    times_us: list[float]
    late_ns: list[int]


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    """A port that nobody has right now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def service_settings(port: int, zenoh_port: int, rate_hz: int, directory: Path) -> list[str]:
    """The demo's configuration before a timing autopilot; telemetry and log on."""
    return [
        *SETTINGS,
        f'link.connection="udpin://127.0.0.1:{port}"',
        f"link.rate_hz={rate_hz}",
        f'zenoh.listen=["tcp/127.0.0.1:{zenoh_port}"]',
        f'log.directory="{directory}"',
    ]


def run_command(settings: Sequence[str]) -> list[str]:
    """`guidance run`, with the demo's configuration but for the settings."""
    command = [sys.executable, "-m", "guidance", "run", "--config", str(CONFIG_FILE)]
    return command + [part for setting in settings for part in ("--set", setting)]


def service_command(port: int, rate_hz: int, directory: Path) -> list[str]:
    """`guidance run`, which nobody listens to."""
    return run_command(service_settings(port, free_port(socket.SOCK_STREAM), rate_hz, directory))


def mavsdk_command(port: int, rate_hz: int, directory: Path) -> list[str]:
    """The same job with MAVSDK.

    Raises:
        UnavailableError: it is not installed.
    """
    if importlib.util.find_spec("mavsdk") is None:
        raise UnavailableError("mavsdk is not installed (pip install '.[bench]')")
    return [sys.executable, "-m", "sitl.bench_mavsdk", str(port)]


def echo_command(port: int, rate_hz: int, directory: Path) -> list[str]:
    """The floor."""
    return [sys.executable, "-m", "sitl.bench_echo", str(port)]


Command = Callable[[int, int, Path], list[str]]
CANDIDATES: Final[Mapping[str, Command]] = {
    "service": service_command,
    "mavsdk": mavsdk_command,
    "echo": echo_command,
}


def fly(name: str, command: Sequence[str], port: int, rate_hz: int, seconds: float) -> Flight:
    """Start the process, wait until it answers at `port`, and measure; it is gone afterwards.

    Raises:
        UnavailableError: it ended, or never answered all states of a quarter of a second.
    """
    answers = yaw_rates(load(CONFIG_FILE, SETTINGS))
    with (
        Child(command, name, lambda *_: None) as child,
        TimingAutopilot(("127.0.0.1", port), answers) as autopilot,
    ):
        child.listen(lambda _: None)  # a full pipe would hold it up
        if not autopilot.fly_until_answered(rate_hz, _PATIENCE_S, lambda: not child.ended):
            raise UnavailableError(child.obituary() if child.ended else f"the {name} does not answer")
        return autopilot.fly(rate_hz, round(seconds * rate_hz))


def fly_round(name: str, rate_hz: int) -> Round:
    """One of `CANDIDATES`, once; raises UnavailableError as `fly` does."""
    port = free_port()
    with tempfile.TemporaryDirectory() as directory:
        command = CANDIDATES[name](port, rate_hz, Path(directory))
        flight = fly(name, command, port, rate_hz, SECONDS[rate_hz])
    return Round(answered_us(flight), flight.late_ns)


def measure(rounds: int = ROUNDS, step: Callable[[], object] = lambda: None) -> Report:
    """All figures; takes about a minute and a half. `step` is called after each of `steps(rounds)` turns."""
    notes: list[str] = []
    rates = [_at_rate(rate_hz, rounds, notes, step) for rate_hz in RATES_HZ]
    return Report(rates=rates, notes=notes, met=all(at["met"] for at in rates))


def steps(rounds: int) -> int:
    """How many turns there are."""
    return len(RATES_HZ) * rounds * len(CANDIDATES)


def _at_rate(rate_hz: int, rounds: int, notes: list[str], step: Callable[[], object]) -> AtRate:
    flown: dict[str, list[Round]] = {name: [] for name in CANDIDATES}
    missing: set[str] = set()
    for number in range(rounds):
        for name in _turned(list(CANDIDATES), number):
            try:
                if name not in missing:
                    flown[name].append(fly_round(name, rate_hz))
            except UnavailableError as reason:
                missing.add(name)
                notes.append(f"{name} not measured at {rate_hz} Hz: {reason}")
            step()
    return at_rate(rate_hz, {name: [] if name in missing else flown[name] for name in CANDIDATES})


def _turned(names: list[str], by: int) -> list[str]:
    """Another one begins each round."""
    return names[by % len(names) :] + names[: by % len(names)]


def at_rate(rate_hz: int, flown: Mapping[str, Sequence[Round]]) -> AtRate:
    """The figures of some rounds; those of a name without rounds are None."""
    figures = {name: latency([r.times_us for r in rounds]) for name, rounds in flown.items()}
    medians = _ratio(figures, "p50_us")
    tails = _ratio(figures, "p99_us")
    late_ns = [late for rounds in flown.values() for r in rounds for late in r.late_ns]
    return AtRate(
        rate_hz=rate_hz,
        service=figures["service"],
        mavsdk=figures["mavsdk"],
        echo=figures["echo"],
        ratio_p50=medians,
        ratio_p99=tails,
        late_p99_us=percentile(late_ns, 99.0) * 1e-3 if late_ns else None,
        met=medians is not None and tails is not None and medians <= GOAL_MEDIAN and tails <= GOAL_99TH,
    )


def _ratio(figures: Mapping[str, Latency | None], key: Literal["p50_us", "p99_us"]) -> float | None:
    ours, theirs = figures["service"], figures["mavsdk"]
    if ours is None or theirs is None:
        return None
    our_us, their_us = ours[key], theirs[key]
    return None if our_us is None or their_us is None else our_us / their_us


def latency(rounds: Sequence[Sequence[float]]) -> Latency | None:
    """The figures of some rounds' times (us, infinite: never); None if there are none."""
    if not rounds:
        return None
    return Latency(
        p50_us=typical(rounds, 50.0),
        p90_us=typical(rounds, 90.0),
        p99_us=typical(rounds, 99.0),
        worst_us=worst(rounds),
        states=sum(map(len, rounds)),
        unanswered=never(rounds),
    )


def rows(report: Report) -> list[tuple[str, str]]:
    """The report as lines to print: what, and the figures with the goals they are held against."""
    lines = []
    for at in report["rates"]:
        heads = ("50 %", "90 %", "99 %", "worst")
        lines.append((f"at {at['rate_hz']} Hz, us", "".join(f"{head:>9}" for head in heads)))
        for name, found in (("service", at["service"]), ("mavsdk", at["mavsdk"]), ("echo", at["echo"])):
            lines.append((f"  {name}", "not measured" if found is None else _figures(found)))
        for what, ratio, goal in (
            ("median to mavsdk's", at["ratio_p50"], GOAL_MEDIAN),
            ("99 % to mavsdk's", at["ratio_p99"], GOAL_99TH),
        ):
            value = "not measured" if ratio is None else f"{ratio:9.2f}"
            verdict = "met" if ratio is not None and ratio <= goal else "MISSED"
            lines.append((f"  {what}", f"{value}  at most {goal} {verdict}"))
        if at["late_p99_us"] is not None:
            lines.append(("  late itself, 99 %", f"{at['late_p99_us']:9.0f}  the autopilot, on this machine"))
    return lines


def _figures(found: Latency) -> str:
    figures = (found["p50_us"], found["p90_us"], found["p99_us"], found["worst_us"])
    text = "".join("    never" if figure is None else f"{figure:9.0f}" for figure in figures)
    lost = found["unanswered"]
    return text if not lost else f"{text}  {lost} of {found['states']} never answered"
