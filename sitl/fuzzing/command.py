"""`sitl fuzz`: options to a run, and what it found."""

from __future__ import annotations

import json
import sys
import time
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

if TYPE_CHECKING:  # it imports the whole service and the built-in vehicle: only a run waits for them
    from sitl.fuzzing.run import Failure, Report

#: Without a terminal, a line every so many seconds.
_LINE_EVERY_S: Final = 30.0


def fuzz(
    inputs: Annotated[int, typer.Option(min=1, help="How many, over all doors.")] = 100_000,
    seed: Annotated[int, typer.Option(help="The same seed gives the same inputs and outputs.")] = 1,
    door: Annotated[
        str | None, typer.Option(help="bytes, messages, config, zenoh or logs; without it, all.")
    ] = None,
    episode: Annotated[
        int | None, typer.Option(min=0, help="Only this one of --door, in this process, to see it fail.")
    ] = None,
    processes: Annotated[int | None, typer.Option(min=1, help="Default: one per core.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Throw hostile input at every door of the service, on virtual time, and see that it holds.

    Nothing may raise, hang, grow without bound, or send what it must not: setpoints outside the limits or in
    a state without any, packets that pymavlink cannot read. Exit status 0 only if all of that holds.
    """
    from sitl.fuzzing.run import DOORS, cores, run

    if door is not None and door not in DOORS:
        sys.stderr.write(f"sitl fuzz: --door must be one of {', '.join(DOORS)}, not {door!r}\n")
        raise typer.Exit(2)
    if episode is not None and door is None:
        sys.stderr.write("sitl fuzz: --episode needs a --door\n")
        raise typer.Exit(2)
    if door is not None and episode is not None:
        report = _alone(door, seed, episode)
    else:
        doors = [*DOORS] if door is None else [door]
        progress = _Progress(inputs)
        with progress:
            report = run(doors, inputs, seed, processes or cores(), progress.advance)
    if as_json:
        typer.echo(json.dumps(_as_json(report, seed)))
    else:
        _show(report, seed)
    raise typer.Exit(1 if report.failures else 0)


def _alone(door: str, seed: int, number: int) -> Report:
    from sitl.fuzzing.run import DOORS, Episode, Report, run_episode

    begun_s = time.monotonic()
    outcome = run_episode(Episode(door, seed, number, DOORS[door].inputs))
    failures = [] if outcome.failure is None else [outcome.failure]
    return Report({door: outcome.inputs}, time.monotonic() - begun_s, outcome.digest.hex()[:16], failures)


class _Progress:
    """A bar on a terminal; a line now and then elsewhere."""

    def __init__(self, inputs: int) -> None:
        console = Console(stderr=True)
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._lines = not console.is_terminal
        self._task = self._bar.add_task("inputs", total=inputs)
        self._inputs, self._done = inputs, 0
        self._begun_s = self._said_s = time.monotonic()

    def __enter__(self) -> _Progress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def advance(self, door: str, inputs: int) -> None:
        """So many more have been taken."""
        self._done += inputs
        now_s = time.monotonic()
        rate = self._done / max(now_s - self._begun_s, 1e-3)
        self._bar.update(self._task, advance=inputs, description=f"{rate:,.0f} inputs/s")
        if self._lines and now_s - self._said_s >= _LINE_EVERY_S:
            self._said_s = now_s
            sys.stderr.write(f"sitl fuzz: {self._done:,} of {self._inputs:,} inputs, {rate:,.0f} a second\n")


def _show(report: Report, seed: int) -> None:
    for failure in report.failures:
        typer.echo(_told(failure))
    total = sum(report.inputs.values())
    by_door = ", ".join(f"{door} {count:,}" for door, count in report.inputs.items())
    rate = total / max(report.seconds, 1e-3)
    typer.echo(f"{total:,} inputs ({by_door}) in {report.seconds:.0f} s, {rate:,.0f} a second")
    typer.echo(f"seed {seed}, digest {report.digest or 'none'}: {_verdict(report)}")


def _verdict(report: Report) -> str:
    count = len(report.failures)
    return "nothing found" if not count else f"{count} failure{'s' if count > 1 else ''}"


def _told(failure: Failure) -> str:
    lines = [
        f"FAILED {failure.error}",
        f"  door {failure.episode.door}, episode {failure.episode.number}, input {failure.input}",
        f"  while: {failure.scene}",
        f"  input: {failure.shown}",
        *(f"  {line}" for line in failure.trace.splitlines()),
        f"  again: {failure.episode.command}",
    ]
    return "\n".join(lines)


def _as_json(report: Report, seed: int) -> dict[str, Any]:
    return {
        "seed": seed,
        "inputs": report.inputs,
        "seconds": report.seconds,
        "inputs_per_s": sum(report.inputs.values()) / max(report.seconds, 1e-3),
        "digest": report.digest,
        "failures": [
            {
                "door": failure.episode.door,
                "episode": failure.episode.number,
                "input": failure.input,
                "scene": failure.scene,
                "shown": failure.shown,
                "error": failure.error,
                "trace": failure.trace,
                "again": failure.episode.command,
            }
            for failure in report.failures
        ],
    }
