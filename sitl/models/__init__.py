"""The bodies behind the built-in vehicle: pure functions of a state and a command, with parameters in files.

Each `NAME.toml` names its model and the values of that model's parameters; all are SI units. The text knows
nothing of `guidance`, so that a sign error here cannot cancel against the same error there.
"""

from __future__ import annotations

import math
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Final

from sitl.models.rover import Parameters

#: Models that come with the package.
SHIPPED: Final = ("rover", "boat")
#: Parameters that divide, and those that may be negative.
POSITIVE: Final = frozenset(
    {
        "yaw_lag_s",
        "yaw_gain",
        "yaw_slew_rad_s2",
        "turning_radius_m",
        "lateral_acceleration_m_s2",
        "speed_max_m_s",
        "acceleration_m_s2",
        "drag_s",
        "drive_m_s2",
    }
)
SIGNED: Final = frozenset({"misalignment_rad", "carried_north_m_s", "carried_east_m_s"})


def load(name: str) -> Parameters:
    """A shipped model's parameters by its name, or those in a file by its path.

    Raises:
        ValueError: there is no such file, or a parameter is missing, unknown or impossible.
    """
    if name in SHIPPED:
        text = (files("sitl.models") / f"{name}.toml").read_text(encoding="utf-8")
    else:
        try:
            text = Path(name).read_text(encoding="utf-8")
        except OSError as error:
            known = ", ".join(SHIPPED)
            raise ValueError(f"{name}: {error.strerror}; a model is {known} or a TOML file") from error
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{name}: {error}") from error
    missing = [field for field in Parameters._fields if field not in table]
    unknown = [key for key in table if key not in Parameters._fields]
    if missing or unknown:
        raise ValueError(f"{name}: missing {', '.join(missing) or '-'}; unknown {', '.join(unknown) or '-'}")
    for key, value in table.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError(f"{name}: {key} must be a finite number, not {value!r}")
        if key in POSITIVE and not value > 0.0:
            raise ValueError(f"{name}: {key} must be above 0, not {value}")
        if key not in SIGNED and value < 0.0:
            raise ValueError(f"{name}: {key} must not be negative, not {value}")
    return Parameters(**{key: float(value) for key, value in table.items()})
