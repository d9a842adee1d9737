"""The handling of a copter from its autopilot's own parameters, and what a configuration allows of them.

What binds each number:

- speeds, accelerations and the yaw rate are the tighter of the autopilot's and the configuration's. PX4 does
  not shape a velocity in OFFBOARD; MPC_ACC_HOR says all the same what the vehicle is meant to do. ArduPilot
  flies vertical velocities beyond WP_SPD_UP and WP_SPD_DN in GUIDED; they are kept here;
- how a velocity is answered follows of the loops' gains (`response`);
- of a velocity that is short, so much is asked for on top that gusts move PX4's copter half as far, and that
  200 ms of delay nobody knows of do not make it swing; ArduPilot's, which holds its own path, needs less;
- lambda k times what is left of the delay stays well below a half;
- no more acceleration is asked for than the highest tilt gives, g times its tangent;
- an approach of v brakes by up to 0.33 lambda k v in the bounded field: half of the acceleration goes to
  that, the rest to the reference;
- the nose is turned softly: where it points does not matter to the path.
"""

from __future__ import annotations

from math import inf, radians, tan
from typing import Final, NamedTuple

from guidance.error_function import bounded_apart
from guidance.handling import response, smoothing, stuck, velocity, waiting
from guidance.handling.airplane_bank import GRAVITY_M_S2
from guidance.law import Gains, Limits

K_PER_S: Final = 1.0
RHO_PER_S: Final = 1.5
#: Of what is allowed, so much is asked for; the rest is for the loops.
ACCELERATION_PART: Final = 0.9
BRAKING_PART: Final = 0.5
#: The largest slope of the bounded field times its speed, over lambda k times the approach.
BOUNDED_BRAKING: Final = 0.325
#: Yaw is slewed at this at most (rad/s^2): about half of what both autopilots showed.
YAW_SLEW_RAD_S2: Final = 1.5
YAW_RATE_RAD_S: Final = 1.5
#: What is asked for on top of a velocity that is short is at most this.
MISSING_MAX_M_S: Final = 1.0
#: A clock that waits as long as the vehicle is behind, as that of rovers.
WAITING: Final = waiting.Parameters(slowest=0.5, fastest=1.15, per_m=1.0, falls_per_s=1.0, rises_per_s=0.3)


class Configured(NamedTuple):
    """What the configuration allows; inf: what the autopilot does. `follows`: the nose follows the field.

    `k_per_s` is lambda k, to which the approach must fit.
    """

    speed_max_m_s: float = inf
    up_max_m_s: float = inf
    down_max_m_s: float = inf
    acceleration_m_s2: float = inf
    vertical_acceleration_m_s2: float = inf
    yaw_rate_rad_s: float = YAW_RATE_RAD_S
    yaw_acceleration_rad_s2: float = inf
    follows: bool = True
    waits: bool = False
    k_per_s: float = K_PER_S
    approach_m_s: float = inf
    approach_up_m_s: float = inf


#: All that the autopilot allows.
UNBOUNDED: Final = Configured()


class Px4(NamedTuple):
    """PX4's parameters, in its units, with its defaults."""

    MPC_XY_VEL_MAX: float = 12.0
    MPC_Z_VEL_MAX_UP: float = 3.0
    MPC_Z_VEL_MAX_DN: float = 1.5
    MPC_ACC_HOR: float = 3.0
    MPC_ACC_UP_MAX: float = 4.0
    MPC_ACC_DOWN_MAX: float = 3.0
    MPC_XY_VEL_P_ACC: float = 1.8
    MPC_XY_VEL_I_ACC: float = 0.4
    MPC_XY_VEL_D_ACC: float = 0.2
    MPC_Z_VEL_P_ACC: float = 4.0
    MPC_Z_VEL_I_ACC: float = 2.0
    MPC_Z_VEL_D_ACC: float = 0.0
    MPC_YAWRAUTO_MAX: float = 60.0
    MPC_TILTMAX_AIR: float = 45.0


class ArduPilot(NamedTuple):
    """ArduPilot's parameters by their names of 4.7, in m, with its autotest values; before, they were
    WPNAV_SPEED, WPNAV_ACCEL (cm), PSC_JERK_XY, PSC_JERK_Z and ANGLE_MAX (centidegrees)."""

    WP_SPD: float = 10.0
    WP_SPD_UP: float = 2.5
    WP_SPD_DN: float = 1.5
    WP_ACC: float = 2.5
    WP_ACC_Z: float = 1.0
    PSC_NE_JERK: float = 5.0
    PSC_D_JERK: float = 5.0
    ATC_ANGLE_MAX: float = 30.0


