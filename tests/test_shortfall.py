"""What a vehicle cannot fly: found where it is, with numbers that are right and advice that works."""

from __future__ import annotations

import math
from math import acos, atan, cos, hypot, isnan, pi, radians, sqrt, tan
from typing import TypeVar

import msgspec
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from guidance.abilities import (
    Abilities,
    Bound,
    GroundAbilities,
    SpaceAbilities,
)
from guidance.feasibility import abilities_of, within_autopilot
from guidance.handling.airplane_bank import GRAVITY_M_S2
from guidance.instants import INSTANTS
from guidance.se3 import Vec3
from guidance.shortfall import Shortfall, shortfalls
from guidance.trajectory import Circle, Eight, Helix, Lemniscate, Line, Trajectory, Zigzag, sample
from tests.flyable import AIRPLANE_12, AIRPLANE_20, COPTER, ROVER, refused
from tests.helpers import make_config
from tests.strategies import properties


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
    plane = AIRPLANE_12._replace(load=Bound(9.0, ""), airspeed_least_m_s=Bound(5.0, ""))
    (bank,) = shortfalls(Circle(radius_m=12.0, speed_m_s=12.0), plane)
    assert bank.needed == pytest.approx(atan(144.0 / 12.0 / GRAVITY_M_S2))
    lateral_m_s2 = GRAVITY_M_S2 * tan(radians(40.5))
    assert bank.speed_m_s == pytest.approx(sqrt(12.0 * lateral_m_s2))
    assert bank.radius_m == pytest.approx(144.0 / lateral_m_s2)
    assert bank.text == (
        "bank: 50.7 deg needed at t = 0 s (north 12 m, east 0 m), 40.5 deg available (ROLL_LIMIT_DEG 45 less "
        "10 %): fly at most 10 m/s there, or a radius of at least 17.2 m"
    )


def test_advice_that_would_harm_what_is_met_is_not_given() -> None:
    """To fly slowly enough for the bank is too slow for the wing."""
    found = shortfalls(Circle(radius_m=12.0, speed_m_s=12.0), AIRPLANE_12._replace(load=Bound(9.0, "")))
    bank = next(each for each in found if each.kind.what == "bank")
    assert bank.text.endswith(
        "less 10 %): fly at most 10 m/s there, or a radius of at least 17.2 m"
    )  # stalls now
    slow = AIRPLANE_12._replace(load=Bound(9.0, ""), airspeed_least_m_s=Bound(9.5, ""))
    (bank,) = shortfalls(Circle(radius_m=12.0, speed_m_s=12.0), slow)
    assert isnan(bank.speed_m_s)
    assert bank.text.endswith("less 10 %): a radius of at least 17.2 m")


SPEEDS = st.floats(0.5, 30.0)
RADII = st.floats(0.5, 300.0)

Curve = TypeVar("Curve", Circle, Line)


def with_advice(trajectory: Curve, shortfall: Shortfall) -> list[Curve]:
    """The trajectory as it is advised to be, in each of the ways, with the numbers of the text."""
    words = shortfall.text.rpartition(": ")[2]
    if "available" in words:
        return []
    numbers = words.replace(",", "").split()
    advised = []
    for key, unit in (("speed_m_s", "m/s"), ("radius_m", "m"), ("stop_over_s", "s")):
        if unit in numbers:
            value = float(numbers[numbers.index(unit) - 1])
            if hasattr(trajectory, key):
                advised.append(msgspec.structs.replace(trajectory, **{key: value}))
    return advised


