"""The MAVLink messages that tell of the air that an airplane flies in."""

from __future__ import annotations

from typing import NamedTuple


class VfrHud(NamedTuple):
    """VFR_HUD (74): the calibrated airspeed in m/s (PX4 `VFR_HUD.hpp`; ArduPlane's sensor, else its estimate;
    0 or NaN: none), and the height above mean sea level in m."""

    airspeed: float
    alt: float


class Wind(NamedTuple):
    """WIND (168) of ArduPilot: where it comes from in deg, its speed and its vertical part (down) in m/s."""

    direction: float
    speed: float
    speed_z: float


class WindCov(NamedTuple):
    """WIND_COV (231) of PX4: the wind's own velocity, NED, in m/s."""

    wind_x: float
    wind_y: float
    wind_z: float


#: What tells of the air that an airplane flies in.
AirBody = VfrHud | Wind | WindCov
