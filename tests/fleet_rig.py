"""Records of vehicles that do not exist, on a clock of the test's own: for the fleet and its view."""

from __future__ import annotations

from typing import Any, Final

from guidance.fleet import Fleet, Seen
from guidance.records import (
    TOPICS,
    Event,
    Level,
    Link,
    Record,
    Session,
    Setpoint,
    State,
    Status,
    StreamStatus,
    TrackingError,
)
from guidance.telemetry.arrivals import Heard, Presence, read

S: Final = 1_000_000_000
MS: Final = 1_000_000
UNIX_OFFSET_NS: Final = 1_790_000_000 * S

_A = (1.0, 2.0, 3.0)


def status(t_ns: int, **changes: Any) -> Status:
    fields: dict[str, Any] = {
        "state": "tracking",
        "reason": "offboard and armed, confirmed",
        "since_ns": 0,
        "armed": True,
        "mode": "offboard",
        "intended_mode": "offboard",
        "trajectory_start_ns": 0,
        "origin_ned_m": _A,
        "setpoints_sent": 1,
    }
    return Status(t_ns=t_ns, **{**fields, **changes})


def session(session_id: str) -> Session:
    return Session(
        t_ns=0,
        schema_version=1,
        session_id=session_id,
        guidance_version="0.1",
        vehicle="",
        profile="",
        unix_offset_ns=UNIX_OFFSET_NS,
        config_json="{}",
    )


def event(t_ns: int, text: str, level: Level = Level.NOTICE) -> Event:
    return Event(t_ns=t_ns, level=level, code="test", text=text)


def error(t_ns: int, norm_m: float) -> TrackingError:
    return TrackingError(t_ns=t_ns, error_ned_m=_A, norm_m=norm_m, v1=1.0, v2=1.0, field_body=_A)


def setpoint(t_ns: int, seq: int) -> Setpoint:
    return Setpoint(
        t_ns=t_ns,
        seq=seq,
        neutral=False,
        body_rates_frd_rad_s=_A,
        speed_m_s=1.0,
        demanded_body_rates_frd_rad_s=_A,
        demanded_speed_m_s=1.0,
        thrust=0.3,
        saturated=False,
        singular=False,
    )


def state(t_ns: int) -> State:
    return State(
        t_ns=t_ns,
        position_ned_m=_A,
        velocity_ned_m_s=_A,
        attitude_wxyz=(1.0, 0.0, 0.0, 0.0),
        body_rates_frd_rad_s=_A,
        attitude_age_s=0.012,
        position_age_s=0.034,
        predicted_s=0.012,
        attitude_source="ATTITUDE_QUATERNION",
        position_source="LOCAL_POSITION_NED",
        vehicle_time_ms=1,
    )


def link(t_ns: int) -> Link:
    streams = tuple(
        StreamStatus(
            message=message,
            wanted_hz=hz,
            rate_hz=hz,
            age_s=0.01,
            alive=True,
            at_rate=True,
            valid=True,
            rejected=0,
        )
        for message, hz in (("ATTITUDE_QUATERNION", 200.0), ("LOCAL_POSITION_NED", 50.0))
    )
    return Link(
        t_ns=t_ns,
        connected=True,
        heartbeat_age_s=0.25,
        autopilot="",
        vehicle_type="",
        autopilot_version="",
        autopilot_uid="",
        received=1,
        lost=7,
        reboots=0,
        round_trip_s=0.0004,
        uplink_age_s=None,
        clock_offset_ns=None,
        clock_drift_ppm=None,
        streams=streams,
        counters={},
    )


class Sky:
    """A fleet, and the means to let its vehicles say something."""

    def __init__(self) -> None:
        self.fleet = Fleet()

    def say(self, now_ns: int, vehicle: str, *records: Record, answered: bool = False) -> None:
        self.fleet.take(Heard(now_ns, vehicle, TOPICS[type(r)], r, answered) for r in records)

    def payload(self, now_ns: int, key: str, encoding: str, payload: bytes = b"{}") -> None:
        self.fleet.take([read(now_ns, key, encoding, payload)])

    def token(self, now_ns: int, vehicle: str, here: bool) -> None:
        self.fleet.take([Presence(now_ns, vehicle, here)])

    def fly(
        self, vehicle: str, start_ns: int, end_ns: int, rate_hz: int = 50, error_m: float = 0.123
    ) -> None:
        """What a vehicle that tracks says in [start, end), at the cadence of the service."""
        period_ns = S // rate_hz
        for t_ns in range(start_ns, end_ns, period_ns):
            seq = t_ns // period_ns
            self.say(t_ns, vehicle, state(t_ns), error(t_ns, error_m), setpoint(t_ns, seq))
            if seq % 10 == 0:
                self.say(t_ns, vehicle, status(t_ns))
            if seq % 25 == 0:
                self.say(t_ns, vehicle, link(t_ns))

    def look(self, now_ns: int, vehicle: str) -> Seen:
        (seen,) = (seen for seen in self.fleet.look(now_ns) if seen.vehicle == vehicle)
        return seen

    def texts(self) -> list[str]:
        return [f"{note.vehicle}: {note.text}" for note in self.fleet.notes]
