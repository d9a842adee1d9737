"""`sitl scenarios`: the table of profile x task, flown now."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from guidance.completion import one_of
from guidance.config import ConfigError
from guidance.entry import refused
from guidance.mavlink.profiles import PROFILES
from guidance.progress import stepped
from sitl.scenarios import airplane, copter, jsbsim, px4_rover, rover
from sitl.scenarios.flight import DEPLOY
from sitl.scenarios.table import AS_IT_IS, Result, Row, Variation, fly_row, in_words
from sitl.workers import workers

#: Each class's rows.
ROWS: Final = (rover.rows, px4_rover.rows, airplane.rows, jsbsim.rows, copter.rows)


def every_row(directory: Path = DEPLOY) -> list[Row]:
    """In the order of the table."""
    return [row for rows in ROWS for row in rows(directory)]


def scenarios(
    profile: Annotated[
        str, typer.Option(help="Only rows of this profile.", autocompletion=one_of(*PROFILES))
    ] = "",
    task: Annotated[
        str, typer.Option(metavar="TEXT", help="Only rows whose task has this in its name.")
    ] = "",
    seeds: Annotated[int, typer.Option(min=1, help="Flights of each row; the worst of them counts.")] = 3,
    plain: Annotated[bool, typer.Option("--plain", help="Without the variations.")] = False,
    configurations: Annotated[
        Path, typer.Option(metavar="DIR", help="Where PROFILE.toml are; those that ship are in deploy.")
    ] = DEPLOY,
    as_json: Annotated[bool, typer.Option("--json", help="A list of objects on stdout.")] = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="As docs/results.md has it.")] = False,
) -> None:
    """Fly every profile's tasks, the whole service against the built-in vehicle with an estimator's noise.

    Exit status 0 if every figure is within its limit, 1 if one is not, 2 for a wrong option.

    Examples:

    \b
    sitl scenarios --profile ardupilot-rover --plain
    sitl scenarios --task circle --seeds 10 --json
    """
    try:
        rows = every_row(configurations)
    except ConfigError as error:
        raise refused("sitl scenarios", error) from None
    if as_json and markdown:
        raise refused("sitl scenarios", "--json and --markdown are two forms of one table: choose one")
    wanted = [row for row in rows if profile in ("", row.task.profile) and task in row.name]
    if not wanted:
        names = ", ".join(sorted({row.task.profile for row in rows}))
        raise refused("sitl scenarios", f"no such row; profiles are {names}")
    jobs = [(row, each) for row in wanted for each in ((AS_IT_IS,) if plain else row.variations)]
    found: list[Result] = []
    if markdown:
        typer.echo("| profile | task | figures / limits |\n| --- | --- | --- |")
    for result in stepped("sitl scenarios", "rows", flown(jobs, seeds, configurations), len(jobs)):
        found.append(result)
        if not as_json:
            typer.echo(_line(result, markdown=markdown))
    if as_json:
        typer.echo(json.dumps([_object(result) for result in found], indent=1))
    if any(result.missed for result in found):
        raise typer.Exit(1)


def flown(jobs: list[tuple[Row, Variation]], seeds: int, directory: Path) -> Iterator[Result]:
    """Each row in its turn, on all cores."""
    with workers() as pool:
        futures = [pool.submit(fly_row, row, variation, seeds, directory) for row, variation in jobs]
        yield from (future.result() for future in futures)


def _line(result: Result, *, markdown: bool) -> str:
    name = result.row.name
    if result.variation is not AS_IT_IS and result.variation.name != AS_IT_IS.name:
        name += f"; {result.variation.name}"
    words = in_words(result)
    if markdown:
        return f"| {result.row.task.profile} | {name} | {words} |"
    return f"{result.row.task.profile:17}{name:58}{words}"


def _object(result: Result) -> dict[str, Any]:
    figures = {} if result.figures is None else vars(result.figures)
    return {
        "profile": result.row.task.profile,
        "task": result.row.name,
        "variation": result.variation.name,
        "figures": {key: _number(value) for key, value in figures.items() if key != "trace"},
        "limits": {key: _number(value) for key, value in vars(result.limits).items()},
        "missed": list(result.missed),
    }


def _number(value: float) -> float | None:
    """JSON has no infinity."""
    return value if math.isfinite(value) else None
