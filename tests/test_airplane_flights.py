"""The airplane line of the figures: every task at 12 and at 20 m/s, with the noise of an estimator."""

from __future__ import annotations

from math import cos, radians, sin

import numpy as np
import pytest
from numpy.typing import NDArray

from guidance.handling import airplane
from guidance.handling.airplane import Measured, airplane_step
from guidance.se3 import Pose, Vec3, from_euler
from guidance.trajectory import line
from sitl.airplane_flight import (
    COLUMNS,
    EIGHT,
    GUIDE_STEP_S,
    MODEL_STEP_S,
    Task,
    fly,
    phase_step,
    planned,
)
from sitl.airplane_tasks import (
    FAR,
    Airplane,
    Scenario,
    airplane_12,
    airplane_20,
    figures,
    flown,
    scenarios,
)
from sitl.compiled import compiled
from sitl.models import airplane as model
from sitl.models.gusts import CALM

Track = NDArray[np.float64]
AIRPLANES = {12: airplane_12(), 20: airplane_20()}
TABLE = [(speed, name) for speed in AIRPLANES for name in scenarios(float(speed))]
CALM_CIRCLE = "circle 100 m"


@pytest.fixture(scope="module", autouse=True)
def _machine_code() -> None:
    """Compiled once, before a test's time runs."""
    flown(AIRPLANES[12], scenario(12, CALM_CIRCLE)._replace(duration_s=1.0), 0, compiled(fly))


def scenario(speed: int, name: str) -> Scenario:
    return scenarios(float(speed))[name]


@pytest.mark.timeout(180)  # the first of these compiles
@pytest.mark.parametrize(("speed", "name"), TABLE)
def test_every_task_is_flown_within_its_limits(speed: int, name: str) -> None:
    asked = scenario(speed, name)
    plane = AIRPLANES[speed]
    for seed in (1, 2):
        found = figures(flown(plane, asked, seed, compiled(fly)))
        if asked.wind_m_s == 0.0:
            assert found.converged_s < asked.converged_s
            assert found.max_m < asked.max_m
        assert found.rms_m < asked.rms_m
        assert found.airspeed_min_m_s > plane.guide.envelope.airspeed_min_m_s
        assert found.saturated < 0.01
        assert found.effectiveness == pytest.approx(plane.body.bank_effectiveness, abs=0.06)


def altered(plane: Airplane, **changes: float) -> Airplane:
    return plane._replace(body=plane.body._replace(**changes))


@pytest.mark.parametrize("speed", AIRPLANES)
def test_two_tenths_of_a_second_more_delay_do_no_harm(speed: int) -> None:
    plane = AIRPLANES[speed]
    late = altered(
        plane,
        roll_delay_s=plane.body.roll_delay_s + 0.2,
        pitch_delay_s=plane.body.pitch_delay_s + 0.2,
        throttle_delay_s=plane.body.throttle_delay_s + 0.2,
    )
    # the guide knows of it: the delay is measured
    known = late._replace(ahead_s=plane.ahead_s + 0.2)
    found = figures(flown(known, scenario(speed, CALM_CIRCLE), 3, compiled(fly)))
    assert found.rms_m < 0.5
    assert found.max_m < 1.5


@pytest.mark.parametrize("speed", AIRPLANES)
def test_a_body_that_is_known_badly_is_learned(speed: int) -> None:
    """Thrust 10 % less, drag 10 % more, and two degrees of angle of attack."""
    plane = AIRPLANES[speed]
    body = plane.body
    other = altered(
        plane,
        thrust_m_s2=0.97 * body.thrust_m_s2 if speed == 12 else 0.9 * body.thrust_m_s2,
        drag_per_m=1.03 * body.drag_per_m if speed == 12 else 1.1 * body.drag_per_m,
        alpha_zero_rad=body.alpha_zero_rad + radians(2.0),
    )
    found = figures(flown(other, scenario(speed, CALM_CIRCLE), 3, compiled(fly)))
    assert found.rms_m < 0.5
    assert found.max_m < 1.5


