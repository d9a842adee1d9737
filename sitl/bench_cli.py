"""The command line `sitl bench`: what is measured, and the goals beside it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Annotated

import typer

from guidance.entry import refused
from guidance.progress import Steps, waiting

benchmarks = typer.Typer(rich_markup_mode=None)


@benchmarks.callback(invoke_without_command=True)
def bench(
    context: typer.Context,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Measure lockstep, replay, law, time to the first setpoint and memory, beside their goals.

    Exit status 0 only if every goal is met on this machine, 1 if not. It takes some ten seconds.

    Examples:

    \b
    sitl bench
    sitl bench --json
    sitl bench latency
    """
    if context.invoked_subcommand is not None:
        return
    from sitl import bench as quick

    with Steps("sitl bench", "figures", len(quick.MEASUREMENTS), steady=True) as steps:
        figures = quick.run(steps.advance)
    if as_json:
        typer.echo(json.dumps([figure._asdict() for figure in figures]))
    else:
        for figure in figures:
            verdict = "met" if figure.met else "MISSED"
            typer.echo(
                f"{figure.name:<34} {figure.value:10.3f} {figure.unit:<12} {figure.goal:<16} {verdict}"
            )
    raise typer.Exit(0 if all(figure.met for figure in figures) else 1)


@benchmarks.command("campaign")
def bench_campaign(
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Measure the throughput of campaigns beside a C loop of the same arithmetic and crazyflow.

    Exit status 0 only if every goal is met on this machine, 1 if not; one that could not be measured is not.

    Example:

    \b
    sitl bench campaign --json
    """
    try:
        from sitl import bench_campaign as throughput
    except ModuleNotFoundError as error:
        raise refused("sitl bench campaign", f"needs {error.name}, of the extra se3-guidance[sitl]") from None

    with Steps("sitl bench campaign", "rounds", throughput.ROUNDS, steady=True) as steps:
        report = throughput.measure(steps.advance)
    if as_json:
        typer.echo(json.dumps(report))
    else:
        for what, value, goal in throughput.rows(report):
            typer.echo(f"{what:<32} {value:>18}  {goal}")
        for note in report["notes"]:
            typer.echo(note)
    raise typer.Exit(0 if report["met"] else 1)


@benchmarks.command("latency")
def bench_latency(
    rounds: Annotated[int, typer.Option(min=1, help="Turns that each one takes at each rate.")] = 4,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Measure state sent to setpoint received, over UDP, at 50 and 200 Hz: the service, mavsdk and an echo.

    The service runs with telemetry and log on; mavsdk (the extra `bench`) does the same job in Python; the
    echo is the floor. Takes a minute and a half.

    Exit status 0 only if every goal is met on this machine, 1 if not.

    Example:

    \b
    sitl bench latency --rounds 2 --json
    """
    from sitl import bench_latency as latency

    with Steps("sitl bench latency", "turns", latency.steps(rounds), steady=True) as steps:
        report = latency.measure(rounds, steps.advance)
    _print_bench(report, latency.rows(report), report["notes"], as_json=as_json)
    raise typer.Exit(0 if report["met"] else 1)


@benchmarks.command("loop")
def bench_loop(
    rounds: Annotated[int, typer.Option(min=1, help="Turns, idle and under load.")] = 4,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Measure how late the service's loop is, idle and with its sinks under load.

    Load: every record ten times to log and zenoh, a `guidance watch`, and a sink that computes in Python
    without end. Takes about a minute.

    Exit status 0 only if both goals are met on this machine, 1 if not.

    Example:

    \b
    sitl bench loop --rounds 2 --json
    """
    from sitl import bench_loop as loop

    with Steps("sitl bench loop", "turns", 2 * rounds, steady=True) as steps:
        report = loop.measure(rounds, steps.advance)
    _print_bench(report, loop.rows(report), report["notes"], as_json=as_json)
    raise typer.Exit(0 if report["met"] else 1)


@benchmarks.command("link")
def bench_link(
    flights: Annotated[int, typer.Option(min=1, help="Flights of each kind, with seeds of their own.")] = 10,
    seconds: Annotated[float, typer.Option(min=20.0, help="How long each one tracks.")] = 60.0,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Measure tracking over links that lose and delay, and which loss and gap end a flight: on virtual time.

    Takes a minute or two; the figures depend on no machine.

    Exit status 0 only if every goal is met, 1 if not.

    Example:

    \b
    sitl bench link --flights 3 --seconds 30 --json
    """
    from sitl import bench_link as link

    with Steps("sitl bench link", "rows", link.ROWS, steady=True) as steps:
        report = link.measure(flights, seconds, steps.advance)
    _print_bench(report, link.rows(report), (), as_json=as_json)
    raise typer.Exit(0 if report["met"] else 1)


@benchmarks.command("dashboard")
def bench_dashboard(
    seconds: Annotated[float, typer.Option(min=5.0, help="How long to measure.")] = 30.0,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Measure the dashboard's server: CPU, memory, and what a page gets, for ten vehicles at 50 Hz.

    Takes 10 s longer.

    Exit status 0 only if every goal is met on this machine, 1 if not, 2 without the extra.

    Example:

    \b
    sitl bench dashboard --seconds 10 --json
    """
    from sitl import bench_dashboard as dashboard

    try:
        with waiting("sitl bench dashboard", f"measuring for {seconds + 10.0:g} s"):
            report = dashboard.measure(seconds)
    except (ModuleNotFoundError, dashboard.UnavailableError) as error:
        raise refused(
            "sitl bench dashboard", f"{error} (it needs the extra se3-guidance[dashboard])"
        ) from None
    _print_bench(report, dashboard.rows(report), (), as_json=as_json)
    raise typer.Exit(0 if report["met"] else 1)


@benchmarks.command("report")
def bench_report(
    seconds: Annotated[float, typer.Option(min=20.0, help="How long a flight the log is of.")] = 3600.0,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Measure `guidance report` and `guidance replay` on an hour's log: time, memory and the page's size.

    Takes some five minutes, most of it to fly the hour.

    Exit status 0 only if every goal is met on this machine, 1 if not.

    Example:

    \b
    sitl bench report --seconds 60 --json
    """
    from sitl import bench_report as reports

    with Steps("sitl bench report", "parts", reports.PARTS, steady=True) as steps:
        report = reports.measure(seconds, steps.advance)
    _print_bench(report, reports.rows(report), (), as_json=as_json)
    raise typer.Exit(0 if report["met"] else 1)


def _print_bench(
    report: Mapping[str, object], rows: Sequence[tuple[str, str]], notes: Sequence[str], *, as_json: bool
) -> None:
    if as_json:
        typer.echo(json.dumps(report))
        return
    for what, figures in rows:
        typer.echo(f"{what:<22}{figures}")
    for note in notes:
        typer.echo(note)
