"""The airplane models answer as the recorded autopilots did, and fly as their physics says."""

from __future__ import annotations

from math import cos, degrees, pi, radians, sin, sqrt, tan
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from sitl.compiled import compiled
from sitl.models import airplane
from sitl.models.airplane import GRAVITY_M_S2, Parameters, State, flying, step, told
from sitl.models.files import load_airplane
from sitl.models.gusts import CALM, NO_GUSTS, Gusts, Turbulence, Wind, blowing, gusts_step

DT_S = 0.004
SPEEDS = {"airplane_12": 12.0, "airplane_20": 20.0}


def level(name: str, wind: Wind = CALM) -> tuple[Parameters, State]:
    """In level flight to the north at its speed."""
    parameters = load_airplane(name)
    return parameters, flying(parameters, 0.0, 0.0, -50.0, 0.0, SPEEDS[name], wind)


def answer(
    name: str, roll_rad: float, pitch_step_rad: float, throttle_step: float, duration_s: float
) -> NDArray[np.float64]:
    """Steps from level flight: rows of time, roll, pitch, airspeed, course, down velocity."""
    parameters, state = level(name)
    asked = state.queue[-1]
    state = told(state, roll_rad, asked.pitch_rad + pitch_step_rad, asked.throttle + throttle_step)
    rows = []
    for _ in range(round(duration_s / DT_S)):
        state = step(parameters, state, CALM, DT_S)
        rows.append(
            (
                state.time_s,
                state.roll_rad,
                state.pitch_rad,
                state.airspeed_m_s,
                state.heading_rad,
                state.velocity_down_m_s,
            )
        )
    return np.array(rows)


def reached(times: NDArray[np.float64], y: NDArray[np.float64], start: float) -> tuple[float, ...]:
    """Time of 5, 50, 90 % of the change, and the overshoot in percent; as the recordings' table has them."""
    end = float(y[-100:].mean())
    part = (y - start) / (end - start)
    return (
        *(float(times[np.argmax(part >= p)]) for p in (0.05, 0.5, 0.9)),
        100.0 * (float(part.max()) - 1.0),
    )


# name, bank asked, 5 %, 50 %, 90 % in s, overshoot in %, of the recordings
BANKS = [
    ("airplane_20", 20.0, 0.14, 0.32, 0.46, 20.5),
    ("airplane_20", 40.0, 0.16, 0.42, 0.60, 13.0),
    ("airplane_12", 20.0, 0.04, 0.12, 0.34, 1.0),
    ("airplane_12", 40.0, 0.04, 0.14, 0.37, 0.0),
]


@pytest.mark.parametrize("row", BANKS)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_bank_steps_answer_as_recorded(
    row: tuple[str, float, float, float, float, float], side: float
) -> None:
    name, asked_deg, *times, overshoot = row
    seen = answer(name, side * radians(asked_deg), 0.0, 0.0, 3.0)
    *at, over = reached(seen[:, 0], seen[:, 1], 0.0)
    # the recording is 20 ms apart, and the fits leave 50 ms of the slow end of PX4's
    assert at == pytest.approx(times, abs=0.06)
    assert over == pytest.approx(overshoot, abs=7.0)
    assert seen[-1, 1] == pytest.approx(side * radians(asked_deg), rel=0.03)


# name, step of pitch asked, step of pitch seen (rad), 5 %, 50 % in s, overshoot in %
PITCHES = [
    ("airplane_20", 5.0, 0.08, 0.18, 0.33, 44.0),
    ("airplane_20", -5.0, -0.08, 0.18, 0.33, 44.0),
    ("airplane_12", 5.0, 0.06, 0.04, 0.17, 4.0),
    ("airplane_12", -5.0, -0.08, 0.04, 0.14, 6.0),
]


