"""What another configuration would have commanded: from the same inputs, at the same instants."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace
from typer.testing import CliRunner

from guidance import what_if
from guidance.cli import app
from guidance.config import Config, ConfigError, from_json
from guidance.records import Input, Session, Setpoint, TrackingError
from guidance.replay import ReplayError, replay
from guidance.telemetry.log import read_records
from guidance.what_if import Comparison, compare, other_configuration
from sitl.logbook import LogBook
from tests.flight_asset import ASSET, configuration
from tests.hand_made_flight import log_of, with_session
from tests.helpers import make_config, make_flight
from tests.test_report_page import read_page

DEPLOY = Path(__file__).parents[1] / "deploy"


def call(*arguments: str) -> tuple[int, str, str]:
    """Exit status, stdout and stderr; anything but an orderly exit is raised."""
    result = CliRunner().invoke(app, list(arguments), catch_exceptions=False)
    return result.exit_code, result.stdout, result.stderr


def compared(path: Path, *settings: str) -> Comparison:
    return compare(path, lambda logged: other_configuration(logged, None, settings))


# The log that is kept ------------------------------------------------------------------------------------


def test_the_kept_log_replays_to_the_bit_and_within_1e_9() -> None:
    for tolerance in (0.0, 1e-9):
        found = replay(ASSET, tolerance)
        assert (found.difference, found.stopped) == (None, "")
        assert found.identical
        assert found.tracked > 100
    assert ASSET.stat().st_size < 300_000
    (session,) = read_records(ASSET, "session")
    assert isinstance(session, Session)
    assert from_json(session.config_json) == configuration()


@pytest.fixture(scope="module")
def nudged(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The kept log with a change made to one of its setpoints."""
    records = list(read_records(ASSET))[1:]
    last = max(i for i, record in enumerate(records) if isinstance(record, Setpoint))

    def write(**fields: object) -> Path:
        directory = tmp_path_factory.mktemp("nudged")
        with LogBook(configuration(), directory) as book:
            for i, record in enumerate(records):
                book.add(replace(record, **fields) if i == last else record)
        return book.path

    setpoint = records[last]
    assert isinstance(setpoint, Setpoint)
    return setpoint, write


def test_a_tolerance_forgives_fractions_alone_and_no_more_than_it_says(nudged: Any) -> None:
    setpoint, write = nudged
    near = write(speed_m_s=setpoint.speed_m_s + 5e-10)
    assert not replay(near).identical
    assert replay(near, 1e-9).identical
    for fields in (
        {"speed_m_s": setpoint.speed_m_s + 2e-9},
        {"body_rates_frd_rad_s": (0.0, 0.0, setpoint.body_rates_frd_rad_s[2] - 2e-9)},
        {"seq": setpoint.seq + 1},
        {"saturated": not setpoint.saturated},
        {"t_ns": setpoint.t_ns + 1},
        {"speed_m_s": 2},
    ):
        found = replay(write(**fields), 1e-9)
        assert found.difference is not None, fields
        assert (found.difference.topic, found.difference.field) == ("setpoint", *fields)


# Another configuration -----------------------------------------------------------------------------------


def test_the_same_configuration_would_have_commanded_the_same() -> None:
    found = compared(ASSET)
    setpoints = [r for r in read_records(ASSET, "setpoint") if isinstance(r, Setpoint) and not r.neutral]
    assert len(found.t_ns) == len(setpoints) > 100
    assert all((one.rms, one.largest) == (0.0, 0.0) for one in found.differences)
    assert found.saturated_flown == found.saturated_other == sum(s.saturated for s in setpoints)
    assert (found.only_flown, found.only_other, found.partings, found.refused, found.stopped) == (
        0,
        0,
        (),
        "",
        "",
    )
    yaw = next(one for one in found.commands if one.name == "yaw rate")
    assert list(yaw.flown) == [s.body_rates_frd_rad_s[2] for s in setpoints]


