"""The configuration's door: damaged files and generated settings; what is accepted must fly."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Final

import msgspec
from msgspec import inspect

from guidance.config import Config, ConfigError, from_json, parse, to_json
from guidance.supervisor import State
from guidance.trajectory import TRAJECTORIES, Trajectory, sample
from sitl.fuzzing.dice import Dice
from sitl.fuzzing.flight import DEMO, KEY
from sitl.fuzzing.oracle import Broken, Oracle
from sitl.fuzzing.orders import engage
from sitl.lockstep import SECOND, Lockstep
from sitl.vehicle import Firmware, Vehicle, VehicleOptions

_TEXTS: Final = (
    *(
        "nan",
        "-inf",
        "1e999",
        "1e308",
        "-1",
        "0",
        "0.0",
        "0x" + "f" * 5000,
        "9" * 400,
        "true",
        '""',
        '"pilot"',
    ),
    *(
        '"\\u0000"',
        '"\\u001b[2J"',
        '"helix"',
        "[]",
        "{}",
        "[{}]",
        "[" * 5000,
        "{ name = 'circle' }",
        "07:32:00",
    ),
    *(
        "1979-05-27T07:32:00Z",
        "'''",
        '"""',
        "[1, 2, 3]",
        "[[1, 2], 3]",
        '"udpin://[::1"',
        '"bounded"',
        "=",
        "#",
    ),
)
#: How many settings are told at most, and how long those that are accepted fly.
_SETTINGS_MAX: Final = 5
_FLIGHT_S: Final = 1.0
_ENGAGING_S: Final = 2.0
_TIMES_S: Final = (0.0, 1e-9, 0.02, 1.0, 59.99, 3600.0, 1e6)


class ConfigDoor:
    """One text, set of settings or trajectory after the other; `newest` shows it."""

    inputs = 60
    scene = "configuration files"

    def __init__(self, dice: Dice) -> None:
        self.newest = ""
        self._dice = dice
        self._outcomes: list[bytes] = []

    def feed(self) -> None:
        """One input."""
        kind = self._dice.random()
        if kind < 0.5:
            self._parsed(self._damaged(self._dice.choice(files())), [])
        elif kind < 0.9:
            known = settings()
            drawn = self._dice.sample(known, self._dice.randrange(1, _SETTINGS_MAX + 1))
            text = self._dice.choice(files())
            self._parsed(text, [f"{key}={toml(draw(self._dice))}" for key, draw in drawn])
        else:
            self._trajectory()

    def finish(self) -> bytes:
        """The outcomes."""
        return b"".join(self._outcomes)

    def _parsed(self, text: str, overrides: list[str]) -> None:
        self.newest = f"settings {overrides} over the file {text!r}"
        try:
            config = parse(text, "fuzz.toml", overrides)
        except ConfigError as error:
            told = str(error)
            hidden = [mark for mark in told if ord(mark) < 32 and mark != "\n"]
            if not told or hidden:
                raise Broken(f"a refusal that steers a terminal: {told!r}") from None
            self._outcomes.append(told.encode())
            return
        if from_json(to_json(config)) != config:
            raise Broken("a configuration does not come back from its JSON")
        self._outcomes.append(flown(to_json(config)))

    def _damaged(self, text: str) -> str:
        dice = self._dice
        lines = text.splitlines()
        for _ in range(dice.choice((1, 1, 2, 5))):
            kind, at = dice.randrange(6), dice.randrange(len(lines))
            key, equals, _value = lines[at].partition("=")
            if kind <= 1:
                assigned = [n for n, line in enumerate(lines) if "=" in line and not line.startswith("#")]
                at = dice.choice(assigned or [at])
                key = lines[at].partition("=")[0]
                lines[at] = f"{key}= {dice.choice(_TEXTS)}"
            elif kind == 2:
                del lines[at : at + dice.choice((1, 1, 3))]
                lines = lines or [""]
            elif kind == 3:
                lines.insert(at, dice.choice(lines))
            elif kind == 4:
                lines[at] = dice.mutated(lines[at].encode()).decode("utf-8", "replace")
            else:  # a line that was a comment counts
                lines[at] = lines[at].removeprefix("# ") if equals else dice.text()
        return "\n".join(lines)

    def _trajectory(self) -> None:
        dice = self._dice
        name = dice.choice(sorted(TRAJECTORIES))
        fields: dict[str, Any] = {"name": name}
        for field in msgspec.structs.fields(TRAJECTORIES[name]):
            if dice.chance(0.5):
                fields[field.name] = (
                    dice.real() if dice.chance(0.3) else number(dice, inspect.type_info(field.type))
                )
        self.newest = f"trajectory {fields}"
        try:
            trajectory: Trajectory = msgspec.convert(fields, type=Trajectory)
        except msgspec.ValidationError:
            return
        _sampled(trajectory)


