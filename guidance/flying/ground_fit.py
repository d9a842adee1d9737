"""The parameters of `handling.ground` from the configuration and from the autopilot's own.

Of two limits the tighter holds, whichever firmware it is: what it says is first made one (`Allowed`).
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, radians
from typing import Final, NamedTuple

from guidance.config import Config, profile_of
from guidance.handling import rover_px4, slip, smoothing, speed_loop, stuck, waiting
from guidance.handling.ground import Parameters
from guidance.handling.rover import ACCELERATION_PART, GRAVITY_M_S2, LATERAL_PART, WAITING
from guidance.se3 import Vec3
from guidance.tuning import parameters

#: So slowly is the error of a rover's velocity found: sooner, and a turn's slip is taken for it.
ERROR_S: Final = 1.5


class Allowed(NamedTuple):
    """What an autopilot allows a vehicle that drives; inf is no limit, a radius of 0 turns at rest."""

    speed_m_s: float = inf
    acceleration_m_s2: float = inf
    yaw_rate_rad_s: float = inf
    yaw_acceleration_rad_s2: float = inf
    lateral_m_s2: float = inf
    radius_m: float = 0.0


def ardupilot_allows(values: Mapping[str, float]) -> Allowed:
    """By ArduPilot's parameters, in its units; 0 is no limit there, of braking the same as of speeding up."""
    v = values
    return Allowed(
        speed_m_s=v.get("WP_SPEED") or inf,
        acceleration_m_s2=min(v.get(name) or inf for name in ("ATC_ACCEL_MAX", "ATC_DECEL_MAX")),
        yaw_rate_rad_s=radians(v.get("ATC_STR_RAT_MAX") or inf),
        yaw_acceleration_rad_s2=radians(v.get("ATC_STR_ACC_MAX") or inf),
        lateral_m_s2=LATERAL_PART * GRAVITY_M_S2 * (v.get("ATC_TURN_MAX_G") or inf),
        radius_m=v.get("TURN_RADIUS", 0.0),
    )


def px4_rover(values: Mapping[str, float]) -> rover_px4.Autopilot | str:
    """PX4's rover, or what of it is not known; a parameter of 0 is one that nobody has set.

    A build has the parameters of every kind of rover: what is set says of which kind this one is.
    """
    v = {name: value for name, value in values.items() if value > 0.0}
    if "RO_YAW_P" not in v:
        return "RO_YAW_P must be above 0: without it PX4 turns to no bearing (PX4 1.16 and later have it)"
    ackermann = v.keys() >= {"RA_WHEEL_BASE", "RA_MAX_STR_ANG"}
    if not ackermann and not v.keys() >= {"RD_WHEEL_TRACK", "RD_TRANS_DRV_TRN"}:
        return (
            "neither RA_WHEEL_BASE and RA_MAX_STR_ANG (an Ackermann rover) nor RD_WHEEL_TRACK and "
            "RD_TRANS_DRV_TRN (a differential one) are set: how does it turn?"
        )
    if ackermann and values.get("RO_MAX_THR_SPEED", 1.0) <= 0.0:
        return "RO_MAX_THR_SPEED must be above 0: without it PX4 does not steer an Ackermann rover"
    other = "RD_" if ackermann else "RA_"
    known = {name: v[name] for name in rover_px4.Autopilot._fields if name in v and name[:3] != other}
    return rover_px4.Autopilot(**known)


def px4_allows(autopilot: rover_px4.Autopilot) -> Allowed:
    """By PX4's parameters."""
    a = autopilot
    return Allowed(
        speed_m_s=a.RO_SPEED_LIM,
        acceleration_m_s2=a.RO_ACCEL_LIM,
        yaw_rate_rad_s=rover_px4.yaw_rate_max_rad_s(a),
        yaw_acceleration_rad_s2=radians(a.RO_YAW_ACCEL_LIM),
        lateral_m_s2=rover_px4.LATERAL_M_S2,
        radius_m=rover_px4.turning_radius_m(a),
    )


def fitted(config: Config, origin_ned_m: Vec3, allowed: Allowed) -> Parameters:
    """For a trajectory whose origin is there."""
    ground, a = config.ground, allowed
    error_s = ERROR_S if profile_of(config).firmware == "PX4" else 0.0
    base = parameters(config.law, config.limits, origin_ned_m, planar=True)
    limits = base.limits
    limits = limits._replace(
        speed_max_m_s=min(limits.speed_max_m_s, a.speed_m_s),
        yaw_rate_rad_s=min(limits.yaw_rate_rad_s, a.yaw_rate_rad_s),
        acceleration_m_s2=min(limits.acceleration_m_s2, ACCELERATION_PART * a.acceleration_m_s2),
        yaw_acceleration_rad_s2=min(limits.yaw_acceleration_rad_s2, a.yaw_acceleration_rad_s2),
    )
    radius_m = a.radius_m if ground.turning_radius_m is None else ground.turning_radius_m
    crawl_m_s = radius_m * limits.yaw_rate_rad_s if ground.crawl_m_s is None else ground.crawl_m_s
    lateral = ground.lateral_acceleration_max_m_s2
    return Parameters(
        law=base._replace(limits=limits),
        crawl_m_s=min(crawl_m_s, limits.speed_max_m_s),
        lateral_acceleration_m_s2=a.lateral_m_s2 if lateral is None else lateral,
        yaw_gain=ground.yaw_gain,
        smoothing=smoothing.Parameters(ground.smoothing_s, 0.5, error_s, error_max_m_s=0.8),
        slip=slip.Parameters(time_constant_s=2.0, speed_min_m_s=0.7, bound_rad=radians(ground.slip_max_deg)),
        speed_loop=speed_loop.Parameters(
            kp=ground.speed_kp,
            ki=ground.speed_ki_per_s,
            lag_s=ground.speed_lag_s,
            part=0.5,
        ),
        waiting=WAITING if ground.waits else waiting.OFF,
        stuck=stuck.Parameters(asked_m_s=0.3, speed_m_s=0.15, yaw_rate_rad_s=0.05, after_s=ground.stuck_s),
    )
