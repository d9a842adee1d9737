"""What a rover or boat can do of a trajectory: what configuration and autopilot leave it, and which binds."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, radians

from guidance.abilities import Bound, GroundAbilities
from guidance.config import Config
from guidance.feasibility import abilities_of, within_autopilot
from guidance.flying import Caution
from guidance.handling import rover_px4
from guidance.handling.ground import Parameters
from guidance.handling.rover import ACCELERATION_PART


def ardupilot_abilities(config: Config, values: Mapping[str, float]) -> GroundAbilities:
    """By ArduPilot's parameters, in its units; those that are not known bound nothing."""
    own = abilities_of(config.limits, config.law, inf, True, config.ground)
    assert isinstance(own, GroundAbilities)
    return within_autopilot(own, values)


def px4_abilities(config: Config, autopilot: rover_px4.Autopilot) -> GroundAbilities:
    """By PX4's, which says nothing of what the tyres hold."""
    a, own = autopilot, ardupilot_abilities(config, {})
    lateral = config.ground.lateral_acceleration_max_m_s2
    return own._replace(
        speed_m_s=min(own.speed_m_s, Bound(a.RO_SPEED_LIM, f"RO_SPEED_LIM {a.RO_SPEED_LIM:g}")),
        yaw_rate_rad_s=min(
            own.yaw_rate_rad_s,
            Bound(
                rover_px4.yaw_rate_max_rad_s(a),
                f"RO_YAW_RATE_LIM {a.RO_YAW_RATE_LIM:g}, RO_YAW_P {a.RO_YAW_P:g}",
            ),
        ),
        yaw_acceleration_rad_s2=min(
            own.yaw_acceleration_rad_s2,
            Bound(radians(a.RO_YAW_ACCEL_LIM), f"RO_YAW_ACCEL_LIM {a.RO_YAW_ACCEL_LIM:g}"),
        ),
        lateral_m_s2=Bound(rover_px4.LATERAL_M_S2, "what tyres are taken to hold")
        if lateral is None
        else own.lateral_m_s2,
        radius_least_m=own.radius_least_m
        if config.ground.turning_radius_m is not None
        else Bound(rover_px4.turning_radius_m(a), f"RA_WHEEL_BASE {a.RA_WHEEL_BASE:g}"),
        acceleration_m_s2=min(
            own.acceleration_m_s2,
            Bound(a.RO_ACCEL_LIM, f"RO_ACCEL_LIM {a.RO_ACCEL_LIM:g}").less(1.0 - ACCELERATION_PART),
        ),
    )


def unbounded(p: Parameters | None) -> tuple[Caution, ...]:
    """What neither says a limit of: it is asked for at once."""
    if p is None:
        return ()
    limits = p.law.limits
    free = [
        key
        for key, value in (
            ("limits.acceleration_max_m_s2", limits.acceleration_m_s2),
            ("limits.yaw_acceleration_max_rad_s2", limits.yaw_acceleration_rad_s2),
            ("ground.lateral_acceleration_max_m_s2", p.lateral_acceleration_m_s2),
        )
        if value == inf
    ]
    text = f"the autopilot tells no limit, nor is one set, and none is kept: {', '.join(free)}"
    return (Caution("parameters", text),) if free else ()
