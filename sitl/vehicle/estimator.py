"""The autopilot's estimator: the body as it is, off by noise and by slow errors, at 50 Hz."""

from __future__ import annotations

import math
import random
from math import exp, radians
from typing import Final, NamedTuple

from sitl.plant import Triple, Wxyz
from sitl.vehicle.body import BodyState

#: The estimator draws anew so often, whatever is asked of it.
PERIOD_NS: Final = 20_000_000
PERIOD_S: Final = 0.02
#: What it says of the wind follows the wind that blows with this lag, as an EKF's does: no gusts are in it.
WIND_LAG_S: Final = 5.0


class Noise(NamedTuple):
    """Sigma of what is new in every estimate, and errors that stay.

    The position's bias wanders in each axis with half of `position_bias_m` as its sigma, never beyond it,
    and `position_bias_s` as its correlation time (Gauss-Markov). The heading is off by `heading_bias_rad`
    all the time, to the side that the seed says.
    """

    position_m: float = 0.0
    position_bias_m: float = 0.0
    position_bias_s: float = 30.0
    heading_bias_rad: float = 0.0
    attitude_rad: float = 0.0
    velocity_m_s: float = 0.0
    airspeed_m_s: float = 0.0


SILENT: Final = Noise()
#: An outdoor vehicle with a good receiver and a magnetometer.
USUAL: Final = Noise(0.05, 0.1, 30.0, radians(2.0), radians(0.3), 0.05, 0.3)


class Astray(NamedTuple):
    """How far the estimator is off the truth: its position and velocity, its heading turned to the right."""

    moved_ned_m: Triple = (0.0, 0.0, 0.0)
    turned_rad: float = 0.0
    faster_ned_m_s: Triple = (0.0, 0.0, 0.0)


#: An estimator that is right.
RIGHT: Final = Astray()


class _Errors(NamedTuple):
    position_ned_m: Triple
    heading_rad: float
    attitude_rad: Triple
    velocity_ned_m_s: Triple
    airspeed_m_s: float


class Estimator:
    """Errors drawn by a seed and the time since `start_ns` alone; `astray` may be set at any instant."""

    def __init__(self, noise: Noise, seed: int, start_ns: int) -> None:
        self.astray = RIGHT
        self._noise = noise
        self._start_ns = start_ns
        self._tick = -1
        self._dice = random.Random(seed)
        self._side = self._dice.choice((-1.0, 1.0))
        half = 0.5 * noise.position_bias_m
        self._keep = exp(-PERIOD_S / noise.position_bias_s)
        self._kick_m = half * math.sqrt(1.0 - self._keep * self._keep)
        self._bias_m = [self._dice.gauss(0.0, half) for _ in range(3)]
        self._errors = self._drawn() if noise != SILENT else None
        self._wind_ned_m_s: Triple | None = None

    @property
    def position_bias_ned_m(self) -> Triple:
        """How far its position is off for longer than one estimate."""
        bound = self._noise.position_bias_m
        x, y, z = (max(-bound, min(bound, bias)) for bias in self._bias_m)
        return x, y, z

    def estimate(self, body: BodyState, at_ns: int) -> BodyState:
        """What it makes of the body at `at_ns`; instants do not run backwards."""
        tick = (at_ns - self._start_ns) // PERIOD_NS
        position, attitude, velocity = body.position_ned_m, body.attitude_wxyz, body.velocity_ned_m_s
        airspeed = body.airspeed_m_s
        if self.astray is not RIGHT:
            moved, turned_rad, faster = self.astray
            position = _sum(position, moved)
            attitude = _turned(attitude, turned_rad)
            velocity = _sum(_turned_vector(velocity, turned_rad), faster)
        if self._errors is not None:
            for _ in range(tick - self._tick):
                self._errors = self._drawn()
            error = self._errors
            position = _sum(position, error.position_ned_m)
            attitude = _shaken(_turned(attitude, error.heading_rad), error.attitude_rad)
            velocity = _sum(velocity, error.velocity_ned_m_s)
            if airspeed:
                airspeed = max(0.0, airspeed + error.airspeed_m_s)
        wind = self._slow_wind(body.wind_ned_m_s, (tick - self._tick) * PERIOD_S)
        self._tick = max(tick, self._tick)
        return BodyState(
            position,
            attitude,
            body.body_rates_frd_rad_s,
            velocity,
            body.speed_m_s,
            airspeed,
            wind,
            body.throttle,
        )

    def _drawn(self) -> _Errors:
        noise, gauss = self._noise, self._dice.gauss
        self._bias_m = [self._keep * bias + gauss(0.0, self._kick_m) for bias in self._bias_m]
        x, y, z = (bias + gauss(0.0, noise.position_m) for bias in self.position_bias_ned_m)
        a, b, c = (gauss(0.0, noise.attitude_rad) for _ in range(3))
        u, v, w = (gauss(0.0, noise.velocity_m_s) for _ in range(3))
        heading = self._side * noise.heading_bias_rad
        return _Errors((x, y, z), heading, (a, b, c), (u, v, w), gauss(0.0, noise.airspeed_m_s))

    def _slow_wind(self, wind_ned_m_s: Triple, dt_s: float) -> Triple:
        said = self._wind_ned_m_s
        if said is None or said == wind_ned_m_s:
            self._wind_ned_m_s = wind_ned_m_s
        else:
            part = 1.0 - exp(-max(0.0, dt_s) / WIND_LAG_S)
            north, east, down = (
                now + part * (is_ - now) for now, is_ in zip(said, wind_ned_m_s, strict=True)
            )
            self._wind_ned_m_s = (north, east, down)
        return self._wind_ned_m_s


def _sum(a: Triple, b: Triple) -> Triple:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _turned(attitude: Wxyz, by_rad: float) -> Wxyz:
    """The attitude after a turn to the right about the vertical of the world."""
    c, s = math.cos(0.5 * by_rad), math.sin(0.5 * by_rad)
    w, x, y, z = attitude
    return (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)


def _turned_vector(ned: Triple, by_rad: float) -> Triple:
    c, s = math.cos(by_rad), math.sin(by_rad)
    return (c * ned[0] - s * ned[1], s * ned[0] + c * ned[1], ned[2])


def _shaken(attitude: Wxyz, by_rad: Triple) -> Wxyz:
    """The attitude after small turns about the body's axes."""
    x, y, z = (0.5 * angle for angle in by_rad)
    w, a, b, c = attitude
    turned = (
        w - a * x - b * y - c * z,
        a + w * x + b * z - c * y,
        b + w * y - a * z + c * x,
        c + w * z + a * y - b * x,
    )
    norm = math.sqrt(sum(part * part for part in turned))
    return (turned[0] / norm, turned[1] / norm, turned[2] / norm, turned[3] / norm)
