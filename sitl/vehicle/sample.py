"""The vehicle's own estimate at one instant, in every form that telemetry needs."""

from __future__ import annotations

import math
from typing import Final

from sitl.plant import Triple, euler_from_attitude, rotation
from sitl.vehicle.body import BodyState
from sitl.vehicle.options import Origin
from sitl.vehicle.projection import Projection

GRAVITY_M_S2: Final = 9.80665
#: A magnetic field in NED (gauss) as the recorded simulator has it.
FIELD_NED_GAUSS: Final = (0.2158, 0.0126, 0.4284)


class Sample:
    """What the estimator says at `boot_ns`; all telemetry of one loop comes from one sample."""

    __slots__ = (
        "attitude_wxyz",
        "body_rates_frd_rad_s",
        "boot_ms",
        "boot_us",
        "estimate",
        "euler_rad",
        "origin",
        "position_ned_m",
        "project",
        "rows",
        "speed_m_s",
        "velocity_ned_m_s",
    )

    def __init__(self, boot_ns: int, estimate: BodyState, origin: Origin, project: Projection) -> None:
        self.boot_us = boot_ns // 1000
        self.boot_ms = boot_ns // 1_000_000 & 0xFFFFFFFF
        self.origin = origin
        self.project = project
        self.estimate = estimate
        self.position_ned_m = estimate.position_ned_m
        self.attitude_wxyz = estimate.attitude_wxyz
        self.body_rates_frd_rad_s = estimate.body_rates_frd_rad_s
        self.velocity_ned_m_s = estimate.velocity_ned_m_s
        self.speed_m_s = estimate.speed_m_s
        self.rows = rotation(estimate.attitude_wxyz)
        self.euler_rad = euler_from_attitude(estimate.attitude_wxyz)

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