def px4(autopilot: Px4, configured: Configured = UNBOUNDED) -> velocity.Parameters:
    """The default of the profile `px4-copter`. The caller has checked the parameters: all > 0, D, I >= 0."""
    a = autopilot
    p, i, d = a.MPC_XY_VEL_P_ACC, a.MPC_XY_VEL_I_ACC, a.MPC_XY_VEL_D_ACC
    pz, iz, dz = a.MPC_Z_VEL_P_ACC, a.MPC_Z_VEL_I_ACC, a.MPC_Z_VEL_D_ACC
    return _handling(
        configured,
        Configured(
            a.MPC_XY_VEL_MAX,
            a.MPC_Z_VEL_MAX_UP,
            a.MPC_Z_VEL_MAX_DN,
            min(a.MPC_ACC_HOR, tilted_m_s2(a.MPC_TILTMAX_AIR)),
            min(a.MPC_ACC_UP_MAX, a.MPC_ACC_DOWN_MAX),
            radians(a.MPC_YAWRAUTO_MAX),
        ),
        response.Parameters(
            response.Axis((1.0 + d) / p, 1.0 / p, p / i if i > 0.0 else 0.0),
            response.Axis((1.0 + dz) / pz, 1.0 / pz, pz / iz if iz > 0.0 else 0.0),
            per_s=0.3,
            drag_max_per_s=2.0,
            kp=1.0,
            bound_m_s=MISSING_MAX_M_S,
        ),
        drag_per_s=0.5,
        error_s=smoothing.ERROR_S,
    )


def ardupilot(autopilot: ArduPilot, configured: Configured = UNBOUNDED) -> velocity.Parameters:
    """The default of the profile `ardupilot-copter`. The caller has checked the parameters: all > 0."""
    a = autopilot
    acceleration = min(a.WP_ACC, tilted_m_s2(a.ATC_ANGLE_MAX))
    return _handling(
        configured,
        Configured(a.WP_SPD, a.WP_SPD_UP, a.WP_SPD_DN, acceleration, a.WP_ACC_Z, inf),
        response.Parameters(
            response.Axis(a.WP_ACC / a.PSC_NE_JERK, 0.0, 0.0),
            response.Axis(a.WP_ACC_Z / a.PSC_D_JERK, 0.0, 0.0),
            per_s=0.0,
            drag_max_per_s=0.0,
            kp=0.6,
            bound_m_s=MISSING_MAX_M_S,
        ),
        drag_per_s=0.0,
        error_s=0.0,
    )


def tilted_m_s2(tilt_deg: float) -> float:
    """The horizontal acceleration of a copter that leans so far (0 to 89 deg) and keeps its height."""
    return GRAVITY_M_S2 * tan(radians(tilt_deg))


def _handling(
    configured: Configured,
    autopilot: Configured,
    answers: response.Parameters,
    drag_per_s: float,
    error_s: float,
) -> velocity.Parameters:
    c, a = configured, autopilot
    speed = min(c.speed_max_m_s, a.speed_max_m_s)
    up, down = min(c.up_max_m_s, a.up_max_m_s), min(c.down_max_m_s, a.down_max_m_s)
    acceleration = ACCELERATION_PART * min(c.acceleration_m_s2, a.acceleration_m_s2)
    vertical = ACCELERATION_PART * min(c.vertical_acceleration_m_s2, a.vertical_acceleration_m_s2)
    braking = BRAKING_PART / (BOUNDED_BRAKING * c.k_per_s)
    return velocity.Parameters(
        gains=Gains(k=c.k_per_s, rho2=RHO_PER_S, rho3=RHO_PER_S, beta=1.0),
        error_function=bounded_apart(
            min(c.approach_m_s, 0.8 * speed, braking * acceleration),
            min(c.approach_up_m_s, 0.8 * up, 0.8 * down, braking * vertical),
        ),
        limits=Limits(
            speed_min_m_s=0.0,
            speed_max_m_s=speed,
            roll_rate_rad_s=0.0,
            pitch_rate_rad_s=0.0,
            yaw_rate_rad_s=min(c.yaw_rate_rad_s, a.yaw_rate_rad_s),
            acceleration_m_s2=acceleration,
            yaw_acceleration_rad_s2=min(c.yaw_acceleration_rad_s2, YAW_SLEW_RAD_S2),
        ),
        up_max_m_s=up,
        down_max_m_s=down,
        vertical_acceleration_m_s2=vertical,
        follows=c.follows,
        slow_m_s=0.3,
        drag_per_s=drag_per_s,
        response=answers,
        smoothing=smoothing.Parameters(0.3, 0.5, error_s, error_max_m_s=0.8),
        waiting=WAITING if c.waits else waiting.OFF,
        stuck=stuck.Parameters(asked_m_s=0.5, speed_m_s=0.15, yaw_rate_rad_s=0.05, after_s=3.0),
    )
