"""The words of `guidance command`."""

from __future__ import annotations

from typing import Any

import pytest
import zenoh
from typer.testing import CliRunner

from guidance.cli import app
from guidance.ordering import NoAnswerError, ask, fields_of


@pytest.mark.parametrize(
    ("words", "fields"),
    [
        (["engage"], {}),
        (["allocate", "roll-yaw"], {"allocation": "roll-yaw"}),
        (["set", "law.k=0.5"], {"key": "law.k", "value": 0.5}),
        (
            ["set", "law.error_function.approach_m_s=2"],
            {"key": "law.error_function.approach_m_s", "value": 2},
        ),
        (["set", "limits.keep_direction=false"], {"key": "limits.keep_direction", "value": False}),
        (["load", "name=circle", "radius_m=5"], {"trajectory": {"name": "circle", "radius_m": 5}}),
    ],
)
def test_words_become_fields(words: list[str], fields: dict[str, Any]) -> None:
    assert fields_of(words[0], words[1:]) == fields


def test_a_trajectory_is_read_from_a_configuration(tmp_path: Any) -> None:
    path = tmp_path / "flight.toml"
    path.write_text('[trajectory]\nname = "line"\nspeed_m_s = 0.5\n')
    assert fields_of("load", [str(path)]) == {"trajectory": {"name": "line", "speed_m_s": 0.5}}
    for text, why in (("[vehicle]\n", "has no [trajectory]"), ("=", "not valid TOML")):
        path.write_text(text)
        with pytest.raises(ValueError, match=why.replace("[", r"\[")):
            fields_of("load", [str(path)])
    with pytest.raises(ValueError, match="cannot be read"):
        fields_of("load", [str(tmp_path / "none.toml")])


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["set"], "set: expected KEY=VALUE, such as law.k=0.8, got nothing"),
        (["set", "law.k", "0.8"], "set: expected KEY=VALUE, such as law.k=0.8, got law.k 0.8"),
        (["set", "law.k="], "set law.k=: the value is missing"),
        (["engage", "now"], "engage: expected nothing behind it, got now"),
        (["allocate"], "allocate: expected one of pitch-yaw, roll-pitch, roll-yaw, got nothing"),
        (["load"], "load: expected a TOML file"),
        (["fly"], "there is no order 'fly'"),
        (["allocate", "yaw"], "Invalid enum value 'yaw'"),
    ],
)
def test_wrong_words_are_said_before_anybody_is_asked(words: list[str], why: str) -> None:
    outcome = CliRunner().invoke(app, ["command", "uuv-1", *words])
    assert outcome.exit_code == 2
    assert why in outcome.stderr


def test_a_vehicle_is_one_name_and_a_session_that_fails_is_said() -> None:
    with pytest.raises(ValueError, match="1 to 64 letters"):
        ask("uuv/*", "engage", {})

    def broken(config: zenoh.Config) -> zenoh.Session:
        raise zenoh.ZError("unreachable")

    with pytest.raises(NoAnswerError, match="no zenoh session: unreachable"):
        ask("uuv-1", "engage", {}, open_session=broken)
