"""What a copter can do of a trajectory: what configuration and autopilot leave it, and which binds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from guidance.abilities import FREE, Bound, VelocityAbilities
from guidance.config import Config
from guidance.handling import velocity
from guidance.handling.copter import ACCELERATION_PART, ArduPilot, Px4, tilted_m_s2


class _Names(NamedTuple):
    """What either firmware calls its limits; `stock` are its defaults, which hold where it tells none."""

    speed: str
    up: str
    down: str
    acceleration: str
    tilt: str
    stock: Mapping[str, float]


_PX4 = _Names(
    "MPC_XY_VEL_MAX",
    "MPC_Z_VEL_MAX_UP",
    "MPC_Z_VEL_MAX_DN",
    "MPC_ACC_HOR",
    "MPC_TILTMAX_AIR",
    Px4._field_defaults,
)
_ARDUPILOT = _Names("WP_SPD", "WP_SPD_UP", "WP_SPD_DN", "WP_ACC", "ATC_ANGLE_MAX", ArduPilot._field_defaults)


def assumed(values: Mapping[str, float]) -> dict[str, float]:
    """What is taken for those of the autopilot's parameters (`values`) that it does not tell."""
    stock = _names(values).stock
    return {name: value for name, value in stock.items() if name not in values}


def abilities(config: Config, values: Mapping[str, float], p: velocity.Parameters) -> VelocityAbilities:
    """Of the parameters as they were fitted to both."""
    c, limits, names = config.copter, config.limits, _names(values)
    stock = {**names.stock, **values}

    def told(name: str) -> Bound:
        return Bound(stock[name], f"{name} {stock[name]:g}")

    lean = stock[names.tilt]
    speed = min(Bound(limits.speed_max_m_s, "limits.speed_max_m_s"), told(names.speed))
    up = min(told(names.up), _own(c.up_max_m_s, "copter.up_max_m_s"))
    down = min(told(names.down), _own(c.down_max_m_s, "copter.down_max_m_s"))
    acceleration = min(
        told(names.acceleration),
        Bound(tilted_m_s2(lean), f"g tan {names.tilt} {lean:g}"),
        _own(limits.acceleration_max_m_s2, "limits.acceleration_max_m_s2"),
    ).less(1.0 - ACCELERATION_PART)
    own_lean = c.tilt_max_deg if c.output == "rates" else None
    if own_lean is not None and own_lean < lean and p.limits.acceleration_m_s2 < acceleration.value:
        acceleration = Bound(p.limits.acceleration_m_s2, f"copter.tilt_max_deg {own_lean:g}")
    return VelocityAbilities(
        speed._replace(value=p.limits.speed_max_m_s),
        up._replace(value=p.up_max_m_s),
        down._replace(value=p.down_max_m_s),
        acceleration._replace(value=p.limits.acceleration_m_s2),
    )


def _names(values: Mapping[str, float]) -> _Names:
    return _PX4 if _PX4.speed in values else _ARDUPILOT


def _own(limit: float | None, key: str) -> Bound:
    return FREE if limit is None else Bound(limit, key)
