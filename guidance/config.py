"""The configuration: one TOML file, checked whole before anything moves.

Every key has a unit in its name, a range and a description here; `deploy/*.toml` are commented examples that
the tests hold against this file. What flies by luck has no default: gains, limits, time-outs and the map
from speed to thrust must be written down. Errors name key, line, value and what is allowed.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

import msgspec
from msgspec import Meta

from guidance.law import Gains, Limits
from guidance.trajectory import Trajectory

Name = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_.-]{1,64}$", description="letters, digits, _ . -")]
Positive = Annotated[float, Meta(gt=0.0)]
NonNegative = Annotated[float, Meta(ge=0.0)]
Timeout = Annotated[float, Meta(gt=0.0, le=10.0)]
SystemId = Annotated[int, Meta(ge=1, le=255)]


class ConfigError(Exception):
    """The operator's configuration is refused; the text says what, where, and what is allowed."""


class _Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table of the file. Unknown keys are refused: a misspelt limit must not be a missing limit."""


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

    def __post_init__(self) -> None:
        parse_connection(self.connection)


class SupervisorConfig(_Section, frozen=True, kw_only=True):
    """When the service may take control, and how it gives it back."""

    engage: Literal["pilot", "auto"] = "pilot"
    arm: bool = False
    engage_max_error_m: Positive
    step_timeout_s: Annotated[float, Meta(ge=1.0, le=60.0)] = 5.0
    exit_mode: str = "hold"


class LawConfig(_Section, frozen=True, kw_only=True):
    """Gains of (11) and (14); lambda = 1 / beta."""

    k: Positive
    rho2_per_s: Positive
    rho3_per_s: Positive
    beta: Positive = 1.0

    def gains(self) -> Gains:
        """As the law takes them."""
        return Gains(k=self.k, rho2=self.rho2_per_s, rho3=self.rho3_per_s, beta=self.beta)


class LimitsConfig(_Section, frozen=True, kw_only=True):
    """What may be asked of the vehicle, always; rates are symmetric."""

    speed_min_m_s: float
    speed_max_m_s: Positive
    roll_rate_max_rad_s: NonNegative
    pitch_rate_max_rad_s: NonNegative
    yaw_rate_max_rad_s: Positive

    def __post_init__(self) -> None:
        if self.speed_min_m_s >= self.speed_max_m_s:
            raise ValueError("speed_min_m_s must be below speed_max_m_s")

    def limits(self) -> Limits:
        """As the law takes them."""
        return Limits(
            speed_min_m_s=self.speed_min_m_s,
            speed_max_m_s=self.speed_max_m_s,
            roll_rate_rad_s=self.roll_rate_max_rad_s,
            pitch_rate_rad_s=self.pitch_rate_max_rad_s,
            yaw_rate_rad_s=self.yaw_rate_max_rad_s,
        )


Latitude = Annotated[float, Meta(ge=-90.0, le=90.0)]
Longitude = Annotated[float, Meta(ge=-180.0, le=180.0)]
Altitude = Annotated[float, Meta(ge=-12000.0, le=60000.0)]
Origin = Literal["ekf", "home", "engage"] | tuple[Latitude, Longitude, Altitude]


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
    parts = urlsplit(text)
    try:
        port = parts.port
    except ValueError:
        raise ValueError(f"connection {text!r}: the port must be 0 to 65535; {expected}") from None
    if parts.scheme not in ("udpin", "udpout") or not parts.hostname or port is None or parts.path:
        raise ValueError(f"connection {text!r}: {expected}")
    scheme: Literal["udpin", "udpout"] = "udpin" if parts.scheme == "udpin" else "udpout"
    if scheme == "udpout" and port == 0:
        raise ValueError(f"connection {text!r}: port 0 is only for listening; {expected}")
    return Connection(scheme, parts.hostname, port)


def load(path: Path, overrides: Sequence[str] = ()) -> Config:
    """Read, override (`KEY=VALUE`, dotted keys) and check a configuration file; raises ConfigError."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not UTF-8 text (byte {error.start})") from None
    return parse(text, str(path), overrides)


