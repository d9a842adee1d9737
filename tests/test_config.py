"""The configuration: whatever is wrong is refused with key, value, place and what is allowed."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guidance.config import (
    Config,
    ConfigError,
    from_json,
    load,
    parse,
    to_json,
)
from guidance.trajectory import TRAJECTORIES
from tests.helpers import DEMO, make_config

TEXT = DEMO.read_text(encoding="utf-8")


def refusal(*overrides: str, text: str = TEXT) -> str:
    """What the operator is told; the test fails if nothing is refused."""
    with pytest.raises(ConfigError) as caught:
        parse(text, "flight.toml", overrides)
    return str(caught.value)


def with_line(key: str, line: str) -> tuple[str, int]:
    """The demo's text with the line of `key` replaced, and that line's number."""
    lines = TEXT.splitlines()
    number = next(i for i, old in enumerate(lines) if old.startswith(f"{key} ="))
    lines[number] = line
    return "\n".join(lines), number + 1


ORIGIN = (
    '"ekf", "home" or "engage" or a list of 3 numbers '
    "(latitude -90 to 90 deg, longitude -180 to 180 deg, altitude -12000 to 60000 m AMSL)"
)


@pytest.mark.parametrize(
    ("key", "line", "said"),
    [
        ("k", "k = 0", "law.k = 0: must be a number from 1e-06 to 1e+06"),
        ("k", "k = -1.5", "law.k = -1.5: must be a number from 1e-06 to 1e+06"),
        ("k", "k = nan", "law.k = nan: must be a number from 1e-06 to 1e+06"),
        ("k", "k = inf", "law.k = inf: must be a number from 1e-06 to 1e+06"),
        ("k", "k = true", "law.k = true: must be a number from 1e-06 to 1e+06"),
        ("k", 'k = "1"', 'law.k = "1": must be a number from 1e-06 to 1e+06'),
        ("k", "k = [1.0]", "law.k = [1.0]: must be a number from 1e-06 to 1e+06"),
        ("k", "k = 2025-01-01", "law.k = 2025-01-01: must be a number from 1e-06 to 1e+06"),
        ("speed_min_m_s", "speed_min_m_s = -inf", "limits.speed_min_m_s = -inf: must be a number"),
        ("rate_hz", "rate_hz = 4.9", "link.rate_hz = 4.9: must be a number from 5 to 200"),
        ("rate_hz", "rate_hz = 201", "link.rate_hz = 201: must be a number from 5 to 200"),
        ("attitude_timeout_s", "attitude_timeout_s = 2.5", " = 2.5: must be a number from 0.05 to 2"),
        ("position_timeout_s", "position_timeout_s = 0", " = 0: must be a number from 0.05 to 2"),
        ("system_id", "system_id = 0", "vehicle.system_id = 0: must be a whole number from 1 to 255"),
        ("system_id", "system_id = 1.0", "vehicle.system_id = 1.0: must be a whole number from 1 to 255"),
        ("arm", "arm = 1", "supervisor.arm = 1: must be true or false"),
        ("engage", 'engage = "now"', 'supervisor.engage = "now": must be "pilot" or "auto"'),
        ("origin", 'origin = "here"', f'flight.origin = "here": must be {ORIGIN}'),
        ("origin", "origin = [47.4, 8.5]", f"flight.origin = [47.4, 8.5]: must be {ORIGIN}"),
        ("origin", "origin = [91, 0, 0]", f"flight.origin = [91, 0, 0]: must be {ORIGIN}"),
        ("origin", "origin = [0, 181, 0]", f"flight.origin = [0, 181, 0]: must be {ORIGIN}"),
        ("origin", "origin = [0, 0, 1e9]", f"flight.origin = [0, 0, 1000000000.0]: must be {ORIGIN}"),
        ("origin", "origin = [0, 0, nan]", f"flight.origin = [0, 0, nan]: must be {ORIGIN}"),
        ("origin", 'origin = ["a", 0, 0]', f"flight.origin = ['a', 0, 0]: must be {ORIGIN}"),
        ("origin", "origin = 1", f"flight.origin = 1: must be {ORIGIN}"),
        ("name", 'name = "a/b"', 'vehicle.name = "a/b": must be a text (1 to 64 letters, digits, _ . -)'),
        ("name", 'name = ""', 'vehicle.name = "": must be a text (1 to 64 letters, digits, _ . -)'),
        ("name", 'name = "a\\n"', 'vehicle.name = "a\\n": must be a text (1 to 64 letters'),
        ("name", 'name = "*"', 'vehicle.name = "*": must be a text (1 to 64 letters, digits, _ . -)'),
    ],
)
def test_a_wrong_value_is_refused_with_line_key_value_and_what_is_allowed(
    key: str, line: str, said: str
) -> None:
    text, number = with_line(key, line)
    message = refusal(text=text)
    assert message.startswith(f"flight.toml:{number}: ")
    assert said in message
    assert "\n" not in message


REQUIRED = [
    "vehicle.name",
    "vehicle.profile",
    "vehicle.system_id",
    "vehicle.speed_at_full_thrust_m_s",
    "link.connection",
    "link.attitude_timeout_s",
    "link.position_timeout_s",
    "supervisor.engage_max_error_m",
    "law.k",
    "law.rho2_per_s",
    "law.rho3_per_s",
    "limits.speed_min_m_s",
    "limits.speed_max_m_s",
    "limits.roll_rate_max_rad_s",
    "limits.pitch_rate_max_rad_s",
    "limits.yaw_rate_max_rad_s",
    "flight.origin",
]


@pytest.mark.parametrize("dotted", REQUIRED)
def test_what_flies_by_luck_has_no_default(dotted: str) -> None:
    table, _, key = dotted.partition(".")
    text, _ = with_line(key, "")
    header = TEXT.splitlines().index(f"[{table}]") + 1
    message = refusal(text=text)
    assert message.startswith(f"flight.toml:{header}: {dotted} is missing: there is no default; must be ")


def test_exactly_these_keys_are_required() -> None:
    required = [
        f"{table.name}.{field.name}"
        for table in msgspec.structs.fields(Config)
        if table.name != "trajectory"
        for field in msgspec.structs.fields(table.type)
        if field.required
    ]
    assert sorted(required) == sorted(REQUIRED)


def test_a_missing_table_is_named_with_the_keys_it_must_have() -> None:
    message = refusal(text=TEXT.replace("[law]", "[lew]"))
    assert (
        "flight.toml:19: lew: unknown table (did you mean law?); a configuration has vehicle, link" in message
    )
    assert "flight.toml: law is missing: the table must have k, rho2_per_s, rho3_per_s" in message


def test_an_unknown_key_is_refused_with_its_line_and_the_likely_meaning() -> None:
    text, number = with_line("speed_max_m_s", "speed_max_ms = 5.0")
    message = refusal(text=text)
    assert (
        f"flight.toml:{number}: limits.speed_max_ms = 5.0: unknown key (did you mean speed_max_m_s?)"
        in message
    )
    assert "limits.speed_max_m_s is missing" in message


def test_every_fault_is_named_not_only_the_first() -> None:
    message = refusal("law.k=0", "supervisor.arm=3", "limits.foo=1")
    assert [line.split(":")[0] for line in message.splitlines()] == [
        "--set supervisor.arm=3",
        "--set law.k=0",
        "--set limits.foo=1",
    ]


def test_lines_are_found_behind_dotted_quoted_and_inline_keys() -> None:
    body = TEXT[TEXT.index("[vehicle]") :].replace(
        "[law]\nk = 1.0\nrho2_per_s = 10.0\nrho3_per_s = 10.0\n", ""
    )
    head = "law.k = 1.0\nlaw . rho2_per_s = 10.0\n"
    assert refusal(text=f"{head}law.'rho3_per_s' = 0\n{body}").startswith("flight.toml:3: law.rho3_per_s = 0")
    inline = "\nlaw = {k = 1.0, rho2_per_s = 10.0, rho3_per_s = -1}\n"
    assert refusal(text=f"{inline}{body}").startswith("flight.toml:2: law.rho3_per_s = -1")
    indented = TEXT.replace("[law]\nk = 1.0", "  [ law ]\n  k=0")
    assert refusal(text=indented).startswith("flight.toml:20: law.k = 0")


def test_bad_toml_is_refused_with_its_line() -> None:
    assert refusal(text=f"{TEXT}\nk = = 3\n").startswith("flight.toml: not valid TOML: ")
    assert "(at line 41, column 5)" in refusal(text=f"{TEXT}\nk = = 3\n")
    assert "not valid TOML" in refusal(text="a = " + "[" * 100_000)
    assert "not valid TOML" in refusal(text="a = " + "1" * 5000)


def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"absent\.toml: cannot be read: No such file or directory"):
        load(tmp_path / "absent.toml")
    with pytest.raises(ConfigError, match="cannot be read: Is a directory"):
        load(tmp_path)
    with pytest.raises(ConfigError, match="cannot be read"):
        load(Path("\0"))
    latin = tmp_path / "latin.toml"
    latin.write_bytes(b'[vehicle]\nname = "\xfcber"\n')
    with pytest.raises(ConfigError, match=r"latin\.toml: not UTF-8 text \(byte 18\)"):
        load(latin)


def test_a_trajectory_takes_only_its_own_keys() -> None:
    assert refusal("trajectory.name=helx") == (
        '--set trajectory.name=helx: trajectory.name = "helx": '
        'must be "helix", "circle", "line", "zigzag", "lemniscate" or "eight" (did you mean helix?)'
    )
    assert refusal("trajectory.leg_m=3") == (
        "--set trajectory.leg_m=3: trajectory.leg_m = 3: unknown key; "
        'trajectory "helix" has stop_at_s, stop_over_s, radius_m, speed_m_s, down_m_s, down_m, levels_off_m'
    )
    assert refusal("trajectory.radius_m=0").endswith("must be a number from 0.01 to 100000 (radius, m)")
    text, number = with_line("name", 'name = "demo"')
    text = text.replace('name = "helix"', "radius_m = 1.0")
    assert number == 3
    assert refusal(text=text).startswith("flight.toml:38: trajectory.name is missing: must be")


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_naming_another_trajectory_forgets_the_parameters_of_the_first(name: str) -> None:
    text = TEXT + "radius_m = 2.0\ndown_m_s = 0.2\n"
    trajectory = parse(text, "flight.toml", [f"trajectory.name={name}"]).trajectory
    assert type(trajectory) is TRAJECTORIES[name]
    assert name == "helix" or trajectory == TRAJECTORIES[name]()
    assert parse(text, "flight.toml", ["trajectory.name=helix"]).trajectory == parse(text, "").trajectory


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("law.k", "expected KEY=VALUE with a dotted key, such as law.k=1.0"),
        ("=1", "expected KEY=VALUE"),
        ("law..k=1", "expected KEY=VALUE"),
        (".law=1", "expected KEY=VALUE"),
        ("law.k=", "the value is missing"),
        ("law=1", "law is a table; name a key in it, such as law.k"),
        ("law.k.x=1", "law.k is a value, not a table"),
        ("law.k=" + "[" * 100_000, "nested too deeply"),
        ("law.k=" + "1" * 5000, "limit"),
        ("law.k=\udcff", "not UTF-8 text"),
        ("law.\udcff=1", "not UTF-8 text"),
        ("lew.k=1", "unknown table"),
        ("law.k=1\nrho2_per_s=3", "must be a number from 1e-06 to 1e+06"),
    ],
)
def test_a_bad_override_is_named_as_the_operator_wrote_it(setting: str, said: str) -> None:
    message = refusal(setting)
    message.encode()
    written = setting.encode("utf-8", "backslashreplace").decode().replace("\n", "\\n")
    assert message.startswith((f"--set {written[:97]}", "flight.toml: lew"))
    assert said in message
    assert len(message) < 400


def test_an_override_has_the_last_word_and_is_blamed_instead_of_the_line() -> None:
    assert make_config("law.k=0.25", "law.k = 0.5").law.k == 0.5
    assert make_config("vehicle.name=some-name").vehicle.name == "some-name"
    assert make_config("flight.origin=[47.0, 8.0, 400]").flight.origin == (47.0, 8.0, 400.0)
    assert make_config("log.enabled=false").log.enabled is False
    assert refusal("law.rho2_per_s=nan").startswith("--set law.rho2_per_s=nan: law.rho2_per_s = nan: ")


def some_config() -> st.SearchStrategy[Config]:
    """Configurations that load, far from the demo's."""
    exact = st.floats(0.01, 1.9)
    return st.builds(
        lambda k, timeout, origin, name, auto: make_config(
            f"law.k={k!r}",
            f"link.position_timeout_s={timeout!r}",
            f"flight.origin={origin}",
            f"trajectory.name={name}",
            f"supervisor.engage={'auto' if auto else 'pilot'}",
        ),
        exact,
        st.floats(0.05, 2.0),
        st.sampled_from(["ekf", "home", "engage", "[47.397742, 8.545594, 489.1]", "[-1, 2, 3]"]),
        st.sampled_from(sorted(TRAJECTORIES)),
        st.booleans(),
    )


@settings(max_examples=50)
@given(some_config())
def test_json_gives_the_very_same_configuration_back(config: Config) -> None:
    assert from_json(to_json(config)) == config
    assert to_json(from_json(to_json(config))) == to_json(config)


@pytest.mark.parametrize("text", ["", "{}", "[", '{"vehicle": 3}', "[" * 100_000, "\udcff"])
def test_a_log_of_another_make_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="the configuration in the log: "):
        from_json(text)
