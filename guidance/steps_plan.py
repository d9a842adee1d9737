"""From a configuration to that of a tuning flight: which steps, how large, and the room that they need."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from typing import Final, NamedTuple

from msgspec.structs import replace

from guidance.config import Config, ConfigError, checked, profile_of
from guidance.handling_config import ExcitationConfig
from guidance.mavlink.profiles import Handling
from guidance.steps_runs import excitation_of, radius_of
from guidance.trajectory import Line
from guidance.tune import room
from guidance.tune.excitation import Run
from guidance.tune.propose import Known, Results, airplane_lines, copter_lines, ground_lines
from guidance.tune.propose import Line as Proposed
from guidance.tune.way_back import Place


class Plan(NamedTuple):
    """The configuration to be flown, with its steps, and how they are announced."""

    config: Config
    text: str


def planned(
    config: Config, speed_m_s: float | None = None, values: Mapping[str, float] | None = None
) -> Plan:
    """The tuning flight of a checked configuration, at this cruising speed; `values` are the autopilot's
    parameters, in its units.

    Raises:
        ConfigError: there are no steps for the profile, the speed is beyond its limits, or there is no fence.
    """
    profile, values = profile_of(config), values or {}
    excitation = excitation_of(config, profile, values, speed_m_s)
    guards = config.guards
    if not (guards.fence_ned_m or guards.fence_deg):
        raise ConfigError(_without_fence(excitation))
    radius_m = radius_of(config, profile, values)
    flown = replace(
        config,
        excitation=excitation,
        flight=replace(config.flight, origin="engage"),
        ground=config.ground if radius_m is None else replace(config.ground, turning_radius_m=radius_m),
        # it is not followed: the flight begins where the vehicle is
        trajectory=Line(speed_m_s=excitation.back_m_s if excitation.way == "flies" else 0.001),
    )
    return Plan(checked(flown), _announced(excitation))


def proposed(config: Config, results: Results) -> tuple[Proposed, ...]:
    """Lines for this vehicle's configuration, by what its steps showed."""
    match profile_of(config).handling:
        case Handling.AIRPLANE:
            return airplane_lines(results, config.excitation.back_m_s)
        case Handling.VELOCITY:
            return copter_lines(results, known(config))
    return ground_lines(results, known(config))


def known(config: Config) -> Known:
    """What proposals for this vehicle rest on beside the measurements."""
    limits = config.limits
    return Known(
        limits.speed_max_m_s,
        limits.yaw_rate_max_rad_s,
        config.ground.turning_radius_m or 0.0,
        config.vehicle.speed_at_full_thrust_m_s,
    )


def _announced(excitation: ExcitationConfig) -> str:
    way = excitation.way
    lines = ["This flight asks the vehicle for steps, one channel at a time, without the law:"]
    lines += [f"  {run.name}: {_sizes(run)}, {run.lasts_s:.0f} s" for run in excitation.runs]
    between = {
        "drives": f"Between them it drives back to where it began, at {excitation.back_m_s:.2g} m/s.",
        "hovers": "Between them it goes back to where it began. Let it hover there before you engage.",
        "flies": f"It is engaged in level flight. Between them it flies level, at an airspeed of "
        f"{excitation.back_m_s:.3g} m/s, and turns back to where it began; the stall guard and the floor "
        "end a run.",
    }[way]
    lines.append(f"{between} All of it takes about {_about_s(excitation):.0f} s.")
    lines.append(f"It needs {room.in_words(excitation.box)} of {_where(excitation)}.")
    lines.append("Your mode switch ends it at any time; the fence and all other guards act.")
    return "\n".join(lines)


def _where(excitation: ExcitationConfig) -> str:
    """What the room is measured from."""
    return {
        "drives": "where it stands, along its heading",
        "hovers": "where it hovers, ahead being north",
        "flies": f"where it is engaged, along its course, in a wind of {excitation.wind_max_m_s:.2g} m/s at "
        "most",
    }[excitation.way]


def _sizes(run: Run) -> str:
    values = sorted({hold.value for hold in run.holds} - {0.0})
    unit = next((unit for end, unit in _UNITS.items() if run.channel.endswith(end)), "")
    others = ", ".join(f"{name.replace('_m_s', '')} {value:g} m/s" for name, value in run.others if value)
    return ", ".join(f"{value:.2g}" for value in values) + f" {unit}" + (f" at {others}" if others else "")


#: The longest first.
_UNITS: Final = {"_rad_s": "rad/s", "_m_s": "m/s", "_rad": "rad"}


def _about_s(excitation: ExcitationConfig) -> float:
    """A way back ends at rest, or is that of a copter, a few seconds."""
    back_m = excitation.box.ahead_m + 2.0 * pi * excitation.back_radius_m
    back_s = back_m / excitation.back_m_s if excitation.back_m_s else 0.0
    ways = len(excitation.runs) - 1
    return sum(run.lasts_s for run in excitation.runs) + ways * (back_s + 5.0)


def _without_fence(excitation: ExcitationConfig) -> str:
    start = Place(0.0, 0.0, 0.0)
    return (
        f"guards.fence_ned_m: there is no fence, and steps are flown inside one only. They need "
        f"{room.in_words(excitation.box)} of {_where(excitation)}. From the autopilot's local origin, "
        f"heading north, that is\n{room.fence_in_words(excitation.box, start)}"
    )