def test_without_the_learned_effectiveness_it_flies_wide() -> None:
    """Field notes: 2.3 to 5.6 m RMS with the prior of 1 instead of 0.2 m."""
    plane = AIRPLANES[20]
    stubborn = plane._replace(guide=plane.guide._replace(bank=plane.guide.bank._replace(per_s=0.0)))
    circle = scenario(20, CALM_CIRCLE)
    learned = figures(flown(plane, circle, 1, compiled(fly)))
    # NaN where it never comes within 3 m
    assert not figures(flown(stubborn, circle, 1, compiled(fly))).rms_m <= 4.0 * learned.rms_m


def test_waiting_halves_the_way_back() -> None:
    """Field notes: 33 s without, 16 s with."""
    plane = AIRPLANES[20]
    far = scenario(20, "150 m off, facing away")
    waited = figures(flown(plane, far, 1, compiled(fly)))
    punctual = figures(flown(plane, far._replace(waits=False), 1, compiled(fly)))
    assert waited.converged_s < 0.75 * punctual.converged_s
    assert far.start == FAR


def test_without_an_airspeed_sensor_and_without_wind_it_flies_the_same() -> None:
    plane, circle = AIRPLANES[20], scenario(20, CALM_CIRCLE)
    found = figures(flown(plane, circle, 2, compiled(fly), has_airspeed=False))
    assert found.rms_m < 0.5


def test_compiled_it_is_the_same() -> None:
    short = scenario(20, "lemniscate 400 x 200 m +-10 m, 5 m/s wind estimated")._replace(duration_s=4.0)
    plain, fast = flown(AIRPLANES[20], short, 7), flown(AIRPLANES[20], short, 7, compiled(fly))
    np.testing.assert_allclose(fast, plain, rtol=1e-6, atol=1e-6)
    assert plain.shape == (200, len(COLUMNS))


def test_the_same_seed_is_the_same_flight() -> None:
    circle = scenario(12, "circle 80 m, 5 m/s wind given")._replace(duration_s=10.0)
    one, two, other = (flown(AIRPLANES[12], circle, seed, compiled(fly)) for seed in (4, 4, 5))
    assert (one == two).all()
    assert (one != other).any()


def test_the_eight_is_flown_at_constant_speed_and_its_derivatives_are_its_own() -> None:
    task = Task(EIGHT, 400.0, 20.0, 10.0)
    phase, h = 0.3, 1e-3
    for _ in range(300):
        r = planned(task, phase, 60.0)
        before = planned(task, phase_step(task, phase, -h), 60.0)
        after = planned(task, phase_step(task, phase, h), 60.0)
        assert np.hypot(r.velocity.x, r.velocity.y) == pytest.approx(20.0)
        change = (np.array(after.position) - np.array(before.position)) / (2.0 * h)
        assert r.velocity == pytest.approx(change, abs=1e-4)
        change = (np.array(after.velocity) - np.array(before.velocity)) / (2.0 * h)
        assert r.acceleration == pytest.approx(change, abs=1e-4)
        phase = phase_step(task, phase, 0.2)


def test_a_flight_that_never_converges_says_so() -> None:
    record = np.full((100, len(COLUMNS)), 5.0)
    assert np.isnan(figures(record).converged_s)
    assert airplane.UNTRIMMED.effectiveness == 1.0


