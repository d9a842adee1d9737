"""The configuration changed while the service runs: what may be, and what is refused as in the file."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from guidance.changing import settings, with_setting, with_trajectory
from guidance.checking import ConfigError
from guidance.commands import Scalar
from guidance.config import from_json, to_json
from guidance.trajectory import Circle
from tests.helpers import ROVER, make_config

PLAIN = make_config()
BOUNDED = make_config('law.error_function={name="bounded", approach_m_s=1.0}')


def test_one_value_is_another_and_all_else_stays() -> None:
    changed = with_setting(PLAIN, "law.k", 0.5)
    assert changed.law.k == 0.5
    assert replace(changed, law=PLAIN.law) == PLAIN
    changed = with_setting(PLAIN, "limits.acceleration_max_m_s2", 1.5)
    assert changed.limits.acceleration_max_m_s2 == 1.5
    assert with_setting(changed, "limits.acceleration_max_m_s2", None) == PLAIN
    changed = with_setting(BOUNDED, "law.error_function.approach_m_s", 2)
    assert settings(changed)["law.error_function.approach_m_s"] == 2.0
    assert with_setting(PLAIN, "limits.keep_direction", False).limits.keep_direction is False


def test_every_setting_may_be_set_to_what_it_is() -> None:
    for config in (PLAIN, BOUNDED, make_config(*ROVER)):
        for key, value in settings(config).items():
            assert with_setting(config, key, value) == config


@pytest.mark.parametrize(
    ("key", "value", "why"),
    [
        ("law.k", 0.0, "law.k = 0.0: must be a number from 1e-06 to 1e+06"),
        ("law.k", True, "law.k = true: must be a number"),
        ("law.k", "fast", 'law.k = "fast": must be a number'),
        ("law.k", None, "law.k = None: must be a number"),
        ("law.k", float("nan"), "law.k = nan: must be a number"),
        ("law.k", 60.0, "law.k = 60.0: k / beta times the period of link.rate_hz = 50 is 1.2"),
        ("law.kay", 1.0, "law.kay: cannot be set (did you mean law.k?); law.k, law.rho2_per_s"),
        ("law.name", "global", "law.name: cannot be set"),
        ("law.allocation", "roll-yaw", "law.allocation: cannot be set"),
        ("law.error_function.approach_m_s", 1.0, "law.error_function.approach_m_s: cannot be set"),
        ("vehicle.system_id", 2, "vehicle.system_id: cannot be set"),
        ("", 2, ": cannot be set"),
        ("limits.yaw_rate_max_rad_s", 0.0, "limits.yaw_rate_max_rad_s = 0.0: must be a number from 0.001"),
        ("limits.speed_max_m_s", 0.1, 'trajectory.name = "helix": speed: 0.141 m/s needed'),
        ("limits.speed_max_m_s", -5.0, "limits.speed_max_m_s = -5.0: must be a number from 0.001"),
        ("limits.keep_direction", 1.0, "limits.keep_direction = 1.0: must be true or false"),
    ],
)
def test_what_the_file_would_be_refused_for_is_refused(key: str, value: Scalar, why: str) -> None:
    with pytest.raises(ConfigError) as refused:
        with_setting(PLAIN, key, value)
    assert why in str(refused.value)


def test_a_trajectory_is_taken_with_its_defaults_and_refused_with_its_key() -> None:
    changed = with_trajectory(PLAIN, {"name": "circle", "radius_m": 5})
    assert changed.trajectory == Circle(radius_m=5.0)
    assert replace(changed, trajectory=PLAIN.trajectory) == PLAIN
    refusals: list[tuple[dict[str, Scalar], str]] = [
        ({}, "trajectory.name is missing"),
        ({"name": "circe"}, "(did you mean circle?)"),
        ({"name": "circle", "radius_m": 0}, "trajectory.radius_m = 0: must be a number from 0.01"),
        ({"name": "circle", "radius": 1}, "trajectory.radius = 1: unknown key (did you mean radius_m?)"),
        (
            {"name": "circle", "speed_m_s": 6},
            "speed: 6 m/s needed at t = 0 s (north 10 m, east 0 m), 5 m/s available",
        ),
        (
            {"name": "circle", "radius_m": 0.1},
            "turn: 10 rad/s needed at t = 0 s (north 0.1 m, east 0 m), 7.0711 rad/s available",
        ),
        ({"name": "circle", "radius_m": None}, "trajectory.radius_m = None: must be a number"),
    ]
    for trajectory, why in refusals:
        with pytest.raises(ConfigError) as refused:
            with_trajectory(PLAIN, trajectory)
        assert why in str(refused.value)


SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=10)


@given(st.sampled_from([*settings(BOUNDED), "law.name", "x"]), SCALARS)
def test_whatever_is_set_the_result_is_a_configuration_that_a_file_could_be(key: str, value: Scalar) -> None:
    try:
        changed = with_setting(BOUNDED, key, value)
    except ConfigError:
        return
    assert from_json(to_json(changed)) == changed
