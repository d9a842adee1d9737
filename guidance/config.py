"""The configuration: one TOML file, checked whole before anything moves.

Every key has a unit in its name and a range here; `deploy/*.toml` are commented examples that the tests hold
against this file. What flies by luck has no default: gains, limits, time-outs and the map from speed to
thrust must be written down. Errors name key, place, value and what is allowed, and all of them at once.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec
from msgspec import Meta

from guidance.airplane_config import AirplaneConfig, airspeed_conflicts
from guidance.checking import ConfigError as ConfigError  # raised here, so found here
from guidance.checking import Places, Problem, named, one_of, override, problems, shown
from guidance.connection import parse_connection as parse_connection
from guidance.copter_config import CopterConfig, rate_conflicts
from guidance.feasibility import infeasible
from guidance.guard_limits import GuardsConfig, guard_conflicts
from guidance.handling_config import ExcitationConfig, GroundConfig
from guidance.mavlink.profiles import PROFILES, Asked, Handling, Profile
from guidance.trajectory import Trajectory
from guidance.tuning import LEAST_RATE_RAD_S, NonNegative, Positive, Speed, cannot_allocate, conflicts
from guidance.tuning import LawConfig as LawConfig
from guidance.tuning import LimitsConfig as LimitsConfig
from guidance.tuning import Section as _Section

Name = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9_.-]{1,64}\Z", description="1 to 64 letters, digits, _ . -")]
Timeout = Annotated[float, Meta(ge=0.05, le=2.0)]
SystemId = Annotated[int, Meta(ge=1, le=255)]


class Vehicle(_Section, frozen=True, kw_only=True):
    """Who is flown. `name` is the vehicle's part of the key expressions."""

    name: Name
    profile: str
    system_id: SystemId
    component_id: Annotated[int, Meta(ge=1, le=255)] = 1
    speed_at_full_thrust_m_s: Speed


class Link(_Section, frozen=True, kw_only=True):
    """How the autopilot is reached, and when its data is too old."""

    connection: str
    rate_hz: Annotated[float, Meta(ge=5.0, le=200.0)] = 50.0
    attitude_timeout_s: Timeout
    position_timeout_s: Timeout
    heartbeat_timeout_s: Annotated[float, Meta(ge=1.5, le=30.0)] = 3.0
    actuation_delay_s: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    commands_from: tuple[SystemId, ...] = ()
    signing_key_file: str = ""
    signing_link_id: Annotated[int, Meta(ge=0, le=255)] = 0


class SupervisorConfig(_Section, frozen=True, kw_only=True):
    """When the service may take control, and how it gives it back."""

    engage: Literal["pilot", "auto"] = "pilot"
    arm: bool = False
    engage_max_error_m: Positive
    step_timeout_s: Annotated[float, Meta(ge=1.0, le=60.0)] = 5.0
    exit_mode: str = "hold"
    hold_mode: str = "hold"


Latitude = Annotated[float, Meta(ge=-90.0, le=90.0)]
Longitude = Annotated[float, Meta(ge=-180.0, le=180.0)]
Altitude = Annotated[float, Meta(ge=-12000.0, le=60000.0)]
Origin = Annotated[
    Literal["ekf", "home", "engage"] | tuple[Latitude, Longitude, Altitude],
    Meta(description="latitude -90 to 90 deg, longitude -180 to 180 deg, altitude -12000 to 60000 m AMSL"),
]


class Flight(_Section, frozen=True, kw_only=True):
    """Where the trajectory's origin is: the estimator's, home, where it engages, or [deg, deg, m AMSL]."""

    origin: Origin


_OPTION: Final = r"[A-Za-z0-9_.-]+(=[^\s\0?#;]*)?"
_OPTIONS: Final = rf"{_OPTION}(;{_OPTION})*"
#: PROTOCOL/ADDRESS?METADATA#CONFIG. Whatever this takes zenoh takes, though it may know no such protocol.
Locator = Annotated[
    str,
    Meta(
        pattern=rf"\A[A-Za-z0-9_-]+/[^\s\0?#]+(\?{_OPTIONS})?(#{_OPTIONS})?\Z",
        description="PROTOCOL/ADDRESS, such as tcp/192.168.1.2:7447",
    ),
]


