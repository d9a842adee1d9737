"""What a healthy flight leaves: records for zenoh's door, and the same as a log."""

from __future__ import annotations

from functools import cache

from guidance import __version__
from guidance.config import to_json
from guidance.records import SCHEMA_VERSION, Record, Session
from guidance.supervisor import State
from sitl.fuzzing.flight import KEY, SIGNED, configuration
from sitl.lockstep import SECOND, Lockstep
from sitl.vehicle import Firmware, Vehicle, VehicleOptions

SESSION_ID = "0123456789abcdef0123456789abcdef"


@cache
def flight_records(tracking_s: float = 2.5, *, signed: bool = False) -> tuple[Record, ...]:
    """The records of a short flight of the demo, its session first."""
    config = configuration(*(SIGNED,) * signed)
    key = KEY if signed else None
    session = Session(
        t_ns=SECOND,
        schema_version=SCHEMA_VERSION,
        session_id=SESSION_ID,
        guidance_version=__version__,
        vehicle=config.vehicle.name,
        profile=config.vehicle.profile,
        unix_offset_ns=0,
        config_json=to_json(config),
    )
    options = VehicleOptions(firmware=Firmware.PX4_UUV, signing_key=key or b"")
    flight = Lockstep(config, Vehicle(options, boot_ns=SECOND), signing_key=key)
    flight.run(8.0, until=lambda: flight.guide.engagement.state is State.TRACKING)
    flight.run(tracking_s)
    return (session, *flight.records)
