"""Body rates and thrust of a copter: the maths by itself, compiled, and on the model."""

from __future__ import annotations

from math import acos, cos, inf, pi, radians, sin, tan

import numpy as np
import pytest

from guidance.handling.copter_rates import (
    HELD_PART,
    HOVER_LEAST,
    HOVER_MOST,
    Memory,
    Parameters,
    rates_step,
    standing,
)
from guidance.se3 import (
    IDENTITY,
    ZERO,
    Quaternion,
    Twist,
    Vec3,
    body_axes,
    exp,
    from_euler,
    multiply,
    norm,
    normalized,
)
from sitl.compiled import compiled
from sitl.models import copter as model
from sitl.models.files import load_copter
from sitl.models.gusts import CALM, Wind

G = 9.80665
P = Parameters(
    p_per_s=2.0,
    i_per_s2=0.5,
    p_up_per_s=2.5,
    i_up_per_s2=0.8,
    drag_per_s=0.0,
    tilt_max_rad=radians(30.0),
    attitude_per_s=6.0,
    rates_max_rad_s=Vec3(3.0, 3.0, 1.5),
    hover_thrust=0.5,
    thrust_min=0.1,
    thrust_max=1.0,
    boosts=False,
    climbs=False,
    climb_up_m_s=2.5,
    climb_down_m_s=1.5,
)
LEVEL = Memory(ZERO, 1.0, ZERO)
DT = 0.02


def leaning(attitude: Quaternion) -> float:
    return acos(min(1.0, max(-1.0, body_axes(attitude)[2].z)))


@pytest.mark.parametrize("heading", [0.0, 1.0, -2.5])
def test_level_and_at_rest_it_hovers(heading: float) -> None:
    memory, demand, ends = rates_step(P, LEVEL, from_euler(0.0, 0.0, heading), ZERO, ZERO, 0.0, DT)
    assert demand.body_rates_frd_rad_s == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    assert demand.thrust == pytest.approx(0.5)
    assert (memory, ends) == (LEVEL, (False, False))


@pytest.mark.parametrize("heading", [0.0, 1.0, -2.5])
@pytest.mark.parametrize("bearing", [0.0, 0.5 * pi, 2.0])
def test_it_leans_where_it_is_to_go_and_as_far_as_that_takes(heading: float, bearing: float) -> None:
    attitude = from_euler(0.0, 0.0, heading)
    asked = Vec3(cos(bearing), sin(bearing), 0.0)
    for _ in range(300):
        rates = rates_step(P, LEVEL, attitude, ZERO, asked, 0.0, 0.0)[1].body_rates_frd_rad_s
        attitude = normalized(multiply(attitude, exp(Twist(rates, ZERO), 0.01).attitude))
    down = body_axes(attitude)[2]
    # the rotors push along -b3: with P (asked - v) level, and g up
    assert (-down.x / down.z * G, -down.y / down.z * G) == pytest.approx(
        (2.0 * cos(bearing), 2.0 * sin(bearing)), abs=1e-3
    )


def test_the_yaw_rate_is_about_down_however_it_leans() -> None:
    attitude = from_euler(0.2, -0.3, 1.0)
    held = standing(P, 1.0, attitude, ZERO).held_ned_m_s2
    rates = rates_step(P, Memory(held, 1.0, ZERO), attitude, ZERO, ZERO, 0.4, 0.0)[1].body_rates_frd_rad_s
    turned = normalized(multiply(attitude, exp(Twist(rates, ZERO), 0.5).attitude))
    assert leaning(turned) == pytest.approx(leaning(attitude), abs=1e-6)
    assert norm(rates) == pytest.approx(0.4)


def test_standing_is_what_keeps_it_as_it_is() -> None:
    attitude = from_euler(0.15, 0.1, -0.7)
    memory = standing(P, 1.0, attitude, ZERO)
    assert norm(memory.held_ned_m_s2) == pytest.approx(G * tan(leaning(attitude)))
    _, demand, _ = rates_step(P, memory, attitude, ZERO, ZERO, 0.0, DT)
    assert norm(demand.body_rates_frd_rad_s) < 1e-9
    assert demand.thrust == pytest.approx(0.5 / cos(leaning(attitude)))
    # of a lean in flight the air takes what its velocity needs
    flies = standing(P._replace(drag_per_s=0.5), 1.0, IDENTITY, Vec3(2.0, -1.0, 0.0))
    assert flies.held_ned_m_s2 == pytest.approx((-1.0, 0.5, 0.0))