class Zenoh(_Section, frozen=True, kw_only=True):
    """Telemetry and orders. A file replaces all the other settings but `enabled` and `commands`."""

    enabled: bool = True
    mode: Literal["peer", "client"] = "peer"
    connect: tuple[Locator, ...] = ()
    listen: tuple[Locator, ...] = ()
    multicast_scouting: bool = False
    config_file: str = ""
    commands: bool = False


class Log(_Section, frozen=True, kw_only=True):
    """The MCAP recorder."""

    enabled: bool = True
    directory: str = "logs"
    foxglove: bool = True
    min_free_mb: NonNegative = 200.0
    rotate_mb: Annotated[float, Meta(ge=1.0, le=100000.0)] = 256.0
    rotate_min: Annotated[float, Meta(ge=1.0, le=100000.0)] = 60.0
    keep_files: Annotated[int, Meta(ge=1, le=100000)] = 500
    keep_mb: Positive = 20000.0


class Config(_Section, frozen=True, kw_only=True):
    """The whole file."""

    vehicle: Vehicle
    link: Link
    supervisor: SupervisorConfig
    law: LawConfig
    limits: LimitsConfig
    flight: Flight
    trajectory: Trajectory
    ground: GroundConfig = GroundConfig()
    airplane: AirplaneConfig = AirplaneConfig()
    copter: CopterConfig = CopterConfig()
    guards: GuardsConfig = GuardsConfig()
    zenoh: Zenoh = Zenoh()
    log: Log = Log()
    excitation: ExcitationConfig = ExcitationConfig()


def load(path: Path, overrides: Sequence[str] = ()) -> Config:
    """Read, override (`KEY=VALUE`, dotted keys) and check a configuration file; raises ConfigError."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text (byte {error.start})") from None
    except ValueError as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    return parse(text, str(path), overrides)


def parse(text: str, where: str, overrides: Sequence[str] = ()) -> Config:
    """Like `load`, from the text of a file named `where`."""
    try:
        data = tomllib.loads(text)
    except RecursionError:
        raise ConfigError(f"{where}: not valid TOML: nested too deeply") from None
    except ValueError as error:  # TOMLDecodeError, or a number of thousands of digits
        raise ConfigError(f"{where}: not valid TOML: {error}") from None
    overridden: dict[str, str] = {}
    for setting in overrides:
        overridden[override(data, setting)] = setting
    places = Places(where, text)

    def said(problem: Problem) -> str:
        path = problem.key.split(".")
        for length in range(len(path), 0, -1):
            setting = overridden.get(".".join(path[:length]))
            if setting is not None:
                return f"{named(setting)}: {problem.key}{problem.text}"
        return f"{places.of(problem.key)}: {problem.key}{problem.text}"

    if "excitation" in data:
        found = [Problem("excitation", ": only `guidance tune` flies steps; take it out")]
    else:
        found = list(problems(data, Config))
    config: Config | None = None
    if not found:
        config = msgspec.convert(data, type=Config)
        found = list(_conflicts(config))
    if config is None or found:
        raise ConfigError("\n".join(map(said, found)))
    return config


def from_json(data: str) -> Config:
    """The configuration in a log's session record; raises ConfigError if it is of another make."""
    try:
        config = msgspec.json.decode(data, type=Config)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise ConfigError(f"the configuration in the log: {error}") from None
    for problem in _conflicts(config):
        raise ConfigError(f"the configuration in the log: {problem.key}{problem.text}")
    return config


def checked(config: Config) -> Config:
    """The same, if its settings do not contradict each other; raises ConfigError."""
    found = [f"{problem.key}{problem.text}" for problem in _conflicts(config)]
    if found:
        raise ConfigError("\n".join(found))
    return config


def profile_of(config: Config) -> Profile:
    """The row that a checked configuration names."""
    profile = PROFILES[config.vehicle.profile]
    by_rates = "rates" in (config.airplane.output, config.copter.output)
    return profile.by_rates() if by_rates else profile


