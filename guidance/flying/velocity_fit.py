"""The parameters of `handling.velocity` from the configuration and from the autopilot's own.

Of two limits the tighter holds. What [law] and [limits] say of a copter:

| key | in `handling.velocity.Parameters` |
| --- | --- |
| `law.k / law.beta` | of the field: its errors shrink at this rate |
| `law.rho3_per_s` | of the turn of the nose; `rho2_per_s`, `law.name` and `law.allocation` have no part |
| `law.error_function` | bounded ones at most as fast as the accelerations can brake; others as they are |
| `limits.speed_max_m_s` | of the level speed, whichever way the nose points; `speed_min_m_s` has no part |
| `limits.acceleration_max_m_s2` | of the level velocity |
| `limits.yaw_rate_max_rad_s`, `yaw_acceleration_max_rad_s2` | of the nose |
| the other limits on rates | of rates that are sent (`copter.output`); else the autopilot tilts by itself |

Of the autopilot: speeds and accelerations, the gains of its loop on velocity (PX4), how fast it leads a
velocity (ArduPilot: acceleration over jerk), the highest tilt, which bounds the level acceleration, and the
highest yaw rate. MPC_JERK_MAX has no part, for PX4 does not shape a velocity in OFFBOARD.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, radians

from guidance.config import Config
from guidance.flying.copter_rates_fit import by_rates
from guidance.handling import copter, stuck, velocity
from guidance.handling.copter import ArduPilot, Configured, Px4
from guidance.law import Gains
from guidance.se3 import Vec3
from guidance.tuning import Bounded, BoundedApart, parameters

#: Either firmware, by a name that only its copters have.
_PX4, _ARDUPILOT = "MPC_XY_VEL_MAX", "WP_SPD"


def fitted(config: Config, origin_ned_m: Vec3, values: Mapping[str, float]) -> velocity.Parameters | str:
    """All of it, or why the copter cannot be flown; `values` are the autopilot's by their newest names."""
    wanted = _configured(config)
    if _PX4 in values:
        own = Px4(**_known(Px4._fields, values))
        if not (own.MPC_XY_VEL_P_ACC > 0.0 and own.MPC_Z_VEL_P_ACC > 0.0):
            return "MPC_XY_VEL_P_ACC and MPC_Z_VEL_P_ACC must be above 0: it would follow no velocity"
        yaw_rate = min(wanted.yaw_rate_rad_s, radians(values.get("MC_YAWRATE_MAX", inf)))
        p = copter.px4(own, wanted._replace(yaw_rate_rad_s=yaw_rate))
    elif _ARDUPILOT in values:
        yaw_rate = min(wanted.yaw_rate_rad_s, radians(values.get("ATC_RATE_Y_MAX", inf)))
        p = copter.ardupilot(
            ArduPilot(**_known(ArduPilot._fields, values)), wanted._replace(yaw_rate_rad_s=yaw_rate)
        )
    else:
        return f"neither {_PX4} nor {_ARDUPILOT} is told by the autopilot: how fast may it fly?"
    if config.copter.output == "rates":
        p = by_rates(config, p, values)
    return _tuned(config, origin_ned_m, p)


def _known(names: tuple[str, ...], values: Mapping[str, float]) -> dict[str, float]:
    return {name: values[name] for name in names if name in values}


def _configured(config: Config) -> Configured:
    c, limits, law = config.copter, config.limits.limits(), config.law
    level = up = inf
    match law.error_function:
        case Bounded(approach_m_s=bound):
            level = up = bound
        case BoundedApart(horizontal_m_s=bound, vertical_m_s=bound_up):
            level, up = bound, bound_up
    return Configured(
        speed_max_m_s=limits.speed_max_m_s,
        up_max_m_s=_or(c.up_max_m_s, inf),
        down_max_m_s=_or(c.down_max_m_s, inf),
        acceleration_m_s2=limits.acceleration_m_s2,
        vertical_acceleration_m_s2=_or(c.vertical_acceleration_max_m_s2, inf),
        yaw_rate_rad_s=limits.yaw_rate_rad_s,
        yaw_acceleration_rad_s2=limits.yaw_acceleration_rad_s2,
        follows=c.heading == "path",
        waits=c.waits,
        k_per_s=law.k / law.beta,
        approach_m_s=level,
        approach_up_m_s=up,
    )


def _tuned(config: Config, origin_ned_m: Vec3, p: velocity.Parameters) -> velocity.Parameters:
    """With what the configuration has of its own."""
    c, law = config.copter, config.law
    answers = p.response
    if not c.learns:
        answers = answers._replace(per_s=0.0)
    error_function = p.error_function
    if not isinstance(law.error_function, Bounded | BoundedApart):
        error_function = parameters(law, config.limits, origin_ned_m).error_function
    return p._replace(
        gains=Gains(k=law.k, rho2=law.rho2_per_s, rho3=law.rho3_per_s, beta=law.beta),
        error_function=error_function,
        slow_m_s=c.slow_m_s,
        drag_per_s=_or(c.drag_per_s, p.drag_per_s),
        response=answers._replace(kp=_or(c.short_gain, answers.kp)),
        smoothing=p.smoothing._replace(time_constant_s=c.smoothing_s),
        stuck=stuck.Parameters(asked_m_s=0.5, speed_m_s=0.15, yaw_rate_rad_s=0.05, after_s=c.stuck_s),
    )


def _or(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value