@pytest.mark.parametrize("row", PITCHES)
def test_pitch_steps_answer_as_recorded(row: tuple[str, float, float, float, float, float]) -> None:
    name, asked_deg, change, *times, overshoot = row
    seen = answer(name, 0.0, radians(asked_deg), 0.0, 2.6)
    start = level(name)[1].pitch_rad
    at5, at50, _, over = reached(seen[:, 0], seen[:, 2], start)
    assert seen[-1, 2] - start == pytest.approx(change, abs=0.015)
    assert (at5, at50) == pytest.approx(times, abs=0.06)
    assert over == pytest.approx(overshoot, abs=12.0)


# name, gain in m/s per unit, tau in s of the fits; steps up and down as in the recordings
SPEED_FITS = [("airplane_12", 12.706, 0.938, 0.15, -0.1), ("airplane_20", 35.704, 2.844, 0.25, -0.25)]


@pytest.mark.parametrize("row", SPEED_FITS)
def test_throttle_steps_answer_as_recorded(row: tuple[str, float, float, float, float]) -> None:
    """The fits' V' = (K throttle - V)/tau + g vz/V about level flight, over the 5 s of the steps."""
    name, gain, tau_s, up, down = row
    for change in (up, down):
        seen = answer(name, 0.0, 0.0, change, 5.0)
        v = v0 = SPEEDS[name]
        off = []
        for row_seen in seen:
            off.append(v - row_seen[3])
            v += DT_S * ((gain * change - (v - v0)) / tau_s + GRAVITY_M_S2 * row_seen[5] / row_seen[3])
        # the fits are local, drag is not: 15 % of the change, which is 1.3 to 7.4 m/s
        assert sqrt(np.mean(np.square(off))) < 0.15 * abs(v - v0)


@pytest.mark.parametrize("name", SPEEDS)
def test_level_flight_stays_level(name: str) -> None:
    parameters, state = level(name, Wind(3.0, -2.0, 0.0))
    for _ in range(2500):
        state = step(parameters, state, Wind(3.0, -2.0, 0.0), DT_S)
    assert state.airspeed_m_s == pytest.approx(SPEEDS[name], abs=1e-3)
    assert state.down_m == pytest.approx(-50.0, abs=1e-2)
    # the wind carries it along; the offset of its roll is trimmed away
    assert state.east_m == pytest.approx(-20.0, abs=1e-2)
    assert state.north_m == pytest.approx((SPEEDS[name] + 3.0) * 10.0, abs=1e-2)


@pytest.mark.parametrize(("name", "effectiveness"), [("airplane_12", 0.95), ("airplane_20", 0.74)])
def test_a_bank_turns_by_its_effectiveness(name: str, effectiveness: float) -> None:
    """eta g tan(phi)/V, where lift carries the weight; and the nose must be held up for that."""
    parameters, state = level(name)
    bank = radians(30.0)
    asked = state.queue[-1]
    ratios = []
    for n in range(5000):
        # hold the height as a pilot would
        pitch = asked.pitch_rad + 0.03 * state.velocity_down_m_s + 0.006 * (state.down_m + 50.0)
        speed_loop = asked.throttle + 0.2 * (SPEEDS[name] - state.airspeed_m_s)
        state = told(state, bank / parameters.roll_gain, pitch, speed_loop) if n % 5 == 0 else state
        before = state
        state = step(parameters, state, CALM, DT_S)
        if n > 4000:
            turning = sin(state.heading_rad - before.heading_rad) / DT_S * state.airspeed_m_s
            carried = GRAVITY_M_S2 - (state.velocity_down_m_s - before.velocity_down_m_s) / DT_S
            ratios.append(turning / (carried * tan(bank)))
    # but for the small climb
    assert np.mean(ratios) == pytest.approx(effectiveness, rel=0.02)


@pytest.mark.parametrize(
    ("name", "alpha_rad", "speed_m_s"),
    [("airplane_12", -0.0361, 12.10), ("airplane_20", -0.0412, 19.65), ("airplane_20", -0.0518, 23.98)],
)
def test_the_trim_angle_of_attack_is_the_recorded_one(name: str, alpha_rad: float, speed_m_s: float) -> None:
    """Pitch minus path angle in the recordings' straight flight, within half a degree."""
    parameters = load_airplane(name)
    state = flying(parameters, 0.0, 0.0, 0.0, 0.0, speed_m_s, CALM)
    assert degrees(abs(state.pitch_rad - alpha_rad)) < 0.5


