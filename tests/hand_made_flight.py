"""Logs of flights made by hand, whose figures are known without flying them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Final

import msgspec

from guidance.config import Config
from guidance.records import (
    Event,
    Input,
    InputKind,
    Level,
    Link,
    Record,
    Reference,
    Setpoint,
    State,
    Status,
    Timing,
    TrackingError,
)
from guidance.se3 import Vec3
from sitl.logbook import LogBook

#: Between two setpoints, ns.
PERIOD_NS: Final = 20_000_000
ZERO_NS: Final = 5_000_000_000
#: How much later than it is sent each setpoint acts.
DELAY_NS: Final = 30_000_000

#: Of a time in s: the error in m, ahead of the reference, right of it and above it.
Track = Callable[[float], tuple[float, float, float]]


def step(
    t_s: float, error: tuple[float, float, float], seq: int, *, saturated: bool = False
) -> Iterator[Record]:
    """One setpoint of a flight to the east at 2 m/s, sent `t_s` after the start, and what comes with it."""
    sent_ns = ZERO_NS + round(t_s * 1e9)
    ahead, right, above = error
    e = Vec3(-right, ahead, -above)  # it flies east: right of that is south
    reference = Vec3(0.0, 2.0 * t_s, -10.0)
    norm = (ahead * ahead + right * right + above * above) ** 0.5
    at_ns = sent_ns + DELAY_NS
    yield Input(t_ns=sent_ns, seq=seq, kind=InputKind.TICK)
    yield State(
        t_ns=at_ns,
        position_ned_m=(reference.x + e.x, reference.y + e.y, reference.z + e.z),
        velocity_ned_m_s=(0.0, 2.0, 0.0),
        attitude_wxyz=(0.5**0.5, 0.0, 0.0, 0.5**0.5),
        body_rates_frd_rad_s=(0.0, 0.0, 0.0),
        attitude_age_s=0.04,
        position_age_s=0.06,
        predicted_s=0.04,
        attitude_source="ATTITUDE",
        position_source="LOCAL_POSITION_NED",
        vehicle_time_ms=0,
        measured_body_rates_frd_rad_s=(0.0, 0.0, 0.3),
    )
    yield Reference(
        t_ns=at_ns,
        trajectory_s=t_s,
        position_ned_m=reference,
        velocity_ned_m_s=(0.0, 2.0, 0.0),
        acceleration_ned_m_s2=(0.0, 0.0, 0.0),
    )
    yield TrackingError(t_ns=at_ns, error_ned_m=e, norm_m=norm, v1=norm, v2=norm, field_body=(1.0, 0.0, 0.0))
    yield Setpoint(
        t_ns=at_ns,
        seq=seq,
        neutral=False,
        body_rates_frd_rad_s=(0.0, 0.0, 0.2),
        speed_m_s=2.0,
        demanded_body_rates_frd_rad_s=(0.0, 0.0, 0.25),
        demanded_speed_m_s=2.5,
        thrust=0.4,
        saturated=saturated,
        singular=False,
    )


def flown(
    seconds: float,
    track: Track,
    *,
    saturated: Callable[[float], bool] = lambda _: False,
    silent: Callable[[float], bool] = lambda _: False,
) -> list[Record]:
    """A flight of so many seconds at 50 Hz, with its state, an event, the link and the loop's timing."""
    made: list[Record] = [status("tracking", ZERO_NS, ZERO_NS)]
    made.append(
        Event(t_ns=ZERO_NS + 1_000_000_000, level=Level.WARNING, code="made_up", text="<b>so & so</b>")
    )
    seq = count()
    for n in range(round(seconds * 1e9 / PERIOD_NS) + 1):
        t_s = n * PERIOD_NS * 1e-9
        if not silent(t_s):
            made += step(t_s, track(t_s), next(seq), saturated=saturated(t_s))
        if n % 25 == 0:
            made.append(link(ZERO_NS + n * PERIOD_NS, 0.010 if n % 50 else 0.030))
    end_ns = ZERO_NS + round(seconds * 1e9)
    made.append(status("tracking", ZERO_NS, end_ns))
    made.append(
        Timing(
            t_ns=end_ns,
            ticks=100,
            lateness_edges_s=(0.001, 0.002),
            lateness_counts=(90, 9, 1),
            lateness_max_s=0.004,
            setpoint_gap_max_s=0.02,
            setpoint_rate_hz=50.0,
            dropped_records=0,
        )
    )
    return made


def status(state: str, since_ns: int, t_ns: int, reason: str = "made by hand") -> Status:
    """The supervisor."""
    return Status(
        t_ns=t_ns,
        state=state,
        reason=reason,
        since_ns=since_ns,
        armed=True,
        mode="",
        intended_mode="",
        trajectory_start_ns=None,
        origin_ned_m=None,
        setpoints_sent=0,
    )


def link(t_ns: int, round_trip_s: float) -> Link:
    """A link that has lost one packet of a hundred."""
    return Link(
        t_ns=t_ns,
        connected=True,
        heartbeat_age_s=0.1,
        autopilot="MAV_AUTOPILOT_PX4",
        vehicle_type="MAV_TYPE_SUBMARINE",
        autopilot_version="1.16.0",
        autopilot_uid="",
        received=99,
        lost=1,
        reboots=0,
        round_trip_s=round_trip_s,
        uplink_age_s=0.0,
        clock_offset_ns=0,
        clock_drift_ppm=0.0,
        streams=(),
        counters={},
    )


def log_of(directory: Path, config: Config, records: list[Record]) -> Path:
    """The log of these records."""
    with LogBook(config, directory) as book:
        for record in records:
            book.add(record)
    return book.path


def with_session(path: Path, into: Path, **fields: object) -> Path:
    """A copy of a log whose session record says otherwise, written by the library, not by our recorder."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    with path.open("rb") as source, into.open("wb") as target:
        writer = Writer(target)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        channels: dict[str, int] = {}
        for _, channel, message in make_reader(source).iter_messages(log_time_order=False):
            data = message.data
            if channel.topic == "/session":
                data = msgspec.json.encode({**msgspec.json.decode(data), **fields})
            if channel.topic not in channels:
                channels[channel.topic] = writer.register_channel(channel.topic, "json", schema)
            writer.add_message(channels[channel.topic], message.log_time, data, message.publish_time)
        writer.finish()  # type: ignore[no-untyped-call]
    return into
