"""The vehicle's own estimate at one instant: plant state plus noise, in every form that telemetry needs."""

from __future__ import annotations

import math
import random
from typing import Final, NamedTuple

from sitl.plant import PlantState, Triple, Wxyz, euler_from_attitude, rotation
from sitl.vehicle.options import Origin
from sitl.vehicle.projection import Projection

GRAVITY_M_S2: Final = 9.80665
#: A magnetic field in NED (gauss) as the recorded simulator has it.
FIELD_NED_GAUSS: Final = (0.2158, 0.0126, 0.4284)


class Astray(NamedTuple):
    """How far the estimator is off the truth: its position and velocity, its heading turned to the right."""

    moved_ned_m: Triple = (0.0, 0.0, 0.0)
    turned_rad: float = 0.0
    faster_ned_m_s: Triple = (0.0, 0.0, 0.0)


#: An estimator that is right.
RIGHT: Final = Astray()


class Sample:
    """What the estimator says at `boot_ns`; all telemetry of one loop comes from one sample."""

    __slots__ = (
        "attitude_wxyz",
        "body_rates_frd_rad_s",
        "boot_ms",
        "boot_us",
        "euler_rad",
        "origin",
        "position_ned_m",
        "project",
        "rows",
        "speed_m_s",
        "velocity_ned_m_s",
    )

    def __init__(
        self,
        boot_ns: int,
        state: PlantState,
        origin: Origin,
        dice: random.Random | None,
        position_noise_m: float,
        attitude_noise_rad: float,
        project: Projection,
        astray: Astray = RIGHT,
        current_ned_m_s: Triple = (0.0, 0.0, 0.0),
    ) -> None:
        self.boot_us = boot_ns // 1000
        self.boot_ms = boot_ns // 1_000_000 & 0xFFFFFFFF
        self.origin = origin
        self.project = project
        position, attitude, rates, speed = state
        if astray is not RIGHT:
            position, attitude = _astray(position, attitude, astray)
        if dice is not None:
            position, attitude = _noisy(position, attitude, dice, position_noise_m, attitude_noise_rad)
        self.position_ned_m = position
        self.attitude_wxyz = attitude
        self.body_rates_frd_rad_s = rates
        self.speed_m_s = speed
        self.rows = rows = rotation(attitude)
        north, east, down = (
            carried + wrong for carried, wrong in zip(current_ned_m_s, astray.faster_ned_m_s, strict=True)
        )
        self.velocity_ned_m_s = (
            speed * rows[0][0] + north,
            speed * rows[1][0] + east,
            speed * rows[2][0] + down,
        )
        self.euler_rad = euler_from_attitude(attitude)

    def to_body(self, x: float, y: float, z: float) -> Triple:
        """A world (NED) vector in body (FRD) coordinates."""
        a, b, c = self.rows
        return (
            a[0] * x + b[0] * y + c[0] * z,
            a[1] * x + b[1] * y + c[1] * z,
            a[2] * x + b[2] * y + c[2] * z,
        )

    def specific_force_frd_m_s2(self) -> Triple:
        """What an accelerometer reads at steady speed: rates x velocity minus gravity, body axes."""
        _, q, r = self.body_rates_frd_rad_s
        gx, gy, gz = self.to_body(0.0, 0.0, GRAVITY_M_S2)
        return (-gx, r * self.speed_m_s - gy, -q * self.speed_m_s - gz)

    def geodetic(self) -> tuple[int, int, float]:
        """Latitude and longitude in 1e-7 degrees, altitude in metres above mean sea level."""
        return self.project(self.origin, self.position_ned_m)

    def heading_cdeg(self) -> int:
        """Heading of the nose in 0.01 degrees, 0 to 35999."""
        return round(math.degrees(self.euler_rad[2]) * 100.0) % 36000


def _astray(position: Triple, attitude: Wxyz, astray: Astray) -> tuple[Triple, Wxyz]:
    """The heading is wrong, not the place: only the attitude (and with it the velocity) is turned."""
    c, s = math.cos(0.5 * astray.turned_rad), math.sin(0.5 * astray.turned_rad)
    w, x, y, z = attitude
    north, east, down = (at + by for at, by in zip(position, astray.moved_ned_m, strict=True))
    return (north, east, down), (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)


def _noisy(
    position: Triple, attitude: Wxyz, dice: random.Random, position_noise_m: float, attitude_noise_rad: float
) -> tuple[Triple, Wxyz]:
    gauss = dice.gauss
    moved = (
        position[0] + gauss(0.0, position_noise_m),
        position[1] + gauss(0.0, position_noise_m),
        position[2] + gauss(0.0, position_noise_m),
    )
    x, y, z = (gauss(0.0, 0.5 * attitude_noise_rad) for _ in range(3))
    w, a, b, c = attitude
    turned = (
        w - a * x - b * y - c * z,
        a + w * x + b * z - c * y,
        b + w * y - a * z + c * x,
        c + w * z + a * y - b * x,
    )
    norm = math.sqrt(sum(part * part for part in turned))
    return moved, (turned[0] / norm, turned[1] / norm, turned[2] / norm, turned[3] / norm)
