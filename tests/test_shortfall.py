"""What a vehicle cannot fly: found where it is, with numbers that are right and advice that works."""

from __future__ import annotations

import math
import time
from math import atan, cos, hypot, inf, isnan, pi, radians, sqrt, tan

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from guidance.abilities import (
    NEEDS,
    Abilities,
    AirplaneAbilities,
    Bound,
    GroundAbilities,
    SpaceAbilities,
    VelocityAbilities,
    turning_s,
)
from guidance.handling.airplane_bank import GRAVITY_M_S2
from guidance.instants import INSTANTS, looked_at
from guidance.se3 import ZERO, Vec3
from guidance.shortfall import Shortfall, needed, shortfalls
from guidance.trajectory import Circle, Eight, Helix, Lemniscate, Line, Trajectory, Zigzag, sample
from tests.strategies import properties

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
    bank_rad=Bound(radians(45.0), "ROLL_LIMIT_DEG 45").less(0.2),
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
    bank_rad=Bound(radians(64.0), "ROLL_LIMIT_DEG 64").less(0.2),
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


@pytest.mark.parametrize(
    ("trajectory", "abilities"),
    [
        (Circle(radius_m=10.0, speed_m_s=2.0), ROVER),
        (Lemniscate(length_m=20.0, width_m=10.0, speed_m_s=2.0), ROVER),
        (Zigzag(leg_m=20.0, speed_m_s=1.4 / sqrt(2.0)), ROVER),
        *(
            (path, plane)
            for plane, speed in ((AIRPLANE_12, 12.0), (AIRPLANE_20, 20.0))
            for path in (
                Circle(radius_m=80.0, speed_m_s=speed),
                Circle(radius_m=100.0, speed_m_s=speed),
                Helix(radius_m=100.0, speed_m_s=speed, down_m_s=-1.0),
                Helix(radius_m=80.0, speed_m_s=speed, down_m_s=-1.0, levels_off_m=100.0),
                Eight(length_m=400.0, width_m=200.0, speed_m_s=speed, rise_m=10.0),
            )
        ),
        (Circle(radius_m=10.0, speed_m_s=3.0), COPTER),
        (Helix(radius_m=10.0, speed_m_s=3.0, down_m_s=-0.5), COPTER),
        (Circle(radius_m=10.0, speed_m_s=3.0, stop_at_s=60.0), COPTER),
    ],
)
@pytest.mark.parametrize("wind_m_s", [0.0, 5.0])
def test_what_the_vehicles_are_to_fly_is_not_refused(
    trajectory: Trajectory, abilities: Abilities, wind_m_s: float
) -> None:
    for direction in np.linspace(0.0, 2.0 * pi, 8, endpoint=False):
        wind = Vec3(wind_m_s * cos(direction), wind_m_s * math.sin(direction), 0.0)
        assert refused(trajectory, abilities, wind) == []


def test_a_bank_is_told_with_place_source_margin_and_what_would_do() -> None:
    circle = Circle(radius_m=20.0, speed_m_s=12.0)
    (bank,) = shortfalls(circle, AIRPLANE_12._replace(load=Bound(9.0, ""), roll_rate_rad_s=Bound(inf, "")))
    asked, allowed = atan(144.0 / 20.0 / GRAVITY_M_S2), radians(36.0)
    assert bank.needed == pytest.approx(asked)
    assert bank.available == pytest.approx(allowed)
    assert bank.radius_m == pytest.approx(144.0 / GRAVITY_M_S2 / tan(allowed))
    assert isnan(bank.speed_m_s)  # 11.9 m/s banks little enough, and is too slow for that load
    assert bank.text == (
        "bank: 36.3 deg needed at t = 0 s (north 20 m, east 0 m), 36 deg available (ROLL_LIMIT_DEG 45 less "
        "20 %): a radius of at least 20.3 m"
    ).replace("a radius", "fly at most 11.9 m/s there, or a radius" if not isnan(bank.speed_m_s) else "a radius")


