"""The copter models against the step responses that were recorded of both autopilots, and as bodies."""

from __future__ import annotations

from functools import cache
from math import atan, cos, hypot, pi, radians, sin, tan
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from sitl.compiled import compiled
from sitl.models.attitude import GRAVITY_M_S2, roll_pitch_heading
from sitl.models.copter import (
    IN_FLIGHT,
    Parameters,
    State,
    acting,
    hovering,
    step,
    thrust_of,
    told,
    told_rates,
)
from sitl.models.files import COPTERS, load_copter
from sitl.models.gusts import CALM, Wind

DT_S = 0.004
PERIOD = 5
MODELS = {name: load_copter(name) for name in COPTERS}

#: The flights that were recorded, from rest: s, and which of velocity NED and yaw rate was asked for (index).
PX4_STEPS = (4.5, 3.0), (3.0, 3.0), (2.0, 1.3)
ARDU_STEPS = (3.5, 2.5), (3.0, 3.0), (2.0, 1.3)
STEPS = (
    ("north +2", 0, 2.0),
    ("north -2", 0, -2.0),
    ("east +2", 1, 2.0),
    ("east -2", 1, -2.0),
    ("down -2", 2, -2.0),
    ("down +2", 2, 2.0),
    ("yaw +0.3", 3, 0.3),
    ("yaw -0.3", 3, -0.3),
    ("yaw +1", 3, 1.0),
    ("yaw -1", 3, -1.0),
)
#: What was seen: value at the end (mean of 0.4 s), s until 5, 50 and 90 % of the change, overshoot in %.
RECORDED = {
    "copter_ardupilot": {
        "north +2": (1.98, 0.32, 0.76, 1.36, 0.0),
        "north -2": (-2.03, 0.28, 0.74, 1.36, 0.0),
        "east +2": (2.00, 0.31, 0.75, 1.32, 0.0),
        "east -2": (-1.99, 0.29, 0.75, 1.35, 0.0),
        "down -2": (-2.05, 0.28, 1.14, 1.94, 1.0),
        "down +2": (2.02, 0.34, 1.18, 1.86, 2.0),
        "yaw +0.3": (0.30, 0.10, 0.24, 0.36, 23.0),
        "yaw -0.3": (-0.30, 0.13, 0.24, 0.36, 23.0),
        "yaw +1": (1.00, 0.16, 0.32, 0.46, 19.0),
        "yaw -1": (-1.00, 0.18, 0.32, 0.46, 18.0),
    },
    "copter_px4": {
        "north +2": (1.58, 0.18, 0.46, 1.32, 1.0),
        "north -2": (-1.60, 0.16, 0.50, 2.27, 1.0),
        "east +2": (1.55, 0.19, 0.46, 1.73, 4.0),
        "east -2": (-1.58, 0.20, 0.54, 1.90, 5.0),
        "down -2": (-1.90, 0.07, 0.22, 0.56, 1.0),
        "down +2": (1.48, 0.06, 0.22, 0.67, 4.0),
        "yaw +0.3": (0.28, 0.00, 0.32, 0.69, 15.0),
        "yaw -0.3": (-0.26, 0.00, 0.28, 0.58, 13.0),
        "yaw +1": (0.91, 0.12, 0.34, 0.73, 3.0),
        "yaw -1": (-0.90, 0.02, 0.34, 0.67, 6.0),
    },
}


def seen(state: State, what: int) -> float:
    return state.yaw_rate_rad_s if what == 3 else state.velocity_ned_m_s[what]


@cache
def answers(name: str) -> dict[str, NDArray[np.float64]]:
    """The recorded flight, flown by the model: the value that each step asks for, every `DT_S`."""
    parameters = MODELS[name]
    state = hovering(parameters, (0.0, 0.0, -30.0), radians(-2.0), CALM)
    times = PX4_STEPS if name == "copter_px4" else ARDU_STEPS
    found = {}
    for label, what, asked in STEPS:
        on_s, off_s = times[max(0, what - 1)]
        track = [seen(state, what)]
        for n in range(round((on_s + off_s) / DT_S)):
            if n % PERIOD == 0:
                values = [0.0] * 4
                values[what] = asked if n * DT_S < on_s - 1e-9 else 0.0
                state = told(parameters, state, (values[0], values[1], values[2]), values[3])
            state = step(parameters, state, CALM, DT_S)
            if n * DT_S < on_s - 1e-9:
                track.append(seen(state, what))
        found[label] = np.array(track)
    return found


