"""The command `guidance`; `guidance.entry` has the exit statuses."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from guidance import __version__
from guidance.command_cli import command
from guidance.completion import Overrides
from guidance.dashboard_cli import dashboard
from guidance.demo_cli import demo
from guidance.entry import complain, enter, refused
from guidance.network_options import Connect, Listen, ZenohFile
from guidance.progress import waiting
from guidance.replay_cli import replay
from guidance.report_cli import report
from guidance.tune_cli import tune

_ROOT_HELP = """Guidance of forward-driven vehicles on SE(3) over MAVLink.

Examples:

\b
guidance demo                                       fly the built-in vehicle
guidance demo --dashboard                           on a page, with buttons
guidance check --config vehicle.toml                is all well? moves nothing
guidance run --config vehicle.toml                  the service, for a real one
guidance watch --connect tcp/192.168.1.2:7447       every vehicle, live
guidance dashboard --open                           the same in a browser
guidance command uuv-1 engage                       an order, answered
guidance tune --config vehicle.toml                 steps, and gains from them
guidance report logs/FLIGHT.mcap                    what was flown, as HTML
guidance replay logs/FLIGHT.mcap                    its law again, to the bit
"""

app = typer.Typer(
    help=_ROOT_HELP,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _refuse(text: object) -> typer.Exit:
    return refused("guidance", text)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"guidance {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@app.command()
def run(
    config: Annotated[Path, typer.Option("--config", "-c", metavar="FILE", help="The TOML configuration.")],
    overrides: Overrides = None,
) -> None:
    """Run the service until SIGTERM, Ctrl-C or its terminal is closed; SIGUSR1 commands it to engage.

    Exit status 0 after a shutdown, 1 after an internal error, 2 for a wrong configuration.

    Examples:

    \b
    guidance run --config vehicle.toml
    guidance run -c vehicle.toml --set link.connection=udpout://10.0.0.2:14580
    """
    from guidance.config import ConfigError, load
    from guidance.service import serve

    try:
        status = serve(load(config, overrides or ()))
    except ConfigError as error:
        raise _refuse(error) from None
    raise typer.Exit(status)


app.command()(demo)


@app.command()
def watch(
    connect: Connect = None,
    listen: Listen = None,
    config: ZenohFile = None,
    multicast: Annotated[
        bool | None,
        typer.Option(
            "--multicast/--no-multicast", help="Whether to look around on the network.", show_default=False
        ),
    ] = None,
    vehicle: Annotated[str | None, typer.Option(metavar="NAME", help="Only this one.")] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object per vehicle and second on stdout.")
    ] = False,
    seconds: Annotated[
        float | None, typer.Option(min=0.0, help="End after so long, s; else with Ctrl-C (status 130).")
    ] = None,
) -> None:
    """Show every vehicle on the network, live, by what its service publishes over zenoh.

    A service publishes where [zenoh] of its configuration says: connect to its `listen`, or to the router
    that it connects to. Without a place this looks at tcp/127.0.0.1:7447 and around by multicast, which
    finds services that have multicast_scouting = true and listen somewhere.

    Exit status 0 after --seconds or when nobody reads any more, 2 for a wrong option, 130 after Ctrl-C.

    Examples:

    \b
    guidance watch
    guidance watch --connect tcp/192.168.1.2:7447 --connect tcp/192.168.1.3:7447
    guidance watch --listen tcp/0.0.0.0:7447 --vehicle uuv-1
    guidance watch --json --seconds 10
    """
    from guidance.watch import watch as watch_fleet

    try:
        status = watch_fleet(
            connect=connect or (),
            listen=listen or (),
            config_file=config,
            multicast=multicast,
            vehicle=vehicle,
            as_json=as_json,
            seconds=seconds,
        )
    except ValueError as error:
        raise _refuse(error) from None
    raise typer.Exit(status)


@app.command("foxglove")
def foxglove_command(
    connect: Connect = None,
    listen: Listen = None,
    host: Annotated[
        str, typer.Option(help="Address for viewers; 0.0.0.0 is for all of the network.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port for viewers.")] = 8765,
    vehicle: Annotated[
        str,
        typer.Option(metavar="NAME", help="Only this one, with the topics of a log: for the shipped layout."),
    ] = "",
) -> None:
    """Show vehicles live in Foxglove or Lichtblick, by what their services publish over zenoh.

    Topics and frames are /NAME/..., or without /NAME if --vehicle says which. Without a place this looks
    where `guidance watch` does. It needs the extra "foxglove".

    Exit status 130 after Ctrl-C, 1 if the port is taken, 2 for a wrong option.

    Examples:

    \b
    guidance foxglove --connect tcp/10.0.0.2:7447 --vehicle uuv-1
    guidance foxglove --listen tcp/0.0.0.0:7447
    """
    try:
        from guidance.bridge import BridgeError, bridge
    except ModuleNotFoundError as error:
        if error.name != "foxglove":
            raise
        raise _refuse("the Foxglove SDK is missing: pip install 'se3-guidance[foxglove]'") from None
    try:
        status = bridge(connect=connect or (), listen=listen or (), host=host, port=port, vehicle=vehicle)
    except ValueError as error:
        raise _refuse(error) from None
    except BridgeError as error:
        complain("guidance foxglove", error)
        raise typer.Exit(1) from None
    raise typer.Exit(status)


@app.command()
def check(
    config: Annotated[Path, typer.Option("--config", "-c", metavar="FILE", help="The TOML configuration.")],
    overrides: Overrides = None,
    seconds: Annotated[
        float, typer.Option(min=1.0, max=600.0, help="At most so long; less if all is well, s.")
    ] = 10.0,
    as_json: Annotated[bool, typer.Option("--json", help="One line of JSON on stdout instead.")] = False,
) -> None:
    """Look at everything that a flight rests on, and say what to do where something is wrong.

    It looks at the port, the autopilot and its parameters, message rates, clock, estimator, zenoh and the
    disk. It sends no setpoint, no mode and no arming command; it asks the autopilot for message rates (as
    the service does, COMMAND_LONG 511 and 512), parameters and the time. Stop the service first.

    Exit status 0 if nothing fails, 1 if something does, 2 for a wrong configuration.

    Examples:

    \b
    guidance check --config vehicle.toml
    guidance check -c vehicle.toml --seconds 30 --json
    """
    from guidance.config import ConfigError, load
    from guidance.preflight.run import check as look
    from guidance.preflight.view import as_json as json_of
    from guidance.preflight.view import passed, show

    try:
        loaded = load(config, overrides or ())
        with waiting("guidance check", f"looking for at most {seconds:g} s"):
            found = look(loaded, str(config), seconds)
    except ConfigError as error:
        raise _refuse(error) from None
    if as_json:
        typer.echo(json.dumps(json_of(found.findings, loaded.vehicle.name, found.seconds)))
    else:
        show(found.findings, found.seconds, Console(highlight=False))
    status = 0 if passed(found.findings) else 1
    if not found.clean:
        sys.stdout.flush()
        os._exit(status)  # a thread in zenoh would hold up the interpreter's own end, or abort it
    raise typer.Exit(status)


app.command("command")(command)
app.command("dashboard")(dashboard)
app.command("tune")(tune)
app.command("report")(report)
app.command("replay")(replay)


def main() -> None:
    """Entry point."""
    enter(app, "guidance")
