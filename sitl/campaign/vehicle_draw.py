"""From a vehicle's plan and the numbers of a flight to the row that says how it starts and what is wrong."""

from __future__ import annotations

from math import cos, radians, sin, sqrt, tau

import numpy as np
from numpy.typing import NDArray

from sitl.campaign.draw import between, uniforms
from sitl.campaign.flight import Rows
from sitl.campaign.vehicle_plan import PARAMETERS, VehiclePlan
from sitl.vehicle.estimator import USUAL


def drawn(plan: VehiclePlan, first: int, count: int) -> Rows:
    """Rows of `PARAMETERS` of flights `first` to `first + count - 1`."""
    rows = np.zeros((count, len(PARAMETERS)))
    for row, u in zip(rows, uniforms(plan.seed, first, count), strict=True):
        nearest, farthest = plan.distance_m
        distance = sqrt(nearest**2 + u[0] * (farthest**2 - nearest**2))
        off = radians(between(plan.off_deg, u[3]))
        wind = between(plan.wind_m_s, u[9])
        row[:] = (
            distance * sin(tau * u[1]),
            distance * cos(tau * u[1]),
            between(plan.up_m, u[2]),
            off if u[4] < 0.5 else -off,
            between(plan.gain, u[5]),
            between(plan.power, u[6]),
            between(plan.slew, u[7]),
            between(plan.delay_s, u[8]),
            wind * cos(tau * u[10]),
            wind * sin(tau * u[10]),
            wind * between(plan.gusts, u[11]),
            between(plan.noise, u[12]),
            between((-USUAL.heading_bias_rad, USUAL.heading_bias_rad), u[13]),
        )
    return rows


def normals(plan: VehiclePlan, flight: int, count: int, width: int) -> NDArray[np.float64]:
    """The noise of one flight: its own stream of the campaign's seed, (count, width)."""
    key = np.array([plan.seed, flight + 1], np.uint64)
    return np.random.Generator(np.random.Philox(key=key)).standard_normal((count, width))
