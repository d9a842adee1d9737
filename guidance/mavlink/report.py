"""What the link knows, as a record and, while there is no autopilot, in words."""

from __future__ import annotations

from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.link import AutopilotLink
from guidance.records import Link


def link_record(link: AutopilotLink, now_ns: int) -> Link:
    """The link as a record."""
    beat = link.heartbeat
    version = link.version
    known = link.clock.accepted > 0
    return Link(
        t_ns=now_ns,
        connected=link.connected(now_ns),
        heartbeat_age_s=None if beat is None else (now_ns - link.heartbeat_ns) * 1e-9,
        autopilot="" if beat is None else _enum_name("MAV_AUTOPILOT", beat.autopilot),
        vehicle_type="" if beat is None else _enum_name("MAV_TYPE", beat.type),
        autopilot_version="" if version is None else _version(version.flight_sw_version),
        autopilot_uid="" if version is None else f"{version.uid:016x}",
        received=link.received,
        lost=link.sequence.lost,
        reboots=link.reboots,
        round_trip_s=link.clock.round_trip_s,
        uplink_age_s=link.uplink_age_s(now_ns),
        clock_offset_ns=link.clock.offset_ns(now_ns) if known else None,
        clock_drift_ppm=link.clock.drift_ppm if known else None,
        streams=link.streams.status(now_ns),
        counters={**link.reader.counters, **link.counters},
    )


def absence(link: AutopilotLink) -> str:
    """Why there is no autopilot, from what is heard instead, and what to look at."""
    wanted = f"{link.system}/{link.component}"
    if link.heartbeat is not None:
        return f"the heartbeat of {wanted} stopped: is the autopilot on, does the link stand?"
    if link.reboots and link.received:
        return "the autopilot rebooted: waiting for its heartbeat"
    if not link.bytes_received:
        return "no bytes yet: does the autopilot or a router send to this port?"
    if link.others:
        heard = ", ".join(f"{system}/{component}" for system, component in sorted(link.others))
        return (
            f"heartbeats of {heard}, none of {wanted}: is vehicle.system_id right, does the router forward?"
        )
    if link.received:
        return f"packets of {wanted}, but no heartbeat of an autopilot yet"
    return f"{link.bytes_received} bytes, but no heartbeat of {wanted}: is this a MAVLink port?"


def _enum_name(enum: str, value: int) -> str:
    entry = dialect.enums[enum].get(value)
    return str(value) if entry is None else str(entry.name)


def _version(packed: int) -> str:
    return f"{packed >> 24 & 255}.{packed >> 16 & 255}.{packed >> 8 & 255}"
