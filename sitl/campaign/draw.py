"""From uniform numbers to flights: where a flight starts, with what gains and limits, in what wind.

The numbers of flight `i` of seed `s` are a function of `i` and `s` alone (a counter-based generator), so that
a campaign may be cut into pieces anywhere, flown anywhere in any order, and is the same.
"""

from __future__ import annotations

from math import cos, pi, sin, sqrt, tau
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sitl.campaign.flight import Common, reference_at

Pair = tuple[float, float]

#: Uniform numbers per flight; a multiple of 4, which is what one count of the generator gives.
DRAWS: Final = 28


class Ranges(NamedTuple):
    """Lowest and highest value of all that is drawn, uniformly and independently; directions are uniform.

    `distance_m` is that from the reference at the start (uniform in volume, or in area). `wind_m_s`,
    `gust_m_s` and `start_rate_rad_s` are magnitudes; a planar flight starts with a yaw rate alone, to either
    side.
    """

    distance_m: Pair
    start_s: Pair
    k: Pair
    rho2_per_s: Pair
    rho3_per_s: Pair
    beta: Pair
    speed_min_m_s: Pair
    speed_max_m_s: Pair
    rate_max_rad_s: Pair
    wind_m_s: Pair
    gust_m_s: Pair
    delay_s: Pair
    rate_lag_s: Pair
    speed_lag_s: Pair
    start_speed_m_s: Pair
    start_rate_rad_s: Pair


def uniforms(seed: int, first: int, count: int) -> NDArray[np.float64]:
    """The numbers in [0, 1) of flights `first` to `first + count - 1`: (count, DRAWS)."""
    generator = np.random.Philox(key=seed)
    generator.advance(first * (DRAWS // 4))
    return np.random.Generator(generator).random((count, DRAWS))


def between(pair: Pair, u: float) -> float:
    """The value at `u` of the way."""
    return pair[0] + u * (pair[1] - pair[0])


def direction(is_planar: bool, u: float, v: float) -> tuple[float, float, float]:
    """A unit vector, uniform on the sphere, or on the horizontal circle."""
    down = 0.0 if is_planar else 2.0 * u - 1.0
    level = sqrt(1.0 - down * down)
    return level * cos(tau * v), level * sin(tau * v), down


def draw(common: Common, ranges: Ranges, u: NDArray[np.float64], flights: NDArray[np.float64]) -> None:
    """Write the rows of `flights` (n, PARAMETERS) for the uniform numbers `u` (n, DRAWS)."""
    for j in range(u.shape[0]):
        start_s = between(ranges.start_s, u[j, 6])
        reference = reference_at(common.trajectory, common.shape, start_s)
        nearest, farthest = ranges.distance_m
        power = 2.0 if common.is_planar else 3.0
        distance = (nearest**power + u[j, 0] * (farthest**power - nearest**power)) ** (1.0 / power)
        north, east, down = direction(common.is_planar, u[j, 1], u[j, 2])
        flights[j, 0] = reference.position.x + distance * north
        flights[j, 1] = reference.position.y + distance * east
        flights[j, 2] = reference.position.z + distance * down
        # Uniform on SO(3): Shoemake, "Uniform random rotations", Graphics Gems III.
        a, b = (0.0, 1.0) if common.is_planar else (sqrt(1.0 - u[j, 3]), sqrt(u[j, 3]))
        flights[j, 3] = b * cos(tau * u[j, 5]) if not common.is_planar else cos(pi * u[j, 5])
        flights[j, 4] = a * sin(tau * u[j, 4])
        flights[j, 5] = a * cos(tau * u[j, 4])
        flights[j, 6] = b * sin(tau * u[j, 5]) if not common.is_planar else sin(pi * u[j, 5])
        flights[j, 7] = start_s
        flights[j, 8] = between(ranges.k, u[j, 7])
        flights[j, 9] = between(ranges.rho2_per_s, u[j, 8])
        flights[j, 10] = between(ranges.rho3_per_s, u[j, 9])
        flights[j, 11] = between(ranges.beta, u[j, 10])
        flights[j, 12] = between(ranges.speed_min_m_s, u[j, 11])
        flights[j, 13] = between(ranges.speed_max_m_s, u[j, 12])
        flights[j, 14] = between(ranges.rate_max_rad_s, u[j, 13])
        wind = between(ranges.wind_m_s, u[j, 14])
        north, east, down = direction(common.is_planar, u[j, 15], u[j, 16])
        flights[j, 15], flights[j, 16], flights[j, 17] = wind * north, wind * east, wind * down
        gust = between(ranges.gust_m_s, u[j, 17])
        north, east, down = direction(common.is_planar, u[j, 18], u[j, 19])
        flights[j, 18], flights[j, 19], flights[j, 20] = gust * north, gust * east, gust * down
        flights[j, 21] = tau * u[j, 20]
        flights[j, 22] = between(ranges.delay_s, u[j, 21])
        flights[j, 23] = between(ranges.rate_lag_s, u[j, 22])
        flights[j, 24] = between(ranges.speed_lag_s, u[j, 23])
        rate = between(ranges.start_rate_rad_s, u[j, 24])
        if common.is_planar:
            flights[j, 25], flights[j, 26] = 0.0, 0.0
            flights[j, 27] = rate if u[j, 25] < 0.5 else -rate
        else:
            roll, pitch, yaw = direction(False, u[j, 25], u[j, 26])
            flights[j, 25], flights[j, 26], flights[j, 27] = rate * roll, rate * pitch, rate * yaw
        flights[j, 28] = between(ranges.start_speed_m_s, u[j, 27])
