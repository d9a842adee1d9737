"""Trajectories: derivatives against differences, the paper's curves, and what a configuration may say."""

from __future__ import annotations

import inspect
from math import cos, hypot, inf, isfinite, nan, pi, sin, sqrt
from typing import Any, get_args

import msgspec
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from guidance import trajectory
from guidance.se3 import norm
from guidance.trajectory import (
    TRAJECTORIES,
    Circle,
    Helix,
    Lemniscate,
    Line,
    Reference,
    Trajectory,
    Zigzag,
    sample,
)
from tests.strategies import properties


class Configuration(msgspec.Struct, forbid_unknown_fields=True):
    """As a configuration embeds a trajectory."""

    trajectory: Trajectory


SMOOTH: list[Trajectory] = [
    Helix(),
    Helix(radius_m=20.0, speed_m_s=4.0, down_m_s=-0.5),
    Circle(),
    Circle(radius_m=3.0, speed_m_s=2.0, clockwise=False, down_m=4.0),
    Line(north_m=1.0, east_m=2.0, down_m=3.0, heading_deg=210.0, speed_m_s=2.0, climb_m_s=0.5),
    Lemniscate(),
    Lemniscate(length_m=5.0, width_m=30.0, speed_m_s=6.0, down_m=-2.0),
]


def assert_derivatives_hold(curve: Trajectory, t_s: float) -> None:
    h = 1e-4
    before, now, after = (sample(curve, t) for t in (t_s - h, t_s, t_s + h))
    assert_allclose(np.subtract(after.position, before.position) / (2 * h), now.velocity, atol=1e-5)
    assert_allclose(np.subtract(after.velocity, before.velocity) / (2 * h), now.acceleration, atol=1e-5)


@pytest.mark.parametrize("curve", SMOOTH, ids=repr)
@properties
@given(t_s=st.floats(-50.0, 500.0))
@example(t_s=0.0)
def test_velocity_and_acceleration_are_the_derivatives(curve: Trajectory, t_s: float) -> None:
    assert_derivatives_hold(curve, t_s)


@pytest.mark.parametrize("t_s", [-5.0, 0.0, 10.0, 29.9, 30.1, 45.0, 59.9, 60.1, 100.0, 1000.0])
def test_zigzag_has_its_derivatives_between_the_corners(t_s: float) -> None:
    assert_derivatives_hold(Zigzag(), t_s)


@pytest.mark.parametrize("t_s", [0.0, 3.0, 10.0 * pi, 100.0])
def test_helix_is_that_of_section_4(t_s: float) -> None:
    expected = (sin(t_s / 10.0), cos(t_s / 10.0), t_s / 10.0)
    assert_allclose(sample(Helix(), t_s).position, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("t_s", "expected"),
    [
        (12.0, (12.0, 12.0)),
        (30.0, (30.0, 30.0)),
        (45.0, (15.0, 45.0)),
        (60.0, (0.0, 60.0)),
        (95.0, (35.0, 95.0)),
    ],
)
def test_zigzag_is_15(t_s: float, expected: tuple[float, float]) -> None:
    assert_allclose(sample(Zigzag(), t_s).position, (*expected, 0.0), atol=1e-12)


@pytest.mark.parametrize("parameters", [Zigzag(), Zigzag(leg_m=7.0, speed_m_s=0.3)])
@pytest.mark.parametrize("corner", [1, 2])
def test_zigzag_is_continuous_at_its_corners_where_the_velocity_turns_by_a_right_angle(
    parameters: Zigzag, corner: int
) -> None:
    corner_s = corner * parameters.leg_m / parameters.speed_m_s
    before = sample(parameters, corner_s - 1e-9)
    at = sample(parameters, corner_s + 1e-12)
    assert_allclose(before.position, at.position, atol=1e-8)
    assert np.dot(before.velocity, at.velocity) == pytest.approx(0.0, abs=1e-12)
    assert at.acceleration == (0.0, 0.0, 0.0)


def test_zigzag_at_its_corner_has_the_velocity_of_the_leg_that_begins() -> None:
    assert sample(Zigzag(), 30.0).velocity == (-1.0, 1.0, 0.0)
    assert sample(Zigzag(), 60.0).velocity == (1.0, 1.0, 0.0)


@pytest.mark.parametrize("t_s", [0.0, 1.0, 7.3, 100.0])
def test_circle_keeps_its_radius_speed_depth_and_direction(t_s: float) -> None:
    for clockwise in (True, False):
        r = sample(Circle(radius_m=4.0, speed_m_s=2.0, clockwise=clockwise, down_m=3.0), t_s)
        assert hypot(r.position.x, r.position.y) == pytest.approx(4.0)
        assert norm(r.velocity) == pytest.approx(2.0)
        assert norm(r.acceleration) == pytest.approx(1.0)
        assert r.position.z == 3.0
        # In NED, clockwise from above is a positive turn about down.
        turn = r.position.x * r.velocity.y - r.position.y * r.velocity.x
        assert (turn > 0.0) is clockwise


