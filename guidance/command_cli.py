"""The command line of `guidance command`."""

from __future__ import annotations

import json
from typing import Annotated

import msgspec
import typer

from guidance.completion import order, words_of_order
from guidance.entry import complain, refused
from guidance.network_options import Connect, Listen, ZenohFile


def command(
    vehicle: Annotated[str, typer.Argument(metavar="VEHICLE", help="Its name, vehicle.name.")],
    verb: Annotated[
        str,
        typer.Argument(
            metavar="ORDER",
            help="engage, hold, resume, abort, load, set, allocate or shutdown.",
            autocompletion=order,
        ),
    ],
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[WORD]...",
            help="set KEY=VALUE; load FILE or KEY=VALUE...; allocate NAME",
            autocompletion=words_of_order,
        ),
    ] = None,
    connect: Connect = None,
    listen: Listen = None,
    config: ZenohFile = None,
    multicast: Annotated[bool, typer.Option("--multicast", help="Look around on the network.")] = False,
    seconds: Annotated[
        float, typer.Option(min=0.1, max=600.0, help="How long to look for the vehicle, s.")
    ] = 3.0,
    as_json: Annotated[bool, typer.Option("--json", help="The answer as one line of JSON.")] = False,
) -> None:
    """Give a vehicle an order over zenoh, and say whether it is obeyed.

    Its service must have zenoh.commands = true. Without a place this looks at tcp/127.0.0.1:7447.

    Exit status 0 accepted, 1 refused or not answered (`accepted` is null in the JSON), 2 a wrong order.

    Examples:

    \b
    guidance command uuv-1 engage
    guidance command uuv-1 set law.k=0.5 --connect tcp/192.168.1.2:7447
    guidance command uuv-1 load name=circle radius_m=5 speed_m_s=1 --json
    """
    from guidance.ordering import NoAnswerError, ask, fields_of

    try:
        reply = ask(
            vehicle,
            verb,
            fields_of(verb, words or ()),
            connect=connect or (),
            listen=listen or (),
            config_file=config,
            multicast=multicast,
            seconds=seconds,
        )
    except ValueError as error:
        raise refused("guidance", error) from None
    except NoAnswerError as error:
        complain("guidance command", error)
        if as_json:
            typer.echo(json.dumps({"accepted": None, "reason": str(error), "id": "", "repeated": False}))
        raise typer.Exit(1) from None
    if as_json:
        typer.echo(msgspec.json.encode(reply).decode())
    else:
        said = "accepted" if reply.accepted else "refused"
        typer.echo(f"{verb} {said}{': ' if reply.reason else ''}{reply.reason}")
    raise typer.Exit(0 if reply.accepted else 1)
