"""The parameters of an autopilot that was set up for one of JSBSim's aircraft, as its manual has it."""

from __future__ import annotations

from math import degrees, radians, tan
from typing import Final

from sitl.models.files import JSBSIM_PREFIX
from sitl.models.manuals import MANUALS, Manual
from sitl.vehicle.options import Firmware

GRAVITY_M_S2: Final = 9.80665
#: Bank of the circles that the autopilot flies by itself.
CIRCLE_BANK_RAD: Final = radians(25.0)


def manual_parameters(model: str, firmware: Firmware) -> dict[str, float]:
    """By their names; none for a model that has no manual."""
    manual = MANUALS.get(model.removeprefix(JSBSIM_PREFIX)) if model.startswith(JSBSIM_PREFIX) else None
    if manual is None:
        return {}
    if firmware is Firmware.PX4_PLANE:
        return _px4(manual)
    return _ardupilot(manual) if firmware is Firmware.ARDUPILOT_PLANE else {}


def _px4(m: Manual) -> dict[str, float]:
    return {
        "FW_AIRSPD_MIN": m.airspeed_min_m_s,
        "FW_AIRSPD_TRIM": m.airspeed_cruise_m_s,
        "FW_AIRSPD_MAX": m.airspeed_max_m_s,
        "FW_T_CLMB_MAX": m.climb_full_m_s,
        "FW_T_SINK_R_SP": m.sink_max_m_s,
        "FW_T_SINK_MAX": m.sink_max_m_s,
        "FW_THR_TRIM": m.throttle_cruise,
        "FW_PSP_OFF": m.pitch_cruise_deg,
        "FW_R_LIM": m.bank_max_deg,
        "FW_R_RMAX": degrees(m.roll_rate_rad_s),
        "NAV_LOITER_RAD": _radius_m(m),
    }


def _ardupilot(m: Manual) -> dict[str, float]:
    return {
        "AIRSPEED_MIN": m.airspeed_min_m_s,
        "AIRSPEED_CRUISE": m.airspeed_cruise_m_s,
        "AIRSPEED_MAX": m.airspeed_max_m_s,
        "TECS_CLMB_MAX": m.climb_full_m_s,
        "TECS_SINK_MAX": m.sink_max_m_s,
        "TRIM_THROTTLE": round(100.0 * m.throttle_cruise),
        "ROLL_LIMIT_DEG": m.bank_max_deg,
        "RLL2SRV_RMAX": round(degrees(m.roll_rate_rad_s)),
        "WP_LOITER_RAD": round(_radius_m(m)),
    }


def _radius_m(m: Manual) -> float:
    return m.airspeed_cruise_m_s * m.airspeed_cruise_m_s / (GRAVITY_M_S2 * tan(CIRCLE_BANK_RAD))