def reached(track: NDArray[np.float64]) -> tuple[float, list[float], float]:
    """The end, s until 5, 50 and 90 % of the change, overshoot in %."""
    end = float(track[-100:].mean())
    parts = (track - track[0]) / (end - track[0])
    return end, [float(np.argmax(parts >= x)) * DT_S for x in (0.05, 0.5, 0.9)], 100.0 * (parts.max() - 1.0)


@pytest.mark.parametrize("label", [label for label, _, _ in STEPS])
def test_arducopter_answers_as_recorded(label: str) -> None:
    end, times, overshoot = reached(answers("copter_ardupilot")[label])
    recorded = RECORDED["copter_ardupilot"][label]
    assert end == pytest.approx(recorded[0], abs=0.05)
    # the table's times are 20 ms apart
    assert times == pytest.approx(recorded[1:4], abs=0.07)
    assert overshoot == pytest.approx(recorded[4], abs=3.0)


@pytest.mark.parametrize("label", [label for label, _, _ in STEPS])
def test_px4s_quadrotor_answers_as_recorded(label: str) -> None:
    """Its recorded velocities wander by 0.1 m/s on their own, and yaw rates have 0.03 rad/s of noise.

    That is in the overshoot, and in 5 % of a yaw step. From 70 % on velocity creeps, 0.1 m/s in 0.5 s.
    """
    end, times, overshoot = reached(answers("copter_px4")[label])
    recorded = RECORDED["copter_px4"][label]
    is_yaw = label.startswith("yaw")
    assert end == pytest.approx(recorded[0], abs=0.02 if is_yaw else 0.13)
    if not is_yaw:
        assert times[0] == pytest.approx(recorded[1], abs=0.07)
    assert times[1] == pytest.approx(recorded[2], abs=0.08)
    slow = label.startswith(("north", "east"))
    assert times[2] == pytest.approx(recorded[3], abs=0.65 if slow else 0.13)
    assert overshoot < 2.0


#: The largest tilt of a step and the tilt that holds 2 m/s, degrees, as recorded.
TILTS = {"copter_ardupilot": (15.8, 3.7), "copter_px4": (20.0, 9.3)}


@pytest.mark.parametrize("name", COPTERS)
def test_it_tilts_as_recorded(name: str) -> None:
    p = MODELS[name]
    state = hovering(p, (0.0, 0.0, 0.0), 0.0, CALM)
    pitches = []
    for n in range(round(3.5 / DT_S)):
        if n % PERIOD == 0:
            state = told(p, state, (2.0, 0.0, 0.0), 0.0)
        state = step(p, state, CALM, DT_S)
        pitches.append(roll_pitch_heading(state.attitude_wxyz)[1])
    most, holds = TILTS[name]
    # nose down to go north
    assert -min(pitches) == pytest.approx(radians(most), abs=radians(1.5))
    assert -pitches[-1] == pytest.approx(radians(holds), abs=radians(1.0))


def flown(p: Parameters, state: State, seconds: float, wind: Wind = CALM, dt_s: float = DT_S) -> State:
    for _ in range(round(seconds / dt_s)):
        state = step(p, state, wind, dt_s)
    return state


@pytest.mark.parametrize("name", COPTERS)
@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_its_thrust_is_its_acceleration(name: str, heading: float) -> None:
    """R (0, 0, -thrust) + g is what it accelerates by, wherever its nose points; so its telemetry is true."""
    p = MODELS[name]
    state = flown(p, told(p, hovering(p, (0.0, 0.0, 0.0), heading, CALM), (3.0, -1.0, -1.0), 0.5), 0.5)
    roll, pitch, yaw = roll_pitch_heading(state.attitude_wxyz)
    cr, sr, cp, sp, cy, sy = cos(roll), sin(roll), cos(pitch), sin(pitch), cos(yaw), sin(yaw)
    push = -thrust_of(p, state) / p.hover_thrust * GRAVITY_M_S2
    given = (
        push * (cr * sp * cy + sr * sy),
        push * (cr * sp * sy - sr * cy),
        push * cr * cp + GRAVITY_M_S2,
    )
    assert given == pytest.approx([x.given_m_s2 for x in (state.north, state.east, state.down)], abs=1e-9)
    assert hypot(given[0], given[1]) > 1.0


