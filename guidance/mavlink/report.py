"""What the link knows, as a record and, while there is no autopilot, in words."""

from __future__ import annotations

from typing import Final

from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.company import AUTOPILOT, RADIO
from guidance.mavlink.link import AutopilotLink
from guidance.mavlink.signing import Refusal
from guidance.records import Link


def link_record(link: AutopilotLink, now_ns: int) -> Link:
    """The link as a record."""
    beat = link.heartbeat
    version = link.version
    known, at = link.clock.accepted > 0, link.origin
    return Link(
        t_ns=now_ns,
        connected=link.connected(now_ns),
        heartbeat_age_s=None if beat is None else (now_ns - link.heartbeat_ns) * 1e-9,
        autopilot="" if beat is None else enum_name("MAV_AUTOPILOT", beat.autopilot),
        vehicle_type="" if beat is None else enum_name("MAV_TYPE", beat.type),
        autopilot_version="" if version is None else version_text(version.flight_sw_version),
        autopilot_uid="" if version is None else f"{version.uid:016x}",
        received=link.received,
        lost=link.sequence.lost,
        reboots=link.reboots,
        round_trip_s=link.clock.round_trip_s,
        uplink_age_s=link.uplink_age_s(now_ns),
        clock_offset_ns=link.clock.offset_ns(now_ns) if known else None,
        clock_drift_ppm=link.clock.drift_ppm if known else None,
        streams=link.streams.status(now_ns),
        counters={**link.reader.counters, **link.counters, **link.company.counters},
        origin_geodetic=None if at is None else (at.latitude * 1e-7, at.longitude * 1e-7, at.altitude * 1e-3),
    )


def absence(link: AutopilotLink, scheme: str) -> str:
    """Why there is no autopilot, from what is heard instead, and what to look at.

    `scheme` is the connection's kind.
    """
    wanted = f"{link.system}/{link.component}"
    if link.refusal is not None:
        return f"heard {wanted}, but {_REFUSED[link.refusal]}"
    if link.heartbeat is not None:
        return f"the heartbeat of {wanted} stopped: {_since_heartbeat(link, scheme)}"
    if link.reboots and link.received:
        return "the autopilot rebooted: waiting for its heartbeat"
    if not link.bytes_received:
        return f"no bytes yet: {_NOTHING[scheme]}"
    if link.company.roles:
        return f"heard: {link.company}, no heartbeat of {wanted}: {_instead(link)}"
    if link.received:
        return f"packets of {wanted}, but no heartbeat of an autopilot yet"
    if link.signing is not None and link.signing.refused and not link.company.frames:
        return f"{link.signing.refused} packets that are not signed by our key, none of {wanted}: {_ELSE}"
    if not link.company.frames or is_garbage(link.bytes_received, link.reader.counters["garbage_bytes"]):
        return f"{link.bytes_received} bytes and no MAVLink frame: {_GARBAGE[scheme]}"
    return f"{link.bytes_received} bytes, but no heartbeat of {wanted}: does the router forward it?"


#: What to look at when the autopilot is heard and its packets are refused for their signature.
_REFUSED: Final = {
    Refusal.UNSIGNED: "the autopilot does not sign: give it the key of link.signing_key_file",
    Refusal.BAD_SIGNATURE: "the autopilot signs with another key: give it that of link.signing_key_file",
    Refusal.REPLAYED: (
        "its signatures are of the past: a replay, or its clock is more than a minute behind; is it without "
        "GPS, does it hear us?"
    ),
}
#: What to look at when nothing comes.
_NOTHING: Final = {
    "udpin": "does the autopilot or a router send to this port?",
    "udpout": "does an autopilot or a router listen at this address?",
    "udpbcast": "is the autopilot on this network, does it listen on this port?",
    "tcp": "does what listens there serve MAVLink, is the autopilot on?",
    "serial": "is it on, RX wired to TX, its port set to MAVLink (SERIALx_PROTOCOL, MAV_x_CONFIG)?",
}
#: What to look at when what comes is not MAVLink.
_GARBAGE: Final = {
    "udpin": "another program sends to this port",
    "udpout": "another program answers at this address",
    "udpbcast": "another program answers",
    "tcp": "what listens there does not speak MAVLink, or another program does",
    "serial": "wrong baud rate? A console or GPS on this port, or another program that takes bytes away?",
}
_ELSE: Final = "is vehicle.system_id right, does the router forward the autopilot's packets?"
#: Of what came: above this part of it is not MAVLink, whatever a checksum may have found in it by chance.
_GARBAGE_PART: Final = 0.9
_GARBAGE_MIN_BYTES: Final = 200


def is_garbage(total_bytes: int, garbage_bytes: int) -> bool:
    """Whether what came is not MAVLink, but for what may look like it by chance."""
    return total_bytes >= _GARBAGE_MIN_BYTES and garbage_bytes > _GARBAGE_PART * total_bytes


def _since_heartbeat(link: AutopilotLink, scheme: str) -> str:
    total, garbage = link.bytes_at_heartbeat
    came = link.bytes_received - total
    if is_garbage(came, link.reader.counters["garbage_bytes"] - garbage):
        return f"{came} bytes since, and hardly a MAVLink frame: {_GARBAGE[scheme]}"
    return "is the autopilot on, does the link stand?"


def _instead(link: AutopilotLink) -> str:
    """What the company suggests."""
    roles = link.company.roles
    autopilots = sorted(sender for sender, role in roles.items() if role == AUTOPILOT)
    if autopilots:
        system, component = autopilots[0]
        return f"is it vehicle.system_id = {system}, vehicle.component_id = {component} that is meant?"
    if set(roles.values()) == {RADIO}:
        return (
            "nothing comes through the radio: is the other one powered, paired, at the autopilot's baud rate?"
        )
    return _ELSE


def enum_name(enum: str, value: int) -> str:
    """As the dialect calls it, or the number if it does not know it."""
    entry = dialect.enums[enum].get(value)
    return str(value) if entry is None else str(entry.name)


def version_text(packed: int) -> str:
    """MAJOR.MINOR.PATCH of a `flight_sw_version`."""
    return f"{packed >> 24 & 255}.{packed >> 16 & 255}.{packed >> 8 & 255}"