def to_json(config: Config) -> str:
    """The effective configuration, for the session record."""
    return msgspec.json.encode(config).decode()


def _conflicts(config: Config) -> Iterator[Problem]:
    """What no single key can tell: settings that contradict each other or cannot fly."""
    link, law, limits = config.link, config.law, config.limits
    try:
        parse_connection(link.connection)
    except ValueError as error:
        yield Problem("link.connection", f" = {shown(link.connection)}: {error}")
    yield from conflicts(law, link.rate_hz)
    yield from _zenoh_conflicts(config.zenoh)
    profile = PROFILES.get(config.vehicle.profile)
    if profile is None:
        name = config.vehicle.profile
        yield Problem("vehicle.profile", f" = {shown(name)}: must be {one_of(sorted(PROFILES), name)}")
        return  # what the others may be is not known
    yield from _profile_conflicts(config, profile)
    yield from guard_conflicts(
        config.guards, profile, config.trajectory, config.flight.origin, link.attitude_timeout_s
    )
    full_m_s = config.vehicle.speed_at_full_thrust_m_s
    copter = config.copter if profile.handling is Handling.VELOCITY else None
    yield from infeasible(config.trajectory, limits, law, full_m_s, profile.planar, config.ground, copter)


def _profile_conflicts(config: Config, profile: Profile) -> Iterator[Problem]:
    exits = profile.exits
    for key, name in (
        ("exit_mode", config.supervisor.exit_mode),
        ("hold_mode", config.supervisor.hold_mode),
    ):
        if name not in exits:
            yield Problem(
                f"supervisor.{key}",
                f" = {shown(name)}: not a mode that {profile.name} can be left in; must be "
                f"{one_of(exits, name)}",
            )
    airplane = config.airplane
    if profile.handling is not Handling.AIRPLANE and airplane != AirplaneConfig():
        yield Problem("airplane", f": {profile.name} is no airplane; leave the section out")
    elif airplane.output == "rates" and not profile.takes_rates:
        yield Problem("airplane.output", f' = "rates": {profile.name} takes none; must be "attitude"')
    if profile.handling is not Handling.VELOCITY and config.copter != CopterConfig():
        yield Problem("copter", f": {profile.name} is no copter; leave the section out")
    if config.copter.output == "rates":
        yield from rate_conflicts(config.copter, config.limits, config.link.rate_hz)
    if profile.asked is Asked.VELOCITY_YAW_RATE and profile.planar and not config.ground.enabled:
        yield Problem(
            "ground.enabled",
            f" = false: {profile.name} takes velocities, which the law alone does not ask for; must be true",
        )
    if profile.handling is Handling.AIRPLANE:
        yield from airspeed_conflicts(airplane, config.limits.speed_max_m_s)
    allocation = config.law.allocation
    if profile.planar and allocation != "pitch-yaw":
        yield Problem(
            "law.allocation",
            f' = {shown(allocation)}: {profile.name} is planar and cannot roll; must be "pitch-yaw"',
        )
    without = cannot_allocate(allocation, config.limits, profile.planar)
    if without is not None:
        yield Problem(
            "law.allocation",
            f" = {shown(allocation)}: limits.{without[0]} = {without[1]:g} leaves it without that "
            f"rate: must be at least {LEAST_RATE_RAD_S:g}",
        )


def _zenoh_conflicts(zenoh: Zenoh) -> Iterator[Problem]:
    if zenoh.config_file:
        plain = Zenoh()
        for key in ("mode", "connect", "listen", "multicast_scouting"):
            value = getattr(zenoh, key)
            if value != getattr(plain, key):
                text = shown(list(value) if isinstance(value, tuple) else value)
                yield Problem(
                    f"zenoh.{key}", f" = {text}: zenoh.config_file replaces it; set only one of the two"
                )
    elif zenoh.mode == "client" and not zenoh.connect and not zenoh.multicast_scouting:
        yield Problem(
            "zenoh.mode",
            ' = "client": a client needs a router; name it in zenoh.connect, or set zenoh.multicast_scouting',
        )
