"""Looks at everything at once for as long as it takes, and no longer than it may."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final, NamedTuple

from guidance.config import Config, ConfigError
from guidance.mavlink.signing import Refusal
from guidance.preflight.checks import findings
from guidance.preflight.observation import Observation
from guidance.preflight.seen import Seen
from guidance.preflight.surroundings import PortLook, ZenohProbe, look_at_disk, look_at_port
from guidance.preflight.view import Findings
from guidance.shell import READ_AT_MOST_NS
from guidance.signing_files import open_signing
from guidance.transport import Lost, Transport, open_transport
from guidance.transport.processes import Processes

#: Neighbours that zenoh has not found by then, or in half of the time, are not there.
ZENOH_S: Final = 5.0
#: A zenoh that hangs is left behind: so long after all is known, and at the end of the time at the latest.
LEAVE_ZENOH_S: Final = 1.0

#: The signing clock has as long to be kept.
KEEP_S: Final = 0.5


class Checked(NamedTuple):
    """What was found in how many seconds; not `clean` if a thread of zenoh's was left behind."""

    findings: Findings
    seconds: float
    clean: bool


def check(config: Config, source: str, seconds: float, processes: Processes | None = None) -> Checked:
    """Look at all that `guidance run` with this configuration needs, for at most `seconds`, whatever hangs.

    Raises:
        ConfigError: zenoh does not take its settings, or the key of a signed link cannot be used.
    """
    started = time.monotonic()
    end = started + seconds
    zenoh_s = min(seconds / 2.0, ZENOH_S)
    keeper = open_signing(config)
    observation = Observation(config, None if keeper is None else keeper.signing)
    if keeper is not None:
        keeper.signing.set(keeper.begin(time.time_ns()), time.monotonic_ns())
    port = look_at_port(observation.connection, processes or Processes())
    disk = look_at_disk(config.log) if config.log.enabled else None
    try:
        probe = ZenohProbe(config, zenoh_s) if config.zenoh.enabled else None
    except ValueError as error:
        raise ConfigError(str(error)) from None
    look, clean = None, True
    if probe is not None:
        probe.start()
    try:
        opened, refused = asyncio.run(_observe(observation, port, end))
        if probe is not None:
            probe.done.wait(max(started + zenoh_s - time.monotonic(), 0.0))
            look = probe.look
    finally:
        if keeper is not None:
            keeper.close(KEEP_S)
        if probe is not None:
            clean = probe.end(max(min(LEAVE_ZENOH_S, end - time.monotonic()), 0.0))
    seen = Seen(source, observation, port, opened, refused, look, disk)
    return Checked(findings(seen), time.monotonic() - started, clean)


def observed(
    config: Config, seconds: float, enough: Callable[[Observation], bool]
) -> tuple[Observation, str]:
    """Listen until it is `enough`, for at most `seconds`: what was seen, and why the line was not opened.

    Raises:
        ConfigError: the key of a signed link cannot be used.
    """
    end = time.monotonic() + seconds
    keeper = open_signing(config)
    observation = Observation(config, None if keeper is None else keeper.signing)
    if keeper is not None:
        keeper.signing.set(keeper.begin(time.time_ns()), time.monotonic_ns())
    port = look_at_port(observation.connection, Processes())
    try:
        _, refused = asyncio.run(_observe(observation, port, end, enough))
    finally:
        if keeper is not None:
            keeper.close(KEEP_S)
    return observation, refused


async def _observe(
    observation: Observation,
    port: PortLook,
    end: float,
    enough: Callable[[Observation], bool] = Observation.complete,
) -> tuple[str, str]:
    """Open the line and listen: what was opened, or why it was not. A port that is in use is left alone."""
    if port.holders:
        return "", "it is in use"
    try:
        async with asyncio.timeout_at(_loop_time(end)):
            transport = await open_transport(
                observation.connection, observation.config.link.heartbeat_timeout_s
            )
    except Lost as lost:
        return "", str(lost)
    except TimeoutError:
        return "", "it did not open in time: does the device answer?"
    try:
        await _listen(observation, transport, end, enough)
    except Lost as lost:
        observation.problem("lost", str(lost))
    finally:
        asyncio.get_running_loop().remove_reader(transport.fileno())
        transport.close()
    return transport.opened, ""


def _loop_time(end: float) -> float:
    return asyncio.get_running_loop().time() + end - time.monotonic()


async def _listen(
    observation: Observation, transport: Transport, end: float, enough: Callable[[Observation], bool]
) -> None:
    """Until it is enough or the time is over."""
    readable = asyncio.Event()
    asyncio.get_running_loop().add_reader(transport.fileno(), readable.set)
    observation.opened(time.monotonic_ns())
    while not enough(observation):
        readable.clear()
        with suppress(OSError):  # nobody listens at the other end yet
            _read(observation, transport)
        now_ns = time.monotonic_ns()
        if now_ns >= end * 1e9:
            return
        if now_ns >= observation.deadline():
            for packet in observation.tick(now_ns):
                with suppress(OSError):
                    transport.send(packet)
        wait_s = min(observation.deadline() * 1e-9, end) - time.monotonic()
        with suppress(TimeoutError):
            await asyncio.wait_for(readable.wait(), max(wait_s, 0.0))


def _read(observation: Observation, transport: Transport) -> None:
    """All that waits, but a flood does not hold up the end."""
    link, end_ns = observation.link, time.monotonic_ns() + READ_AT_MOST_NS
    while (came := transport.receive()) is not None:
        now_ns, before, stale = time.monotonic_ns(), link.received, link.counters[Refusal.REPLAYED]
        observation.receive(came[0], now_ns)
        if link.received != before and (words := transport.heard(came[1], now_ns)):
            observation.problem("two_addresses", words)
        elif link.refusal is Refusal.REPLAYED and link.counters[Refusal.REPLAYED] != stale:
            transport.perhaps(came[1], now_ns)
        if now_ns >= end_ns:
            return