def test_line_goes_where_its_heading_and_climb_say() -> None:
    r = sample(Line(heading_deg=90.0, speed_m_s=2.0, climb_m_s=0.5, north_m=7.0), 10.0)
    assert_allclose(r.position, (7.0, 20.0, -5.0), atol=1e-12)


def test_lemniscate_has_its_extent_and_is_fastest_at_the_crossing() -> None:
    eight = Lemniscate(length_m=20.0, width_m=10.0, speed_m_s=1.5)
    period_s = 2.0 * pi * hypot(10.0, 10.0) / 1.5
    samples = [sample(eight, t) for t in np.linspace(0.0, period_s, 2001)]
    assert max(r.position.x for r in samples) == pytest.approx(10.0, rel=1e-4)
    assert max(r.position.y for r in samples) == pytest.approx(5.0, rel=1e-4)
    speeds = [norm(r.velocity) for r in samples]
    assert max(speeds) == pytest.approx(speeds[0]) == pytest.approx(1.5)
    assert_allclose(samples[0].position, samples[1000].position, atol=1e-12)
    assert_allclose(samples[0].position, samples[-1].position, atol=1e-12)


def test_every_name_in_the_table_is_a_trajectory_a_configuration_can_name() -> None:
    assert list(TRAJECTORIES) == ["helix", "circle", "line", "zigzag", "lemniscate"]
    assert set(TRAJECTORIES.values()) == set(get_args(Trajectory))
    for name, parameters in TRAJECTORIES.items():
        curve = msgspec.convert({"trajectory": {"name": name}}, Configuration).trajectory
        assert type(curve) is parameters
        r = sample(curve, 1.0)
        assert isinstance(r, Reference)
        assert all(isfinite(value) for part in r for value in part)


def test_each_function_takes_time_and_the_fields_of_its_struct_in_order() -> None:
    assert trajectory._FUNCTIONS
    for parameters, function in trajectory._FUNCTIONS.items():
        names = list(inspect.signature(function).parameters)
        assert names == ["t_s", *parameters.__struct_fields__]


def test_every_parameter_states_its_meaning_and_unit() -> None:
    schema = msgspec.json.schema(Configuration)
    for parameters in TRAJECTORIES.values():
        properties_of = schema["$defs"][parameters.__name__]["properties"]
        for field in parameters.__struct_fields__:
            assert properties_of[field]["description"], field


NUMBERS = [
    (name, field.encode_name)
    for name, parameters in TRAJECTORIES.items()
    for field in msgspec.structs.fields(parameters)
    if isinstance(field.default, float)
]


@pytest.mark.parametrize("bad", [nan, inf, -inf, "fast", None, True])
@pytest.mark.parametrize(("name", "key"), NUMBERS)
def test_a_parameter_that_is_no_finite_number_is_refused_by_name(name: str, key: str, bad: Any) -> None:
    with pytest.raises(msgspec.ValidationError, match=rf"{key}|\$\.trajectory\.{key}"):
        msgspec.convert({"trajectory": {"name": name, key: bad}}, Configuration)


@pytest.mark.parametrize("bad", [nan, inf])
def test_a_parameter_that_is_not_finite_is_refused_in_code_too(bad: float) -> None:
    with pytest.raises(ValueError, match="down_m_s must be a finite number"):
        Helix(down_m_s=bad)


@pytest.mark.parametrize("bad", [0.0, -1.0])
@pytest.mark.parametrize(
    ("name", "key"), [pair for pair in NUMBERS if pair[1] in ("radius_m", "speed_m_s", "leg_m", "width_m")]
)
def test_lengths_and_speeds_are_positive(name: str, key: str, bad: float) -> None:
    with pytest.raises(msgspec.ValidationError, match=rf"\$\.trajectory\.{key}"):
        msgspec.convert({"trajectory": {"name": name, key: bad}}, Configuration)


def test_unknown_names_and_keys_are_refused() -> None:
    with pytest.raises(msgspec.ValidationError, match=r"Invalid value 'helx' - at `\$\.trajectory\.name`"):
        msgspec.convert({"trajectory": {"name": "helx"}}, Configuration)
    with pytest.raises(msgspec.ValidationError, match="unknown field `radius`"):
        msgspec.convert({"trajectory": {"name": "helix", "radius": 2.0}}, Configuration)
    with pytest.raises(msgspec.ValidationError, match="missing required field `name`"):
        msgspec.convert({"trajectory": {}}, Configuration)


def test_the_smallest_and_largest_parameters_still_give_numbers() -> None:
    extremes: list[Trajectory] = [
        Helix(radius_m=0.01, speed_m_s=1e3),
        Helix(radius_m=1e5, speed_m_s=5e-324),
        Zigzag(leg_m=1e5, speed_m_s=5e-324),
        Lemniscate(length_m=0.01, width_m=0.01, speed_m_s=1e3),
    ]
    for curve in extremes:
        for t_s in (-1e6, 0.0, 1e9):
            r = sample(curve, t_s)
            assert all(isfinite(value) for part in r for value in part), (curve, t_s)
    assert norm(sample(Zigzag(), 1.0).velocity) == pytest.approx(sqrt(2.0))
