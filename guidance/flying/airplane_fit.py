"""The parameters of `handling.airplane` from the configuration and from the autopilot's own.

Of two limits the tighter holds. What [law] and [limits] say of an airplane:

| key | in `handling.airplane.Parameters` |
| --- | --- |
| `law.k / law.beta` | `k_per_s`, of the field in the plane |
| `law.rho3_per_s` | `rho_per_s`, of the turn; `rho2_per_s` has no part: climbs are no rates here |
| `law.error_function` | if bounded, `approach_m_s` and `approach_up_m_s`; else as it can |
| `limits.speed_max_m_s` | bounds the greatest airspeed |
| `limits.roll_rate_max_rad_s` | `roll_rate_rad_s` |
| the other limits on rates | of rates that are sent (`airplane.output`), and of what a trajectory may want |
"""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees, inf, radians
from typing import Final, NamedTuple

from guidance.config import Config
from guidance.handling import airplane, waiting
from guidance.handling.airplane_defaults import Airframe, handling, patience
from guidance.limits import clamp
from guidance.tuning import Bounded, BoundedApart

#: What the autopilots call it, newest name first, and what makes it m/s, degrees or a part of 1. An airplane
#: has the names of one firmware.
_NAMES: Final[dict[str, tuple[tuple[str, float], ...]]] = {
    "airspeed_min": (("FW_AIRSPD_MIN", 1.0), ("AIRSPEED_MIN", 1.0), ("ARSPD_FBW_MIN", 1.0)),
    "airspeed_cruise": (("FW_AIRSPD_TRIM", 1.0), ("AIRSPEED_CRUISE", 1.0), ("TRIM_ARSPD_CM", 0.01)),
    "airspeed_max": (("FW_AIRSPD_MAX", 1.0), ("AIRSPEED_MAX", 1.0), ("ARSPD_FBW_MAX", 1.0)),
    "bank": (("FW_R_LIM", 1.0), ("ROLL_LIMIT_DEG", 1.0), ("LIM_ROLL_CD", 0.01)),
    "roll_rate": (("FW_R_RMAX", 1.0), ("RLL2SRV_RMAX", 1.0)),
    "pitch_min": (("FW_P_LIM_MIN", 1.0), ("PTCH_LIM_MIN_DEG", 1.0), ("LIM_PITCH_MIN", 0.01)),
    "pitch_max": (("FW_P_LIM_MAX", 1.0), ("PTCH_LIM_MAX_DEG", 1.0), ("LIM_PITCH_MAX", 0.01)),
    "pitch_cruise": (("FW_PSP_OFF", 1.0),),  # what ArduPilot calls level is level
    "throttle_min": (("FW_THR_MIN", 1.0), ("THR_MIN", 0.01)),
    "throttle_max": (("FW_THR_MAX", 1.0), ("THR_MAX", 0.01)),
    "throttle_cruise": (("FW_THR_TRIM", 1.0), ("TRIM_THROTTLE", 0.01)),
    "climb": (("FW_T_CLMB_MAX", 1.0), ("TECS_CLMB_MAX", 1.0)),
    "sink": (("FW_T_SINK_MAX", 1.0), ("TECS_SINK_MAX", 1.0)),
}
#: The parameters of an autopilot that are asked for.
ASKED_FOR: Final = tuple(name for names in _NAMES.values() for name, _ in names)

#: Of the cruise airspeed, the climb and sink that are asked for where nothing says more.
_CLIMB_PART: Final = 0.2
_PITCH_DEG: Final = 25.0
#: The nose goes down further, as far as the autopilot lets it: that ends a stall.
_DIVE_DEG: Final = 30.0
_THROTTLE_CRUISE: Final = 0.5


def told(values: Mapping[str, float], what: str) -> float | None:
    """One of `_NAMES` as the autopilot has it, None if it has not."""
    return next((values[name] * scale for name, scale in _NAMES[what] if name in values), None)


def thinness(altitude_m: float) -> float:
    """True over calibrated airspeed at this height above mean sea level, in the standard atmosphere."""
    return float((1.0 - 2.25577e-5 * clamp(altitude_m, -500.0, 10_000.0)) ** -2.12794)


