"""Steps to be flown: within limits, there and back, and within the room that is said to be needed."""

from __future__ import annotations

from math import hypot, pi, radians

import pytest
from numpy.testing import assert_allclose

from guidance.tune.excitation import (
    Airplane,
    Box,
    Copter,
    Ground,
    Run,
    airplane_runs,
    copter_runs,
    corners_ned_m,
    demand_at,
    ground_runs,
    space_needed,
)
from sitl.models.airplane import flying
from sitl.models.files import load_airplane, load_rover
from sitl.models.gusts import CALM
from tests.steps_flown import SILENT, banked, driven

ROVER = Ground(2.0, 0.8, 5.0, 2.09, 1.0, 0.9)
AIRPLANE = Airplane(20.0, radians(65.0), 0.03, 0.4)
COPTER = Copter(10.0, 3.0, 2.0)
ALL = (*ground_runs(ROVER), *airplane_runs(AIRPLANE), *copter_runs(COPTER))


def values(run: Run) -> list[float]:
    return [hold.value for hold in run.holds]


@pytest.mark.parametrize("run", ALL, ids=lambda run: f"{run.channel} {run.name}")
def test_a_run_leads_in_at_rest_and_steps_away_and_back(run: Run) -> None:
    first, others = run.holds[0], dict(run.others)
    assert first.lasts_s >= 2.0
    assert run.channel not in others
    returns = [
        a for a, b, c in zip(run.holds, run.holds[1:], run.holds[2:], strict=False) if a.value == c.value
    ]
    assert len(returns) >= 2
    assert run.lasts_s < 30.0
    about = first.value
    if run.channel != "speed_m_s":
        assert_allclose(sum(value - about for value in values(run)), 0.0, atol=1e-12)


def test_demand_at_is_that_of_the_hold_at_each_instant() -> None:
    yaw, speed = ground_runs(ROVER)
    edges = [sum(hold.lasts_s for hold in yaw.holds[:n]) for n in range(len(yaw.holds))]
    for hold, edge in zip(yaw.holds, edges, strict=True):
        assert demand_at(yaw, edge) == {"yaw_rate_rad_s": hold.value, "speed_m_s": 2.0}
        assert demand_at(yaw, edge + hold.lasts_s - 1e-6)["yaw_rate_rad_s"] == hold.value
    assert demand_at(speed, -1.0) == {"speed_m_s": 0.0, "yaw_rate_rad_s": 0.0}
    assert demand_at(speed, 1e3)["speed_m_s"] == speed.holds[-1].value
    # a clock that counts in periods lands a nanosecond short of an edge
    assert demand_at(yaw, edges[1] - 1e-10)["yaw_rate_rad_s"] == yaw.holds[1].value


def test_ground_steps_scale_with_the_limits() -> None:
    assert max(values(ground_runs(ROVER)[0])) == 1.0
    assert max(values(ground_runs(ROVER._replace(yaw_rate_max_rad_s=0.8))[0])) == 0.4
    # half of what its wheels allow at that speed
    assert max(values(ground_runs(ROVER._replace(turning_radius_m=4.0))[0])) == 0.25
    assert max(values(ground_runs(ROVER._replace(turning_radius_m=0.0))[0])) == 1.0
    assert sorted(set(values(ground_runs(ROVER)[1]))) == [0.0, 0.8, 2.0]


def test_airplane_steps_stay_about_the_trim_and_leave_the_height_to_the_guidance() -> None:
    bank, pitch, throttle = airplane_runs(AIRPLANE)
    assert_allclose(max(values(bank)), radians(40.0))
    assert set(demand_at(bank, 5.0)) == {"roll_rad"}
    assert set(demand_at(throttle, 5.0)) == {"roll_rad", "throttle"}
    assert demand_at(pitch, 0.0) == {"roll_rad": 0.0, "pitch_rad": 0.03}
    # what the nose gains going down is there when it goes up
    assert demand_at(pitch, 3.0)["pitch_rad"] < 0.03
    assert_allclose((min(values(pitch)), max(values(pitch))), (0.03 - radians(5.0), 0.03 + radians(5.0)))
    assert_allclose((min(values(throttle)), max(values(throttle))), (0.25, 0.55))
    full = airplane_runs(AIRPLANE._replace(throttle_trim=0.81, bank_max_rad=0.5))
    assert_allclose((max(values(full[2])), max(values(full[0]))), (0.95, 0.45))


def test_what_leaves_no_room_for_a_step_is_refused() -> None:
    with pytest.raises(ValueError, match=r"throttle 0.92 in level flight leaves no room"):
        airplane_runs(AIRPLANE._replace(throttle_trim=0.92))
    with pytest.raises(ValueError, match=r"crawl 2, cruise 2 and highest speed 5 m/s: must rise"):
        ground_runs(ROVER._replace(crawl_m_s=2.0))


@pytest.mark.parametrize(
    ("name", "limits"), [("rover", ROVER), ("boat", Ground(2.0, 0.8, 4.0, 1.5, 0.7, 2.0))]
)
def test_a_ground_vehicle_stays_in_the_room_that_was_announced(name: str, limits: Ground) -> None:
    runs = ground_runs(limits)
    paths = [driven(load_rover(name), run, SILENT).path for run in runs]
    _inside(space_needed(runs, 0.0), [at for path in paths for at in path])


@pytest.mark.parametrize(("name", "speed_m_s"), [("airplane_12", 12.0), ("airplane_20", 20.0)])
def test_an_airplane_stays_in_the_room_that_was_announced(name: str, speed_m_s: float) -> None:
    model = load_airplane(name)
    trim = flying(model, 0.0, 0.0, 0.0, 0.0, speed_m_s, CALM).queue[-1]
    runs = airplane_runs(Airplane(speed_m_s, model.roll_max_rad, trim.pitch_rad, trim.throttle))
    box = space_needed(runs, speed_m_s)
    _inside(box, [at for run in runs for at in banked(model, speed_m_s, run).path])
    # and not in half of it, or nobody could fence it
    assert box.ahead_m < 2.0 * speed_m_s * max(run.lasts_s for run in runs)


def test_the_room_of_a_copter_is_its_steps() -> None:
    box = space_needed(copter_runs(COPTER), 0.0)
    assert_allclose((box.ahead_m, box.right_m, box.down_m), (10.05, 10.05, 6.025), atol=0.3)
    assert_allclose((box.behind_m, box.left_m, box.up_m), (2.0, 2.0, 2.0), atol=0.3)


def test_corners_are_turned_by_the_heading() -> None:
    corners = corners_ned_m(Box(10.0, 1.0, 3.0, 2.0, 0.0, 0.0), 100.0, 50.0, 0.5 * pi)
    assert_allclose(corners, ((97.0, 60.0), (97.0, 49.0), (102.0, 49.0), (102.0, 60.0)))
    diagonal = hypot(corners[0][0] - corners[2][0], corners[0][1] - corners[2][1])
    assert_allclose(diagonal, hypot(11.0, 5.0))


def _inside(box: Box, path: list[tuple[float, float, float]]) -> None:
    for north, east, down in path:
        assert -box.behind_m <= north <= box.ahead_m
        assert -box.left_m <= east <= box.right_m
        assert -box.up_m <= down <= box.down_m
