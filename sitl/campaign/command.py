"""`sitl campaign`: options to plans, and plans to a file, a table and a plot."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.console import Console

from guidance.completion import one_of
from guidance.entry import refused
from guidance.progress import Steps
from guidance.tuning import ALLOCATIONS

if TYPE_CHECKING:  # numpy and numba are slow to import, and of an extra: only a campaign waits for them
    from sitl.campaign.plan import Plan
    from sitl.campaign.run import AnyPlan, Result

_PAIR: Final = "X|LOW:HIGH"
_PLOTS: Final = (".png", ".svg", ".pdf")
#: What says how and where, and not what is flown; these and `_OF_PRESET` may be given with a preset.
_HOW: Final = frozenset({"preset", "plan", "threads", "output", "plot", "as_json"})
_OF_PRESET: Final = frozenset({"flights", "seed", "within_m"})


def campaign(
    context: typer.Context,
    preset: Annotated[
        str | None,
        typer.Option(
            help="A named set of campaigns instead of the options: table, rover, airplane.",
            autocompletion=one_of("table", "rover", "airplane"),
        ),
    ] = None,
    plan: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="A vehicle's campaign from a TOML file instead of the options."),
    ] = None,
    flights: Annotated[
        int | None,
        typer.Option(help="How many; default 10,000, of the table 1,000,000 or a tenth, of vehicles 400."),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="The same seed gives the same numbers; default 0.")] = None,
    law: Annotated[
        str | None, typer.Option(help="paper (default) or global.", autocompletion=one_of("paper", "global"))
    ] = None,
    allocation: Annotated[
        str | None,
        typer.Option(
            help="pitch-yaw (default), roll-pitch or roll-yaw.", autocompletion=one_of(*ALLOCATIONS)
        ),
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

    Exit status 0 when it was flown, however many converge; 1 for a file that fails, 2 for a wrong option.

    Examples:

    \b
    sitl campaign --flights 100000 --k 0.5:2 --wind 0:1
    sitl campaign --trajectory circle,radius_m=10,speed_m_s=2 --planar --json
    sitl campaign --preset rover --threads 4
    """
    given = {name: value for name, value in context.params.items() if value is not None and name not in _HOW}
    try:
        output = _file(output, "campaign.npz", (".npz",), as_json)
        plot = _file(plot, "campaign.png", _PLOTS, as_json)
        plans = _plans(preset, plan, given)
        _fly(plans, threads, output, plot, as_json)
    except ModuleNotFoundError as error:
        raise refused("sitl campaign", f"needs {error.name}, of the extra se3-guidance[sitl]") from None
    except ValueError as error:
        raise refused("sitl campaign", error) from None


def _file(given: Path | None, default: str, endings: tuple[str, ...], as_json: bool) -> Path | None:
    """Where it goes, if anywhere."""
    path = given if given is not None or as_json else Path(default)
    if path is not None and not path.parent.is_dir():
        raise ValueError(f"{path}: there is no directory {path.parent}")
    if path is not None and path.suffix.lower() not in endings:
        raise ValueError(f"{path}: must end in {' or '.join(endings)}")
    return path


def _plans(preset: str | None, path: Path | None, given: dict[str, Any]) -> Sequence[AnyPlan]:
    if preset is not None and path is not None:
        raise ValueError("preset and plan cannot be given together")
    if preset is not None:
        return _preset(preset, given)
    return [_plan(given)] if path is None else [_read(path, given)]


def _read(path: Path, given: dict[str, Any]) -> AnyPlan:
    from sitl.campaign.vehicle_plan import changed, read_plan

    _only_of_preset(f"the plan {path}", given)
    return changed(read_plan(path), given)


def _only_of_preset(by: str, given: dict[str, Any]) -> None:
    for option in given.keys() - _OF_PRESET:
        raise ValueError(f"{option} is set by {by} and cannot be given with it")


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


def _preset(name: str, given: dict[str, Any]) -> Sequence[AnyPlan]:
    from sitl.campaign.presets import PRESETS
    from sitl.campaign.vehicle_plan import VehiclePlan, changed

    if name not in PRESETS:
        raise ValueError(f"preset must be one of {', '.join(PRESETS)}, not {name!r}")
    _only_of_preset(f"the preset {name}", given)
    within = {key: value for key, value in given.items() if key == "within_m"}
    plans = PRESETS[name](**{key: value for key, value in given.items() if key != "within_m"})
    return [
        changed(plan, given) if isinstance(plan, VehiclePlan) else replace(plan, **within) for plan in plans
    ]


def _fly(
    plans: Sequence[AnyPlan], threads: int | None, output: Path | None, plot: Path | None, as_json: bool
) -> None:
    """Fly, say what came of it, and then write it: a file that fails takes nothing else with it.

    Raises:
        ValueError: more flights than memory holds, or a file that cannot be; before the flights.
        OSError: of a file or stdout that fails after them.
    """
    from guidance.replacing import replacing
    from sitl.campaign.report import show, summary
    from sitl.campaign.run import save
    from sitl.campaign.run import steps as steps_of

    if plot is not None:
        from sitl.campaign import plots  # missing libraries show before the flights
    _check_memory(plans)
    steps = sum(map(steps_of, plans))  # what cannot be flown is refused here
    with ExitStack() as files:
        fill_output = files.enter_context(replacing(output)) if output is not None else None
        fill_plot = files.enter_context(replacing(plot)) if plot is not None else None
        results, seconds = _flown(plans, threads)
        summaries = [summary(result) for result in results]
        try:
            if as_json:
                campaigns = [
                    {"plan": plan.as_dict(), "summary": found}
                    for plan, found in zip(plans, summaries, strict=True)
                ]
                typer.echo(json.dumps({"campaigns": campaigns, "steps": steps, "seconds": seconds}))
            else:
                console = Console()
                # A pipe has no width: there the table is as wide as it needs to be.
                show(summaries, plans[0].within_m, console if console.is_terminal else Console(width=160))
                flights = sum(plan.flights for plan in plans)
                typer.echo(f"{flights:,} flights, {steps:,} steps in {seconds:.1f} s")
        finally:  # a pipe that nobody reads any longer takes no files with it either
            if fill_output is not None:
                fill_output(partial(save, results))
            if fill_plot is not None:
                # Named starts are too few for a region.
                fill_plot(partial(plots.write, [result for result in results if not result.plan.starts]))
        for path in (output, plot):
            if path is not None and not as_json:
                typer.echo(path)


def _check_memory(plans: Sequence[AnyPlan]) -> None:
    from sitl.campaign.run import memory_bytes

    needed = sum(memory_bytes(plan) for plan in plans)
    there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if needed > there:
        raise ValueError(
            f"flights: {sum(plan.flights for plan in plans):,} need {needed / 1e9:,.1f} GB of memory, "
            f"and this machine has {there / 1e9:,.1f} GB"
        )


def _flown(plans: Sequence[AnyPlan], threads: int | None) -> tuple[list[Result], float]:
    """The results, and the seconds they took."""
    from sitl.campaign.run import run

    results = []
    started_s = time.perf_counter()
    for plan in plans:
        with Steps("sitl campaign", f"flights of {plan.name}", plan.flights) as steps:
            results.append(run(plan, threads, on_progress=steps.advance))
    return results, time.perf_counter() - started_s