@cache
def files() -> tuple[str, ...]:
    """The demo's configuration, and in a checkout those of `deploy`."""
    deploy = Path(__file__).parents[2] / "deploy"
    return tuple(path.read_text(encoding="utf-8") for path in (DEMO, *sorted(deploy.glob("*.toml"))))


def toml(value: Any) -> str:
    """A value as TOML has it."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return repr(value) if isinstance(value, float) else json.dumps(value)


@cache
def settings() -> list[tuple[str, Callable[[Dice], Any]]]:
    """Every key of the configuration, with what draws a value that its type allows, or nearly so."""
    found: list[tuple[str, Callable[[Dice], Any]]] = []
    for section in msgspec.structs.fields(Config):
        kind = inspect.type_info(section.type)
        if isinstance(kind, inspect.StructType):
            for field in kind.fields:
                found.append((f"{section.name}.{field.name}", _drawing(field.type)))
        else:
            found.append((section.name, _drawing(kind)))
    return found


def _drawing(kind: inspect.Type) -> Callable[[Dice], Any]:
    return lambda dice: drawn(dice, kind)


def drawn(dice: Dice, kind: inspect.Type) -> Any:
    """A value of a type of msgspec's, mostly in its range."""
    while isinstance(kind, inspect.Metadata):
        kind = kind.type
    if dice.chance(0.02):
        return dice.text()
    if isinstance(kind, inspect.UnionType):
        return drawn(dice, dice.choice(kind.types))
    if isinstance(kind, inspect.StructType):
        fields = {} if kind.tag is None else {str(kind.tag_field): kind.tag}
        return fields | {
            field.encode_name: drawn(dice, field.type)
            for field in kind.fields
            if field.required or dice.chance(0.5)
        }
    if isinstance(kind, inspect.LiteralType):
        return dice.choice(kind.values)
    if isinstance(kind, inspect.TupleType):
        return [drawn(dice, item) for item in kind.item_types]
    if isinstance(kind, inspect.VarTupleType):
        return [drawn(dice, kind.item_type) for _ in range(dice.randrange(3))]
    if isinstance(kind, inspect.BoolType):
        return dice.chance(0.5)
    if isinstance(kind, inspect.StrType):
        return dice.choice(
            ("hold", "return", "px4-uuv", "ardupilot-rover", "tcp/127.0.0.1:7447", "x", dice.text())
        )
    return number(dice, kind)


def number(dice: Dice, kind: inspect.Type) -> float:
    """Of the type's range: an end of it, an ordinary number, or any; rarely none of it."""
    while isinstance(kind, inspect.Metadata):
        kind = kind.type
    if not isinstance(kind, inspect.FloatType | inspect.IntType) or dice.chance(0.03):
        return dice.real()
    low = next((float(end) for end in (kind.ge, kind.gt) if end is not None), -1e6)
    high = next((float(end) for end in (kind.le, kind.lt) if end is not None), 1e6)
    choice = dice.random()
    value = (
        low + (high - low) * dice.random() ** 6 if choice < 0.4 else dice.choice((0.5, 1.0, 2.0, 5.0, 20.0))
    )
    if choice > 0.8:
        value = dice.choice((low, high))
    value = min(max(value, low), high)
    return int(value) if isinstance(kind, inspect.IntType) else value


@lru_cache(maxsize=512)
def flown(config_json: str) -> bytes:
    """Fly a configuration for a second, by auto or by command; the digest of all that was recorded."""
    config = from_json(config_json)
    _sampled(config.trajectory)
    start = sample(config.trajectory, 0.0).position
    signed = bool(config.link.signing_key_file)
    vehicle = VehicleOptions(
        firmware=Firmware(config.vehicle.profile),
        system_id=config.vehicle.system_id,
        component_id=config.vehicle.component_id,
        initial_position_ned_m=(start.x + 1.0, start.y, start.z),
        initially_armed=not config.supervisor.arm,
        initial_mode="STABILIZE" if config.vehicle.profile == "ardupilot-copter" else "MANUAL",
        signing_key=KEY if signed else b"",
    )
    flight = Lockstep(config, Vehicle(vehicle, boot_ns=SECOND), signing_key=KEY if signed else None)
    guide = flight.guide
    oracle = Oracle(guide, KEY if signed else None)
    flight.on_record = oracle.take
    if flight.run(_ENGAGING_S, until=lambda: guide.engagement.state is State.READY):
        engage(guide, flight.now_ns)
        flight.run(_ENGAGING_S, until=lambda: guide.engagement.state is State.TRACKING)
    flight.run(_FLIGHT_S)
    return oracle.finish()


def _sampled(trajectory: Trajectory) -> None:
    for t_s in _TIMES_S:
        reference = sample(trajectory, t_s)
        if not all(math.isfinite(part) for vector in reference for part in vector):
            raise Broken(f"{trajectory} at {t_s} s is {reference}")