def parse(text: str, where: str, overrides: Sequence[str] = ()) -> Config:
    """Like `load`, from the text of a file named `where`."""
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{where}: not valid TOML: {error}") from None
    for override in overrides:
        _override(data, override)
    config = _convert(data, where, text)
    _check_across(config, where)
    return config


def from_json(data: str) -> Config:
    """The configuration in a log's session record; raises ConfigError if it is of another make."""
    try:
        return msgspec.json.decode(data, type=Config)
    except msgspec.MsgspecError as error:
        raise ConfigError(f"the configuration in the log: {error}") from None


def to_json(config: Config) -> str:
    """The effective configuration, for the session record."""
    return msgspec.json.encode(config).decode()


def _override(data: dict[str, Any], override: str) -> None:
    key, equals, value_text = override.partition("=")
    path = key.strip().split(".")
    if not equals or not all(path):
        raise ConfigError(f"--set {override}: expected KEY=VALUE with a dotted key, such as law.k=1.0")
    try:
        value = tomllib.loads(f"value = {value_text}")["value"]
    except tomllib.TOMLDecodeError:
        value = value_text.strip()  # a bare word is a string
    table = data
    for part in path[:-1]:
        below = table.setdefault(part, {})
        if not isinstance(below, dict):
            raise ConfigError(f"--set {override}: {part} is a value, not a table")
        table = below
    if path == ["trajectory", "name"] and data["trajectory"].get("name") != value:
        data["trajectory"] = {"name": value}  # another trajectory's parameters mean nothing to this one
    else:
        table[path[-1]] = value


def _convert(data: dict[str, Any], where: str, text: str) -> Config:
    for key, value in _leaves(data):
        if isinstance(value, float) and not math.isfinite(value):
            raise ConfigError(f"{_place(where, text, key)}: {key} = {value}: must be a finite number")
    try:
        return msgspec.convert(data, type=Config)
    except msgspec.ValidationError as error:
        message, _, path = str(error).partition(" - at `$")
        dotted = re.sub(r"\[\.\.\.\]|\[\d+\]", "", path.strip("`.")).strip(".")
        for field in re.findall(r"`([a-z_0-9]+)`", message)[-1:]:
            if "field" in message:  # missing or unknown: the key stands in the message
                dotted = f"{dotted}.{field}".strip(".")
        found = dict(_leaves(data)).get(dotted)
        shown = f" = {found!r}" if found is not None else ""
        raise ConfigError(f"{_place(where, text, dotted)}: {dotted}{shown}: {message}") from None


def _leaves(table: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        dotted = f"{above}.{key}".strip(".")
        if isinstance(value, Mapping):
            yield from _leaves(value, dotted)
        elif isinstance(value, list):
            yield dotted, value
            yield from ((dotted, item) for item in value)
        else:
            yield dotted, value


def _place(where: str, text: str, dotted: str) -> str:
    """`where:line` of a key, or of its table if the key is missing, or just `where`."""
    *tables, key = dotted.split(".")
    table, best = "", None
    for number, line in enumerate(text.splitlines(), start=1):
        header = re.match(r"\s*\[\s*([^\]]+?)\s*\]", line)
        if header:
            table = header[1]
            if table == ".".join(tables) or table == dotted:
                best = number
        elif table == ".".join(tables) and re.match(rf"\s*{re.escape(key)}\s*=", line):
            return f"{where}:{number}"
    return where if best is None else f"{where}:{best}"


def _check_across(config: Config, where: str) -> None:
    """What no single key can tell."""
    period_s = 1.0 / config.link.rate_hz
    if config.link.attitude_timeout_s < period_s:
        raise ConfigError(
            f"{where}: link.attitude_timeout_s = {config.link.attitude_timeout_s}: shorter than one period "
            f"of link.rate_hz ({period_s:.3f} s); no setpoint would ever be sent"
        )
