"""A turn that is too fast is driven more slowly on the same path, not more widely at the same speed.

The path's curvature is yaw rate over speed. Where the wanted turn exceeds what the vehicle may do at this
speed, both are shortened by one factor, down to the speed below which a vehicle on wheels turns less, too.
"""

from __future__ import annotations

from math import sqrt


def kept_curvature(
    speed_m_s: float,
    yaw_rate_rad_s: float,
    yaw_rate_max_rad_s: float,
    lateral_acceleration_m_s2: float,
    slowest_m_s: float,
) -> float:
    """The speed (m/s, of `speed_m_s`'s sign) at which this curvature stays within both limits (> 0).

    Not below `slowest_m_s`, unless the wanted speed is.
    """
    speed = abs(speed_m_s)
    turn = abs(yaw_rate_rad_s)
    if speed <= slowest_m_s:
        return speed_m_s
    part = 1.0
    if turn > yaw_rate_max_rad_s:
        part = yaw_rate_max_rad_s / turn
    # the lateral acceleration v w falls with the square of the factor
    if part * part * speed * turn > lateral_acceleration_m_s2:
        part = sqrt(lateral_acceleration_m_s2 / (speed * turn))
    if part * speed < slowest_m_s:
        part = slowest_m_s / speed
    return part * speed_m_s
