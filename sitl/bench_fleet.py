"""Vehicles that do not exist, at 50 Hz over zenoh, for `sitl bench dashboard`, which starts it as a process.

    python -m sitl.bench_fleet ENDPOINT VEHICLES RATE_HZ

Records, encodings, cadence and liveliness tokens are those of the service; the flights are made up.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from math import cos, exp, hypot, pi, sin
from typing import Final

import msgspec
import zenoh

from guidance.records import (
    SCHEMA_VERSION,
    TOPICS,
    Event,
    Level,
    Link,
    Record,
    Reference,
    Session,
    Setpoint,
    State,
    Status,
    StreamStatus,
    Timing,
    TrackingError,
)
from guidance.telemetry.schema import encoding_schema
from guidance.telemetry.zenoh_sink import zenoh_config

_S: Final = 1_000_000_000
_EDGES_S: Final = tuple(1e-4 * 2**i for i in range(12))
_STREAMS: Final = ("ATTITUDE_QUATERNION", "LOCAL_POSITION_NED")


def session_of(number: int, t_ns: int, unix_offset_ns: int) -> Session:
    """The first record of a vehicle."""
    return Session(
        t_ns=t_ns,
        schema_version=SCHEMA_VERSION,
        session_id=f"{number:032x}",
        guidance_version="bench",
        vehicle=f"rover-{number}",
        profile="ardupilot-rover",
        unix_offset_ns=unix_offset_ns,
        config_json='{"guards":{"fence_ned_m":[[-40,-40],[-40,40],[40,40],[40,-40]]}}',
    )


def spoken(number: int, tick: int, rate_hz: int, t_ns: int, start_ns: int) -> Iterator[Record]:
    """What a vehicle says in a tick."""
    s = tick / rate_hz
    rate_rad_s, size_m = 0.35 + 0.02 * number, 4.0 + number
    angle = rate_rad_s * s + number
    r = (size_m * sin(angle), size_m * sin(2 * angle) / 2, -1.0 - 0.5 * sin(angle / 2))
    v = (size_m * rate_rad_s * cos(angle), size_m * rate_rad_s * cos(2 * angle), 0.0)
    off_m = 2.5 * exp(-0.25 * (s % 40)) + 0.01 * sin(9.7 * s + number)
    e = (off_m, 0.4 * off_m, 0.1 * off_m)
    rates, speed_m_s = (0.0, 0.02, rate_rad_s), hypot(*v)
    yield State(
        t_ns=t_ns,
        position_ned_m=(r[0] + e[0], r[1] + e[1], r[2] + e[2]),
        velocity_ned_m_s=v,
        attitude_wxyz=(cos(angle / 2), 0.0, 0.0, sin(angle / 2)),
        body_rates_frd_rad_s=rates,
        attitude_age_s=0.011,
        position_age_s=0.021,
        predicted_s=0.011,
        attitude_source=_STREAMS[0],
        position_source=_STREAMS[1],
        vehicle_time_ms=int(s * 1000),
        measured_body_rates_frd_rad_s=(0.0, 0.02 * sin(s), rate_rad_s + 0.02 * sin(5 * s)),
    )
    yield Reference(
        t_ns=t_ns,
        trajectory_s=s,
        position_ned_m=r,
        velocity_ned_m_s=v,
        acceleration_ned_m_s2=(0.1, 0.2, 0.0),
    )
    yield TrackingError(
        t_ns=t_ns,
        error_ned_m=e,
        norm_m=hypot(*e),
        v1=0.5 * off_m * off_m,
        v2=0.5 * off_m * off_m + 0.01,
        field_body=(0.9, 0.1, -0.1),
    )
    yield Setpoint(
        t_ns=t_ns,
        seq=tick,
        neutral=False,
        body_rates_frd_rad_s=rates,
        speed_m_s=speed_m_s,
        demanded_body_rates_frd_rad_s=rates,
        demanded_speed_m_s=1.1 * speed_m_s,
        thrust=0.4 + 0.1 * sin(s),
        saturated=False,
        singular=False,
    )
    if tick % (rate_hz // 5) == 0:
        yield Status(
            t_ns=t_ns,
            state="tracking",
            reason="guided and armed, confirmed",
            since_ns=start_ns,
            armed=True,
            mode="guided",
            intended_mode="guided",
            trajectory_start_ns=start_ns,
            origin_ned_m=(0.0, 0.0, 0.0),
            setpoints_sent=tick,
        )
    if tick % (rate_hz // 2) == 0:
        yield _link(t_ns, tick)
    if tick % rate_hz == 0:
        counts = tuple(tick // 2 ** (i + 1) for i in range(13))
        yield Timing(
            t_ns=t_ns,
            ticks=tick,
            lateness_edges_s=_EDGES_S,
            lateness_counts=counts,
            lateness_max_s=0.001,
            setpoint_gap_max_s=0.021,
            setpoint_rate_hz=float(rate_hz),
            dropped_records=0,
        )
    if tick % (rate_hz * 10) == rate_hz:
        yield Event(t_ns=t_ns, level=Level.NOTICE, code="bench", text=f"ten seconds, for the {tick}th tick")


def _link(t_ns: int, tick: int) -> Link:
    return Link(
        t_ns=t_ns,
        connected=True,
        heartbeat_age_s=0.4,
        autopilot="ARDUPILOT",
        vehicle_type="GROUND_ROVER",
        autopilot_version="4.6",
        autopilot_uid="bench",
        received=tick,
        lost=0,
        reboots=0,
        round_trip_s=0.002,
        uplink_age_s=0.05 + 0.05 * abs(sin(pi * tick / 100)),
        clock_offset_ns=5,
        clock_drift_ppm=0.1,
        streams=tuple(
            StreamStatus(
                message=message,
                wanted_hz=50.0,
                rate_hz=50.0,
                age_s=0.01,
                alive=True,
                at_rate=True,
                valid=True,
                rejected=0,
            )
            for message in _STREAMS
        ),
        counters={"garbage": 0, "crc": 0},
    )


def fly(endpoint: str, vehicles: int, rate_hz: int) -> None:
    """Publish until it is ended; each vehicle answers who asks for its session."""
    session = zenoh.open(zenoh_config(listen=[endpoint]))
    encode = msgspec.json.Encoder().encode
    publishers: dict[tuple[int, str], zenoh.Publisher] = {}
    held: list[object] = []

    def put(number: int, record: Record) -> None:
        topic = TOPICS[type(record)]
        publisher = publishers.get((number, topic))
        if publisher is None:
            publisher = publishers[number, topic] = session.declare_publisher(
                f"guidance/rover-{number}/{topic}",
                encoding=zenoh.Encoding.APPLICATION_JSON.with_schema(encoding_schema(topic)),
                congestion_control=zenoh.CongestionControl.DROP,
            )
        publisher.put(encode(record))

    start_ns = time.monotonic_ns()
    for number in range(vehicles):
        held.append(session.liveliness().declare_token(f"guidance/rover-{number}/alive"))
    tick = 0
    while True:
        due_ns = start_ns + tick * _S // rate_hz
        time.sleep(max(0, due_ns - time.monotonic_ns()) * 1e-9)
        for number in range(vehicles):
            if tick % (5 * rate_hz) == 0:  # nobody asks for it: who comes late hears it soon
                put(number, session_of(number, start_ns, time.time_ns() - time.monotonic_ns()))
            for record in spoken(number, tick, rate_hz, time.monotonic_ns(), start_ns):
                put(number, record)
        tick += 1


if __name__ == "__main__":
    fly(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