@properties
@given(
    st.sampled_from(
        [ROVER, COPTER, AIRPLANE_12, AIRPLANE_20, SpaceAbilities(turn_rad_s=Bound(1.0, "rates"))]
    ),
    SPEEDS,
    RADII,
    st.booleans(),
)
@example(COPTER, 3.0, 1.0, True)
@example(ROVER, 4.0, 1.0, False)
@example(AIRPLANE_20, 20.0, 25.0, True)
def test_the_advice_for_a_circle_works_as_it_is_written(
    abilities: Abilities, speed_m_s: float, radius_m: float, clockwise: bool
) -> None:
    circle = Circle(radius_m=radius_m, speed_m_s=speed_m_s, clockwise=clockwise)
    for shortfall in shortfalls(circle, abilities):
        for advised in with_advice(circle, shortfall):
            assert shortfall.kind not in [each.kind for each in shortfalls(advised, abilities)]
            slightly = 0.98 if shortfall.kind.is_least else 1.02  # and is not more than is needed
            if advised.speed_m_s != speed_m_s:
                beyond = msgspec.structs.replace(circle, speed_m_s=slightly * advised.speed_m_s)
            else:
                beyond = msgspec.structs.replace(circle, radius_m=0.98 * advised.radius_m)
            assert shortfall.kind in [each.kind for each in shortfalls(beyond, abilities)]


@properties
@given(SPEEDS, st.floats(0.5, 20.0))
def test_the_advice_for_a_stop_works_as_it_is_written(speed_m_s: float, over_s: float) -> None:
    line = Line(speed_m_s=speed_m_s, stop_at_s=100.0, stop_over_s=over_s)
    abilities = ROVER._replace(speed_m_s=Bound(100.0, ""))
    found = shortfalls(line, abilities)
    assert bool(found) is (1.5 * speed_m_s / over_s > 1.0)
    for shortfall in found:
        assert shortfall.kind.what == "change of speed"
        (advised,) = with_advice(line, shortfall)
        assert shortfalls(advised, abilities) == ()
        assert advised.stop_over_s == pytest.approx(1.5 * speed_m_s, rel=0.02)


def test_an_airplane_is_not_to_stop() -> None:
    line = Line(speed_m_s=12.0, stop_at_s=60.0)
    assert any(
        "airspeed" in text and "leave out trajectory.stop_at_s" in text for text in refused(line, AIRPLANE_12)
    )


@properties
@given(st.floats(0.0, 2.0 * pi), st.floats(1.0, 8.0), st.floats(30.0, 200.0))
def test_the_wind_asks_for_airspeed_on_one_side_and_takes_it_on_the_other(
    direction: float, wind_m_s: float, radius_m: float
) -> None:
    plane = AIRPLANE_12._replace(
        clock_least=1.0, clock_most=1.0, load=Bound(9.0, ""), bank_rad=Bound(1.5, "")
    )
    wind = Vec3(wind_m_s * cos(direction), wind_m_s * math.sin(direction), 0.0)
    rounded = hypot(*(0.5 * round(2.0 * part) for part in wind))
    circle = Circle(radius_m=radius_m, speed_m_s=12.0)
    found = {each.kind.what: each for each in shortfalls(circle, plane, wind)}
    fast, slow = found.get("airspeed"), found.get("airspeed by the root of the load")
    assert (fast is not None) is (12.0 + rounded > 14.0 * (1.0 + 1e-4)) or abs(rounded - 2.0) < 1e-3
    if fast is not None:
        assert fast.needed == pytest.approx(12.0 + rounded, rel=1e-4)
        against = sample(circle, fast.time_s).velocity
        assert against.x * wind.x + against.y * wind.y < 0.0
        assert fast.speed_m_s == pytest.approx(14.0 - rounded, rel=1e-3)
    if slow is not None:
        load = 1.0 / cos(atan(144.0 / radius_m / GRAVITY_M_S2))
        assert slow.needed <= (12.0 - rounded) / sqrt(load) * (1.0 + 1e-4)
        assert refused(circle, plane, wind)


