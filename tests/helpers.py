"""Shared builders: configurations, lockstep flights on virtual time, and looking through their records."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, TypeVar

import guidance
from guidance.config import Config, load
from guidance.mavlink.signing import SigningClock
from guidance.records import Event, Record
from guidance.supervisor import State
from sitl.lockstep import Channel, Lockstep
from sitl.vehicle import Firmware, Vehicle, VehicleOptions

DEMO: Final = Path(guidance.__file__).with_name("demo.toml")
#: What turns the demo's configuration into one for the built-in ArduRover.
ROVER: Final = ("vehicle.profile=ardupilot-rover", "flight.origin=engage", "limits.yaw_rate_max_rad_s=2.0")

#: A way of the link that delays and loses nothing.
PERFECT: Final = Channel()

R = TypeVar("R", bound=Record)


def make_config(*overrides: str) -> Config:
    """`guidance/demo.toml` with overrides (`KEY=VALUE`) as `--set` takes them."""
    return load(DEMO, overrides)


def make_flight(
    *overrides: str,
    config: Config | None = None,
    to_guide: Channel = PERFECT,
    to_vehicle: Channel = PERFECT,
    seed: int = 0,
    signing_key: bytes | None = None,
    vehicle_key: bytes | None = None,
    signing_clock: SigningClock | None = None,
    **vehicle_options: Any,
) -> Lockstep:
    """The guide against the built-in vehicle of the configured profile, booted at the first instant.

    `config` replaces the demo's; `vehicle_options` are those of `VehicleOptions`, with the paper's start and
    the profile's firmware unless given. `signing_key` is that of both ends, but for a `vehicle_key`.
    """
    config = make_config(*overrides) if config is None else config
    vehicle_options.setdefault("firmware", Firmware(config.vehicle.profile))
    key = signing_key if vehicle_key is None else vehicle_key
    options = VehicleOptions(**vehicle_options, signing_key=key or b"")
    start_ns = 1_000_000_000
    return Lockstep(
        config,
        Vehicle(options, boot_ns=start_ns),
        start_ns=start_ns,
        to_guide=to_guide,
        to_vehicle=to_vehicle,
        seed=seed,
        signing_key=signing_key,
        signing_clock=signing_clock,
    )


def state_of(flight: Lockstep) -> State:
    """The supervisor's state; a call, so that a type checker does not take it for constant."""
    return flight.guide.engagement.state


def fly_until(flight: Lockstep, state: State, seconds: float = 5.0) -> None:
    """Let time pass until the supervisor is in `state`; AssertionError with its reason if it never is."""
    reached = flight.run(seconds, until=lambda: state_of(flight) is state)
    assert reached, f"not {state} after {seconds} s but {state_of(flight)}: {flight.guide.engagement.reason}"


def fly_until_tracking(flight: Lockstep, seconds: float = 5.0) -> None:
    """Let time pass until setpoints of the law flow."""
    fly_until(flight, State.TRACKING, seconds)


def records_of(flight: Lockstep, kind: type[R], since_ns: int = 0) -> list[R]:
    """The records of one type, in order, from `since_ns` on."""
    return [record for record in flight.records if isinstance(record, kind) and record.t_ns >= since_ns]


def events_of(flight: Lockstep, code: str | None = None, since_ns: int = 0) -> list[str]:
    """The texts of the events (with one code), in order."""
    return [event.text for event in records_of(flight, Event, since_ns) if code in (None, event.code)]


def setpoints_since(flight: Lockstep, since_ns: int) -> list[int]:
    """The instants (ns) of the setpoints sent after `since_ns`."""
    return [t_ns for t_ns in flight.setpoint_times_ns if t_ns > since_ns]
