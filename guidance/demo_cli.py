"""The command line of `guidance demo`."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from guidance.completion import Overrides
from guidance.completion import trajectory as trajectories
from guidance.entry import complain, refused


def demo(
    seconds: Annotated[
        float | None,
        typer.Option(
            min=1.0,
            max=86400.0,
            show_default="30, with --dashboard until Ctrl-C",
            help="How long to track the trajectory, s.",
        ),
    ] = None,
    trajectory: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="helix, circle, line, zigzag or lemniscate.", autocompletion=trajectories
        ),
    ] = None,
    overrides: Overrides = None,
    as_json: Annotated[bool, typer.Option("--json", help="End with one line of JSON on stdout.")] = False,
    dashboard: Annotated[
        bool, typer.Option("--dashboard", help="Show it on a page and take orders there; it is not judged.")
    ] = False,
    open_browser: Annotated[
        bool, typer.Option("--open", help="The same, and open it if there is a display.")
    ] = False,
) -> None:
    """Fly the built-in vehicle along the paper's helix and say how well it tracked.

    Exit status 0 only if it did: below 0.1 m for good. 1 if not, 2 for a wrong setting, 130 after Ctrl-C.
    With --dashboard 0 after --seconds, 1 if a process of the demo failed.

    Examples:

    \b
    guidance demo --seconds 60
    guidance demo --dashboard --open
    guidance demo --set trajectory.radius_m=20 --set trajectory.speed_m_s=4
    guidance demo --set vehicle.profile=ardupilot-rover --set flight.origin=engage
    guidance demo --seconds 13 --json | tail -1
    """
    from guidance import demo as flight
    from guidance.config import ConfigError
    from guidance.demo_page import attend
    from guidance.demo_view import failure_json, show

    settings = [*([] if trajectory is None else [f"trajectory.name={trajectory}"]), *(overrides or ())]
    if as_json and (dashboard or open_browser):
        raise refused("guidance", "--json, --dashboard: what is flown from a page is not judged; give either")
    try:
        if dashboard or open_browser:
            raise typer.Exit(attend(seconds, settings, open_browser=open_browser))
        result = flight.fly(30.0 if seconds is None else seconds, settings)
    except ConfigError as error:
        raise refused("guidance", error) from None
    except flight.DemoError as error:
        complain("guidance demo", error)
        if as_json:
            typer.echo(json.dumps(failure_json(str(error))))
        raise typer.Exit(1) from None
    show(result)
    if as_json:
        typer.echo(json.dumps(result.as_json()))
    raise typer.Exit(result.exit_status)
