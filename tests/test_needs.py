"""What is hardest of a trajectory, its corners and its lowest place: found where they are."""

from __future__ import annotations

import time
from math import pi, radians, sqrt

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
from guidance.instants import looked_at
from guidance.se3 import Vec3
from guidance.shortfall import needed, shortfalls
from guidance.trajectory import Eight, Helix, Lemniscate, Trajectory, Zigzag, sample
from tests.flyable import AIRPLANE_12, COPTER, ROVER, named, refused
from tests.strategies import properties

SPEEDS = st.floats(0.5, 30.0)


#: Trajectories whose needs vary along them.
UNEVEN: list[Trajectory] = [
    Lemniscate(length_m=20.0, width_m=10.0, speed_m_s=2.0),
    Lemniscate(length_m=60.0, width_m=5.0, speed_m_s=4.0, stop_at_s=31.0),
    Eight(length_m=400.0, width_m=200.0, speed_m_s=20.0, rise_m=10.0),
    Eight(length_m=30.0, width_m=25.0, speed_m_s=3.0, rise_m=-2.0, stop_at_s=17.0, stop_over_s=6.0),
    Helix(radius_m=30.0, speed_m_s=5.0, down_m_s=-2.0, levels_off_m=30.0),
]


@pytest.mark.parametrize("trajectory", UNEVEN, ids=repr)
@pytest.mark.parametrize("vehicle", NEEDS)
def test_what_is_needed_most_is_found_within_1_percent(
    trajectory: Trajectory, vehicle: type[Abilities]
) -> None:
    """Beside sums of their own over 20 000 instants, all by differences of the velocity or the position."""
    end_s = max(trajectory.cycle_s, *(span[1] for span in trajectory.eased_s), 0.0)
    t = np.linspace(0.0, end_s, 20_001)
    v = np.array([sample(trajectory, time_s).velocity for time_s in t])
    a = np.gradient(v, t, axis=0)
    j = np.gradient(a, t, axis=0)
    level = np.hypot(v[:, 0], v[:, 1])
    speed = np.linalg.norm(v, axis=1)
    moving = level > 0.05 * level.max()
    along = np.abs(np.gradient(level, t))
    turn = np.where(moving, np.abs(v[:, 0] * a[:, 1] - v[:, 1] * a[:, 0]) / np.maximum(level, 1e-9) ** 2, 0.0)
    bank = np.arctan(level * turn / (GRAVITY_M_S2 - a[:, 2]))
    load = (GRAVITY_M_S2 - a[:, 2]) / GRAVITY_M_S2 / np.cos(bank)
    expected = {
        SpaceAbilities: [
            speed.min(),
            speed.max(),
            (np.linalg.norm(np.cross(v, a), axis=1) / np.maximum(speed, 1e-9) ** 2)[moving].max(),
            np.abs(np.gradient(speed, t)).max(),
        ],
        GroundAbilities: [
            level.min(),
            level.max(),
            turn.max(),
            np.abs(np.gradient(turn, t))[2:-2][moving[2:-2]].max(),
            (level * turn).max(),
            (level[moving] / np.maximum(turn[moving], 1e-9)).min(),
            along.max(),
        ],
        AirplaneAbilities: [
            (speed / np.sqrt(np.maximum(load, 1.0))).min(),
            speed.max(),
            bank.max(),
            load.max(),
            (-v[:, 2]).max(),
            v[:, 2].max(),
            None,
        ],
        VelocityAbilities: [
            level.max(),
            (-v[:, 2]).max(),
            v[:, 2].max(),
            np.hypot(a[:, 0], a[:, 1]).max(),
            np.hypot(j[:, 0], j[:, 1])[4:-4].max(),
        ],
    }[vehicle]
    for kind, value, right in zip(NEEDS[vehicle].kinds, needed(trajectory, vehicle), expected, strict=True):
        if right is not None and not (trajectory.stop_at_s > 0.0 and kind.what in STEPS_AT_REST):
            assert value == pytest.approx(right, rel=0.01, abs=2e-3), kind.what


#: Their differences mean little while the speed goes to zero.
STEPS_AT_REST = {"change of yaw rate", "horizontal jerk"}