@pytest.mark.parametrize("name", COPTERS)
def test_its_body_rates_are_those_of_its_attitude(name: str) -> None:
    p = MODELS[name]
    state = flown(p, told(p, hovering(p, (0.0, 0.0, 0.0), 0.3, CALM), (3.0, 2.0, 0.0), 0.8), 0.4)
    after = step(p, state, CALM, DT_S)
    angles, then = roll_pitch_heading(state.attitude_wxyz), roll_pitch_heading(after.attitude_wxyz)
    roll, pitch, _ = angles
    d_roll, d_pitch, d_yaw = ((b - a) / DT_S for a, b in zip(angles, then, strict=True))
    assert after.body_rates_frd_rad_s == pytest.approx(
        (
            d_roll - d_yaw * sin(pitch),
            d_pitch * cos(roll) + d_yaw * sin(roll) * cos(pitch),
            d_yaw * cos(roll) * cos(pitch) - d_pitch * sin(roll),
        ),
        abs=0.01,
    )
    assert d_yaw == pytest.approx(after.yaw_rate_rad_s, abs=0.01)


@pytest.mark.parametrize("name", COPTERS)
def test_in_wind_it_stands_tilted(name: str) -> None:
    p = MODELS[name]
    wind = Wind(0.0, 5.0, 0.0)
    state = flown(p, hovering(p, (1.0, 2.0, -3.0), 0.0, wind), 4.0, wind)
    assert state.position_ned_m == pytest.approx((1.0, 2.0, -3.0), abs=1e-6)
    assert roll_pitch_heading(state.attitude_wxyz)[0] == pytest.approx(
        -atan(5.0 * p.drag_per_s / GRAVITY_M_S2), abs=1e-6
    )
    blown = flown(p, hovering(p, (0.0, 0.0, 0.0), 0.0, CALM), 1.0, wind)
    assert blown.velocity_ned_m_s[1] > 0.2


@pytest.mark.parametrize("name", COPTERS)
def test_it_never_tilts_further_than_it_may(name: str) -> None:
    p = MODELS[name]
    # without the overshoot of the attitude's loops
    bound = p._replace(tilt_max_rad=0.15, damping=1.0)
    state = told(bound, hovering(bound, (0.0, 0.0, 0.0), 0.0, CALM), (8.0, 6.0, 0.0), 0.0)
    leans = 0.0
    for _ in range(500):
        state = step(bound, state, CALM, DT_S)
        leans = max(leans, hypot(state.north.given_m_s2, state.east.given_m_s2))
    assert leans == pytest.approx(GRAVITY_M_S2 * tan(0.15), rel=1e-3)


def test_a_tilt_at_its_end_winds_nothing_up() -> None:
    p = MODELS["copter_px4"]._replace(tilt_max_rad=0.15)
    asked = told(p, hovering(p, (0.0, 0.0, 0.0), 0.0, CALM), (12.0, 0.0, 0.0), 0.0)
    assert flown(p, asked, 20.0).north.integral_m_s2 < 0.1


@pytest.mark.parametrize("name", COPTERS)
def test_a_velocity_is_taken_up_from_the_one_that_rates_left(name: str) -> None:
    p = MODELS[name]
    state = told_rates(p, hovering(p, (0.0, 0.0, 0.0), 0.0, CALM), (0.0, -0.3, 0.0), p.hover_thrust)
    state = flown(p, state, 1.5)
    fast, tilt = state.velocity_ned_m_s[0], state.north.given_m_s2
    assert fast > 1.0
    state = flown(p, told(p, state, (fast, 0.0, 0.0), 0.0), p.delay_s + 2 * DT_S)
    assert state.north.given_m_s2 == pytest.approx(tilt, abs=0.2)
    assert state.north.led_m_s == pytest.approx(fast, abs=0.3)


def test_what_it_may_fly_bounds_what_it_is_asked_for() -> None:
    p = MODELS["copter_px4"]
    state = flown(p, told(p, hovering(p, (0.0, 0.0, 0.0), 0.0, CALM), (0.0, 0.0, 9.0), 0.0), 8.0)
    assert state.velocity_ned_m_s[2] == pytest.approx(p.down_max_m_s, abs=0.05)