@pytest.mark.parametrize("name", SPEEDS)
def test_below_the_stall_speed_the_wing_carries_no_more(name: str) -> None:
    parameters = load_airplane(name)
    slow = 0.8 * parameters.stall_m_s
    n, stalled = airplane.load_factor(parameters, slow, 0.5)
    assert stalled
    assert n == pytest.approx(0.64)
    # and it sinks, whatever the pitch, until it is faster
    state = flying(parameters, 0.0, 0.0, 0.0, 0.0, slow, CALM)
    state = told(state, 0.0, 0.3, 0.0)
    for _ in range(500):
        state = step(parameters, state, CALM, DT_S)
    assert state.velocity_down_m_s > 1.0


@pytest.mark.parametrize("name", SPEEDS)
def test_a_stalled_wing_drags_twice_as_much(name: str) -> None:
    """Just beyond the angle of the most lift, without thrust, against just before it."""
    parameters, state = level(name)
    speed = 1.1 * parameters.stall_m_s
    most = speed**2 / parameters.stall_m_s**2
    alpha = parameters.alpha_zero_rad + parameters.alpha_per_load_rad_m2_s2 * most / speed**2
    slowed = []
    for beyond in (-1e-3, 1e-3):
        flown = state._replace(velocity_north_m_s=speed, pitch_rad=alpha + beyond, throttle=0.0)
        slowed.append(speed - step(parameters, flown, CALM, 1e-4).airspeed_m_s)
    assert slowed[1] / slowed[0] == pytest.approx(2.0, rel=0.05)


