"""An airplane's whole handling from a few numbers: those that its autopilot's parameters tell.

Flight mechanics and three rules make the rest:

- thrust A and drag D per mass from throttle and climb at the cruise: A (1 - u) = g climb/V and D = A u;
- the angle of attack K n/V^2 from the least airspeed, at which it is `ALPHA_AT_LEAST_RAD` above that of no
  lift;
- each loop is as quick as the one inside it allows: turn and throttle by their lags, the field by both, the
  approach by what the greatest bank can bend, the clock by what an airplane can speed up.

It is a start, and need not be exact: what a bank gives, and pitch and throttle of level flight, are learned.
Flown with a third to 1.5 times the climb, 0.85 to 1.15 of the throttle, 0.75 of the lag, each with the pitch
wrong by 3 degrees: within the limits of a table of figures that was made with numbers set by hand. Half the
lag is too little: the gains that it makes are those of a limit cycle.
"""

from __future__ import annotations

from math import cos, inf, isnan, pi, radians, tan
from typing import Final, NamedTuple

from guidance.handling import (
    airplane,
    airplane_bank,
    airplane_envelope,
    airplane_pitch,
    airplane_throttle,
    airplane_wind,
    waiting,
)
from guidance.handling.airplane_bank import GRAVITY_M_S2

#: Angle of attack above that of no lift, at the least airspeed.
ALPHA_AT_LEAST_RAD: Final = 0.15
#: Of the drag at cruise, the part that comes of the lift.
INDUCED_PART: Final = 0.2
#: No bank is as steep as this.
BANK_RAD: Final = radians(80.0)
#: The quickest that is asked for (1/s), however short the lags: turn, throttle, field, and its vertical.
TURN_PER_S: Final = 1.8
THROTTLE_PER_S: Final = 3.0
FIELD_PER_S: Final = 0.7
FIELD_UP_PER_S: Final = 0.8


class Airframe(NamedTuple):
    """What `handling` is made from, and where PX4 and ArduPlane have it. Airspeeds are true ones.

    `airspeed_*_m_s`: the envelope (PX4: FW_AIRSPD_MIN, TRIM, MAX; ArduPlane: AIRSPEED_MIN, CRUISE, MAX).
    `climb_max_m_s`, `sink_max_m_s`: asked for at most (FW_T_CLMB_MAX, FW_T_SINK_MAX; TECS_CLMB_MAX,
    TECS_SINK_MAX). `climb_full_m_s`: that of full throttle at the cruise (FW_T_CLMB_MAX; TECS_CLMB_MAX).
    `throttle_cruise`, `pitch_cruise_rad`: of level flight at the cruise (FW_THR_TRIM, FW_PSP_OFF;
    TRIM_THROTTLE, PTCH_TRIM_DEG). `bank_max_rad`: FW_R_LIM; ROLL_LIMIT_DEG. `pitch_*_rad`: FW_P_LIM_MIN, MAX;
    PTCH_LIM_MIN_DEG, MAX_DEG. `roll_rate_rad_s`: how fast the bank can change (FW_R_RMAX; RLL2SRV_RMAX, where
    0 is none).

    `lag_s` is the time from a demand to bank or pitch, delay and lags together, `throttle_lag_s` from a
    demand to thrust: short for an electric motor, a second and more for a piston engine. `floor_down_m` is
    the least height, NED.
    """

    airspeed_min_m_s: float
    airspeed_cruise_m_s: float
    airspeed_max_m_s: float
    climb_max_m_s: float
    sink_max_m_s: float
    climb_full_m_s: float
    throttle_cruise: float
    bank_max_rad: float = radians(45.0)
    pitch_cruise_rad: float = 0.0
    pitch_lowest_rad: float = radians(-20.0)
    pitch_highest_rad: float = radians(20.0)
    roll_rate_rad_s: float = 1.0
    lag_s: float = 0.4
    throttle_lag_s: float = 0.2
    floor_down_m: float = inf


