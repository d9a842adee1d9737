"""`sitl campaign`: options to plans, and plans to a file, a table and a plot."""

from __future__ import annotations

import json
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

if TYPE_CHECKING:  # numpy and numba are slow to import, and of an extra: only a campaign waits for them
    from sitl.campaign.plan import Plan

_PAIR: Final = "X|LOW:HIGH"
_PLOTS: Final = (".png", ".svg", ".pdf")
#: What says how and where, and not what is flown; these and `_OF_PRESET` may be given with a preset.
_HOW: Final = frozenset({"preset", "threads", "output", "plot", "as_json"})
_OF_PRESET: Final = frozenset({"flights", "seed", "within_m"})


def campaign(
    context: typer.Context,
    preset: Annotated[
        str | None, typer.Option(help="A named set of campaigns instead of the options: table.")
    ] = None,
    flights: Annotated[
        int | None, typer.Option(help="How many; default 10,000, of the table's first row 1,000,000.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="The same seed gives the same numbers; default 0.")] = None,
    law: Annotated[str | None, typer.Option(help="paper (default) or global.")] = None,
    allocation: Annotated[
        str | None, typer.Option(help="pitch-yaw (default), roll-pitch or roll-yaw.")
    ] = None,
    error_function: Annotated[
        str | None,
        typer.Option(metavar="NAME,KEY=VALUE..", help="quadratic, or such as bounded,approach_m_s=2."),
    ] = None,
    trajectory: Annotated[
        str | None,
        typer.Option(metavar="NAME,KEY=VALUE..", help="helix, or such as circle,radius_m=10,speed_m_s=2."),
    ] = None,
    planar: Annotated[
        bool | None, typer.Option("--planar", help="SE(2): errors and motion in the plane.")
    ] = None,
    keep_direction: Annotated[
        bool | None, typer.Option(help="Limits shorten the turn and do not bend it (default).")
    ] = None,
    acceleration_m_s2: Annotated[
        float | None,
        typer.Option("--acceleration", help="Limit on the change of speed, m/s^2; default none."),
    ] = None,
    turn_acceleration_rad_s2: Annotated[
        float | None,
        typer.Option("--turn-acceleration", help="The same of each rate, rad/s^2; default none."),
    ] = None,
    duration_s: Annotated[
        float | None, typer.Option("--duration", help="Of a flight, s; default 30.")
    ] = None,
    step_s: Annotated[float | None, typer.Option("--step", help="Of law and plant, s; default 0.02.")] = None,
    within_m: Annotated[
        float | None, typer.Option("--within", help="Converged is below this for good, m; default 0.01.")
    ] = None,
    due_s: Annotated[
        float | None, typer.Option("--due", help="Converged by then is in time, s; default 20.")
    ] = None,
    gust_period_s: Annotated[
        float | None, typer.Option("--gust-period", help="Of the gusts, s; default 5.")
    ] = None,
    distance_m: Annotated[
        str | None,
        typer.Option("--distance", metavar=_PAIR, help="From the reference at the start, m; default 0:50."),
    ] = None,
    start_s: Annotated[
        str | None, typer.Option("--start", metavar=_PAIR, help="Where on the trajectory, s; default 0.")
    ] = None,
    k: Annotated[str | None, typer.Option("--k", metavar=_PAIR, help="Gain k; default 1.")] = None,
    rho2_per_s: Annotated[
        str | None, typer.Option("--rho2", metavar=_PAIR, help="Gain rho2, 1/s; default 10.")
    ] = None,
    rho3_per_s: Annotated[
        str | None, typer.Option("--rho3", metavar=_PAIR, help="Gain rho3, 1/s; default 10.")
    ] = None,
    beta: Annotated[
        str | None, typer.Option("--beta", metavar=_PAIR, help="beta of the metric; default 1.")
    ] = None,
    speed_min_m_s: Annotated[
        str | None,
        typer.Option("--speed-min", metavar=_PAIR, help="m/s; 0 is forward only, default -5."),
    ] = None,
    speed_max_m_s: Annotated[
        str | None, typer.Option("--speed-max", metavar=_PAIR, help="m/s; default 5.")
    ] = None,
    rate_max_rad_s: Annotated[
        str | None, typer.Option("--rate-max", metavar=_PAIR, help="Of each body rate, rad/s; default 5.")
    ] = None,
    wind_m_s: Annotated[
        str | None,
        typer.Option(
            "--wind", metavar=_PAIR, help="Constant wind or current, from anywhere, m/s; default 0."
        ),
    ] = None,
    gust_m_s: Annotated[
        str | None,
        typer.Option("--gust", metavar=_PAIR, help="Amplitude of a gust (a sine), m/s; default 0."),
    ] = None,
    delay_s: Annotated[
        str | None,
        typer.Option(
            "--delay", metavar=_PAIR, help="From command to actuator, s, up to whole steps; default 0."
        ),
    ] = None,
    rate_lag_s: Annotated[
        str | None,
        typer.Option("--rate-lag", metavar=_PAIR, help="First-order lag of the rates, s; default 0."),
    ] = None,
    speed_lag_s: Annotated[
        str | None,
        typer.Option("--speed-lag", metavar=_PAIR, help="First-order lag of the speed, s; default 0."),
    ] = None,
    start_speed_m_s: Annotated[
        str | None,
        typer.Option("--start-speed", metavar=_PAIR, help="Forward speed at the start, m/s; default 0."),
    ] = None,
    start_rate_rad_s: Annotated[
        str | None,
        typer.Option(
            "--start-rate",
            metavar=_PAIR,
            help="Magnitude of the body rates at the start, about any axis, rad/s; default 0.",
        ),
    ] = None,
    threads: Annotated[int | None, typer.Option(min=1, help="Default: one per core.")] = None,
    output: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Results (.npz); default campaign.npz, with --json nowhere."),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Region of attraction; default campaign.png, with --json nowhere."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Fly up to millions of flights, law and plant compiled, and say how many converge.

    Start, gains, limits, wind and delay are drawn for each flight from the ranges given. The defaults are
    section 4's gains and limits on its helix, with reverse, from rest in any attitude within 50 m.
    """
    given = {name: value for name, value in context.params.items() if value is not None and name not in _HOW}
    try:
        output = _file(output, "campaign.npz", (".npz",), as_json)
        plot = _file(plot, "campaign.png", _PLOTS, as_json)
        plans = [_plan(given)] if preset is None else _preset(preset, given)
        _fly(plans, threads, output, plot, as_json)
    except ModuleNotFoundError as error:
        sys.stderr.write(f"sitl campaign: needs {error.name}, of the extra se3-guidance[sitl]\n")
        raise typer.Exit(2) from None
    except (ValueError, OSError) as error:
        sys.stderr.write(f"sitl campaign: {error}\n")
        raise typer.Exit(2) from None


def _file(given: Path | None, default: str, endings: tuple[str, ...], as_json: bool) -> Path | None:
    """Where it goes, refused now rather than after the flights."""
    path = given if given is not None or as_json else Path(default)
    if path is not None and not path.parent.is_dir():
        raise FileNotFoundError(f"{path}: there is no directory {path.parent}")
    if path is not None and path.suffix.lower() not in endings:
        raise ValueError(f"{path}: must end in {' or '.join(endings)}")
    return path


def _plan(given: dict[str, Any]) -> Plan:
    from sitl.campaign.plan import DRAWN, Plan, named_error_function, named_trajectory, pair

    for name in DRAWN:
        if name in given:
            given[name] = pair(name, given[name])
    if "trajectory" in given:
        given["trajectory"] = named_trajectory(given["trajectory"])
    if "error_function" in given:
        given["error_function"] = named_error_function(given["error_function"])
    return Plan(**given)


def _preset(name: str, given: dict[str, Any]) -> list[Plan]:
    from sitl.campaign.presets import PRESETS, TABLE_FLIGHTS

    if name not in PRESETS:
        raise ValueError(f"preset must be one of {', '.join(PRESETS)}, not {name!r}")
    for option in given.keys() - _OF_PRESET:
        raise ValueError(f"{option} is set by the preset {name} and cannot be given with it")
    plans = PRESETS[name](given.get("flights", TABLE_FLIGHTS), given.get("seed", 0))
    return [replace(plan, within_m=given.get("within_m", plan.within_m)) for plan in plans]


def _fly(
    plans: list[Plan], threads: int | None, output: Path | None, plot: Path | None, as_json: bool
) -> None:
    from sitl.campaign.report import show, summary
    from sitl.campaign.run import run, save

    if plot is not None:
        from sitl.campaign import plots  # missing libraries show before the flights
    results = []
    started_s = time.perf_counter()
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    )
    with bar:
        for plan in plans:
            task = bar.add_task(plan.name, total=plan.flights)
            results.append(run(plan, threads, on_progress=partial(bar.advance, task)))
    seconds = time.perf_counter() - started_s
    steps = sum(plan.flights * plan.steps for plan in plans)
    summaries = [summary(result) for result in results]
    if output is not None:
        save(results, output)
    if plot is not None:
        # Named starts are too few for a region.
        plots.write([result for result in results if not result.plan.starts], plot)
    if as_json:
        campaigns = [
            {"plan": plan.as_dict(), "summary": found} for plan, found in zip(plans, summaries, strict=True)
        ]
        typer.echo(json.dumps({"campaigns": campaigns, "steps": steps, "seconds": seconds}))
        return
    console = Console()
    # A pipe has no width: there the table is as wide as it needs to be.
    show(summaries, plans[0].within_m, console if console.is_terminal else Console(width=160))
    typer.echo(f"{steps:,} steps in {seconds:.1f} s")
    for path in (output, plot):
        if path is not None:
            typer.echo(path)
