"""The process: signals in, an exit status out, and an end within two seconds whatever hangs."""

from __future__ import annotations

import asyncio
import gc
import os
import signal
import sys
import threading
import time
import traceback
import uuid
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from guidance import __version__
from guidance.commands import Engage, Shutdown
from guidance.config import Config, to_json
from guidance.journal import say
from guidance.kept_file import open_learned
from guidance.notify import Notifier
from guidance.records import SCHEMA_VERSION, Level, Session
from guidance.shell import Shell
from guidance.signing_files import ClockKeeper, open_signing
from guidance.telemetry.sinks import Sinks, configured_sinks

#: The sinks' threads give the interpreter back at least this often (default 5 ms).
SWITCH_INTERVAL_S: Final = 0.0005
#: All sinks together have this long to write what waits when the service stops.
CLOSE_S: Final = 0.35
#: The signing clock has as long to be kept, and what was learned.
KEEP_S: Final = 0.15
#: The process ends so long after it was told to, whatever hangs (a disk, a router, a pipe nobody reads).
LEAVE_AT_THE_LATEST_S: Final = 1.8


def new_session(config: Config) -> Session:
    """The first record of a run that begins now."""
    now_ns = time.monotonic_ns()
    return Session(
        t_ns=now_ns,
        schema_version=SCHEMA_VERSION,
        session_id=uuid.uuid4().hex,
        guidance_version=__version__,
        vehicle=config.vehicle.name,
        profile=config.vehicle.profile,
        unix_offset_ns=time.time_ns() - now_ns,
        config_json=to_json(config),
    )


def sinks_of(config: Config, session: Session) -> Sinks:
    """What the configuration wants; raises ConfigError for bad zenoh settings."""
    return Sinks(configured_sinks(config, session))


async def _serve(
    config: Config, keeper: ClockKeeper | None, gather: Callable[[Config, Session], Sinks]
) -> int:
    learned = open_learned(config)
    session = new_session(config)
    sinks = gather(config, session)
    notifier = Notifier(os.environ, os.getpid())
    shell = Shell(config, sinks, session, notifier, keeper, learned)
    loop = asyncio.get_running_loop()

    def stop(number: signal.Signals) -> None:
        _leave_at_the_latest(lambda: 0 if shell.finished else 1)
        shell.command(Shutdown(source=number.name))

    numbers = [signal.SIGTERM, signal.SIGINT]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # `nohup` has it ignored
        numbers.append(signal.SIGHUP)
    for number in numbers:
        loop.add_signal_handler(number, stop, number)
    loop.add_signal_handler(signal.SIGUSR1, shell.command, Engage(source="SIGUSR1"))
    sinks.orders_to(shell.hand_over)
    sinks.start()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.collect()
    gc.freeze()  # what stands now stands for good: later collections need not walk it
    status = 0
    try:
        await shell.run()
    except Exception:
        status = 1
        _leave_at_the_latest(lambda: 1)
        notifier.failed("internal error, no setpoint follows")
        _say(
            Level.CRITICAL,
            f"guidance: internal error, no setpoint follows; please report it\n{traceback.format_exc()}",
        )
    if keeper is not None:
        keeper.close(KEEP_S)
    if learned is not None:
        learned.close(shell.learned, KEEP_S)
    left = sinks.close(CLOSE_S)
    if left:
        # Threads that hang in a disk or in zenoh would hold up the interpreter's own end by seconds.
        if "log" in left:
            _say(Level.ERROR, f"log: not everything was written: {left['log']}\n")
        os._exit(status)
    return status


def _say(level: Level, text: str) -> None:
    with suppress(OSError, ValueError):  # nobody listens
        say(level, text)


def _leave_at_the_latest(status: Callable[[], int]) -> None:
    """End the process in `LEAVE_AT_THE_LATEST_S` even if something hangs, without waiting for it."""
    timer = threading.Timer(LEAVE_AT_THE_LATEST_S, lambda: os._exit(status()))
    timer.daemon = True
    timer.start()


def serve(config: Config, gather: Callable[[Config, Session], Sinks] = sinks_of) -> int:
    """Run the service until SIGTERM, SIGINT or SIGHUP, SIGUSR1 commands to engage; the exit status.

    0 after a shutdown, 1 after an internal error, which is told on stderr. `gather` makes the sinks that the
    records go to.

    Raises:
        ConfigError: no profile fits the configuration, zenoh does not take its settings, or the key of a
            signed link cannot be used.
    """
    keeper = open_signing(config)
    try:
        import uvloop
    except ImportError:  # not published for this platform
        return asyncio.run(_serve(config, keeper, gather))
    return uvloop.run(_serve(config, keeper, gather))