def test_the_tilt_is_cut_and_not_the_climb_and_what_is_at_its_end_does_not_learn() -> None:
    attitude, memory = IDENTITY, LEVEL
    for _ in range(300):
        memory, demand, ends = rates_step(P, memory, attitude, ZERO, Vec3(50.0, -20.0, -0.5), 0.0, DT)
        turn = exp(Twist(demand.body_rates_frd_rad_s, ZERO), DT)
        attitude = normalized(multiply(attitude, turn.attitude))
        assert leaning(attitude) < P.tilt_max_rad + 1e-6
        assert ends.tilt
    assert leaning(attitude) == pytest.approx(P.tilt_max_rad, abs=1e-3)
    assert memory.held_ned_m_s2 == ZERO
    assert memory.hover_part > 1.0


def test_wind_is_held_and_no_more_than_its_part_of_the_tilt() -> None:
    memory = LEVEL
    for _ in range(10000):
        memory, _, _ = rates_step(P, memory, IDENTITY, Vec3(0.5, 0.0, 0.0), ZERO, 0.0, DT)
    most = HELD_PART * G * tan(P.tilt_max_rad)
    assert 0.5 * most < norm(memory.held_ned_m_s2) <= most * (1.0 + 1e-12)
    assert memory.held_ned_m_s2.x < 0.0


@pytest.mark.parametrize(("sinks", "bound"), [(0.3, HOVER_MOST), (-0.3, HOVER_LEAST)])
def test_the_hover_thrust_is_learned_within_its_bounds(sinks: float, bound: float) -> None:
    p = P._replace(hover_thrust=0.4)
    memory, before = LEVEL, 1.0
    for _ in range(20000):
        memory, _, _ = rates_step(p, memory, IDENTITY, Vec3(0.0, 0.0, sinks), ZERO, 0.0, DT)
        assert (memory.hover_part - before) * sinks >= 0.0
        before = memory.hover_part
    assert memory.hover_part == pytest.approx(bound, rel=0.05)
    assert HOVER_LEAST <= memory.hover_part <= HOVER_MOST


def test_at_its_end_the_thrust_teaches_nothing() -> None:
    sinking = Vec3(0.0, 0.0, 10.0)
    memory, demand, ends = rates_step(P, LEVEL, IDENTITY, sinking, ZERO, 0.0, DT)
    assert ends.thrust
    assert demand.thrust == pytest.approx(0.75)
    low = P._replace(thrust_max=0.55)
    memory, demand, ends = rates_step(low, LEVEL, IDENTITY, Vec3(0.0, 0.0, 1.0), ZERO, 0.0, DT)
    assert (memory.hover_part, demand.thrust, ends.thrust) == (1.0, 0.55, True)


@pytest.mark.parametrize(
    ("start", "needed"), [(HOVER_LEAST, 1.0), (0.6, 1.5), (1.0, 1.9), (HOVER_MOST, 0.7), (HOVER_MOST, 1.0)]
)
def test_from_whatever_hover_thrust_it_finds_the_right_one(start: float, needed: float) -> None:
    """Also one that all it may ask for does not carry at first: it fell for ever."""
    p = P._replace(hover_thrust=0.4)
    memory, down_m, sinks = LEVEL._replace(hover_part=start), 0.0, 0.0
    for _ in range(3000):
        asked = Vec3(0.0, 0.0, min(max(-0.5 * down_m, -1.5), 1.5))
        memory, demand, _ = rates_step(p, memory, IDENTITY, Vec3(0.0, 0.0, sinks), asked, 0.0, DT)
        sinks += DT * G * (1.0 - demand.thrust / (0.4 * needed))
        down_m += DT * sinks
    assert memory.hover_part == pytest.approx(needed, rel=0.01)
    assert abs(down_m) < 1.0
    assert abs(sinks) < 0.5


