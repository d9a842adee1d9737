"""The handling of a PX4 rover: the law's yaw rate and speed, said as the velocity that PX4 drives by.

What PX4 does with one (`AckermannPosVelControl` and `DifferentialPosVelControl` of 2025-02, the OffboardMode
of either since): the speed is the velocity's length, so it never reverses; the heading is steered to its
bearing by a yaw rate of RO_YAW_P times what is missing; yaw and yaw rate of the setpoint are not read. So a
yaw rate w is asked for by a bearing that is w/RO_YAW_P off the heading. That is the heading that PX4 sees
while it holds the setpoint, not the one when the wheels answer: PX4 takes the difference to the heading it
has.

- A velocity of zero has the bearing 0: a rover that turns at rest would turn to the north. To stand, it is
  told the least speed along its nose instead.
- Later versions stop a differential rover that is more than RD_TRANS_DRV_TRN off, and turn it on the spot
  until it is less than RD_TRANS_TRN_DRV off. It is never asked for a bearing so far off; at rest it turns
  all the same.
- The speed loop is commonly left open (RO_SPEED_P 0.001 and a feed-forward that was 1.37 times too much, as
  measured): that is the speed loop's to learn.
"""

from __future__ import annotations

from math import cos, inf, radians, sin, tan
from typing import Final, NamedTuple

from guidance.handling.ground import Demand
from guidance.limits import clamp
from guidance.se3 import Vec3

#: What stands is told this speed, m/s: a bearing, and far below what moves a wheel (RO_SPEED_TH 0.1).
STANDING_M_S: Final = 0.02
#: A bearing is at most this far off the heading, rad: farther, and noise would turn it round the other way.
BEARING_MAX_RAD: Final = 2.5
#: Of RD_TRANS_DRV_TRN, so much is used.
SPOT_TURN_PART: Final = 0.8
#: What the tyres hold, m/s^2; PX4 has no such parameter.
LATERAL_M_S2: Final = 3.0


class Autopilot(NamedTuple):
    """PX4's parameters, in its units; inf is no limit. A differential rover has 0 for RA_*, an
    Ackermann one for RD_*."""

    RO_YAW_P: float
    RO_YAW_RATE_LIM: float = inf
    RO_SPEED_LIM: float = inf
    RO_ACCEL_LIM: float = inf
    RO_YAW_ACCEL_LIM: float = inf
    RA_WHEEL_BASE: float = 0.0
    RA_MAX_STR_ANG: float = 0.0
    RD_TRANS_DRV_TRN: float = 0.0


def turning_radius_m(autopilot: Autopilot) -> float:
    """Of the tightest turn; 0 of one that turns at rest."""
    a = autopilot
    return a.RA_WHEEL_BASE / tan(a.RA_MAX_STR_ANG) if a.RA_MAX_STR_ANG > 0.0 else 0.0


def yaw_rate_max_rad_s(autopilot: Autopilot) -> float:
    """The most that can be asked for by a bearing."""
    return min(radians(autopilot.RO_YAW_RATE_LIM), _bearing_max_rad(autopilot) * autopilot.RO_YAW_P)


def velocity_of(autopilot: Autopilot, demand: Demand, heading_rad: float) -> Vec3:
    """The velocity (NED, m/s) that asks for this yaw rate and speed of a rover that will be seen at this
    heading while the velocity is held."""
    most = _bearing_max_rad(autopilot)
    bearing = heading_rad + clamp(demand.yaw_rate_rad_s / autopilot.RO_YAW_P, -most, most)
    speed = max(demand.speed_m_s, STANDING_M_S)
    return Vec3(speed * cos(bearing), speed * sin(bearing), 0.0)


def _bearing_max_rad(a: Autopilot) -> float:
    return SPOT_TURN_PART * a.RD_TRANS_DRV_TRN if a.RD_TRANS_DRV_TRN > 0.0 else BEARING_MAX_RAD
