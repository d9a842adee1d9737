"""The steps of a tuning flight for each class of vehicle, and what each needs: from the configuration and the
autopilot's parameters, the tighter of both."""

from __future__ import annotations

from collections.abc import Mapping
from math import acos, exp, inf, tan
from typing import Final

from guidance.config import Config, ConfigError, profile_of
from guidance.flying import airplane_fit, velocity_fit
from guidance.flying.ground_fit import Allowed, ardupilot_allows, px4_allows, px4_rover
from guidance.handling import airplane, airplane_throttle
from guidance.handling_config import ExcitationConfig
from guidance.mavlink.profiles import Asked, Handling, Profile
from guidance.se3 import ZERO
from guidance.tune.excitation import (
    GRAVITY_M_S2,
    PART,
    THROTTLE_S,
    VELOCITY_M_S,
    Airplane,
    Box,
    Copter,
    Ground,
    airplane_runs,
    copter_runs,
    ground_runs,
    space_needed,
)
from guidance.tune.way_back import with_ways_back

#: What can be stepped: how a vehicle is driven, and what it is asked for.
STEPPED: Final = frozenset(
    {
        (Handling.GROUND, Asked.YAW_RATE_SPEED),
        (Handling.GROUND, Asked.VELOCITY_YAW_RATE),
        (Handling.AIRPLANE, Asked.ATTITUDE_THROTTLE),
        (Handling.VELOCITY, Asked.VELOCITY_YAW_RATE),
    }
)
#: Without a speed of the operator's: this part of the highest, m/s at most.
SPEED_PART: Final = 0.5
SPEED_M_S: Final = 2.0
CRAWL_PART: Final = 0.4
#: Where none is known.
ACCELERATION_M_S2: Final = 1.0
#: The way back: at this part of the cruise, its turns within this part of the yaw rate, and sideways m/s^2.
BACK_PART: Final = 0.75
TURN_PART: Final = 0.5
LATERAL_M_S2: Final = 1.0
#: How much wider than its tightest turn.
WIDER: Final = 2.0
#: Stopping begins so late, s, beside the configured delay.
LAG_S: Final = 0.3
#: Straight before the start, s at the way back's speed, so that the heading settles; of an airplane, until
#: height and airspeed have.
STRAIGHT_S: Final = 2.0
LEVEL_S: Final = 5.0
#: An airplane turns back with this part of its steepest bank, of which the least effectiveness is counted.
BACK_BANK_PART: Final = 0.5
EFFECTIVENESS: Final = 0.6
#: What carries a banked airplane has this margin of its airspeed, and a step of the throttle uses so much of
#: the airspeed's room.
LOADED_PART: Final = 0.95
ENVELOPE_PART: Final = 0.6
#: The wind that an airplane's room is counted for, a part of its airspeed.
WIND_PART: Final = 0.3


def excitation_of(
    config: Config, profile: Profile, values: Mapping[str, float], speed_m_s: float | None
) -> ExcitationConfig:
    """Of a checked configuration, at this cruising speed; `values` are the autopilot's, in its units.

    Raises:
        ConfigError: the vehicle has no steps, they do not fit its limits, or something of it is not known.
    """
    check_steps(config)
    match profile.handling, profile.asked:
        case Handling.GROUND, Asked.YAW_RATE_SPEED:
            if config.ground.turning_radius_m is None and "TURN_RADIUS" not in values:
                raise ConfigError(
                    "ground.turning_radius_m: the autopilot does not tell TURN_RADIUS, so it must be set: "
                    "the radius of the tightest circle in m, 0 if it turns at rest"
                )
            allowed = ardupilot_allows(values)
            full = min(allowed.speed_m_s, config.vehicle.speed_at_full_thrust_m_s)
            return _ground(config, allowed._replace(speed_m_s=full), speed_m_s)
        case Handling.GROUND, Asked.VELOCITY_YAW_RATE:
            rover = px4_rover(values)
            if isinstance(rover, str):
                raise ConfigError(rover)
            return _ground(config, px4_allows(rover), speed_m_s)
        case Handling.AIRPLANE, Asked.ATTITUDE_THROTTLE:
            return _airplane(config, values, speed_m_s)
    return _copter(config, values, speed_m_s)


def check_steps(config: Config) -> None:
    """Raises ConfigError for a vehicle that is asked for something that has no steps."""
    profile = profile_of(config)
    if (profile.handling, profile.asked) not in STEPPED:
        raise ConfigError(
            f"vehicle.profile = {profile.name}, which is asked for {profile.asked}: there are no steps of "
            "that, only of yaw rate and speed (rovers, boats), of roll, pitch and throttle (airplanes, "
            "airplane.output = attitude) and of velocity and yaw rate (copters, PX4's rovers)"
        )


def radius_of(config: Config, profile: Profile, values: Mapping[str, float]) -> float | None:
    """Of the tightest turn of what drives, None if it does not: the configuration's, or the autopilot's."""
    if profile.handling is not Handling.GROUND:
        return None
    if config.ground.turning_radius_m is not None:
        return config.ground.turning_radius_m
    rover = px4_rover(values)
    return ardupilot_allows(values).radius_m if isinstance(rover, str) else px4_allows(rover).radius_m


