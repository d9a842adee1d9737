"""The command line of `guidance dashboard`."""

from __future__ import annotations

from typing import Annotated

import typer

from guidance.entry import FAILED, complain, refused
from guidance.network_options import Connect, Listen, ZenohFile

#: The one package of the extra `dashboard`.
_PACKAGE = "websockets"


def dashboard(
    connect: Connect = None,
    listen: Listen = None,
    config: ZenohFile = None,
    multicast: Annotated[
        bool | None, typer.Option("--multicast/--no-multicast", help="Look around on the network.")
    ] = None,
    host: Annotated[
        str, typer.Option(help="Address for browsers; 0.0.0.0 is for all of the network.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port for browsers; 0 is any.")] = 8080,
    name: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="A host name by which browsers reach this machine (repeatable)."),
    ] = None,
    commands: Annotated[
        bool, typer.Option("--commands", help="Show buttons: whoever reaches the page may order.")
    ] = False,
    open_browser: Annotated[bool, typer.Option("--open", help="Open it in a browser.")] = False,
) -> None:
    """Show every vehicle on the network in a browser: fleet, paths in 3-D, charts, events.

    Without a place this looks where `guidance watch` does. Buttons appear with --commands, for vehicles
    that have zenoh.commands = true. It needs the extra "dashboard" and no internet.

    Exit status 130 after Ctrl-C, 143 after SIGTERM, 1 if it cannot listen, 2 for a wrong setting or without
    the extra.

    Examples:

    \b
    guidance dashboard --open
    guidance dashboard --connect tcp/192.168.1.2:7447 --commands
    guidance dashboard --host 0.0.0.0 --port 8000       for a phone
    """
    try:
        from guidance.dashboard.command import DashboardError
        from guidance.dashboard.command import dashboard as serve
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != _PACKAGE:
            raise
        raise refused(
            "guidance dashboard", "it is not installed: pip install 'se3-guidance[dashboard]'"
        ) from None
    try:
        status = serve(
            connect=connect or (),
            listen=listen or (),
            config_file=config,
            multicast=multicast,
            host=host,
            port=port,
            names=name or (),
            commands=commands,
            open_browser=open_browser,
        )
    except ValueError as error:
        raise refused("guidance dashboard", error) from None
    except DashboardError as error:
        complain("guidance dashboard", error)
        raise typer.Exit(FAILED) from None
    raise typer.Exit(status)
