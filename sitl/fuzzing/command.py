"""`sitl fuzz`: options to a run, and what it found."""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from guidance.completion import one_of
from guidance.entry import refused
from guidance.progress import Steps

if TYPE_CHECKING:  # it imports the whole service and the built-in vehicle: only a run waits for them
    from sitl.fuzzing.run import Failure, Report


def fuzz(
    inputs: Annotated[int, typer.Option(min=1, help="How many, over all doors.")] = 100_000,
    seed: Annotated[int, typer.Option(help="The same seed gives the same inputs and outputs.")] = 1,
    door: Annotated[
        str | None,
        typer.Option(
            help="bytes, messages, config, zenoh or logs; without it, all.",
            autocompletion=one_of("bytes", "messages", "config", "zenoh", "logs"),
        ),
    ] = None,
    episode: Annotated[
        int | None, typer.Option(min=0, help="Only this one of --door, in this process, to see it fail.")
    ] = None,
    processes: Annotated[int | None, typer.Option(min=1, help="Default: one per core.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Throw hostile input at every door of the service, on virtual time, and see that it holds.

    Nothing may raise, hang, grow without bound, or send what it must not: setpoints outside the limits or in
    a state without any, packets that pymavlink cannot read.

    Exit status 0 only if all of that holds, 1 if something was found, 2 for a wrong option.

    Examples:

    \b
    sitl fuzz --inputs 10000 --seed 7
    sitl fuzz --door config --json
    sitl fuzz --door bytes --seed 7 --episode 12
    """
    from sitl.fuzzing.run import DOORS, cores, run

    if door is not None and door not in DOORS:
        raise refused("sitl fuzz", f"--door must be one of {', '.join(DOORS)}, not {door!r}")
    if episode is not None and door is None:
        raise refused("sitl fuzz", "--episode needs a --door")
    if door is not None and episode is not None:
        report = _alone(door, seed, episode)
    else:
        doors = [*DOORS] if door is None else [door]
        with Steps("sitl fuzz", "inputs", inputs) as steps:
            report = run(doors, inputs, seed, processes or cores(), lambda door, taken: steps.advance(taken))
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