def flown_plainly(plane: Airplane, speed: int, state: model.State, down_m: float, duration_s: float) -> Track:
    """Without noise along a straight line to the north; rows of time, airspeed, height, roll."""
    memory = airplane.unstarted(airplane.UNTRIMMED)
    rows = []
    for n in range(round(duration_s / GUIDE_STEP_S)):
        t_s = n * GUIDE_STEP_S + plane.ahead_s
        reference = line(t_s, 0.0, 0.0, down_m, 0.0, float(speed), 0.0)
        measured = Measured(
            Pose(
                Vec3(state.north_m, state.east_m, state.down_m),
                from_euler(state.roll_rad, state.pitch_rad, state.heading_rad),
            ),
            Vec3(state.velocity_north_m_s, state.velocity_east_m_s, state.velocity_down_m_s),
            state.airspeed_m_s,
            False,
            Vec3(0.0, 0.0, 0.0),
            plane.ahead_s,
        )
        memory, demand, _ = airplane_step(plane.guide, memory, measured, reference, GUIDE_STEP_S)
        state = model.told(state, demand.roll_rad, demand.pitch_rad, demand.throttle)
        for _ in range(5):
            state = model.step(plane.body, state, CALM, MODEL_STEP_S)
        rows.append((n * GUIDE_STEP_S, state.airspeed_m_s, -state.down_m, state.roll_rad))
    return np.array(rows)


@pytest.mark.parametrize("speed", AIRPLANES)
def test_it_recovers_from_a_stall_and_flies_on(speed: int) -> None:
    """Half a m/s below the stall, the path above it: nose down, faster, only then up; no second stall."""
    plane = AIRPLANES[speed]
    state = model.flying(plane.body, 0.0, 10.0, -60.0, 0.0, plane.body.stall_m_s - 0.5, CALM)
    seen = flown_plainly(plane, speed, state, -65.0, 25.0)
    least = plane.guide.envelope.airspeed_min_m_s
    recovered = int(np.argmax(seen[:, 1] > least))
    assert seen[recovered, 0] < 4.0
    assert seen[recovered + 50 :, 1].min() > least
    assert seen[:, 2].min() > 45.0
    assert seen[-1, 2] == pytest.approx(65.0, abs=1.0)


@pytest.mark.parametrize("speed", AIRPLANES)
@pytest.mark.parametrize("altering", [{}, {"alpha_zero_rad": -2.0}, {"alpha_zero_rad": 2.0}])
@pytest.mark.parametrize(("part", "roll_deg", "path_deg"), [(0.6, 0, -20), (0.6, -60, -40), (0.8, 45, 0)])
def test_it_recovers_from_every_stall_in_which_it_can_be_taken_over(
    speed: int, altering: dict[str, float], part: float, roll_deg: float, path_deg: float
) -> None:
    """A stalled wing brakes more than the throttle pulls: PX4's airplane glided on to the ground."""
    plane = AIRPLANES[speed]
    body = {key: getattr(plane.body, key) + radians(value) for key, value in altering.items()}
    plane = altered(plane, **body)
    least = plane.guide.envelope.airspeed_min_m_s
    state = model.flying(plane.body, 0.0, 10.0, -60.0, 1.0, part * least, CALM)
    level = part * least * cos(radians(path_deg))
    state = state._replace(
        velocity_north_m_s=level * cos(1.0),
        velocity_east_m_s=level * sin(1.0),
        velocity_down_m_s=-part * least * sin(radians(path_deg)),
        roll_rad=radians(roll_deg),
    )
    seen = flown_plainly(plane, speed, state, -65.0, 20.0)
    assert seen[:, 2].min() > 35.0  # 43.7 and 50.7
    assert seen[-1, 2] == pytest.approx(65.0, abs=1.0)
    assert seen[-500:, 1].min() > least


@pytest.mark.parametrize("speed", AIRPLANES)
def test_no_reference_leads_it_below_the_floor(speed: int) -> None:
    plane = AIRPLANES[speed]
    state = model.flying(plane.body, 0.0, 0.0, -50.0, 0.0, float(speed), CALM)
    seen = flown_plainly(plane, speed, state, 30.0, 40.0)
    assert seen[:, 2].min() > -plane.guide.envelope.floor_down_m * 0.95
    assert seen[-1, 2] == pytest.approx(-plane.guide.envelope.floor_down_m, abs=1.0)
