"""Invariant: any text and any overrides give a Config or a ConfigError that can be printed, nothing else."""

from __future__ import annotations

from typing import Any

import msgspec
from hypothesis import example, given, settings
from hypothesis import strategies as st

from guidance.config import Config, ConfigError, from_json, parse, to_json
from tests.helpers import DEMO

TEXT = DEMO.read_text(encoding="utf-8")


def outcome(text: str, *overrides: str) -> None:
    """A Config or a ConfigError that can be printed; anything else fails the test."""
    try:
        config = parse(text, "fuzz.toml", overrides)
    except ConfigError as error:
        refused = str(error)
    else:
        assert from_json(to_json(config)) == config
        return
    assert refused.encode()


fuzzing = settings(max_examples=150)
KEYS = [
    "vehicle", "link", "supervisor", "law", "limits", "flight", "trajectory", "zenoh", "log", "name",
    "profile", "k", "beta", "rate_hz", "engage", "arm", "origin", "connection", "connect", "radius_m", "",
    "error_function", "allocation", "exit_mode", "config_file",
]  # fmt: skip
SCALARS = [
    "0", "1", "-1", "1.5", "nan", "-inf", "1e308", "1e999", "0x" + "f" * 5000, "9" * 400, "true", '"pilot"',
    '"helix"', '"bounded"', '["tcp/a:1"]',
    '"\\u0000"', '"ekf"', "'udpin://[::1'", "1979-05-27T07:32:00Z", "07:32:00", "[]", "[1, 2, 3]",
    "[[1, 2], 3]", "{}", "{ k = 1 }", '{ name = "circle" }', "[{}]", "=", "[" * 50,
]  # fmt: skip


@fuzzing
@given(st.text(max_size=200))
@example("[[trajectory]]\nname = 'helix'")
def test_any_text_gives_a_configuration_or_a_refusal(text: str) -> None:
    outcome(text)
    outcome(TEXT + text)


@fuzzing
@given(
    st.lists(st.tuples(st.sampled_from(KEYS), st.sampled_from(KEYS), st.sampled_from(SCALARS)), max_size=6)
)
def test_toml_of_any_shape_gives_a_configuration_or_a_refusal(rows: list[tuple[str, str, str]]) -> None:
    outcome("\n".join(f"[{table}]\n{key} = {value}" for table, key, value in rows))
    outcome("\n".join(f"{table} = {value}" for table, _, value in rows))
    outcome(TEXT + "\n".join(f"{key} = {value}" for _, key, value in rows))


@fuzzing
@given(
    st.lists(
        st.one_of(
            st.text(max_size=30),
            st.builds("{}={}".format, st.sampled_from(KEYS), st.sampled_from(SCALARS)),
            st.builds(
                "{}.{}={}".format, st.sampled_from(KEYS), st.sampled_from(KEYS), st.sampled_from(SCALARS)
            ),
        ),
        max_size=4,
    )
)
@example(["trajectory.name=helix"])
def test_any_overrides_give_a_configuration_or_a_refusal(overrides: list[str]) -> None:
    outcome(TEXT, *overrides)
    outcome("", *overrides)
    outcome("trajectory = 3", *overrides)


def test_every_single_value_can_be_anything() -> None:
    tried = 0
    tables: list[Any] = [table for table in msgspec.structs.fields(Config) if table.name != "trajectory"]
    for table in tables:
        for field in msgspec.structs.fields(table.type):
            for value in SCALARS:
                outcome(TEXT, f"{table.name}.{field.name}={value}")
                tried += 1
    assert tried > 30 * len(SCALARS)


def test_a_number_of_thousands_of_digits_may_stand_where_a_name_should() -> None:
    outcome(TEXT.replace('name = "helix"', "name = 0x" + "f" * 5000))
    outcome(TEXT, "trajectory.name=0x" + "f" * 5000)
