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
    Eight,
    Helix,
    Lemniscate,
    Line,
    Reference,
    Trajectory,
    Zigzag,
    eased,
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
    Helix(radius_m=80.0, speed_m_s=12.0, down_m_s=-1.0, down_m=-30.0, levels_off_m=40.0),
    Helix(radius_m=80.0, speed_m_s=12.0, down_m_s=1.0, levels_off_m=1.0),
    Eight(rise_m=10.0),
    Eight(length_m=20.0, width_m=10.0, speed_m_s=2.0, down_m=-3.0, rise_m=-4.0),
    Circle(radius_m=10.0, speed_m_s=3.0, stop_at_s=20.0),
    Line(heading_deg=30.0, speed_m_s=3.0, climb_m_s=1.0, stop_at_s=2.0, stop_over_s=10.0),
    Eight(length_m=40.0, width_m=20.0, speed_m_s=3.0, rise_m=2.0, stop_at_s=31.0, stop_over_s=7.0),
]


def assert_derivatives_hold(curve: Trajectory, t_s: float) -> None:
    h = 1e-5  # where a stop begins or ends, r''' jumps
    before, now, after = (sample(curve, t) for t in (t_s - h, t_s, t_s + h))
    assert_allclose(np.subtract(after.position, before.position) / (2 * h), now.velocity, atol=2e-5)
    assert_allclose(np.subtract(after.velocity, before.velocity) / (2 * h), now.acceleration, atol=2e-5)


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


SHAPES = [(400.0, 200.0), (20.0, 10.0), (1e5, 0.01), (0.01, 1e5), (300.0, 1e5), (60.0, 0.5), (0.01, 0.01)]


def arc_by_sums_m(half_m: float, width_m: float, phase: float) -> float:
    """Along (half sin p, width/2 sin 2p) from 0, by 20 points in each of thousands of pieces that crowd where
    a thin one bends."""
    near = np.geomspace(1e-12, 1.0, 1500)
    bends = [bend + side * near for bend in (0.25 * pi, 0.5 * pi) for side in (-1.0, 1.0)]
    ends = np.unique(np.clip(np.concatenate([[0.0, 0.25 * pi, 0.5 * pi, phase], *bends]), 0.0, phase))
    nodes, weights = np.polynomial.legendre.leggauss(20)
    reach = 0.5 * np.diff(ends)[:, None]
    p = ends[:-1, None] + reach * (1.0 + nodes)
    return float(np.sum(reach * weights * np.hypot(half_m * np.cos(p), width_m * np.cos(2.0 * p))))


@pytest.mark.parametrize(("length_m", "width_m"), SHAPES)
@pytest.mark.parametrize("part", [0.0, 1e-6, 0.1, 0.5, 0.707, 0.9, 0.999999, 1.0])
def test_an_eight_is_where_its_arc_length_says(length_m: float, width_m: float, part: float) -> None:
    """Of any proportion, to a billionth of its size; `part` of the first quarter."""
    half_m = 0.5 * length_m
    curve = Eight(length_m=length_m, width_m=width_m, speed_m_s=1.0)
    p = part * 0.5 * pi
    arc_m = arc_by_sums_m(half_m, width_m, p)
    quarter_m = 0.25 * curve.cycle_s
    size_m = max(length_m, width_m)
    expected = np.array([half_m * sin(p), 0.5 * width_m * sin(2.0 * p), 0.0])
    for t_s, mirrored in (
        (arc_m, (1, 1)),
        (2.0 * quarter_m - arc_m, (1, -1)),
        (2.0 * quarter_m + arc_m, (-1, 1)),
        (4.0 * quarter_m - arc_m, (-1, -1)),
        (arc_m - 4.0 * quarter_m, (1, 1)),
    ):
        r = sample(curve, t_s)
        assert_allclose(r.position, expected * [*mirrored, 1], atol=1e-9 * size_m, rtol=0)
        assert hypot(*r.velocity) == pytest.approx(1.0, rel=1e-12)