def handling(airframe: Airframe, *, waits: bool = False) -> airplane.Parameters:
    """The parameters of `airplane_step` for this airframe, its reference's clock fixed or `waits`.

    Raises:
        ValueError: no airplane has such numbers; the message says which, and within what they must be.
    """
    _check(airframe)
    f = airframe
    v = f.airspeed_cruise_m_s
    thrust = GRAVITY_M_S2 * f.climb_full_m_s / (v * (1.0 - f.throttle_cruise))
    drag = thrust * f.throttle_cruise
    alpha_per_load = ALPHA_AT_LEAST_RAD * f.airspeed_min_m_s * f.airspeed_min_m_s
    # ArduPlane's bank swings its pitch too: with 0.65 that was a limit cycle
    rho = min(TURN_PER_S, 0.4 / f.lag_s)
    power = min(THROTTLE_PER_S, 0.65 / f.lag_s, 0.6 / f.throttle_lag_s)
    k = min(FIELD_PER_S, 0.62 * rho, 0.6 * power)
    return airplane.Parameters(
        k_per_s=k,
        k_up_per_s=min(FIELD_UP_PER_S, 0.75 * rho),
        approach_m_s=min(v, 0.9 * GRAVITY_M_S2 * tan(f.bank_max_rad) / k),
        approach_up_m_s=0.75 * f.climb_max_m_s,
        rho_per_s=rho,
        roll_rate_rad_s=f.roll_rate_rad_s,
        envelope=airplane_envelope.Parameters(
            airspeed_min_m_s=f.airspeed_min_m_s,
            margin_m_s=min(0.2 * f.airspeed_min_m_s, 0.55 * (v - f.airspeed_min_m_s)),
            airspeed_max_m_s=f.airspeed_max_m_s,
            bank_max_rad=f.bank_max_rad,
            # a pull-up in the steepest turn
            load_max=1.06 / cos(f.bank_max_rad),
            climb_max_m_s=f.climb_max_m_s,
            sink_max_m_s=f.sink_max_m_s,
            floor_down_m=f.floor_down_m,
            floor_per_s=0.5,
        ),
        bank=airplane_bank.Parameters(lowest=0.6, highest=1.3, per_s=0.3, excited_m_s2=1.0, lag_s=0.25),
        pitch=airplane_pitch.Parameters(
            alpha_zero_rad=f.pitch_cruise_rad - alpha_per_load / (v * v),
            alpha_per_load_rad_m2_s2=alpha_per_load,
            lead=min(0.5, 0.1 / f.lag_s),
            trim_per_s=0.3,
            trim_max_rad=0.15,
            lowest_rad=f.pitch_lowest_rad,
            highest_rad=f.pitch_highest_rad,
        ),
        throttle=airplane_throttle.Parameters(
            thrust_m_s2=thrust,
            drag_per_m=(1.0 - INDUCED_PART) * drag / (v * v),
            induced_m3_s4=INDUCED_PART * drag * v * v,
            proportional_s_m=power / thrust,
            integral_per_m=min(0.65, 0.25 * power * power) / thrust,
            trim_max=0.3,
            lowest=0.0,
            highest=1.0,
        ),
        wind=airplane_wind.Parameters(along_per_s=0.3, across_per_s=0.05, given_per_s=0.5, wind_max_m_s=15.0),
        waiting=patience(v, k) if waits else waiting.OFF,
    )


def patience(speed_m_s: float, k_per_s: float) -> waiting.Parameters:
    """A waiting clock for an airplane at this speed, whose reference speeds up by 8 m/s^2 at most.

    The more it follows the airplane, the less it says how fast to fly: no more than what k can hold.
    """
    v = speed_m_s
    return waiting.Parameters(
        slowest=0.5,
        fastest=1.15,
        per_m=min(0.35, 7.0 / v, 12.0 * k_per_s / v),
        falls_per_s=min(0.5, 10.0 / v),
        rises_per_s=min(0.4, 8.0 / v),
    )


def _check(f: Airframe) -> None:
    """Say what is wrong with it, all at once."""
    low, cruise, high = f.airspeed_min_m_s, f.airspeed_cruise_m_s, f.airspeed_max_m_s
    wrong = []
    if not 0.0 < low < cruise <= high < inf:
        wrong.append(f"airspeeds must be 0 < min < cruise <= max, not {low:g}, {cruise:g}, {high:g} m/s")
    if not -pi / 2 < f.pitch_lowest_rad < f.pitch_cruise_rad < f.pitch_highest_rad < pi / 2:
        wrong.append(
            "pitch must be -pi/2 < lowest < cruise < highest < pi/2,"
            f" not {f.pitch_lowest_rad:g}, {f.pitch_cruise_rad:g}, {f.pitch_highest_rad:g} rad"
        )
    bounds = {"throttle_cruise": 1.0, "bank_max_rad": BANK_RAD}
    for name, value in f._asdict().items():
        if name.startswith(("airspeed", "pitch", "floor")):
            continue
        below = bounds.get(name, inf)
        if not 0.0 < value < below:
            wrong.append(f"{name} must be above 0 and below {below:.4g}, not {value:g}")
    if isnan(f.floor_down_m):
        wrong.append("floor_down_m must be a number, or inf for no floor")
    if wrong:
        raise ValueError("; ".join(wrong))
