"""The checks of the companion computer: telemetry and the log."""

from __future__ import annotations

from collections.abc import Iterator
from ipaddress import ip_address
from typing import Final

from guidance.preflight.findings import Finding, fail, ok, skip, warn
from guidance.preflight.seen import Seen

#: What a log grows by (measured): each setpoint with its records, each byte that comes, and the rest.
LOG_BYTES_PER_SETPOINT: Final = 560.0
LOG_BYTES_PER_BYTE: Final = 1.1
LOG_BYTES_PER_S: Final = 2000.0
#: Less room than for this is worth a word.
ROOM_WARN_S: Final = 3600.0


def telemetry(seen: Seen) -> Iterator[Finding]:
    """Zenoh is reached, and nobody publishes under the vehicle's name yet."""
    look, settings = seen.zenoh, seen.config.zenoh
    where = ", ".join(settings.connect) or settings.config_file or "multicast"
    if look is None:
        yield skip("zenoh", "zenoh.enabled = false")
    elif look.problem:
        yield fail(
            "zenoh",
            look.problem,
            "see [zenoh]; if another service listens there, give each a port of its own in zenoh.listen",
        )
    elif look.service:
        yield warn(
            "zenoh",
            f"{look.neighbours} reached; a service publishes as {seen.config.vehicle.name} already",
            "does the service itself run already? Else give each vehicle its own vehicle.name",
        )
    elif look.neighbours:
        yield ok("zenoh", f"{look.neighbours} reached at {where}")
    elif settings.connect:
        yield fail("zenoh", f"nobody answers at {where}", "is the router up, is zenoh.connect right?")
    elif settings.listen:
        yield ok("zenoh", f"nobody there yet; listens at {', '.join(settings.listen)}")
    elif settings.multicast_scouting or settings.config_file:
        yield warn("zenoh", f"nobody found by {where}", "is anybody there who listens?")
    else:
        yield skip("zenoh", "nowhere to connect to or to listen")
    open_to = [place for place in (*settings.connect, *settings.listen) if not _is_here(place)]
    if settings.multicast_scouting and not open_to:
        open_to = ["it by multicast"]
    if settings.config_file and not (look is not None and look.restricted):
        open_to.append(f"it as {settings.config_file} says")
    if settings.enabled and settings.commands and open_to:
        yield warn(
            "zenoh orders",
            f"whoever reaches {', '.join(open_to)} may engage, retune and stop",
            "zenoh.listen on 127.0.0.1 only, TLS and access control by zenoh.config_file, or "
            "zenoh.commands = false",
        )


def _is_here(place: str) -> bool:
    """Whether a zenoh endpoint, as `tcp/127.0.0.1:7447`, is of this machine alone."""
    host = place.partition("/")[2].rpartition(":")[0].strip("[]")
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


def orders(seen: Seen) -> Iterator[Finding]:
    """Who may order the service about, and by which way."""
    zenoh, link = seen.config.zenoh, seen.config.link
    if zenoh.enabled and zenoh.commands:
        yield ok("by zenoh", "whoever reaches it orders, as by guidance command")
    else:
        yield ok("by zenoh", "nobody (zenoh.commands = false)")
    if link.commands_from:
        who = " or ".join(map(str, link.commands_from))
        signed = "with our key's signature" if link.signing_key_file else "unsigned"
        yield ok("by MAVLink", f"system {who}, {signed}")
    else:
        yield ok("by MAVLink", "nobody (link.commands_from = [])")
    engages = {"pilot": "the pilot's switch of the mode, or an order", "auto": "by itself, as soon as it may"}
    arms = "arms" if seen.config.supervisor.arm else "never arms"
    yield ok("engages", f"{engages[seen.config.supervisor.engage]}; {arms}")


def log(seen: Seen) -> Iterator[Finding]:
    """The log can be written, and for how long."""
    look, settings = seen.disk, seen.config.log
    if look is None:
        yield skip("log", "log.enabled = false")
        return
    if look.problem:
        todo = "give this user the directory, or set log.directory"
        yield fail("log", f"{look.directory} cannot be written: {look.problem}", todo)
        return
    room_bytes = look.free_bytes - settings.min_free_mb * 1e6
    room_s = room_bytes / _rate_bytes_per_s(seen)
    free = f"{look.free_bytes * 1e-6:.0f} MB free in {look.directory}"
    if room_bytes <= 0.0:
        todo = "make room, or lower log.min_free_mb"
        yield fail("log", f"{free}, log.min_free_mb keeps {settings.min_free_mb:g}", todo)
    elif room_s < ROOM_WARN_S:
        yield warn("log", f"{free}, enough for {room_s / 60.0:.0f} min", "make room")
    else:
        yield ok("log", f"{free}, enough for {room_s / 3600.0:.0f} h")


def _rate_bytes_per_s(seen: Seen) -> float:
    record = seen.observation.record
    received = record.received_bytes_per_s if record is not None else 0.0
    return LOG_BYTES_PER_S + LOG_BYTES_PER_SETPOINT * seen.config.link.rate_hz + LOG_BYTES_PER_BYTE * received
