"""What pages are told in JSON: the fleet at a glance, notes, and all about the vehicle that a page shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any, Final

import msgspec

from guidance.dashboard.planned import local
from guidance.fleet import Fleet, Note, Seen
from guidance.geodesy import Geodetic
from guidance.geofence import Corner
from guidance.mavlink.profiles import PROFILES, Asked
from guidance.records import NOT_A_RECORD, Link, Session, State, Status, Timing
from guidance.se3 import Vec3
from guidance.trajectory import TRAJECTORIES

NOTES_MAX: Final = 100
IGNORED_MAX: Final = 20
_STATUS_FRESH_NS: Final = 1_000_000_000
_TIMING_FRESH_NS: Final = 2_500_000_000
_CORNERS_MAX: Final = 1000


class _Guards(msgspec.Struct, frozen=True):
    fence_ned_m: tuple[Corner, ...] = ()
    fence_deg: tuple[Corner, ...] = ()
    fence_down_min_m: float | None = None
    fence_down_max_m: float | None = None


class _Zenoh(msgspec.Struct, frozen=True):
    commands: bool = False


class _Vehicle(msgspec.Struct, frozen=True):
    profile: str = ""


class _Flight(msgspec.Struct, frozen=True):
    origin: str | Geodetic = ""


class _Output(msgspec.Struct, frozen=True):
    output: str = ""


class Settings(msgspec.Struct, frozen=True):
    """What a page needs of a service's configuration, whatever else is in it."""

    flight: _Flight = _Flight()
    guards: _Guards = _Guards()
    zenoh: _Zenoh = _Zenoh()
    vehicle: _Vehicle = _Vehicle()
    trajectory: Mapping[str, Any] = {}
    airplane: _Output = _Output()
    copter: _Output = _Output()


class Watched:
    """The settings of each session, read once."""

    def __init__(self) -> None:
        self._read: dict[str, tuple[Session, Settings | None]] = {}
        self._decode = msgspec.json.Decoder(Settings).decode

    def settings(self, session: Session | None, vehicle: str) -> Settings | None:
        """None if there is no session yet, or its configuration is of another make."""
        if session is None:
            return None
        held = self._read.get(vehicle)
        if held is None or held[0] is not session:
            try:
                settings: Settings | None = self._decode(session.config_json)
            except (msgspec.MsgspecError, ValueError, RecursionError):
                settings = None
            if len(self._read) > 200:
                self._read.clear()
            held = self._read[vehicle] = (session, settings)
        return held[1]


def takes_orders(fleet: Fleet, watched: Watched, vehicle: str) -> bool:
    """Whether its service says that it obeys orders by zenoh."""
    settings = watched.settings(fleet.newest(vehicle, Session), vehicle)
    return settings is not None and settings.zenoh.commands


def fleet_told(
    fleet: Fleet, seen: Sequence[Seen], trouble: str, neighbours: int, unix_offset_ns: int
) -> dict[str, object]:
    """The fleet at a glance, the newest notes by their time on the clock here, and what was ignored."""
    notes = sorted(fleet.notes, key=lambda note: (note.when_ns, note.number))[-NOTES_MAX:]
    return {
        "kind": "fleet",
        "fleet": seen,
        "notes": [_note(note, unix_offset_ns) for note in notes],
        "ignored": [
            {"vehicle": vehicle, "what": what, "count": count, "detail": detail[:200]}
            for (vehicle, what), (count, detail) in list(fleet.ignored.items())[:IGNORED_MAX]
        ],
        "trouble": trouble,
        "neighbours": neighbours,
    }


def _note(note: Note, unix_offset_ns: int) -> dict[str, object]:
    unix_ns = note.when_ns + unix_offset_ns
    return {
        "number": note.number,
        "vehicle": note.vehicle,
        "level": note.level,
        "text": note.text[:500],
        # A stranger's record may hold any number; a page can date until the year 275760.
        "unix_s": unix_ns / 1_000_000_000 if abs(unix_ns) < 1 << 62 else 0.0,
    }


def told(fleet: Fleet, watched: Watched, vehicle: str, now_ns: int) -> dict[str, object]:
    """All about one vehicle that is no figure of a chart."""
    session, status = fleet.newest(vehicle, Session), fleet.newest(vehicle, Status)
    settings = watched.settings(session, vehicle)
    link = fleet.fresh(vehicle, Link, now_ns, 1_500_000_000)
    timing = fleet.fresh(vehicle, Timing, now_ns, _TIMING_FRESH_NS)
    said: dict[str, object] = {
        "kind": "about",
        "vehicle": vehicle,
        "commands": settings is not None and settings.zenoh.commands,
        "configured": settings is not None,
        "asked": "" if settings is None else asked(settings),
        "fence": None if settings is None else fence(settings, _ekf(fleet, vehicle)),
        "trajectory": trajectory(fleet, watched, vehicle),
        "origin": origin(fleet, watched, vehicle),
    }
    if session is not None:
        said["session"] = {
            "id": session.session_id[:8],
            "version": session.guidance_version[:40],
            "profile": session.profile[:40],
        }
    if status is not None:
        said["status"] = {
            "state": status.state,
            "reason": status.reason[:2000],
            "for_s": (status.t_ns - status.since_ns) / 1_000_000_000,
            "armed": status.armed,
            "mode": status.mode,
            "intended_mode": status.intended_mode,
            "allocation": status.allocation,
            "cautions": [caution[:500] for caution in status.cautions[:20]],
            "fresh": fleet.fresh(vehicle, Status, now_ns, _STATUS_FRESH_NS) is not None,
        }
    if link is not None:
        said["link"] = {
            "transport": link.transport[:40],
            "connected": link.connected,
            "lost": link.lost,
            "received": link.received,
            "streams": [
                {
                    "message": stream.message[:60],
                    "rate_hz": stream.rate_hz,
                    "wanted_hz": stream.wanted_hz,
                    "good": stream.alive and stream.at_rate and stream.valid,
                    "comes": stream.alive and stream.valid,
                    "insisted": stream.insisted,
                }
                for stream in link.streams[:20]
            ],
        }
    if timing is not None:
        said["timing"] = {
            "lateness_max_s": timing.lateness_max_s,
            "setpoint_gap_max_s": timing.setpoint_gap_max_s,
            "dropped_records": timing.dropped_records,
        }
    return said


