"""The configuration: one TOML file, checked whole before anything moves.

Every key has a unit in its name and a range here; `deploy/*.toml` are commented examples that the tests hold
against this file. What flies by luck has no default: gains, limits, time-outs and the map from speed to
thrust must be written down. Errors name key, place, value and what is allowed, and all of them at once.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Final, Literal
from urllib.parse import urlsplit

import msgspec
from msgspec import Meta

from guidance.checking import ConfigError as ConfigError  # raised here, so found here
from guidance.checking import Places, Problem, named, override, problems, shown
from guidance.trajectory import Trajectory, sample
from guidance.tuning import LawConfig as LawConfig
from guidance.tuning import LimitsConfig as LimitsConfig
from guidance.tuning import NonNegative, Positive, conflicts
from guidance.tuning import Section as _Section

#: So much of a trajectory is held against the limits.
_LOOKED_AT_S: Final = 300
_ROUNDING: Final = 1.0 + 1e-9

Name = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9_.-]{1,64}\Z", description="1 to 64 letters, digits, _ . -")]
Timeout = Annotated[float, Meta(ge=0.05, le=2.0)]
SystemId = Annotated[int, Meta(ge=1, le=255)]


class Vehicle(_Section, frozen=True, kw_only=True):
    """Who is flown. `name` is the vehicle's part of the key expressions."""

    name: Name
    profile: str
    system_id: SystemId
    component_id: Annotated[int, Meta(ge=1, le=255)] = 1
    speed_at_full_thrust_m_s: Positive


class Link(_Section, frozen=True, kw_only=True):
    """How the autopilot is reached, and when its data is too old."""

    connection: str
    rate_hz: Annotated[float, Meta(ge=2.0, le=400.0)] = 50.0
    attitude_timeout_s: Timeout
    position_timeout_s: Timeout
    heartbeat_timeout_s: Annotated[float, Meta(ge=1.5, le=30.0)] = 3.0
    actuation_delay_s: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0


class SupervisorConfig(_Section, frozen=True, kw_only=True):
    """When the service may take control, and how it gives it back."""

    engage: Literal["pilot", "auto"] = "pilot"
    arm: bool = False
    engage_max_error_m: Positive
    step_timeout_s: Annotated[float, Meta(ge=1.0, le=60.0)] = 5.0
    exit_mode: str = "hold"


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


class Zenoh(_Section, frozen=True, kw_only=True):
    """Telemetry. Endpoints are zenoh locators, such as `tcp/127.0.0.1:7447`."""

    enabled: bool = True
    mode: Literal["peer", "client"] = "peer"
    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    multicast_scouting: bool = False
    config_file: str = ""


class Log(_Section, frozen=True, kw_only=True):
    """The MCAP recorder."""

    enabled: bool = True
    directory: str = "logs"
    min_free_mb: NonNegative = 200.0


class Config(_Section, frozen=True, kw_only=True):
    """The whole file."""

    vehicle: Vehicle
    link: Link
    supervisor: SupervisorConfig
    law: LawConfig
    limits: LimitsConfig
    flight: Flight
    trajectory: Trajectory
    zenoh: Zenoh = Zenoh()
    log: Log = Log()


class Connection(msgspec.Struct, frozen=True):
    """A parsed `connection`: `udpin` listens and answers whoever writes, `udpout` writes first."""

    scheme: Literal["udpin", "udpout"]
    host: str
    port: int


def parse_connection(text: str) -> Connection:
    """`udpin://HOST:PORT` or `udpout://HOST:PORT`; ValueError says what is wrong."""
    expected = "expected udpin://HOST:PORT (listen) or udpout://HOST:PORT (connect)"
    try:
        parts = urlsplit(text)
    except ValueError:  # half an IPv6 address
        raise ValueError(expected) from None
    if parts.scheme not in ("udpin", "udpout") or not parts.hostname:
        raise ValueError(expected)
    if parts.path or parts.query or parts.fragment or "@" in parts.netloc:
        raise ValueError(f"nothing may follow the port; {expected}")
    try:
        port = parts.port
    except ValueError:
        raise ValueError(f"the port must be a number from 0 to 65535; {expected}") from None
    if port is None:
        raise ValueError(f"the port is missing; {expected}")
    scheme: Literal["udpin", "udpout"] = "udpin" if parts.scheme == "udpin" else "udpout"
    if scheme == "udpout" and port == 0:
        raise ValueError(f"port 0 is only for listening; {expected}")
    return Connection(scheme, parts.hostname, port)


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
        return msgspec.json.decode(data, type=Config)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise ConfigError(f"the configuration in the log: {error}") from None


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
    yield from conflicts(law, limits, link.rate_hz)
    if limits.speed_min_m_s >= limits.speed_max_m_s:
        yield Problem(
            "limits.speed_min_m_s",
            f" = {limits.speed_min_m_s:g}: must be below speed_max_m_s = {limits.speed_max_m_s:g}",
        )
    else:
        yield from _infeasible(config)


def _infeasible(config: Config) -> Iterator[Problem]:
    """A reference that no vehicle within these limits could follow, by its horizontal motion."""
    limits, trajectory = config.limits, config.trajectory
    name = str(trajectory.__struct_config__.tag)
    moving = [sample(trajectory, 0.5 * i) for i in range(_LOOKED_AT_S * 2)]
    speeds = [math.hypot(r.velocity.x, r.velocity.y) for r in moving]
    fastest = min(limits.speed_max_m_s, config.vehicle.speed_at_full_thrust_m_s)
    if max(speeds) > fastest * _ROUNDING:
        yield Problem(
            "trajectory.name",
            f" = {shown(name)}: it moves at {max(speeds):.3g} m/s, and the vehicle at most at {fastest:g} "
            "(limits.speed_max_m_s, vehicle.speed_at_full_thrust_m_s)",
        )
    elif min(speeds) * _ROUNDING < limits.speed_min_m_s:
        yield Problem(
            "trajectory.name",
            f" = {shown(name)}: it moves at {min(speeds):.3g} m/s, and the vehicle never slower than "
            f"limits.speed_min_m_s = {limits.speed_min_m_s:g}",
        )
    turns = [
        abs(r.velocity.x * r.acceleration.y - r.velocity.y * r.acceleration.x) / (speed * speed)
        for r, speed in zip(moving, speeds, strict=True)
        if speed > 1e-6
    ]
    fastest_turn = math.hypot(limits.pitch_rate_max_rad_s, limits.yaw_rate_max_rad_s)
    if max(turns, default=0.0) > fastest_turn * _ROUNDING:
        yield Problem(
            "trajectory.name",
            f" = {shown(name)}: it turns at {max(turns):.3g} rad/s, and the vehicle at most at "
            f"{fastest_turn:.3g} (limits.yaw_rate_max_rad_s, limits.pitch_rate_max_rad_s)",
        )