def test_commands_act_after_their_delays() -> None:
    """Ten commands 20 ms apart: each acts in its turn, none is lost."""
    parameters, state = level("airplane_20")
    quick = parameters._replace(roll_lag2_s=0.0, roll_lag_s=0.004, roll_slew_rad_s=1e3, roll_gain=1.0)
    rolls = []
    for n in range(100):
        if n % 5 == 0:
            state = told(state, 0.01 * (n // 5), 0.0, 0.5)
        state = step(quick, state, CALM, DT_S)
        rolls.append(state.roll_rad)
    # given at 0.2 s: 0.1 rad; acts 0.086 s later
    assert rolls[round(0.28 / DT_S) - 1] < 0.0965
    assert rolls[round(0.30 / DT_S) - 1] == pytest.approx(0.1 + parameters.roll_offset_rad, abs=5e-3)


def test_a_gust_from_below_lifts() -> None:
    parameters, state = level("airplane_20")
    state = step(parameters, state, Wind(0.0, 0.0, -1.0), DT_S)
    assert state.velocity_down_m_s < 0.0


@pytest.mark.parametrize("name", SPEEDS)
def test_a_turn_to_the_right_is_the_mirror_of_one_to_the_left(name: str) -> None:
    parameters, state = level(name)
    straight = parameters._replace(roll_offset_rad=0.0)
    right = left = state._replace(queue=tuple(c._replace(roll_rad=0.0) for c in state.queue))
    right, left = told(right, 0.6, 0.0, 0.7), told(left, -0.6, 0.0, 0.7)
    for _ in range(500):
        right, left = step(straight, right, CALM, DT_S), step(straight, left, CALM, DT_S)
    assert right.east_m == pytest.approx(-left.east_m, abs=1e-9)
    assert right.east_m > 1.0
    assert right.north_m == pytest.approx(left.north_m, abs=1e-9)


@pytest.mark.parametrize("name", SPEEDS)
def test_energy_is_what_thrust_and_drag_make_of_it(name: str) -> None:
    """d/dt (g h + V^2/2) = V (thrust - drag): lift does no work, banked or not."""
    parameters, state = level(name)
    parameters = parameters._replace(drag_per_m=0.0, induced_m3_s4=0.0)
    state = told(state, 0.5, 0.1, 0.0)
    for _ in range(100):
        state = step(parameters, state, CALM, DT_S)  # the throttle goes to rest
    energy = [0.5 * state.airspeed_m_s**2 - GRAVITY_M_S2 * state.down_m]
    for _ in range(250):
        state = step(parameters, state, CALM, DT_S)
        energy.append(0.5 * state.airspeed_m_s**2 - GRAVITY_M_S2 * state.down_m)
    assert np.ptp(energy) < 1.5e-2 * energy[0]


def test_a_shorter_step_changes_nothing() -> None:
    parameters, state = level("airplane_20")
    coarse = fine = told(state, 0.7, 0.05, 0.6)
    for _ in range(500):
        coarse = step(parameters, coarse, CALM, DT_S)
        fine = step(parameters, step(parameters, fine, CALM, 0.5 * DT_S), CALM, 0.5 * DT_S)
    assert (
        np.hypot(coarse.north_m - fine.north_m, coarse.east_m - fine.east_m) < 0.04
    )  # a delay ends at a step


def test_gusts_have_the_stated_size_and_length() -> None:
    weather = Turbulence(Wind(5.0, 0.0, 0.0), 0.8, 0.5, 200.0, 50.0)
    dice = np.random.default_rng(5)
    gusts, seen = NO_GUSTS, []
    for normals in dice.standard_normal((200_000, 3)):
        gusts = gusts_step(weather, gusts, 20.0, (normals[0], normals[1], normals[2]), 0.1)
        seen.append(gusts)
    rows = np.array(seen)
    assert rows.std(axis=0) == pytest.approx([0.8, 0.8, 0.5], rel=0.1)
    # the correlation after one length, 10 s and 2.5 s, is 1/e
    for axis, lag in ((0, 100), (2, 25)):
        u = rows[:, axis]
        assert np.mean(u[lag:] * u[:-lag]) / np.mean(u * u) == pytest.approx(np.exp(-1.0), abs=0.06)
    assert blowing(weather, Gusts(1.0, 2.0, 3.0)) == Wind(6.0, 2.0, 3.0)


def test_compiled_it_is_the_same() -> None:
    parameters, state = level("airplane_20")
    plain = fast = told(state, 0.5, 0.0, 0.5)
    quick = compiled(step)
    for _ in range(50):
        plain, fast = step(parameters, plain, CALM, DT_S), quick(parameters, fast, CALM, DT_S)
    assert fast[:14] == pytest.approx(plain[:14], abs=1e-9)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("stall_m_s = 0.0", "stall_m_s must be above 0"),
        ("stall_m_s = nan", "stall_m_s must be a finite number"),
        ("roll_delay_s = -0.1", "roll_delay_s must not be negative"),
        ("wings = 2", "unknown wings"),
        ("", "missing stall_m_s"),
    ],
)
def test_a_file_of_impossible_parameters_is_refused(tmp_path: Path, change: str, says: str) -> None:
    shipped = Path(airplane.__file__).with_name("airplane_12.toml").read_text()
    key = change.split(" =", maxsplit=1)[0] or "stall_m_s"
    lines = [line for line in shipped.splitlines() if not line.startswith(f"{key} =")]
    file = tmp_path / "mine.toml"
    file.write_text("\n".join([*lines, change]))
    with pytest.raises(ValueError, match=says):
        load_airplane(str(file))


def test_a_missing_file_is_named() -> None:
    with pytest.raises(ValueError, match=r"nowhere\.toml"):
        load_airplane("nowhere.toml")


def test_the_heading_is_that_of_the_air() -> None:
    parameters, state = level("airplane_20", Wind(0.0, 5.0, 0.0))
    state = step(parameters, state, Wind(0.0, 5.0, 0.0), DT_S)
    assert abs(state.heading_rad) < 1e-3
    assert cos(state.heading_rad) == pytest.approx(1.0)
    assert state.velocity_east_m_s == pytest.approx(5.0, abs=1e-2)
    assert -pi < state.heading_rad < pi
