"""The demo on a page: vehicle, service and dashboard as three processes, commanded from a browser.

The flight is that of `demo`, with orders allowed, and goes on. It is not judged: whoever holds, aborts and
engages anew is not told that it did not track.
"""

from __future__ import annotations

import os
import re
import socket
import sys
import time
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from math import inf
from pathlib import Path
from typing import Final

from rich.console import Console

from guidance.browser import open_page
from guidance.child import Child
from guidance.config import ConfigError
from guidance.demo import DemoError, log_of, plan_flight, service_command, vehicle_command
from guidance.demo_view import coloured
from guidance.noted_signals import noted_signals

#: Where it is served unless somebody has the port.
PORT: Final = 8080
_UP_S: Final = 20.0
_LOOK_S: Final = 0.1
#: Where the dashboard says that it is.
_URL: Final = re.compile(r"http://\S+")


def attend(
    seconds: float | None,
    overrides: Sequence[str],
    *,
    open_browser: bool,
    environment: Mapping[str, str] = os.environ,
) -> int:
    """Fly until `seconds` after the page was up, or until SIGINT, SIGTERM, SIGHUP; 0, or 128 + the signal.

    Raises:
        ConfigError: the overrides do not make a configuration, or the dashboard is not installed.
        DemoError: one of the processes ended.
    """
    if find_spec("websockets") is None:
        raise ConfigError("--dashboard: not installed; pip install 'se3-guidance[dashboard]'")
    plan = plan_flight(["zenoh.commands=true", *overrides])
    console = Console(stderr=True, highlight=False)
    directory = Path(plan.config.log.directory)
    before = set(directory.glob("*.mcap"))

    urls: list[str] = []

    def line(source: str, text: str) -> None:
        if source == "dashboard" and (url := _URL.search(text)) and not urls:
            urls.append(url[0])
        else:
            console.print(coloured(source, text), soft_wrap=True)

    def say(text: str) -> None:
        console.print(text, soft_wrap=True, markup=False)

    name = plan.config.trajectory.__struct_config__.tag
    say(f"Flying the built-in {plan.config.vehicle.profile} along the {name}. Ctrl-C ends it.")
    with (
        noted_signals() as noted,
        Child(vehicle_command(plan.config), "vehicle", line) as vehicle,
        Child(service_command(plan.settings), "service", line) as service,
        Child(dashboard_command(plan.watch_at), "dashboard", line) as page,
    ):
        children = (vehicle, service, page)
        for child in children:
            child.listen(_nothing)
        until_s = time.monotonic() + _UP_S
        while not noted and not urls:
            _see_to(children)
            if time.monotonic() > until_s:
                raise DemoError(f"the dashboard does not come up within {_UP_S:g} s")
        if urls:
            say(f"Dashboard: {urls[0]}")
            if open_browser:
                open_page(urls[0], environment, say)
        until_s = time.monotonic() + (inf if seconds is None else seconds)
        while not noted and time.monotonic() < until_s:
            _see_to(children)
        page.stop()
        service.stop()
    log = log_of(plan.config, set(directory.glob("*.mcap")) - before)
    if log is not None:
        say(f"log: {log}")
    return 128 + noted[0] if noted else 0


def dashboard_command(connect: str) -> list[str]:
    """The dashboard of what publishes there, on `PORT` or, if somebody has that, on another."""
    with socket.socket() as probe:
        port = 0 if probe.connect_ex(("127.0.0.1", PORT)) == 0 else PORT
    command = [sys.executable, "-m", "guidance", "dashboard", "--commands"]
    return [*command, "--connect", connect, "--port", str(port)]


def _see_to(children: Sequence[Child]) -> None:
    """Let a moment pass; raises DemoError if one of them ended in it."""
    for child in children:
        if child.ended:
            raise DemoError(child.obituary())
    time.sleep(_LOOK_S)


def _nothing(_: str) -> None:
    """What it writes to stdout is for nobody; the pipe must not fill."""
