"""Where an airplane is when the demand that is being computed acts: it goes on turning as it banks now.

Telemetry is old when it comes, and a bank takes its time to build up; a fifth of a second is 4 m at 20 m/s.
Position and reference are moved to the same instant, or the 4 m become an error (measured: 2.6 m).
"""

from __future__ import annotations

from math import cos, sin, sqrt, tan

from guidance.handling.airplane_bank import GRAVITY_M_S2, STEEPEST_RAD
from guidance.limits import clamp
from guidance.se3 import Vec3


def coasted(
    position_m: Vec3,
    velocity_ned_m_s: Vec3,
    wind_ned_m_s: Vec3,
    bank_rad: float,
    effectiveness: float,
    ahead_s: float,
) -> tuple[Vec3, Vec3]:
    """Position and velocity `ahead_s` (>= 0) later, in a turn at constant bank, airspeed and climb."""
    north = velocity_ned_m_s.x - wind_ned_m_s.x
    east = velocity_ned_m_s.y - wind_ned_m_s.y
    air = max(sqrt(north * north + east * east), 1.0)
    banked = tan(clamp(bank_rad, -STEEPEST_RAD, STEEPEST_RAD))
    angle = effectiveness * GRAVITY_M_S2 * banked / air * ahead_s
    # the chord is at half the angle; its length is the arc's to second order
    c, s = cos(0.5 * angle), sin(0.5 * angle)
    half_north, half_east = c * north - s * east, s * north + c * east
    return (
        Vec3(
            position_m.x + (half_north + wind_ned_m_s.x) * ahead_s,
            position_m.y + (half_east + wind_ned_m_s.y) * ahead_s,
            position_m.z + velocity_ned_m_s.z * ahead_s,
        ),
        Vec3(
            c * half_north - s * half_east + wind_ned_m_s.x,
            s * half_north + c * half_east + wind_ned_m_s.y,
            velocity_ned_m_s.z,
        ),
    )
