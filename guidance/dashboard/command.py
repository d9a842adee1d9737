"""`guidance dashboard`: subscriber and server, from start to Ctrl-C."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path
from typing import Final

from guidance.browser import open_page
from guidance.dashboard.server import Dashboard
from guidance.dashboard.server import DashboardError as DashboardError  # raised here, so found here
from guidance.journal import tell
from guidance.noted_signals import noted_signals
from guidance.records import Level
from guidance.telemetry.subscriber import Subscriber
from guidance.telemetry.zenoh_sink import zenoh_config
from guidance.watch import DEFAULT_CONNECT

_PROGRAM: Final = "guidance dashboard"
#: Zenoh waits 10 s for a frozen neighbour; whoever pressed Ctrl-C does not.
_CLOSE_S: Final = 1.0


def dashboard(
    *,
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    config_file: Path | None = None,
    multicast: bool | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    names: Sequence[str] = (),
    commands: bool = False,
    open_browser: bool = False,
) -> int:
    """Serve until a signal comes; the exit status, 128 + N after signal N.

    Without any place it looks where `watch` does.

    Raises:
        ValueError: what is wrong with a setting, in words.
        DashboardError: it cannot listen on `host` and `port`.
    """
    nowhere = not connect and not listen and config_file is None
    scouting = nowhere if multicast is None else multicast
    config = zenoh_config(
        connect=DEFAULT_CONNECT if nowhere else connect,
        listen=listen,
        multicast_scouting=scouting,
        config_file=config_file,
    )
    subscriber = Subscriber(config)

    def up(bound: int) -> None:
        url = url_of(host, bound)
        tell(Level.INFO, _PROGRAM, f"{url} (Ctrl-C ends it)")
        if commands and not _is_loopback(host):
            words = "orders are on: whoever reaches this address may command every vehicle that obeys zenoh"
            tell(Level.WARNING, _PROGRAM, words)
        if open_browser:
            open_page(url, os.environ, lambda words: tell(Level.WARNING, _PROGRAM, words))

    with noted_signals() as noted:
        subscriber.start()
        try:
            served = Dashboard(subscriber, commands=commands, names=names)
            asyncio.run(served.run(host, port, up, lambda: bool(noted)))
        finally:
            closed = subscriber.close(_CLOSE_S)
    status = 128 + noted[0] if noted else 0
    if not closed:
        sys.stderr.flush()
        os._exit(status)  # a thread in zenoh would hold up the interpreter's own end, or abort it
    return status


def url_of(host: str, port: int) -> str:
    """Where a browser on this machine finds what listens on `host`."""
    with suppress(ValueError):
        if (address := ip_address(host or "0.0.0.0")).is_unspecified:  # noqa: S104 - compared, not bound
            host = "127.0.0.1" if address.version == 4 else "::1"  # `::` listens on no IPv4
    return f"http://{f'[{host}]' if ':' in host else host}:{port}/"


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
