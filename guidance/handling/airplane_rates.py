"""From the attitude that an airplane is to have to the body rates that bring it there, in a coordinated turn.

For an autopilot that is told rates: roll and pitch angle are closed here, in proportion, and the heading is
not at all. It goes round as the bank makes it, psi' = eta g tan(phi)/V, and that is fed forward:

    p = phi' - psi' sin(theta)
    q = theta' cos(phi) + psi' sin(phi) cos(theta)
    r = psi' cos(phi) cos(theta) - theta' sin(phi)
"""

from __future__ import annotations

from math import cos, sin, tan

from guidance.handling.airplane_bank import GRAVITY_M_S2, STEEPEST_RAD
from guidance.limits import clamp
from guidance.se3 import Vec3


def turn_rate_rad_s(bank_rad: float, airspeed_m_s: float, effectiveness: float) -> float:
    """psi' of the steady turn at this bank and airspeed (> 0)."""
    banked = clamp(bank_rad, -STEEPEST_RAD, STEEPEST_RAD)
    return effectiveness * GRAVITY_M_S2 * tan(banked) / airspeed_m_s


def body_rates(
    roll_rad: float, pitch_rad: float, roll_rate_rad_s: float, pitch_rate_rad_s: float, turn_rate_rad_s: float
) -> Vec3:
    """Body rates (FRD, rad/s) of these rates of the Euler angles phi, theta, psi, at this roll and pitch."""
    s, c = sin(roll_rad), cos(roll_rad)
    level = cos(pitch_rad)
    return Vec3(
        roll_rate_rad_s - turn_rate_rad_s * sin(pitch_rad),
        pitch_rate_rad_s * c + turn_rate_rad_s * s * level,
        turn_rate_rad_s * c * level - pitch_rate_rad_s * s,
    )
