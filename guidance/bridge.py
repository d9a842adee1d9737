"""`guidance foxglove`: vehicles on the network, live in Foxglove and Lichtblick."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import Final

from guidance.journal import tell
from guidance.noted_signals import noted_signals
from guidance.records import Level, Session
from guidance.telemetry.arrivals import VEHICLE, Heard, Ignored, Presence
from guidance.telemetry.foxglove_bridge import Bridge
from guidance.telemetry.foxglove_bridge import BridgeError as BridgeError  # raised here, so found here
from guidance.telemetry.subscriber import Subscriber
from guidance.telemetry.zenoh_sink import zenoh_config
from guidance.watch import DEFAULT_CONNECT

TURN_S: Final = 0.02
#: Zenoh waits 10 s for a frozen neighbour; whoever pressed Ctrl-C does not.
_CLOSE_S: Final = 1.0
_KINDS: Final = 20  # of what is passed over; a stranger can think of more


def bridge(*, connect: Sequence[str], listen: Sequence[str], host: str, port: int, vehicle: str) -> int:
    """Bridge until a signal comes; the exit status, 128 + N after signal N.

    Without any place it looks where `watch` does. `vehicle` is the only one shown; all are if it is empty.

    Raises:
        ValueError: what is wrong with a setting, in words.
        BridgeError: it cannot listen on `host` and `port`.
    """
    if vehicle and VEHICLE.fullmatch(vehicle) is None:
        raise ValueError(f"--vehicle {vehicle!r}: a name has 1 to 64 letters, digits and _.-")
    nowhere = not connect and not listen
    connect = DEFAULT_CONNECT if nowhere else connect
    config = zenoh_config(connect=connect, listen=listen, multicast_scouting=nowhere)
    with noted_signals() as noted, closing(Bridge(host, port, vehicle)) as server:
        where = f"ws://{host}:{server.port}"
        _say(Level.INFO, f"Foxglove WebSocket at {where}: open a connection to it in the viewer")
        subscriber = Subscriber(config, vehicle or "*")
        subscriber.start()

        def stopping(seconds: float) -> bool:
            time.sleep(seconds)
            return bool(noted)

        serve(subscriber, server, _say, stopping)
    status = 128 + noted[0]
    if not subscriber.close(_CLOSE_S):
        sys.stderr.flush()
        os._exit(status)  # a thread in zenoh would hold up the interpreter's own end, or abort it
    return status


def serve(
    subscriber: Subscriber,
    server: Bridge,
    say: Callable[[Level, str], None],
    stopping: Callable[[float], bool],
) -> None:
    """What arrives is shown, until `stopping(TURN_S)`, which waits between turns, is true."""
    said: set[str] = set()
    opening = trouble = subscriber.trouble
    while not stopping(TURN_S):
        for arrival in subscriber.take():
            if isinstance(arrival, Heard):
                # An answer to a query may be older than what came by itself; a session is never old.
                if not arrival.answered or isinstance(arrival.record, Session):
                    server.take(arrival.vehicle, arrival.record)
            elif isinstance(arrival, Presence):
                say(Level.NOTICE, f"{arrival.vehicle} is {'here' if arrival.here else 'gone'}")
            elif isinstance(arrival, Ignored) and arrival.what not in said and len(said) < _KINDS:
                said.add(arrival.what)
                what = f"{arrival.what} ({arrival.detail!r})"
                say(Level.WARNING, f"passed over under the key of {arrival.vehicle!r}: {what}")
        server.welcome()
        if (now := subscriber.trouble) != trouble:
            if now or trouble != opening:
                level = Level.WARNING if now else Level.NOTICE
                say(level, f"zenoh: {now or 'a session is open again'}")
            trouble = now


def _say(level: Level, text: str) -> None:
    tell(level, "guidance foxglove", text)
