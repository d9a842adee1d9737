"""The parameters of `handling.copter_rates` from the configuration and from the autopilot's own.

ArduCopter takes the thrust of a setpoint for a climb rate unless bit 3 of GUID_OPTIONS is set, and gives more
thrust by itself where it leans, unless ATC_ANGLE_BOOST is 0 (`GCS_MAVLink_Copter.cpp`,
`AC_AttitudeControl_Multi.cpp`). PX4 hands thrust to the rotors as it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, radians, tan
from typing import Final

from guidance.config import Config
from guidance.handling import copter_rates, response, velocity
from guidance.handling.airplane_bank import GRAVITY_M_S2
from guidance.handling.copter import MISSING_MAX_M_S
from guidance.handling.copter_rates import I_PER_S2, I_UP_PER_S2, P_PER_S, P_UP_PER_S
from guidance.se3 import Vec3

#: GUID_OPTIONS: the thrust of a setpoint is thrust.
THRUST_AS_THRUST: Final = 8
#: No less thrust is asked for, of ArduPilot's: below it the rotors turn no copter.
LEAST_THRUST: Final = 0.1
#: Of the level acceleration that the tilt allows, the trajectory and the approach may take this part.
TILT_PART: Final = 0.8
#: What the air takes of a velocity, before it is learned, and at most (1/s); how fast it is.
DRAG_PER_S: Final = 0.5
DRAG_MAX_PER_S: Final = 2.0
DRAG_LEARNS_PER_S: Final = 0.3


def climbs(values: Mapping[str, float]) -> bool:
    """Whether the autopilot takes thrust for a climb rate."""
    return "GUID_OPTIONS" in values and not int(values["GUID_OPTIONS"]) & THRUST_AS_THRUST


def tilt_max_rad(config: Config, values: Mapping[str, float]) -> float:
    """The tighter of the configuration's and the autopilot's."""
    own = config.copter.tilt_max_deg
    told = (values[name] for name in ("MPC_TILTMAX_AIR", "ATC_ANGLE_MAX") if name in values)
    return radians(min(*told, 45.0 if own is None else own, 60.0))


def by_rates(config: Config, p: velocity.Parameters, values: Mapping[str, float]) -> velocity.Parameters:
    """The handling of a copter whose velocity is closed here: what is asked for undoes the loop here."""
    c = config.copter
    vertical = response.Axis(1.0 / P_UP_PER_S, 1.0 / P_UP_PER_S, P_UP_PER_S / I_UP_PER_S2)
    return p._replace(
        limits=p.limits._replace(
            acceleration_m_s2=min(
                p.limits.acceleration_m_s2, TILT_PART * GRAVITY_M_S2 * tan(tilt_max_rad(config, values))
            )
        ),
        drag_per_s=DRAG_PER_S if c.drag_per_s is None else c.drag_per_s,
        response=response.Parameters(
            response.Axis(1.0 / P_PER_S, 1.0 / P_PER_S, P_PER_S / I_PER_S2),
            p.response.vertical if climbs(values) else vertical,
            per_s=DRAG_LEARNS_PER_S,
            drag_max_per_s=DRAG_MAX_PER_S,
            kp=0.0,
            bound_m_s=MISSING_MAX_M_S,
        ),
    )


def rates_fitted(
    config: Config, p: velocity.Parameters, values: Mapping[str, float]
) -> copter_rates.Parameters | str:
    """All of it, or why the copter cannot be flown by rates and thrust."""
    c, limits = config.copter, config.limits.limits()
    ardupilot = "WP_SPD" in values
    hover = values.get("MOT_THST_HOVER" if ardupilot else "MPC_THR_HOVER")
    if ardupilot and "GUID_OPTIONS" not in values:
        return (
            "GUID_OPTIONS is not told by the autopilot: is the thrust that is sent thrust, or a climb rate?"
        )
    by_climb = ardupilot and climbs(values)
    if hover is None and not by_climb:
        name = "MOT_THST_HOVER" if ardupilot else "MPC_THR_HOVER"
        return f"{name} is not told by the autopilot: with how much thrust does it hover?"
    least = max(values.get("MPC_THR_MIN", LEAST_THRUST), 0.0)
    most = min(values.get("MPC_THR_MAX", 1.0), 1.0)
    if hover is not None and not by_climb and not least < hover < most:
        return f"the hover thrust, {hover:.3g}, must be between least and most, {least:.3g} and {most:.3g}"
    names = ("ATC_RATE_R_MAX", "ATC_RATE_P_MAX") if ardupilot else ("MC_ROLLRATE_MAX", "MC_PITCHRATE_MAX")
    roll, pitch = (radians(values.get(name, inf)) for name in names)
    return copter_rates.Parameters(
        p_per_s=P_PER_S,
        i_per_s2=I_PER_S2,
        p_up_per_s=P_UP_PER_S,
        i_up_per_s2=I_UP_PER_S2 if c.learns else 0.0,
        drag_per_s=p.drag_per_s,
        tilt_max_rad=tilt_max_rad(config, values),
        attitude_per_s=c.attitude_gain_per_s,
        rates_max_rad_s=Vec3(
            min(roll, limits.roll_rate_rad_s),
            min(pitch, limits.pitch_rate_rad_s),
            p.limits.yaw_rate_rad_s,
        ),
        hover_thrust=1.0 if hover is None else hover,
        thrust_min=least,
        thrust_max=most,
        boosts=ardupilot and values.get("ATC_ANGLE_BOOST", 1.0) != 0.0,
        climbs=by_climb,
        climb_up_m_s=values.get("WP_SPD_UP", p.up_max_m_s),
        climb_down_m_s=values.get("WP_SPD_DN", p.down_max_m_s),
    )