def airframe_of(config: Config, values: Mapping[str, float], thin: float = 1.0) -> Airframe | str:
    """The airframe in air where true airspeeds are `thin` times the calibrated ones of configuration and
    autopilot, or what of it is not known."""
    c, limits = config.airplane, config.limits
    slowest = _highest(c.airspeed_min_m_s, told(values, "airspeed_min"))
    fastest = _lowest(c.airspeed_max_m_s, told(values, "airspeed_max"))
    cruise = c.airspeed_cruise_m_s or told(values, "airspeed_cruise")
    bank_deg = _lowest(c.bank_max_deg, told(values, "bank"))
    for what, value, key in (
        ("airspeed_min", slowest, "airspeed_min_m_s"),
        ("airspeed_cruise", cruise, "airspeed_cruise_m_s"),
        ("airspeed_max", fastest, "airspeed_max_m_s"),
        ("bank", bank_deg, "bank_max_deg"),
    ):
        if value is None:
            names = " nor ".join(name for name, _ in _NAMES[what][:2])
            return f"neither {names} is told by the autopilot: set airplane.{key}"
    assert slowest is not None
    assert fastest is not None
    assert cruise is not None
    assert bank_deg is not None
    roll_rate_deg = told(values, "roll_rate") or inf  # 0 is no limit
    full = c.climb_full_m_s or told(values, "climb") or _CLIMB_PART * cruise
    pitch_deg = c.pitch_cruise_deg
    if pitch_deg is None:
        pitch_deg = told(values, "pitch_cruise") or 0.0
    part = _CLIMB_PART * cruise
    return Airframe(
        airspeed_min_m_s=slowest * thin,
        airspeed_cruise_m_s=cruise * thin,
        airspeed_max_m_s=min(fastest * thin, limits.speed_max_m_s),
        bank_max_rad=radians(bank_deg),
        roll_rate_rad_s=min(limits.roll_rate_max_rad_s, radians(roll_rate_deg)),
        lag_s=c.bank_lag_s,
        throttle_lag_s=c.throttle_lag_s,
        climb_max_m_s=min(_or(_lowest(c.climb_max_m_s, told(values, "climb")), part), full),
        sink_max_m_s=_or(_lowest(c.sink_max_m_s, told(values, "sink")), part),
        climb_full_m_s=full,
        throttle_cruise=c.throttle_cruise or told(values, "throttle_cruise") or _THROTTLE_CRUISE,
        pitch_cruise_rad=radians(pitch_deg),
        pitch_lowest_rad=radians(max(-_DIVE_DEG, _or(told(values, "pitch_min"), -_PITCH_DEG))),
        pitch_highest_rad=radians(min(_PITCH_DEG, _or(told(values, "pitch_max"), _PITCH_DEG))),
        floor_down_m=_or(c.floor_down_m, inf),
    )


def assumed(config: Config, values: Mapping[str, float]) -> str:
    """What neither autopilot nor configuration says, and what is taken for it, in words; empty if nothing."""
    frame = airframe_of(config, values)
    if isinstance(frame, str):
        return ""
    c, first = config.airplane, config.vehicle.profile.startswith("px4")
    taken = (
        ("climb", c.climb_full_m_s, f"{frame.climb_full_m_s:.3g} m/s"),
        ("sink", c.sink_max_m_s, f"{frame.sink_max_m_s:.3g} m/s"),
        ("throttle_cruise", c.throttle_cruise, f"{frame.throttle_cruise:.3g}"),
        ("throttle_min", None, "0"),
        ("throttle_max", None, "1"),
        ("pitch_min", None, f"{degrees(frame.pitch_lowest_rad):.3g} deg"),
        ("pitch_max", None, f"{degrees(frame.pitch_highest_rad):.3g} deg"),
    )
    return ", ".join(
        f"{_NAMES[what][0 if first else 1][0]} {value}"
        for what, own, value in taken
        if own is None and told(values, what) is None
    )


class Fitted(NamedTuple):
    """What `handling.airplane` takes, and the airspeed of level flight that it was made for."""

    parameters: airplane.Parameters
    cruise_m_s: float


def fitted(config: Config, values: Mapping[str, float], thin: float = 1.0) -> Fitted | str:
    """All of it, or why the airplane cannot be flown; `values` are the autopilot's, in its units, and `thin`
    is the air's `thinness`."""
    frame = airframe_of(config, values, thin)
    if isinstance(frame, str):
        return frame
    c, law = config.airplane, config.law
    try:
        p = handling(frame)
    except ValueError as error:
        return (
            "no airplane flies like this ([airplane], [limits] and the autopilot's parameters, the "
            f"tighter of each): {error}"
        )
    k = law.k / law.beta
    level, up = p.approach_m_s, p.approach_up_m_s
    match law.error_function:
        case Bounded(approach_m_s=bound):
            level, up = bound, min(up, bound)
        case BoundedApart(horizontal_m_s=bound, vertical_m_s=bound_up):
            level, up = bound, bound_up
    throttle = p.throttle._replace(
        lowest=max(_or(told(values, "throttle_min"), 0.0), 0.0),
        highest=min(_or(told(values, "throttle_max"), 1.0), 1.0),
    )
    if not throttle.lowest < frame.throttle_cruise < throttle.highest:
        return (
            f"the throttle of the cruise, {frame.throttle_cruise:.3g}, must be between the autopilot's "
            f"limits, {throttle.lowest:.3g} and {throttle.highest:.3g}"
        )
    bank, pitch = p.bank, p.pitch
    if not c.learns:
        bank = bank._replace(per_s=0.0)
        pitch = pitch._replace(trim_per_s=0.0)
        throttle = throttle._replace(integral_per_m=0.0)
    p = p._replace(
        k_per_s=k,
        k_up_per_s=_or(c.k_up_per_s, p.k_up_per_s),
        approach_m_s=level,
        approach_up_m_s=_or(c.approach_up_m_s, up),
        rho_per_s=law.rho3_per_s,
        envelope=p.envelope._replace(load_max=_or(c.load_max, p.envelope.load_max)),
        bank=bank,
        pitch=pitch,
        throttle=throttle,
        wind=p.wind._replace(wind_max_m_s=c.wind_max_m_s),
        waiting=patience(frame.airspeed_cruise_m_s, k) if c.waits else waiting.OFF,
    )
    return Fitted(p, frame.airspeed_cruise_m_s)


def _or(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value


def _lowest(*limits: float | None) -> float | None:
    return min((limit for limit in limits if limit is not None), default=None)


def _highest(*limits: float | None) -> float | None:
    return max((limit for limit in limits if limit is not None), default=None)
