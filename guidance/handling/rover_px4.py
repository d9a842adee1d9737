"""The handling of a PX4 rover: the law's yaw rate and speed, said as the velocity that PX4 drives by.

What PX4 does with one (`AckermannPosVelControl` and `DifferentialPosVelControl` of 2025-02, the OffboardMode
of either since): the speed is the velocity's length, so it never reverses; the heading is steered to its
bearing by a yaw rate of RO_YAW_P times what is missing; yaw and yaw rate of the setpoint are not read. So a
yaw rate w is asked for by a bearing that is w/RO_YAW_P off the heading. That is the heading that PX4 sees
when the setpoint comes, not the one when the wheels answer: PX4 takes the difference to the heading it has.

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

from guidance.allocation import PITCH_YAW
from guidance.error_function import bounded
from guidance.handling import ground, slip, smoothing, speed_loop, stuck, waiting
from guidance.handling.rover import ACCELERATION_PART, APPROACH_PART, WAITING
from guidance.law import GLOBAL, Gains, Limits, Parameters
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
#: How long speed takes to answer, apart from the delay.
SPEED_LAG_S: Final = 0.35


class Autopilot(NamedTuple):
    """PX4's parameters, in its units, with those of its simulated Ackermann rover; an acceleration of 0 is no
    limit there. A differential rover has no RA_* (0), an Ackermann rover no RD_* (0)."""

    RO_SPEED_LIM: float = 3.0
    RO_ACCEL_LIM: float = 3.0
    RO_YAW_P: float = 5.0
    RO_YAW_RATE_LIM: float = 180.0
    RO_YAW_ACCEL_LIM: float = 400.0
    RA_WHEEL_BASE: float = 0.321
    RA_MAX_STR_ANG: float = 0.5236
    RD_TRANS_DRV_TRN: float = 0.0


def handling(autopilot: Autopilot, delay_s: float, *, waits: bool = False) -> ground.Parameters:
    """The default of the profile `px4-rover`.

    The caller has checked the parameters: RO_SPEED_LIM, RO_YAW_P and RO_YAW_RATE_LIM > 0, and either both
    RA_* or RD_TRANS_DRV_TRN. `delay_s` is from a setpoint to motion, as measured; `waits`: with a reference
    that waits.
    """
    a = autopilot
    radius = a.RA_WHEEL_BASE / tan(a.RA_MAX_STR_ANG) if a.RA_MAX_STR_ANG > 0.0 else 0.0
    yaw_rate = min(radians(a.RO_YAW_RATE_LIM), _bearing_max_rad(a) * a.RO_YAW_P)
    return ground.Parameters(
        Parameters(
            GLOBAL,
            PITCH_YAW,
            Gains(k=1.0, rho2=3.0, rho3=3.0, beta=1.0),
            bounded(APPROACH_PART * a.RO_SPEED_LIM),
            Limits(
                speed_min_m_s=0.0,
                speed_max_m_s=a.RO_SPEED_LIM,
                roll_rate_rad_s=0.0,
                pitch_rate_rad_s=0.0,
                yaw_rate_rad_s=yaw_rate,
                keep_direction=True,
                acceleration_m_s2=ACCELERATION_PART * a.RO_ACCEL_LIM if a.RO_ACCEL_LIM > 0.0 else inf,
                yaw_acceleration_rad_s2=radians(a.RO_YAW_ACCEL_LIM) if a.RO_YAW_ACCEL_LIM > 0.0 else inf,
            ),
        ),
        crawl_m_s=min(radius * yaw_rate, 0.5 * a.RO_SPEED_LIM),
        lateral_acceleration_m_s2=LATERAL_M_S2,
        yaw_gain=1.0,
        smoothing=smoothing.Parameters(time_constant_s=0.15, jump_m=0.5),
        slip=slip.Parameters(time_constant_s=2.0, speed_min_m_s=0.7, bound_rad=0.15),
        speed_loop=speed_loop.Parameters(kp=0.45, ki=0.4, lag_s=SPEED_LAG_S + delay_s, part=0.5),
        waiting=WAITING if waits else waiting.OFF,
        stuck=stuck.Parameters(asked_m_s=0.3, speed_m_s=0.15, yaw_rate_rad_s=0.05, after_s=3.0),
    )


def velocity_of(autopilot: Autopilot, demand: ground.Demand, heading_rad: float) -> Vec3:
    """The velocity (NED, m/s) that asks for this yaw rate and speed of a rover that will be seen at this
    heading when the velocity comes."""
    most = _bearing_max_rad(autopilot)
    bearing = heading_rad + clamp(demand.yaw_rate_rad_s / autopilot.RO_YAW_P, -most, most)
    speed = max(demand.speed_m_s, STANDING_M_S)
    return Vec3(speed * cos(bearing), speed * sin(bearing), 0.0)


def _bearing_max_rad(a: Autopilot) -> float:
    return SPOT_TURN_PART * a.RD_TRANS_DRV_TRN if a.RD_TRANS_DRV_TRN > 0.0 else BEARING_MAX_RAD