def asked(settings: Settings) -> str:
    """What the vehicle is told, as the page's charts name it; empty if its profile is not known."""
    profile = PROFILES.get(settings.vehicle.profile)
    if profile is None:
        return ""
    # As `config.profile_of`, of a configuration that may be of another version.
    by_rates = "rates" in (settings.airplane.output, settings.copter.output)
    told = (profile.by_rates() if by_rates else profile).asked
    if told is Asked.VELOCITY_YAW_RATE:
        return "level_velocity" if profile.planar else "velocity"
    if told in (Asked.ATTITUDE_THROTTLE, Asked.RATES_THROTTLE):
        return told.name.lower()
    return Asked.RATES_SPEED.name.lower()


def trajectory(fleet: Fleet, watched: Watched, vehicle: str) -> Mapping[str, Any]:
    """The keys of [trajectory] of what is flown, or would be; empty if that is not known."""
    status = fleet.newest(vehicle, Status)
    if status is not None and status.trajectory_json:
        try:
            return msgspec.json.decode(status.trajectory_json, type=dict[str, Any])
        except NOT_A_RECORD:
            return {}
    settings = watched.settings(fleet.newest(vehicle, Session), vehicle)
    return {} if settings is None else settings.trajectory


def origin(fleet: Fleet, watched: Watched, vehicle: str) -> Vec3 | None:
    """Where the trajectory's origin is in local NED, m, or would be if it were engaged now."""
    session, status, state = (fleet.newest(vehicle, kind) for kind in (Session, Status, State))
    if isinstance(status, Status) and status.origin_ned_m is not None:
        return Vec3(*status.origin_ned_m)
    settings = watched.settings(session if isinstance(session, Session) else None, vehicle)
    if settings is None:
        return None
    chosen = settings.flight.origin
    if chosen == "ekf":
        return Vec3(0.0, 0.0, 0.0)
    if chosen == "engage":
        return Vec3(*state.position_ned_m) if isinstance(state, State) else None
    ekf = _ekf(fleet, vehicle)
    if isinstance(chosen, str) or ekf is None:  # only the service knows where home is
        return None
    return local(settings.vehicle.profile, chosen, ekf)


def _ekf(fleet: Fleet, vehicle: str) -> Geodetic | None:
    link = fleet.newest(vehicle, Link)
    return None if link is None else link.origin_geodetic


def fence(settings: Settings, ekf: Geodetic | None) -> dict[str, object] | None:
    """The geofence in local NED, m; None without one. One in `degrees` needs the local frame's origin."""
    guards = settings.guards
    corners = [corner for corner in guards.fence_ned_m[:_CORNERS_MAX] if all(map(isfinite, corner))]
    if guards.fence_deg and ekf is not None:
        projected = [
            local(settings.vehicle.profile, (*corner, ekf[2]), ekf)
            for corner in guards.fence_deg[:_CORNERS_MAX]
        ]
        corners = [corner[:2] for corner in projected if corner is not None]
    low_m, high_m = guards.fence_down_min_m, guards.fence_down_max_m
    if not (corners or guards.fence_deg) and low_m is None and high_m is None:
        return None
    return {
        "corners": corners,
        "down_min_m": low_m,
        "down_max_m": high_m,
        "degrees": bool(guards.fence_deg) and not corners,
    }


def trajectories_told() -> list[dict[str, object]]:
    """Every trajectory that can be loaded, with its parameters, for a form."""
    shapes: list[dict[str, object]] = []
    for name, kind in TRAJECTORIES.items():
        info = msgspec.inspect.type_info(kind)
        assert isinstance(info, msgspec.inspect.StructType)
        shapes.append({"name": name, "keys": [_key(field) for field in info.fields]})
    return shapes


def _key(field: msgspec.inspect.Field) -> dict[str, object]:
    info, about = field.type, ""
    if isinstance(info, msgspec.inspect.Metadata):
        about, info = str((info.extra_json_schema or {}).get("description", "")), info.type
    number = info if isinstance(info, msgspec.inspect.FloatType) else None
    return {
        "key": field.encode_name,
        "default": field.default,
        "about": about,
        "yes_or_no": number is None,
        "least": None if number is None else number.ge,
        "most": None if number is None else number.le,
    }
