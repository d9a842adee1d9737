"""`guidance replay`: the same again to the bit, or what another configuration would do."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from guidance.completion import setting
from guidance.entry import output_file, refused
from guidance.printable import printable
from guidance.progress import reading
from guidance.report_cli import flights_of, without_extra, write

if TYPE_CHECKING:
    from guidance.what_if import Comparison


def replay(
    log: Annotated[Path, typer.Argument(metavar="LOG.mcap", help="A log that the service wrote.")],
    config: Annotated[
        Path | None,
        typer.Option("--config", "-c", metavar="FILE", help="Compare with this configuration instead."),
    ] = None,
    overrides: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Compare with the configuration so changed (repeatable).",
            autocompletion=setting,
        ),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="Write the comparison as a report (the extra `report`)."),
    ] = None,
    tolerance: Annotated[
        float,
        typer.Option(
            min=0.0, help="Numbers may differ by so much, for a log of another kind of processor or library."
        ),
    ] = 0.0,
    as_json: Annotated[bool, typer.Option("--json", help="End with one line of JSON on stdout.")] = False,
) -> None:
    """Feed a log's inputs to the core again and compare everything that comes out, to the bit.

    With --config or --set the core flies otherwise, and what it would have commanded at the same instants is
    set beside what was. The path stays the flown one. Of the file's [link], connection and signing are the
    log's; --set without --config changes the log's own configuration.

    Of a log in several files any one may be named; they are replayed together, from the first on.

    Exit status 0 only if all of it is identical and the flight did track, or if there was something to
    compare; 1 if not, 2 for no log of ours or a wrong configuration.

    Examples:

    \b
    guidance replay logs/FLIGHT.mcap --json
    guidance replay logs/FLIGHT.mcap --config other.toml --report compared.html
    guidance replay logs/FLIGHT.mcap --set law.k=0.5
    """
    if config is not None or overrides:
        raise typer.Exit(_compare(log, config, overrides or [], report, as_json=as_json))
    if report is not None:
        raise refused(
            "guidance", "--report is of a comparison: name --config or --set, or take `guidance report`"
        )
    raise typer.Exit(_again(log, tolerance, as_json=as_json))


def _again(log: Path, tolerance: float, *, as_json: bool) -> int:
    from guidance import replay as again
    from guidance.telemetry.log import NotALog

    try:
        with reading("guidance replay") as passed:
            found = again.replay(log, tolerance, passed)
    except (NotALog, again.ReplayError) as error:
        raise refused("guidance", error) from None
    console = Console(stderr=as_json, soft_wrap=True, highlight=False)
    console.print(
        f"{found.flight_s:.1f} s of log, {found.inputs} inputs; compared {found.compared} records, "
        f"{found.setpoints} setpoints, {found.tracked} of them tracking"
    )
    if found.stopped:
        console.print(printable(f"stopped early: {found.stopped}"), markup=False)
    if found.difference is not None:
        console.print(printable(f"first difference {found.difference}"), markup=False)
    elif found.tracked == 0:
        console.print("nothing was tracked in this log, so nothing of the law was compared")
    elif found.identical:
        console.print("identical" if tolerance == 0.0 else f"identical within {tolerance:g}")
    if as_json:
        typer.echo(
            json.dumps(
                {
                    "identical": found.identical,
                    "inputs": found.inputs,
                    "compared": found.compared,
                    "setpoints": found.setpoints,
                    "tracked": found.tracked,
                    "flight_s": found.flight_s,
                    "difference": None if found.difference is None else str(found.difference),
                    "stopped": found.stopped,
                }
            )
        )
    return 0 if found.identical else 1


def _compare(
    log: Path, config: Path | None, overrides: list[str], report: Path | None, *, as_json: bool
) -> int:
    if report is None:
        return 0 if _compared(log, config, overrides, as_json=as_json).t_ns else 1
    try:
        from guidance.report.comparison import drawn
        from guidance.report.page import page
    except ModuleNotFoundError as error:
        raise without_extra(error) from None
    with output_file("guidance", report) as fill:
        found = _compared(log, config, overrides, as_json=as_json)
        shown = flights_of([log])
        name = "the changed settings" if config is None else config.name
        write(fill, report, page(shown, drawn(found, shown[0].flight, name)))
    return 0 if found.t_ns else 1


def _compared(log: Path, config: Path | None, overrides: list[str], *, as_json: bool) -> Comparison:
    """The comparison, once all that is found has been said."""
    from guidance.config import ConfigError
    from guidance.replay import ReplayError
    from guidance.telemetry.log import NotALog
    from guidance.what_if import compare, other_configuration

    try:
        with reading("guidance replay") as passed:
            found = compare(log, lambda logged: other_configuration(logged, config, overrides), passed)
    except (NotALog, ReplayError, ConfigError) as error:
        raise refused("guidance", error) from None
    console = Console(stderr=as_json, soft_wrap=True, highlight=False, markup=False)
    log_s, count = found.flight_s, len(found.t_ns)
    console.print(f"{log_s:.1f} s of log, {found.inputs} inputs; commands compared at {count} instants")
    if found.stopped:
        console.print(f"stopped early: {printable(found.stopped)}")
    if found.refused:
        console.print(f"the other configuration would not have engaged: {printable(found.refused)}")
    if found.asked_otherwise:
        console.print(found.asked_otherwise)
    for one in found.differences:
        console.print(
            f"  {one.channel:<19} RMS {one.rms:9.4g}   largest {one.largest:9.4g} {one.unit:<5} "
            f"after {one.largest_at_s:.1f} s"
        )
    if found.t_ns:
        parts = (100.0 * at_limit / count for at_limit in (found.saturated_flown, found.saturated_other))
        console.print("  at a limit          flown {:.1f} %, other {:.1f} %".format(*parts))
    for parting in found.partings if not found.refused else ():
        flown, other, why = map(printable, (parting.flown, parting.other, parting.other_reason))
        console.print(f"  after {parting.at_s:.1f} s flown: {flown}, other: {other}, {why}")
    if found.partings_more and not found.refused:
        console.print(f"  and part or meet {found.partings_more} times more")
    if as_json:
        typer.echo(json.dumps(found.as_json()))
    return found
