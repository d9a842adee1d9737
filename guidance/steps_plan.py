"""From a configuration to that of a tuning flight: which steps, how large, and the room that they need."""

from __future__ import annotations

from math import pi
from typing import Final, NamedTuple

from msgspec.structs import replace

from guidance.config import Config, ConfigError, checked, profile_of
from guidance.handling_config import ExcitationConfig
from guidance.mavlink.profiles import Asked
from guidance.trajectory import Line
from guidance.tune import room
from guidance.tune.excitation import Box, Ground, Run, ground_runs, space_needed
from guidance.tune.propose import Known
from guidance.tune.way_back import Place, with_ways_back

#: Without a speed of the operator's: this part of the highest, m/s at most.
SPEED_PART: Final = 0.5
SPEED_M_S: Final = 2.0
CRAWL_PART: Final = 0.4
#: Where none is configured.
ACCELERATION_M_S2: Final = 1.0
#: The way back: at this part of the cruise, its turns within this part of the yaw rate, and sideways m/s^2.
BACK_PART: Final = 0.75
TURN_PART: Final = 0.5
LATERAL_M_S2: Final = 1.0
#: How much wider than its tightest turn.
WIDER: Final = 2.0
#: Stopping begins so late, s, beside the configured delay.
LAG_S: Final = 0.3
#: Straight before the start, s at the way back's speed, so that the heading settles.
STRAIGHT_S: Final = 2.0


class Plan(NamedTuple):
    """The configuration to be flown, with its steps, and how they are announced."""

    config: Config
    text: str


def planned(config: Config, speed_m_s: float | None = None) -> Plan:
    """The tuning flight of a checked configuration, at this cruising speed.

    Raises:
        ConfigError: there are no steps for the profile, the speed is beyond its limits, or there is no fence.
    """
    profile = profile_of(config)
    if profile.asked is not Asked.YAW_RATE_SPEED:
        raise ConfigError(
            f"vehicle.profile = {profile.name}: there are tuning flights only of vehicles that are asked for "
            f"{Asked.YAW_RATE_SPEED} (ardupilot-rover); this one is asked for {profile.asked}"
        )
    if config.ground.turning_radius_m is None:
        raise ConfigError(
            "ground.turning_radius_m: must be set for this flight, which is planned before the autopilot "
            "tells its own: the radius of the tightest circle in m (TURN_RADIUS), 0 if it turns at rest"
        )
    excitation = _ground(config, speed_m_s)
    guards = config.guards
    if not (guards.fence_ned_m or guards.fence_deg):
        raise ConfigError(_without_fence(excitation.box))
    flown = replace(
        config,
        excitation=excitation,
        flight=replace(config.flight, origin="engage"),
        trajectory=Line(speed_m_s=0.001),  # it is not followed: the flight begins where the vehicle is
    )
    return Plan(checked(flown), _announced(excitation))


def known(config: Config) -> Known:
    """What proposals for this vehicle rest on beside the measurements."""
    limits = config.limits
    return Known(
        limits.speed_max_m_s,
        limits.yaw_rate_max_rad_s,
        config.ground.turning_radius_m or 0.0,
        config.vehicle.speed_at_full_thrust_m_s,
    )


def _ground(config: Config, speed_m_s: float | None) -> ExcitationConfig:
    limits = config.limits
    top = min(limits.speed_max_m_s, config.vehicle.speed_at_full_thrust_m_s)
    cruise = min(SPEED_M_S, SPEED_PART * top) if speed_m_s is None else speed_m_s
    if not 0.0 < cruise <= top:
        raise ConfigError(f"--speed {cruise:g}: must be above 0 and at most {top:g}, its highest speed (m/s)")
    acceleration = limits.acceleration_max_m_s2 or ACCELERATION_M_S2
    radius = config.ground.turning_radius_m or 0.0
    turn = limits.yaw_rate_max_rad_s
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


def _announced(excitation: ExcitationConfig) -> str:
    lines = ["This flight asks the vehicle for steps, one channel at a time, without the law:"]
    lines += [f"  {run.name}: {_sizes(run)}, {run.lasts_s:.0f} s" for run in excitation.runs]
    lines.append(
        f"Between them it drives back to where it began, at {excitation.back_m_s:.2g} m/s. All of it takes "
        f"about {_about_s(excitation):.0f} s."
    )
    lines.append(f"It needs {room.in_words(excitation.box)} of where it stands, along its heading.")
    lines.append("Your mode switch ends it at any time; the fence and all other guards act.")
    return "\n".join(lines)


def _sizes(run: Run) -> str:
    values = sorted({hold.value for hold in run.holds} - {0.0})
    unit = next((unit for end, unit in _UNITS.items() if run.channel.endswith(end)), "")
    others = ", ".join(f"{name.replace('_m_s', '')} {value:g} m/s" for name, value in run.others if value)
    return ", ".join(f"{value:.2g}" for value in values) + f" {unit}" + (f" at {others}" if others else "")


#: The longest first.
_UNITS: Final = {"_rad_s": "rad/s", "_m_s": "m/s", "_rad": "rad"}


def _about_s(excitation: ExcitationConfig) -> float:
    back_m = excitation.box.ahead_m + 2.0 * pi * excitation.back_radius_m
    ways = len(excitation.runs) - 1
    return sum(run.lasts_s for run in excitation.runs) + ways * (back_m / excitation.back_m_s + 5.0)


def _without_fence(box: Box) -> str:
    start = Place(0.0, 0.0, 0.0)
    return (
        f"guards.fence_ned_m: there is no fence, and steps are flown inside one only. They need "
        f"{room.in_words(box)} of where the vehicle stands, along its heading. From the autopilot's local "
        f"origin, heading north, that is\n{room.fence_in_words(box, start)}"
    )