def test_another_gain_would_have_commanded_what_the_law_says_of_the_flown_state(tmp_path: Path) -> None:
    """The law alone, unbounded by k: half the gain takes half of the error's part out of the field."""
    with LogBook(make_config(), tmp_path) as book:
        flight = make_flight()
        flight.on_record = book.add
        flight.run(15.0)
    found = compared(book.path, "law.k=0.5")
    errors = [r for r in read_records(book.path, "error") if isinstance(r, TrackingError)]
    assert len(found.t_ns) == len(errors)
    assert found.flown.law.k == 1.0
    assert found.other.law.k == 0.5
    speed = next(one for one in found.commands if one.name == "speed")
    # at the limit both ask for all there is; settled, both for the reference's speed
    assert (speed.flown[100], speed.other[100]) == (5.0, 5.0)
    assert speed.other[-1] == pytest.approx(speed.flown[-1], abs=1e-3)
    differences = {one.channel: one for one in found.differences}
    worst = differences["speed"]
    at = [(t - found.t_ns[0]) * 1e-9 for t in found.t_ns].index(worst.largest_at_s)
    assert abs(speed.other[at] - speed.flown[at]) == worst.largest > 0.5
    apart = [b - a for a, b in zip(speed.flown, speed.other, strict=True)]
    assert worst.rms == pytest.approx((sum(d * d for d in apart) / len(apart)) ** 0.5)
    assert all(abs(d) <= worst.largest for d in apart)
    assert found.saturated_other < found.saturated_flown


def test_one_that_would_not_have_engaged_says_why() -> None:
    found = compared(ASSET, "supervisor.engage_max_error_m=0.05")
    assert len(found.t_ns) == 0
    assert found.only_flown > 100
    assert "engage_max_error_m is 0.05" in found.refused
    assert found.differences == ()
    plane = compare(ASSET, lambda logged: other_configuration(logged, DEPLOY / "ardupilot-plane.toml", ()))
    assert "not what vehicle.profile ardupilot-plane is for" in plane.refused


def test_where_they_part_is_told_with_the_reason() -> None:
    """A guard on the error would have ended the drive."""
    found = compared(ASSET, "guards.error_max_m=0.5", "guards.error_s=0.2")
    assert 0 < len(found.t_ns) < 100
    assert found.refused == ""
    first = found.partings[0]
    assert 0.0 < first.at_s < 5.0
    assert (first.flown, first.other) == ("tracking", "aborting")
    assert first.other_reason.startswith("error: 8.0 m off")
    assert found.partings[1].other == "aborted"
    assert found.only_flown > 0


def test_partings_that_are_not_told_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = ("guards.error_max_m=0.5", "guards.error_s=0.2")
    found = compared(ASSET, *settings)
    assert found.partings_more == 0
    monkeypatch.setattr(what_if, "PARTINGS_MOST", 1)
    fewer = compared(ASSET, *settings)
    assert fewer.partings == found.partings[:1]
    assert fewer.partings_more == len(found.partings) - 1 > 0
    assert fewer.as_json()["partings_more"] == fewer.partings_more
    _, out, _ = call("replay", str(ASSET), *(word for one in settings for word in ("--set", one)))
    assert f"and part or meet {fewer.partings_more} times more" in out


@pytest.mark.filterwarnings("error")
def test_what_no_number_holds_is_null_in_json(tmp_path: Path) -> None:
    records = [
        replace(one, speed_m_s=-1e308, thrust=1e200) if isinstance(one, Setpoint) and not one.neutral else one
        for one in list(read_records(ASSET))[1:]
    ]
    log, output = log_of(tmp_path, configuration(), records), tmp_path / "x.html"
    status, out, err = call("replay", str(log), "--set", "law.k=0.5", "--report", str(output), "--json")
    assert status == 0, err
    printed = json.loads(out.splitlines()[-1], parse_constant=pytest.fail)
    speed, thrust = (
        next(one for one in printed["differences"] if one["channel"] == name) for name in ("speed", "thrust")
    )
    assert (speed["rms"], speed["largest"]) == (None, pytest.approx(1e308))
    assert (thrust["rms"], thrust["largest"]) == (None, pytest.approx(1e200))


def test_a_record_that_is_none_is_blamed_and_no_input(tmp_path: Path) -> None:
    records = list(read_records(ASSET))[1:]
    at = max(i for i, record in enumerate(records) if isinstance(record, Setpoint))
    inputs = sum(isinstance(record, Input) for record in records[:at])
    records[at] = replace(records[at], speed_m_s="fast")
    with pytest.raises(ReplayError, match=rf"topic setpoint behind {inputs} inputs cannot be read"):
        compared(log_of(tmp_path, configuration(), records))


