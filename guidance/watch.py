"""`guidance watch`: every vehicle on the network, live in a terminal, as lines, or as JSON for scripts."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Protocol

import msgspec
from rich.console import Console
from rich.live import Live

from guidance.fleet import Fleet, Note, Seen
from guidance.journal import tell
from guidance.noted_signals import noted_signals
from guidance.printable import printable
from guidance.records import Level
from guidance.telemetry.arrivals import VEHICLE
from guidance.telemetry.subscriber import Subscriber
from guidance.telemetry.zenoh_sink import zenoh_config
from guidance.watch_view import Connection, clock, ignored_line, line, screen

#: Where it looks if nothing is said: at zenoh's own port on this machine, and around by multicast.
DEFAULT_CONNECT: Final = ("tcp/127.0.0.1:7447",)

_LOOK_S: Final = 0.2
_JSON_EVERY: Final = 5  # looks
_LINES_EVERY: Final = 10
#: Zenoh waits 10 s for a frozen neighbour; whoever pressed Ctrl-C does not.
_CLOSE_S: Final = 1.0


class _View(Protocol):
    """What a look at the fleet is shown on; raises OSError if nobody reads any more."""

    def show(self, fleet: Fleet, seen: Sequence[Seen], connection: Connection) -> None: ...


class _Screen:
    """The live screen of a terminal."""

    def __init__(self, console: Console, live: Live) -> None:
        self._console = console
        self._live = live

    def show(self, fleet: Fleet, seen: Sequence[Seen], connection: Connection) -> None:
        if not self._console.is_terminal:  # rich would go on and write nothing
            raise OSError("the terminal was closed")
        width, height = self._console.size
        whole = screen(
            seen,
            fleet.notes,
            fleet.ignored,
            connection,
            width=width,
            height=height,
            unix_offset_ns=_unix_offset_ns(),
        )
        self._live.update(whole, refresh=True)


class _Lines:
    """Notes as they come, every vehicle every 2 s, and the connection when it changes."""

    def __init__(self) -> None:
        self._looks = 0
        self._number = 0
        self._said: list[str] = []

    def show(self, fleet: Fleet, seen: Sequence[Seen], connection: Connection) -> None:
        for note in _since(fleet, self._number):
            self._number = note.number
            _write(f"{clock(note, _unix_offset_ns())} {note.vehicle} {note.level}: {printable(note.text)}")
        if self._looks % _LINES_EVERY == 0:
            around = [connection.words(), *([] if seen else ["no vehicle yet"]), *_ignored(fleet)]
            for text in around:
                if text not in self._said:
                    _write(text)
            self._said = around
            for vehicle in seen:
                _write(line(vehicle))
        self._looks += 1


class _Json:
    """One object per vehicle and second on stdout; how the connection does is told on stderr."""

    def __init__(self) -> None:
        self._looks = 0
        self._number = 0
        self._said = ""

    def show(self, fleet: Fleet, seen: Sequence[Seen], connection: Connection) -> None:
        self._looks += 1
        if self._looks % _JSON_EVERY:
            return
        words = connection.words() if not seen or connection.trouble else ""
        if words and words != self._said:
            level = Level.WARNING if connection.trouble else Level.INFO
            tell(level, "guidance watch", f"{'' if seen else 'no vehicle yet; '}{words}")
        self._said = words
        notes = _since(fleet, self._number)
        self._number = notes[-1].number if notes else self._number
        now_s = time.time_ns() * 1e-9
        for vehicle in seen:
            _write(msgspec.json.encode(_as_json(now_s, vehicle, notes, fleet)).decode())


def watch(
    *,
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    config_file: Path | None = None,
    multicast: bool | None = None,
    vehicle: str | None = None,
    as_json: bool = False,
    seconds: float | None = None,
) -> int:
    """Watch until `seconds` have passed or a signal comes; the exit status, 0 or 128 + N after signal N.

    Without any place it looks at `DEFAULT_CONNECT` and, unless told otherwise, around by multicast.

    Raises:
        ValueError: what is wrong with a setting, in words.
    """
    if vehicle is not None and VEHICLE.fullmatch(vehicle) is None:
        raise ValueError(f"--vehicle {vehicle!r}: a name has 1 to 64 letters, digits and _.-")
    nowhere = not connect and not listen and config_file is None
    if nowhere and multicast is None:
        multicast = True
    connect = DEFAULT_CONNECT if nowhere else connect
    config = zenoh_config(
        connect=connect, listen=listen, multicast_scouting=bool(multicast), config_file=config_file
    )
    subscriber = Subscriber(config, vehicle or "*")
    place = Connection(
        trouble="",
        neighbours=0,
        connect=connect,
        listen=listen,
        scouting=bool(multicast),
        file="" if config_file is None else str(config_file),
        vehicle=vehicle or "*",
    )
    with noted_signals() as noted:
        subscriber.start()
        try:
            _watch(subscriber, place, noted, as_json, seconds)
        except OSError:  # the reader has what it wanted, or the terminal was closed
            _forget_stdout()
    status = 128 + noted[0] if noted else 0
    if not subscriber.close(_CLOSE_S):
        sys.stdout.flush()
        os._exit(status)  # a thread in zenoh would hold up the interpreter's own end, or abort it
    return status


def _watch(
    subscriber: Subscriber, place: Connection, noted: Sequence[int], as_json: bool, seconds: float | None
) -> None:
    fleet, console = Fleet(), Console(highlight=False)
    live = Live(console=console, auto_refresh=False, screen=True)
    view: _View
    with contextlib.ExitStack() as stack:
        if as_json:
            view = _Json()
        elif console.is_terminal and not console.is_dumb_terminal:
            view = _Screen(console, stack.enter_context(live))
        else:
            view = _Lines()
        end_s = None if seconds is None else time.monotonic() + seconds
        while not noted and (end_s is None or time.monotonic() < end_s):
            fleet.take(subscriber.take())
            seen = fleet.look(time.monotonic_ns())
            connection = place._replace(trouble=subscriber.trouble, neighbours=subscriber.neighbours)
            view.show(fleet, seen, connection)
            time.sleep(_LOOK_S)


def _since(fleet: Fleet, number: int) -> list[Note]:
    return [note for note in fleet.notes if note.number > number]


def _ignored(fleet: Fleet) -> list[str]:
    return [ignored_line(fleet.ignored)] if fleet.ignored else []


def _as_json(now_s: float, seen: Seen, notes: Sequence[Note], fleet: Fleet) -> dict[str, Any]:
    offset_ns = _unix_offset_ns()
    return {
        "unix_s": now_s,
        **msgspec.structs.asdict(seen),
        "events": [
            {
                "unix_s": (note.when_ns + offset_ns) * 1e-9,
                "level": note.level,
                "text": note.text,
            }
            for note in notes
            if note.vehicle == seen.vehicle
        ],
        "ignored": {
            what: count for (vehicle, what), (count, _) in fleet.ignored.items() if vehicle == seen.vehicle
        },
    }


def _unix_offset_ns() -> int:
    return time.time_ns() - time.monotonic_ns()


def _write(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def _forget_stdout() -> None:
    """What is still in its buffer would raise once more at the interpreter's end."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
