"""What the vehicles of the tests can do, and what falls short of it."""

from __future__ import annotations

from math import radians

from guidance.abilities import (
    Abilities,
    AirplaneAbilities,
    Bound,
    GroundAbilities,
    VelocityAbilities,
)
from guidance.se3 import ZERO, Vec3
from guidance.shortfall import Shortfall, shortfalls
from guidance.trajectory import Trajectory

#: ArduPilot's autotest rover, as `handling.rover` takes its parameters.
ROVER = GroundAbilities(
    speed_least_m_s=Bound(0.0, "no reverse"),
    speed_m_s=Bound(5.0, "WP_SPEED 5"),
    yaw_rate_rad_s=Bound(radians(120.0), "ATC_STR_RAT_MAX 120"),
    yaw_acceleration_rad_s2=Bound(radians(120.0), "ATC_STR_ACC_MAX 120"),
    lateral_m_s2=Bound(0.6 * 9.81, "ATC_TURN_MAX_G 0.6").less(0.3),
    radius_least_m=Bound(0.9, "TURN_RADIUS 0.9"),
    acceleration_m_s2=Bound(1.0, "ATC_ACCEL_MAX 1"),
)
#: The airplanes of `sitl.airplane_tasks`, whose reference waits.
AIRPLANE_12 = AirplaneAbilities(
    airspeed_least_m_s=Bound(10.0, "AIRSPEED_MIN 10"),
    airspeed_m_s=Bound(14.0, "AIRSPEED_MAX 14"),
    bank_rad=Bound(radians(45.0), "ROLL_LIMIT_DEG 45").less(0.1),
    load=Bound(1.5, "load_max 1.5"),
    climb_m_s=Bound(2.5, "climb_max 2.5"),
    sink_m_s=Bound(3.0, "sink_max 3"),
    roll_rate_rad_s=Bound(1.5, "roll rate"),
    floor_down_m=Bound(40.0, "floor"),
    clock_least=0.5,
    clock_most=2.0,
)
AIRPLANE_20 = AIRPLANE_12._replace(
    airspeed_least_m_s=Bound(11.0, "AIRSPEED_MIN 11"),
    airspeed_m_s=Bound(26.0, "AIRSPEED_MAX 26"),
    bank_rad=Bound(radians(64.0), "ROLL_LIMIT_DEG 64").less(0.1),
    load=Bound(2.4, "load_max 2.4"),
    effectiveness=0.74,
)
COPTER = VelocityAbilities(
    speed_m_s=Bound(5.0, "WPNAV_SPEED 500"),
    climb_m_s=Bound(2.5, "WPNAV_SPEED_UP 250"),
    sink_m_s=Bound(1.5, "WPNAV_SPEED_DN 150"),
    acceleration_m_s2=Bound(2.5, "WPNAV_ACCEL 250"),
    jerk_m_s3=Bound(5.0, "PSC_JERK_XY 5"),
)


def named(found: tuple[Shortfall, ...]) -> list[str]:
    """What falls short."""
    return [shortfall.kind.what for shortfall in found]


def refused(trajectory: Trajectory, abilities: Abilities, wind: Vec3 = ZERO) -> list[str]:
    """What it is refused for."""
    return [each.text for each in shortfalls(trajectory, abilities, wind) if each.refuses]