def _ground(config: Config, allowed: Allowed, speed_m_s: float | None) -> ExcitationConfig:
    limits = config.limits
    top = min(limits.speed_max_m_s, allowed.speed_m_s)
    cruise = min(SPEED_M_S, SPEED_PART * top) if speed_m_s is None else speed_m_s
    if not 0.0 < cruise <= top:
        raise ConfigError(f"--speed {cruise:g}: must be above 0 and at most {top:g}, its highest speed (m/s)")
    acceleration = min(limits.acceleration_max_m_s2 or inf, allowed.acceleration_m_s2)
    acceleration = ACCELERATION_M_S2 if acceleration == inf else acceleration
    radius = config.ground.turning_radius_m
    radius = allowed.radius_m if radius is None else radius
    turn = min(limits.yaw_rate_max_rad_s, allowed.yaw_rate_rad_s)
    runs = ground_runs(Ground(cruise, CRAWL_PART * cruise, top, turn, acceleration, radius))
    back = BACK_PART * cruise
    wide = max(WIDER * radius, back / (TURN_PART * turn), back * back / LATERAL_M_S2)
    straight = STRAIGHT_S * back
    box = with_ways_back(space_needed(runs, 0.0), runs[:-1], wide, straight)
    return ExcitationConfig(
        runs=runs,
        box=box._replace(up_m=0.0, down_m=0.0),
        back_m_s=back,
        back_radius_m=wide,
        back_straight_m=straight,
        stop_m=back * (0.5 * back / acceleration + config.link.actuation_delay_s + LAG_S),
    )


def _airplane(config: Config, values: Mapping[str, float], speed_m_s: float | None) -> ExcitationConfig:
    found = airplane_fit.fitted(config, values)
    if isinstance(found, str):
        raise ConfigError(found)
    p, cruise = found
    airspeed = cruise if speed_m_s is None else speed_m_s
    least, most = p.envelope.airspeed_min_m_s + p.envelope.margin_m_s, p.envelope.airspeed_max_m_s
    if not least <= airspeed < most:
        raise ConfigError(
            f"--speed {airspeed:g}: must be an airspeed from {least:.3g}, the least and its margin, to below "
            f"{most:.3g} m/s"
        )
    # as steep as the wing carries
    load = min(p.envelope.load_max, (LOADED_PART * airspeed / p.envelope.airspeed_min_m_s) ** 2)
    bank = min(p.envelope.bank_max_rad, acos(1.0 / max(load, 1.0)) / 0.9)
    drag = airplane_throttle.drag_m_s2(p.throttle, airspeed, 1.0)
    pitch = p.pitch.alpha_zero_rad + p.pitch.alpha_per_load_rad_m2_s2 / airspeed**2
    limits = Airplane(
        airspeed, bank, pitch, drag / p.throttle.thrust_m_s2, _throttle_off(p, airspeed, least, most)
    )
    try:
        runs = airplane_runs(limits)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    turning = GRAVITY_M_S2 * EFFECTIVENESS * tan(BACK_BANK_PART * p.envelope.bank_max_rad)
    radius = airspeed * airspeed / turning
    straight, wind = LEVEL_S * airspeed, WIND_PART * airspeed
    box = with_ways_back(space_needed(runs, airspeed), runs[:-1], radius, straight, airspeed)
    drift = wind * max(run.lasts_s for run in runs)
    box = Box(
        box.ahead_m + straight + drift,
        max(box.behind_m - straight, 0.0) + drift,
        box.right_m + drift,
        box.left_m + drift,
        box.up_m,
        box.down_m,
    )
    return ExcitationConfig(
        runs=runs,
        way="flies",
        box=box,
        back_m_s=airspeed,
        back_radius_m=radius,
        back_straight_m=straight,
        fastest_m_s=most,
        wind_max_m_s=wind,
    )


def _throttle_off(p: airplane.Parameters, airspeed: float, least: float, most: float) -> float:
    """The step of the throttle that changes the airspeed by no more than a part of its room."""
    t = p.throttle
    slope = 2.0 * (t.drag_per_m * airspeed - t.induced_m3_s4 / airspeed**3)
    lag_s = 1.0 / max(slope, 0.01)
    change = t.thrust_m_s2 * lag_s * (1.0 - exp(-THROTTLE_S / lag_s))
    # the margin above the least airspeed is for gusts, half of it stays
    least -= 0.5 * p.envelope.margin_m_s
    return ENVELOPE_PART * min(airspeed - least, most - airspeed) / change


def _copter(config: Config, values: Mapping[str, float], speed_m_s: float | None) -> ExcitationConfig:
    p = velocity_fit.fitted(config, ZERO, values)
    if isinstance(p, str):
        raise ConfigError(p)
    top = p.limits.speed_max_m_s
    speed = min(VELOCITY_M_S, PART * top) if speed_m_s is None else speed_m_s
    if not 0.0 < speed <= min(VELOCITY_M_S, PART * top):
        raise ConfigError(
            f"--speed {speed:g}: must be above 0 and at most {min(VELOCITY_M_S, PART * top):g}, half of its "
            f"highest and no more than {VELOCITY_M_S:g} m/s"
        )
    climb = min(p.up_max_m_s, p.down_max_m_s)
    runs = copter_runs(Copter(speed / PART, climb, p.limits.yaw_rate_rad_s))
    return ExcitationConfig(runs=runs, way="hovers", box=space_needed(runs, 0.0))
