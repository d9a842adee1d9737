"""The command line of `guidance tune`."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer

from guidance.completion import Overrides
from guidance.entry import output_file, refused


def tune(
    config: Annotated[
        Path | None,
        typer.Option("--config", "-c", metavar="FILE", help="The TOML configuration."),
    ] = None,
    overrides: Overrides = None,
    log: Annotated[
        Path | None, typer.Option(metavar="LOG.mcap", help="Fly nothing: identify again from this log.")
    ] = None,
    speed: Annotated[
        float | None,
        typer.Option(help="Speed of the steps, m/s; of an airplane its airspeed.", show_default=False),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask: you have read what it will do.")] = False,
    wait: Annotated[
        float,
        typer.Option(min=1.0, max=3600.0, help="How long to wait for it, and until it is engaged, s."),
    ] = 300.0,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write the proposal here, as TOML.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="End with one line of JSON on stdout.")] = False,
) -> None:
    """Measure how the vehicle answers steps, and propose gains and limits.

    It reads the autopilot's parameters, says what it will do and how much room that needs, and asks. Then it
    is a flight as any other: it is engaged as supervisor.engage says, your mode switch ends it, the fence and
    the other guards act, and it is logged. It ends by itself in supervisor.exit_mode. Rovers, boats and
    copters are engaged at rest, airplanes in level flight.

    Exit status 0 if every channel was identified, 1 if not, 2 for a wrong configuration, 130 after Ctrl-C.

    Examples:

    \b
    guidance tune --config vehicle.toml --speed 1.5 --output proposal.toml
    guidance tune --log logs/FLIGHT.mcap --json
    """
    from guidance.steps_command import fly_and_tell, tell_of_log

    if (log is None) == (config is None):
        raise refused("guidance", "say what to fly (--config FILE) or what was flown (--log LOG.mcap)")
    with nullcontext() if output is None else output_file("guidance tune", output) as fill:
        if log is not None:
            status = tell_of_log(log, fill, as_json=as_json)
        else:
            assert config is not None
            status = fly_and_tell(config, overrides or (), speed, wait, fill, yes=yes, as_json=as_json)
    raise typer.Exit(status)
