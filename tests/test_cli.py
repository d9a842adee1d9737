"""The command line: what it teaches, what it refuses, and its exit statuses."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer
from typer.testing import CliRunner

import guidance
from guidance import law
from guidance.cli import app
from guidance.records import Session
from guidance.service import new_session
from guidance.telemetry.recorder import Recorder
from guidance.telemetry.sinks import Sinks
from tests.helpers import DEMO, make_config, make_flight

PATIENCE_S = 20.0


def call(*arguments: str) -> tuple[int, str, str]:
    """Exit status, stdout and stderr; anything but an orderly exit is raised."""
    result = CliRunner().invoke(app, list(arguments), catch_exceptions=False)
    return result.exit_code, result.stdout, result.stderr


def record_flight(directory: Path, seconds: float, *overrides: str) -> Path:
    """A log of the built-in vehicle's flight on virtual time."""
    config = make_config(*overrides)
    session: Session = new_session(config)
    recorder = Recorder(directory, vehicle="v", session_id="0123", unix_offset_ns=0, min_free_bytes=0)
    sinks = Sinks({"log": recorder})
    sinks.publish([session])
    sinks.start()
    flight = make_flight(config=config)
    flight.on_record = lambda record: sinks.publish([record])
    flight.run(seconds)
    assert sinks.close(PATIENCE_S) == {}
    return recorder.path


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_flight(tmp_path_factory.mktemp("logs"), 6.0)


def test_help_teaches_with_examples_and_the_version_is_the_packages() -> None:
    status, out, _ = call("--help")
    assert status == 0
    assert "guidance demo" in out
    assert "guidance run --config" in out
    for command, example in (("run", "-c vehicle.toml --set"), ("demo", "--set trajectory.radius_m=20")):
        status, out, _ = call(command, "--help")
        assert status == 0
        assert example in out
    assert call("--version") == (0, f"guidance {guidance.__version__}\n", "")


def test_run_without_a_configuration_says_which_option_is_missing() -> None:
    status, out, err = call("run")
    assert (status, out) == (2, "")
    assert "--config" in err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("run", "-c", "no/such.toml"), "no/such.toml: cannot be read"),
        (("run", "-c", str(DEMO), "--set", "law.k=0"), "law.k"),
        (("run", "-c", str(DEMO), "--set", "law.kk=1"), "did you mean k?"),
        (("run", "-c", str(DEMO), "--set", "law.k"), "KEY=VALUE"),
        (("run", "-c", str(DEMO), "--set", "vehicle.profile=zeppelin"), "px4-uuv"),
        (("run", "-c", str(DEMO), "--set", 'zenoh.listen=["no locator"]'), "zenoh.listen"),
        (("demo", "--set", "limits.speed_max_m_s=fast"), "limits.speed_max_m_s"),
        (("demo", "--trajectory", "spiral"), "lemniscate"),
        (("demo", "--set", "zenoh.enabled=false"), "zenoh.enabled"),
        (("demo", "--set", "link.connection=udpin://127.0.0.1:0"), "link.connection"),
        (("demo", "--set", "zenoh.config_file=z.json5"), "zenoh.config_file"),
        (("demo", "--set", "zenoh.mode=client"), "zenoh.connect"),
        (("replay", "no/such.mcap"), "no/such.mcap"),
    ],
)
def test_what_is_refused_is_one_line_on_stderr_and_status_2(
    arguments: tuple[str, ...], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    status, out, err = call(*arguments)
    assert (status, out) == (2, "")
    assert says in err
    assert err.startswith("guidance: ")
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []  # before anything moved


def test_replay_of_a_flight_is_identical(log: Path) -> None:
    status, out, _ = call("replay", str(log))
    assert status == 0
    assert out.endswith("identical\n")
    status, out, err = call("replay", str(log), "--json")
    assert status == 0
    found = json.loads(out)  # and nothing else is on stdout
    assert found["identical"] is True
    assert found["tracked"] > 100
    assert found["difference"] is None
    assert "identical" in err


def test_replay_names_the_first_difference(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    exact = law.guide_step

    def edited(*arguments: Any) -> tuple[law.Memory, law.Evaluation]:
        memory, found = exact(*arguments)
        return memory, found._replace(V2=math.nextafter(found.V2, math.inf))

    monkeypatch.setattr("guidance.flying.rates.guide_step", edited)
    status, out, _ = call("replay", str(log))
    assert status == 1
    assert "first difference at " in out
    assert "error.v2: logged " in out


def test_replay_of_a_truncated_log_says_where_it_stopped(log: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    data = log.read_bytes()
    cut.write_bytes(data[: len(data) * 2 // 3])
    status, out, _ = call("replay", str(cut), "--json")
    assert status == 1
    found = json.loads(out)
    assert found["identical"] is False
    assert found["tracked"] > 50
    assert "interrupted" in found["stopped"]


def test_replay_of_a_flight_that_never_tracked_fails_and_says_so(tmp_path: Path) -> None:
    status, out, _ = call("replay", str(record_flight(tmp_path, 2.0, 'supervisor.engage="pilot"')))
    assert status == 1
    assert "nothing was tracked" in out


def test_replay_of_what_is_no_log_of_ours_is_refused(tmp_path: Path) -> None:
    foreign, noise, empty = (tmp_path / name for name in ("foreign.mcap", "noise.mcap", "empty.mcap"))
    buffer = io.BytesIO()
    writer = Writer(buffer)
    writer.start()
    channel = writer.register_channel(topic="/chatter", message_encoding="json", schema_id=0)
    writer.add_message(channel, log_time=0, data=b"{}", publish_time=0)
    writer.finish()  # type: ignore[no-untyped-call]
    foreign.write_bytes(buffer.getvalue())
    noise.write_bytes(b"\x00" * 1000)
    empty.write_bytes(b"")
    for path in (foreign, noise, empty, tmp_path):
        status, out, err = call("replay", str(path), "--json")
        assert (status, out) == (2, ""), path
        assert str(path) in err
        assert err.count("\n") == 1
