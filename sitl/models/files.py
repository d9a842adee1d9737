"""A model's parameters from its TOML file: every one is named, and nothing else."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Final, TypeVar

from sitl.models import airplane, copter, jsbsim_airplane, rotorpy_copter, rover, uuv

#: Models that come with the package: those that drive, airplanes, copters, and those that dive.
ROVERS: Final = ("rover", "boat", "rover_px4")
AIRPLANES: Final = ("airplane_12", "airplane_20")
COPTERS: Final = ("copter_px4", "copter_ardupilot")
UUVS: Final = ("uuv",)
#: Aircraft of JSBSim that have an autopilot's inner loops here; a model's name has `JSBSIM_PREFIX` before it.
JSBSIM: Final = ("J3Cub", "c172p", "t6texan2")
JSBSIM_PREFIX: Final = "jsbsim:"
#: Likewise vehicles of rotorpy.
ROTORPY: Final = ("hummingbird", "crazyflie", "px4_sihsim_quadx")
ROTORPY_PREFIX: Final = "rotorpy:"
NAMES: Final = (
    *ROVERS,
    *AIRPLANES,
    *COPTERS,
    *UUVS,
    *(f"{JSBSIM_PREFIX}{aircraft}" for aircraft in JSBSIM),
    *(f"{ROTORPY_PREFIX}{vehicle}" for vehicle in ROTORPY),
)

Model = (
    rover.Parameters
    | airplane.Parameters
    | copter.Parameters
    | uuv.Parameters
    | jsbsim_airplane.Parameters
    | rotorpy_copter.Parameters
)

P = TypeVar("P", bound=tuple[float, ...])


def load_rover(name: str) -> rover.Parameters:
    """A rover's or boat's parameters, from the shipped `NAME.toml` or a file by its path (with a suffix).

    Raises:
        ValueError: the file is missing, no TOML, or lacks a parameter, has an unknown or an impossible one.
    """
    return _load(rover.Parameters, name, rover.POSITIVE, rover.SIGNED)


def load_airplane(name: str) -> airplane.Parameters:
    """Likewise an airplane's."""
    return _load(airplane.Parameters, name, airplane.POSITIVE, airplane.SIGNED)


def load_copter(name: str) -> copter.Parameters:
    """Likewise a copter's."""
    return _load(copter.Parameters, name, copter.POSITIVE, copter.SIGNED)


def load_uuv(name: str) -> uuv.Parameters:
    """Likewise an underwater vehicle's."""
    return _load(uuv.Parameters, name, uuv.POSITIVE, uuv.SIGNED)


def load_jsbsim(aircraft: str) -> jsbsim_airplane.Parameters:
    """Likewise the inner loops of one of JSBSim's aircraft, by its name there; JSBSim itself is not asked."""
    if aircraft not in JSBSIM:
        raise ValueError(f"JSBSim's {aircraft!r} has no inner loops here; those that do: {', '.join(JSBSIM)}")
    return _load(
        jsbsim_airplane.Parameters,
        f"jsbsim_{aircraft}",
        jsbsim_airplane.POSITIVE,
        jsbsim_airplane.SIGNED,
    )


def load_rotorpy(vehicle: str) -> rotorpy_copter.Parameters:
    """Likewise of one of rotorpy's vehicles."""
    if vehicle not in ROTORPY:
        raise ValueError(
            f"rotorpy's {vehicle!r} has no inner loops here; those that do: {', '.join(ROTORPY)}"
        )
    return _load(
        rotorpy_copter.Parameters,
        f"rotorpy_{vehicle}",
        rotorpy_copter.POSITIVE,
        rotorpy_copter.SIGNED,
    )


#: How each kind is read, and by which keys its files are known.
_KINDS: Final[tuple[tuple[Callable[[str], Model], tuple[str, ...]], ...]] = (
    (load_rover, rover.Parameters._fields),
    (load_airplane, airplane.Parameters._fields),
    (load_copter, copter.Parameters._fields),
    (load_uuv, uuv.Parameters._fields),
)


def load_model(name: str) -> Model:
    """The parameters of whatever kind of model that name or file holds; a file's keys say of which.

    Raises:
        ValueError: as `load_rover`.
    """
    if name.startswith(JSBSIM_PREFIX):
        return load_jsbsim(name.removeprefix(JSBSIM_PREFIX))
    if name.startswith(ROTORPY_PREFIX):
        return load_rotorpy(name.removeprefix(ROTORPY_PREFIX))
    keys = _table(name).keys()
    shared, load = max(((len(keys & set(fields)), load) for load, fields in _KINDS), key=lambda kind: kind[0])
    if not shared:
        raise ValueError(f"{name}: no parameter of a model is in it")
    return load(name)


def _load(kind: type[P], name: str, positive: frozenset[str], signed: frozenset[str]) -> P:
    """Values in `positive` must be above 0, in `signed` may be anything finite, all others not negative."""
    table = _table(name)
    fields: tuple[str, ...] = getattr(kind, "_fields")  # noqa: B009
    missing = [field for field in fields if field not in table]
    unknown = [key for key in table if key not in fields]
    if missing or unknown:
        raise ValueError(f"{name}: missing {', '.join(missing) or '-'}; unknown {', '.join(unknown) or '-'}")
    values: dict[str, float] = {}
    for key, value in table.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError(f"{name}: {key} must be a finite number, not {value!r}")
        if key in positive and not value > 0.0:
            raise ValueError(f"{name}: {key} must be above 0, not {value}")
        if key not in signed and value < 0.0:
            raise ValueError(f"{name}: {key} must not be negative, not {value}")
        values[key] = float(value)
    return kind(**values)


def _table(name: str) -> dict[str, object]:
    try:
        if Path(name).suffix:
            text = Path(name).read_text(encoding="utf-8")
        else:
            text = (files("sitl.models") / f"{name}.toml").read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "no text"
        raise ValueError(f"{name}: {why}; a model is one of {', '.join(NAMES)}, or a TOML file") from error
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{name}: {error}") from error