def test_an_eight_rises_to_the_north_and_its_speed_over_ground_is_constant() -> None:
    curve = Eight(length_m=400.0, width_m=200.0, speed_m_s=20.0, down_m=-60.0, rise_m=10.0)
    samples = [sample(curve, t) for t in np.linspace(0.0, curve.cycle_s, 2001)]
    assert_allclose([hypot(r.velocity.x, r.velocity.y) for r in samples], 20.0, rtol=1e-12)
    highest = min(samples, key=lambda r: r.position.z)
    assert_allclose(highest.position, (200.0, 0.0, -70.0), atol=0.01)
    assert max(r.position.z for r in samples) == pytest.approx(-50.0, abs=1e-3)
    assert_allclose(samples[0].position, samples[-1].position, atol=1e-9)
    # it goes the way of the lemniscate
    assert_allclose(samples[0].velocity[:2], np.array([sqrt(0.5)] * 2) * 20.0)


def test_a_helix_levels_off_once_it_has_climbed_so_much() -> None:
    curve = Helix(radius_m=80.0, speed_m_s=12.0, down_m_s=-1.0, down_m=-30.0, levels_off_m=40.0)
    assert sample(curve, 10.0).position.z == pytest.approx(-40.0)
    for t_s in (42.0, 60.0, 1000.0):
        r = sample(curve, t_s)
        assert r.position.z == pytest.approx(-70.0)
        assert r.velocity.z == r.acceleration.z == 0.0
        assert hypot(r.velocity.x, r.velocity.y) == pytest.approx(12.0)
    low = Helix(down_m_s=2.0, levels_off_m=0.5)  # less than it sinks while it levels off
    assert sample(low, 0.0).position.z == 0.0
    assert sample(low, 9.0).position.z == pytest.approx(0.5)


@pytest.mark.parametrize("curve", [curve for curve in SMOOTH if curve.stop_at_s > 0.0], ids=repr)
def test_a_trajectory_that_stops_slows_down_without_a_jerk_and_stays(curve: Trajectory) -> None:
    on = msgspec.structs.replace(curve, stop_at_s=0.0)
    over_s = min(curve.stop_over_s, curve.stop_at_s)
    begins_s = curve.stop_at_s - over_s
    assert curve.eased_s == ((begins_s, curve.stop_at_s),)
    assert sample(curve, begins_s) == sample(on, begins_s)
    rest = sample(curve, curve.stop_at_s)
    assert_allclose(rest.position, sample(on, begins_s + 0.5 * over_s).position, atol=1e-9)
    assert rest.velocity == rest.acceleration == (0.0, 0.0, 0.0)
    assert sample(curve, 1e5) == rest
    times = np.linspace(begins_s - 0.1, curve.stop_at_s + 0.1, 4001)
    accelerations = np.array([sample(curve, t).acceleration for t in times])
    assert np.abs(np.diff(accelerations, axis=0)).max() < 0.01  # r'' is continuous, at both ends too


@properties
@given(st.floats(-10.0, 40.0), st.floats(0.1, 20.0))
def test_an_eased_clock_never_runs_back_and_loses_half_of_what_it_takes(t_s: float, over_s: float) -> None:
    clock = eased(t_s, 20.0, over_s)
    assert 0.0 <= clock.rate <= 1.0
    assert -1.5 / over_s <= clock.change_per_s <= 0.0
    assert min(t_s, 20.0) - 0.5 * over_s - 1e-9 <= clock.time_s <= t_s
    assert eased(30.0, 20.0, over_s) == (20.0 - 0.5 * over_s, 0.0, 0.0)


def test_every_name_in_the_table_is_a_trajectory_a_configuration_can_name() -> None:
    assert list(TRAJECTORIES) == ["helix", "circle", "line", "zigzag", "lemniscate", "eight"]
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
        stop, fields = parameters.__struct_fields__[:2], parameters.__struct_fields__[2:]
        assert stop == ("stop_at_s", "stop_over_s")
        assert names == ["t_s", *fields]


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
        Eight(length_m=1e5, width_m=0.01, speed_m_s=1e3, rise_m=1e5),
        Eight(length_m=0.01, width_m=1e5, speed_m_s=1e-3),
        Helix(down_m_s=5e-324, levels_off_m=5e-324),
        Helix(down_m_s=5e-324, levels_off_m=1e5),
        Circle(stop_at_s=5e-324),
    ]
    for curve in extremes:
        for t_s in (-1e6, 0.0, 1e9):
            r = sample(curve, t_s)
            assert all(isfinite(value) for part in r for value in part), (curve, t_s)
    assert norm(sample(Zigzag(), 1.0).velocity) == pytest.approx(sqrt(2.0))