def test_who_boosts_by_itself_is_not_boosted_again() -> None:
    leans = from_euler(0.4, 0.0, 0.0)
    assert rates_step(P, LEVEL, leans, ZERO, ZERO, 0.0, DT)[1].thrust == pytest.approx(0.5 / cos(0.4))
    own = P._replace(boosts=True)
    assert rates_step(own, LEVEL, leans, ZERO, ZERO, 0.0, DT)[1].thrust == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("down_m_s", "thrust"), [(0.0, 0.5), (-2.5, 1.0), (-1.25, 0.75), (1.5, 0.0), (0.75, 0.25), (9.0, 0.0)]
)
def test_thrust_may_stand_for_a_climb_rate(down_m_s: float, thrust: float) -> None:
    p = P._replace(climbs=True)
    memory, demand, ends = rates_step(p, LEVEL, IDENTITY, ZERO, Vec3(0.0, 0.0, down_m_s), 0.0, DT)
    assert demand.thrust == pytest.approx(thrust)
    assert (memory.hover_part, ends.thrust) == (1.0, False)


@pytest.mark.parametrize("attitude", [from_euler(pi, 0.0, 0.3), from_euler(0.0, pi / 2, 0.0)])
def test_upside_down_it_turns_back(attitude: Quaternion) -> None:
    memory = standing(P, 1.0, attitude, ZERO)
    assert norm(memory.held_ned_m_s2) < inf
    for _ in range(400):
        _, demand, _ = rates_step(P, LEVEL, attitude, ZERO, ZERO, 0.0, DT)
        attitude = normalized(multiply(attitude, exp(Twist(demand.body_rates_frd_rad_s, ZERO), DT).attitude))
        assert 0.0 <= demand.thrust <= 1.0
    assert leaning(attitude) < 1e-3


def test_whatever_comes_all_is_finite_and_within_its_limits() -> None:
    dice = np.random.default_rng(5)
    memory = LEVEL
    for _ in range(3000):
        q = normalized(Quaternion(*dice.standard_normal(4).tolist()))
        size = 10.0 ** dice.uniform(-12.0, 6.0)
        v, asked = (Vec3(*(size * dice.standard_normal(3)).tolist()) for _ in range(2))
        memory, demand, _ = rates_step(P, memory, q, v, asked, float(dice.normal(0.0, 3.0)), DT)
        for rate, most in zip(demand.body_rates_frd_rad_s, P.rates_max_rad_s, strict=True):
            assert abs(rate) <= most
        assert P.thrust_min <= demand.thrust <= P.thrust_max
        assert HOVER_LEAST <= memory.hover_part <= HOVER_MOST
        assert norm(memory.held_ned_m_s2) <= HELD_PART * G * tan(P.tilt_max_rad) * (1.0 + 1e-12)


def test_compiled_it_is_the_same() -> None:
    fast, attitude = compiled(rates_step), from_euler(0.1, -0.2, 0.5)
    for p in (P, P._replace(climbs=True), P._replace(boosts=True)):
        for asked in (ZERO, Vec3(1.0, 2.0, -0.5), Vec3(90.0, 0.0, 9.0)):
            plain = rates_step(p, LEVEL, attitude, ZERO, asked, 0.3, DT)
            quick = fast(p, LEVEL, attitude, ZERO, asked, 0.3, DT)
            assert quick[1].thrust == pytest.approx(plain[1].thrust, rel=1e-12)
            assert tuple(quick[1].body_rates_frd_rad_s) == pytest.approx(
                tuple(plain[1].body_rates_frd_rad_s), rel=1e-9
            )


@pytest.mark.parametrize("name", ["copter_px4", "copter_ardupilot"])
@pytest.mark.parametrize("wrong", [0.8, 1.3])
def test_on_the_model_it_stands_in_wind_with_another_hover_thrust(name: str, wrong: float) -> None:
    body = load_copter(name)
    wind = Wind(4.0, -3.0, 0.0)
    p = P._replace(hover_thrust=wrong * body.hover_thrust, tilt_max_rad=radians(40.0))
    state, memory = model.hovering(body, (0.0, 0.0, -20.0), 0.5, CALM), LEVEL
    for _ in range(1500):
        attitude = Quaternion(*state.attitude_wxyz)
        v = Vec3(*state.velocity_ned_m_s)
        memory, demand, _ = rates_step(p, memory, attitude, v, ZERO, 0.0, DT)
        rate_p, rate_q, rate_r = demand.body_rates_frd_rad_s
        state = model.told_rates(body, state, (rate_p, rate_q, rate_r), demand.thrust)
        for _ in range(5):
            state = model.step(body, state, wind, 0.004)
    assert norm(Vec3(*state.velocity_ned_m_s)) < 0.03
    assert memory.hover_part == pytest.approx(1.0 / wrong, rel=0.02)
