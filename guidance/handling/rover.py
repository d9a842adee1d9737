"""The handling of an ArduPilot rover from its own parameters, and from what was measured of its answer.

What binds each number, in the order in which they should be set:

- the yaw slew and the yaw rate are the autopilot's; of the slew, the turn profile of `alignment` counts on a
  part;
- rho times (delay + lag) stays below a half: 3 with 0.1 s left after prediction, and room for 60 ms unknown;
- lambda k is at most 1/s, because speed answers in about a second; with 1.2 a delay that nobody knows of
  makes a limit cycle of a metre, with 1.0 it does not;
- the speed is asked to change a little more slowly than the autopilot lets it, so that it can follow;
- the approach needs room, not damping: it is nearly as fast as the vehicle;
- the crawl is the speed at which the tightest turn takes the highest yaw rate: slower turns take longer on
  the same arc, and faster ones a wider arc.
"""

from __future__ import annotations

from math import inf, radians
from typing import Final, NamedTuple

from guidance.allocation import PITCH_YAW
from guidance.error_function import bounded
from guidance.handling import ground, slip, smoothing, speed_loop, stuck, waiting
from guidance.law import GLOBAL, Gains, Limits, Parameters

GRAVITY_M_S2: Final = 9.81
#: Of what the autopilot allows, so much is asked for; the rest is for the loops.
ACCELERATION_PART: Final = 0.95
LATERAL_PART: Final = 0.7
#: How long speed takes to answer, apart from the delay.
SPEED_LAG_S: Final = 0.45
#: Fastest approach, as a part of WP_SPEED.
APPROACH_PART: Final = 0.8
#: A clock that waits as long as the vehicle is behind. Rising 0.3 a second asks 0.6 m/s^2 at 2 m/s.
WAITING: Final = waiting.Parameters(slowest=0.5, fastest=1.15, per_m=3.0, falls_per_s=2.5, rises_per_s=0.3)


class Autopilot(NamedTuple):
    """ArduPilot's parameters, in its units, with its autotest values; an acceleration of 0 is no limit there.

    `yaw_gain` is no parameter but measured: the yaw rate that is got for one that is asked.
    """

    WP_SPEED: float = 5.0
    ATC_ACCEL_MAX: float = 1.0
    ATC_STR_ACC_MAX: float = 120.0
    ATC_STR_RAT_MAX: float = 120.0
    ATC_TURN_MAX_G: float = 0.6
    TURN_RADIUS: float = 0.9
    yaw_gain: float = 0.927


def handling(autopilot: Autopilot, delay_s: float, *, waits: bool = False) -> ground.Parameters:
    """The default of the profile `ardupilot-rover`, which never reverses.

    The caller has checked the parameters: all > 0, but for the accelerations and the yaw rate, where 0 is no
    limit. `delay_s` is from a setpoint to motion, as measured; `waits`: with a reference that waits.
    """
    a = autopilot
    yaw_rate = radians(a.ATC_STR_RAT_MAX) if a.ATC_STR_RAT_MAX > 0.0 else 2.0
    speed_max = a.WP_SPEED
    return ground.Parameters(
        Parameters(
            GLOBAL,
            PITCH_YAW,
            Gains(k=1.0, rho2=3.0, rho3=3.0, beta=1.0),
            bounded(APPROACH_PART * a.WP_SPEED),
            Limits(
                speed_min_m_s=0.0,
                speed_max_m_s=speed_max,
                roll_rate_rad_s=0.0,
                pitch_rate_rad_s=0.0,
                yaw_rate_rad_s=yaw_rate,
                keep_direction=True,
                acceleration_m_s2=ACCELERATION_PART * a.ATC_ACCEL_MAX if a.ATC_ACCEL_MAX > 0.0 else inf,
                yaw_acceleration_rad_s2=radians(a.ATC_STR_ACC_MAX) if a.ATC_STR_ACC_MAX > 0.0 else inf,
            ),
        ),
        crawl_m_s=min(a.TURN_RADIUS * yaw_rate, speed_max),
        lateral_acceleration_m_s2=LATERAL_PART * GRAVITY_M_S2 * a.ATC_TURN_MAX_G,
        yaw_gain=a.yaw_gain,
        smoothing=smoothing.Parameters(time_constant_s=0.15, jump_m=0.5),
        slip=slip.Parameters(time_constant_s=2.0, speed_min_m_s=0.7, bound_rad=0.15),
        speed_loop=speed_loop.Parameters(kp=0.45, ki=0.4, lag_s=SPEED_LAG_S + delay_s, part=0.5),
        waiting=WAITING if waits else waiting.OFF,
        stuck=stuck.Parameters(asked_m_s=0.3, speed_m_s=0.15, yaw_rate_rad_s=0.05, after_s=3.0),
    )
