"""A model's parameters from its TOML file: every one is named, and nothing else."""

from __future__ import annotations

import math
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Final, TypeVar

from sitl.models import airplane, copter, rover

#: Models that come with the package: those that drive, airplanes, and copters.
ROVERS: Final = ("rover", "boat", "rover_px4")
AIRPLANES: Final = ("airplane_12", "airplane_20")
COPTERS: Final = ("copter_px4", "copter_ardupilot")

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


def _load(kind: type[P], name: str, positive: frozenset[str], signed: frozenset[str]) -> P:
    """Values in `positive` must be above 0, in `signed` may be anything finite, all others not negative."""
    try:
        if Path(name).suffix:
            text = Path(name).read_text(encoding="utf-8")
        else:
            text = (files("sitl.models") / f"{name}.toml").read_text(encoding="utf-8")
    except OSError as error:
        raise ValueError(
            f"{name}: {error.strerror}; a model is one of {', '.join((*ROVERS, *AIRPLANES, *COPTERS))},"
            " or a TOML file"
        ) from error
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{name}: {error}") from error
    fields: tuple[str, ...] = getattr(kind, "_fields")  # noqa: B009
    missing = [field for field in fields if field not in table]
    unknown = [key for key in table if key not in fields]
    if missing or unknown:
        raise ValueError(f"{name}: missing {', '.join(missing) or '-'}; unknown {', '.join(unknown) or '-'}")
    for key, value in table.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError(f"{name}: {key} must be a finite number, not {value!r}")
        if key in positive and not value > 0.0:
            raise ValueError(f"{name}: {key} must be above 0, not {value}")
        if key not in signed and value < 0.0:
            raise ValueError(f"{name}: {key} must not be negative, not {value}")
    return kind(**{key: float(value) for key, value in table.items()})