def test_a_corner_is_a_warning_with_its_number_and_a_bend_that_is_too_sharp_is_refused() -> None:
    zigzag = Zigzag(leg_m=20.0, speed_m_s=1.4 / sqrt(2.0))
    (corner,) = shortfalls(zigzag, ROVER)
    turning = 2.0 * sqrt(pi / 2 / radians(120.0))  # the full yaw rate is not reached
    assert turning_s(ROVER, Vec3(1.0, 1.0, 0.0), Vec3(-1.0, 1.0, 0.0)) == pytest.approx(turning)
    assert not corner.refuses
    assert corner.needed == pytest.approx(pi / 2)
    assert corner.off_m == pytest.approx(0.5 * 1.4 * sqrt(2.0) * turning)
    assert turning_s(COPTER, Vec3(0.0, 2.0, 0.0), Vec3(0.0, -3.0, 0.0)) == pytest.approx(2.0)
    assert corner.text == (
        "corner: 90 deg at once at t = 20.2 s (north 20 m, east 20 m): "
        "the reference runs away by 1.7 m or more"
    )
    for abilities in (COPTER, AIRPLANE_12, SpaceAbilities(turn_rad_s=Bound(1.0, ""))):
        assert "corner" in named(shortfalls(Zigzag(speed_m_s=9.0), abilities))
    sharp = Lemniscate(length_m=60.0, width_m=0.5, speed_m_s=2.0)
    assert "corner" not in named(shortfalls(sharp, ROVER))
    assert "radius" in "".join(refused(sharp, ROVER))
    assert shortfalls(zigzag, GroundAbilities()) == ()  # nothing bounds its turn


@pytest.mark.parametrize("leg_m", [0.3, 7.0, 1000.0])
def test_corners_are_found_where_they_are(leg_m: float) -> None:
    corners = looked_at(Zigzag(leg_m=leg_m, speed_m_s=1.3)).corners
    assert [each.time_s for each in corners] == pytest.approx([leg_m / 1.3, 2.0 * leg_m / 1.3], rel=1e-9)
    stopping = looked_at(
        Zigzag(leg_m=leg_m, speed_m_s=1.3, stop_at_s=1.5 * leg_m / 1.3, stop_over_s=0.1)
    ).corners
    assert [each.time_s for each in stopping] == pytest.approx([leg_m / 1.3], rel=1e-9)


@properties
@given(
    st.sampled_from([Lemniscate, Eight]),
    st.floats(1.0, 500.0),
    st.floats(1.0, 500.0),
    SPEEDS,
    st.sampled_from([0.0, 3.0, 40.0]),
)
def test_what_is_smooth_has_no_corner(
    kind: type[Lemniscate] | type[Eight], length_m: float, width_m: float, speed_m_s: float, stop_at_s: float
) -> None:
    looked = looked_at(kind(length_m=length_m, width_m=width_m, speed_m_s=speed_m_s, stop_at_s=stop_at_s))
    assert looked.corners == ()
    assert len(looked.instants) < 3000


def test_a_floor_is_met_where_the_trajectory_passes_it() -> None:
    sinking = Helix(radius_m=100.0, speed_m_s=12.0, down_m_s=0.5, down_m=-60.0)
    (height,) = shortfalls(sinking, AIRPLANE_12)
    assert height.time_s == pytest.approx(200.0)
    assert height.needed == pytest.approx(240.0)  # as far as it is looked ahead
    assert "40 m below the origin, at t = 200 s" in height.text
    assert height.text.endswith("and 200 m below it: start at least 200 m higher")
    level = msgspec.structs.replace(sinking, levels_off_m=100.0)
    assert shortfalls(level, AIRPLANE_12) == ()
    eight = Eight(length_m=400.0, width_m=200.0, speed_m_s=12.0, down_m=35.0, rise_m=10.0)
    assert named(shortfalls(eight, AIRPLANE_12)) == ["height"]


def test_other_limits_and_the_same_wind_are_not_looked_for_again() -> None:
    eight = Eight(length_m=123.0, width_m=77.0, speed_m_s=12.0)
    shortfalls(eight, AIRPLANE_12, Vec3(3.0, 0.0, 0.0))
    looked = looked_at.cache_info().misses
    begin_s = time.perf_counter()
    found = shortfalls(eight, AIRPLANE_12, Vec3(3.1, 0.1, 0.0))  # rounds to the same
    assert found is shortfalls(eight, AIRPLANE_12, Vec3(3.0, 0.0, 0.0))
    for n in range(10):
        shortfalls(eight, AIRPLANE_12._replace(load=Bound(1.5 + n, "")), Vec3(3.0, 0.0, 0.0))
    assert time.perf_counter() - begin_s < 0.5
    assert looked_at.cache_info().misses == looked