def test_the_line_is_the_logs_and_the_rest_the_files() -> None:
    logged = configuration()
    settings = ("law.k=0.7", "link.connection=serial:///dev/null?baud=57600")
    other = other_configuration(logged, DEPLOY / "ardupilot-rover.toml", settings)
    assert other.link.connection == logged.link.connection
    assert other.link.rate_hz != logged.link.rate_hz
    assert other.law.k == 0.7
    own = other_configuration(logged, None, ("law.k=0.7", "guards.speed_max_m_s=9.0"))
    guards = replace(logged.guards, speed_max_m_s=9.0)
    assert own == replace(logged, law=replace(logged.law, k=0.7), guards=guards)
    assert other_configuration(logged, None, ()) == logged


def test_settings_that_make_no_configuration_are_refused_by_name() -> None:
    logged: Config = configuration()
    for setting, why in (("law.k=-1", "law.k"), ("law.kk=1", "law.kk"), ("law.k", "expected KEY=VALUE")):
        with pytest.raises(ConfigError, match=why):
            other_configuration(logged, None, (setting,))


def test_a_log_that_ends_early_is_compared_as_far_as_it_goes(tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(ASSET.read_bytes()[:180_000])
    found = compared(cut, "law.k=0.5")
    assert 10 < len(found.t_ns) < len(compared(ASSET).t_ns)
    assert "incomplete" in found.stopped
    with pytest.raises(ReplayError, match=r"schema version 0.*use guidance 0\.0\.1"):
        compared(with_session(ASSET, tmp_path / "old.mcap", schema_version=0, guidance_version="0.0.1"))


# The command ---------------------------------------------------------------------------------------------


def test_the_command_compares_and_draws(tmp_path: Path) -> None:
    output = tmp_path / "compared.html"
    status, out, err = call("replay", str(ASSET), "--set", "law.k=0.5", "--report", str(output), "--json")
    assert status == 0, err
    printed = json.loads(out.splitlines()[-1])
    assert printed["compared"] == len(compared(ASSET).t_ns)
    assert {one["channel"] for one in printed["differences"]} == {"yaw rate", "speed", "thrust"}
    assert "yaw rate" in err
    text, page = read_page(output)
    assert "moved nothing" in text
    table = page.text.partition("largestafter, s")[2]
    yaw = next(one for one in printed["differences"] if one["channel"] == "yaw rate")
    assert f"{yaw['rms']:.4g}{yaw['largest']:.4g}rad/s" in table
    lines = page.json["charts"]["comparison"]["data"]
    assert [line["name"] for line in lines[:2]] == ["flown", "other"]
    assert "law.k1.00.5" in page.text


def test_the_commands_exit_statuses(tmp_path: Path) -> None:
    assert call("replay", str(ASSET), "--tolerance", "1e-9")[0] == 0
    status, out, _ = call("replay", str(ASSET), "--set", "supervisor.engage_max_error_m=0.05")
    assert status == 1
    assert "would not have engaged" in out
    output = tmp_path / "refused.html"
    other = ("--config", str(DEPLOY / "ardupilot-plane.toml"))
    status, _, err = call("replay", str(ASSET), *other, "--report", str(output))
    assert status == 1, err
    assert "It would not have engaged" in read_page(output)[1].text
    for arguments, why in (
        ((str(ASSET), "--set", "law.k=x"), "law.k"),
        ((str(ASSET), "--report", "x.html"), "--config or --set"),
        ((str(ASSET), "--config", str(tmp_path / "none.toml")), "cannot be read"),
        ((str(tmp_path / "none.mcap"), "--set", "law.k=1"), "No such file"),
    ):
        status, _, err = call("replay", *arguments)
        assert status == 2
        assert why in err
        assert "Traceback" not in err


def test_what_was_found_is_printed_before_a_report_of_no_flight(tmp_path: Path) -> None:
    log = log_of(tmp_path, configuration(), [])
    output = tmp_path / "x.html"
    status, out, err = call("replay", str(log), "--set", "law.k=0.5", "--report", str(output), "--json")
    assert status == 1
    assert json.loads(out)["compared"] == 0
    assert "no flight in it" in err
    assert not output.exists()


def test_a_missing_extra_and_a_place_that_is_none_show_before_the_replay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(what_if, "compare", lambda *_: pytest.fail("it was compared"))
    again = ("replay", str(ASSET), "--set", "law.k=0.5", "--report")
    status, out, err = call(*again, str(tmp_path / "missing" / "x.html"))
    assert (status, out) == (1, "")
    assert "cannot be written: No such file" in err
    for name in [name for name in sys.modules if name.startswith(("plotly", "guidance.report."))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "plotly", None)
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    status, out, err = call(*again, str(tmp_path / "x.html"))
    assert (status, out) == (2, "")
    assert "pip install 'se3-guidance[report]'" in err