def test_with_a_reference_that_waits_the_wind_is_a_warning_unless_it_is_too_much_for_the_clock_too() -> None:
    circle = Circle(radius_m=80.0, speed_m_s=12.0)
    slow, fast = shortfalls(circle, AIRPLANE_12, Vec3(0.0, 5.0, 0.0))
    assert not slow.refuses
    assert not fast.refuses
    assert fast.text == (
        "airspeed: 17 m/s needed at t = 20.9 s (north -80 m, east 0 m), 14 m/s available (AIRSPEED_MAX 14): "
        "the reference runs at 0.75 of its speed there, and off its plan for 18 s of each round"
    )
    assert slow.text.endswith(
        "at least 10 m/s available (AIRSPEED_MIN 10): the reference runs at 1.3 of its speed there, and "
        "off its plan for 13 s of each round"
    )
    # 12^2 + 5^2 - 2 * 12 * 5 cos > 14^2 where the angle to the wind is beyond acos(-0.225)
    assert fast.waits_s == pytest.approx(circle.cycle_s * (1.0 - acos(-0.225) / pi), rel=0.01)
    hasty = AIRPLANE_12._replace(clock_most=1.15)
    assert len(refused(circle, hasty, Vec3(0.0, 5.0, 0.0))) == 1
    (stormy,) = refused(circle, AIRPLANE_12, Vec3(0.0, 11.0, 0.0))
    assert stormy.endswith("fly at most 3 m/s there")  # a quarter of the plan's: the clock runs at half of it
    too_fast = Circle(radius_m=80.0, speed_m_s=14.5)  # in calm air: that is not the wind's doing
    assert any("airspeed" in text for text in refused(too_fast, AIRPLANE_12))


def test_a_bank_in_the_wind_is_that_across_the_air() -> None:
    circle = Circle(radius_m=60.0, speed_m_s=12.0)
    wind = Vec3(3.0, -2.5, 0.0)
    plane = AIRPLANE_12._replace(bank_rad=Bound(0.01, "none"), effectiveness=0.8)
    bank = next(each for each in shortfalls(circle, plane, wind) if each.kind.what == "bank")
    banks = []
    for t_s in np.linspace(0.0, circle.cycle_s, INSTANTS, endpoint=False):
        _, v, a = sample(circle, t_s)
        x, y = v.x - wind.x, v.y - wind.y
        banks.append(atan(abs(x * a.y - y * a.x) / hypot(x, y) / (0.8 * GRAVITY_M_S2)))
    assert bank.needed == pytest.approx(max(banks), rel=1e-6)


def test_margins_and_the_tighter_of_two_limits_say_where_they_come_from() -> None:
    ours, theirs = Bound(4.0, "limits.speed_max_m_s 4"), Bound(5.0, "WP_SPEED 5").less(0.1)
    assert min(ours, theirs) is ours
    assert theirs == (4.5, "WP_SPEED 5 less 10 %")
    assert (
        max(Bound(9.0, "ours"), Bound(8.0, "AIRSPEED_MIN 8").more(0.15)).source == "AIRSPEED_MIN 8 and 15 %"
    )
    found = shortfalls(Helix(down_m_s=-3.0), COPTER)
    assert [each.text for each in found] == [
        "climb: 3 m/s needed at t = 0 s (north 0 m, east 1 m), 2.5 m/s available (WPNAV_SPEED_UP 250)"
    ]


def test_a_rover_is_held_to_the_tighter_of_its_configuration_and_its_autopilot() -> None:
    config = make_config("vehicle.profile=ardupilot-rover", "flight.origin=engage")
    ours = abilities_of(config.limits, config.law, 5.0, planar=True, ground=config.ground)
    assert isinstance(ours, GroundAbilities)
    values = {"WP_SPEED": 3.0, "ATC_STR_ACC_MAX": 120.0, "ATC_ACCEL_MAX": 0.0, "ATC_TURN_MAX_G": 0.6}
    held = within_autopilot(ours, {**values, "ATC_STR_RAT_MAX": 400.0, "TURN_RADIUS": 0.9})
    assert held.speed_m_s == (3.0, "WP_SPEED 3")
    assert held.yaw_rate_rad_s == (5.0, "limits.yaw_rate_max_rad_s")
    assert held.yaw_acceleration_rad_s2.value == pytest.approx(radians(120.0))
    assert held.lateral_m_s2.value == pytest.approx(0.7 * 0.6 * 9.81)
    assert held.lateral_m_s2.source == "ATC_TURN_MAX_G 0.6 less 30 %"
    assert held.radius_least_m == (0.9, "TURN_RADIUS 0.9")
    assert held.acceleration_m_s2.value == math.inf  # 0 is no limit
    assert within_autopilot(ours, {}) == ours._replace(radius_least_m=Bound(0.0, "TURN_RADIUS 0"))