@pytest.mark.parametrize("name", COPTERS)
def test_told_its_hover_thrust_it_hovers_and_told_rates_it_turns_by_them(name: str) -> None:
    p = MODELS[name]
    still = hovering(p, (0.0, 0.0, 0.0), 0.0, CALM)
    state = flown(p, told_rates(p, still, (0.0, 0.0, 0.0), p.hover_thrust), 3.0)
    assert state.velocity_ned_m_s == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    state = flown(p, told_rates(p, still, (0.3, 0.0, 0.0), p.hover_thrust), 1.0)
    late = p.delay_s + p.rate_lag_s
    assert roll_pitch_heading(state.attitude_wxyz)[0] == pytest.approx(0.3 * (1.0 - late), abs=2e-3)
    assert state.velocity_ned_m_s[1] > 0.5  # rolled to the right, it goes right
    state = flown(p, told_rates(p, still, (0.0, 0.0, 0.0), 1.1 * p.hover_thrust), 1.0)
    assert state.velocity_ned_m_s[2] < -0.5
    # and a velocity takes it up again
    state = flown(p, told(p, state, (0.0, 0.0, 0.0), 0.0), 8.0)
    assert state.velocity_ned_m_s == pytest.approx((0.0, 0.0, 0.0), abs=0.1)


def test_rates_carry_it_over() -> None:
    """No angle is forbidden: a full roll."""
    p = MODELS["copter_px4"]
    state = told_rates(p, hovering(p, (0.0, 0.0, 0.0), 0.0, CALM), (2.0, 0.0, 0.0), 0.5)
    state = flown(p, state, pi / 2.0 + p.delay_s + p.rate_lag_s)
    roll = roll_pitch_heading(state.attitude_wxyz)[0]
    assert abs(abs(roll) - pi) < 0.02
    assert state.down.given_m_s2 > 1.9 * GRAVITY_M_S2


def test_nothing_moves_before_the_delay_and_commands_act_in_their_turn() -> None:
    p = MODELS["copter_px4"]._replace(delay_s=0.1)
    state = told(p, hovering(p, (0.0, 0.0, 0.0), 0.0, CALM), (2.0, 0.0, 0.0), 1.0)
    state = flown(p, state, 0.1)
    assert state.velocity_ned_m_s == (0.0, 0.0, 0.0)
    assert state.yaw_rate_rad_s == 0.0
    assert step(p, state, CALM, DT_S).yaw_rate_rad_s > 0.0
    state = hovering(p, (0.0, 0.0, 0.0), 0.0, CALM)
    for n in range(IN_FLIGHT + 3):
        state = told(p, state._replace(time_s=0.02 * n), (float(n), 0.0, 0.0), 0.0)
    seen_ = [acting(state.queue, p.delay_s + 0.02 * n).x for n in range(3, IN_FLIGHT + 3)]
    assert seen_ == [float(n) for n in range(3, IN_FLIGHT + 3)]


@pytest.mark.parametrize("name", COPTERS)
def test_shorter_steps_change_little(name: str) -> None:
    p = MODELS[name]
    asked = told(p, hovering(p, (0.0, 0.0, 0.0), 0.0, CALM), (2.0, 1.0, -1.0), 0.5)
    coarse, fine = flown(p, asked, 4.0), flown(p, asked, 4.0, dt_s=0.001)
    assert coarse.position_ned_m == pytest.approx(fine.position_ned_m, abs=0.02)
    assert coarse.attitude_wxyz == pytest.approx(fine.attitude_wxyz, abs=0.01)


@pytest.mark.timeout(180)  # it compiles
@pytest.mark.parametrize("name", COPTERS)
def test_compiled_it_is_the_same(name: str) -> None:
    p = MODELS[name]
    fast, by_velocity, by_rates = compiled(step), compiled(told), compiled(told_rates)
    state = same = hovering(p, (0.0, 0.0, 0.0), 0.3, CALM)
    for n in range(600):
        if n % 5 == 0:
            v, w = (sin(0.01 * n), 2.0, -0.5), cos(0.02 * n)
            if n < 400:
                state, same = told(p, state, v, w), by_velocity(p, same, v, w)
            else:
                state, same = told_rates(p, state, v, 0.5), by_rates(p, same, v, 0.5)
        state, same = step(p, state, Wind(1.0, 2.0, 0.0), DT_S), fast(p, same, Wind(1.0, 2.0, 0.0), DT_S)
    assert same.position_ned_m == pytest.approx(state.position_ned_m, abs=1e-10)
    assert same.attitude_wxyz == pytest.approx(state.attitude_wxyz, abs=1e-10)
    assert same.north == pytest.approx(state.north, abs=1e-10)


def test_a_wrong_file_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "m.toml"
    values = MODELS["copter_px4"]._asdict() | {"hover_thrust": 0.0}
    file.write_text("\n".join(f"{key} = {value}" for key, value in values.items()))
    with pytest.raises(ValueError, match=r"hover_thrust must be above 0"):
        load_copter(str(file))
    with pytest.raises(ValueError, match=r"nowhere.*copter_px4, copter_ardupilot"):
        load_copter("nowhere")
