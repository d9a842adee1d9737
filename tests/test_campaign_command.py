"""`sitl campaign`: what cannot be is refused with key and reason, and what can is written and printed."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from guidance.se3 import Quaternion, Vec3
from sitl import cli
from sitl.campaign import plots
from sitl.campaign.plan import Plan, Start
from sitl.campaign.run import load

pytestmark = pytest.mark.timeout(120)  # the first of these compiles, and other work may keep the machine busy


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"flights": 0}, "flights must be a whole number from 1"),
        ({"seed": -1}, "seed must be a whole number from 0"),
        ({"law": "pid"}, "law must be one of paper, global, not 'pid'"),
        ({"allocation": "yaw"}, "allocation must be one of"),
        ({"k": (0.0, 1.0)}, "k must be at least 1e-06"),
        ({"k": (-1.0, 1.0)}, "k must be at least 1e-06"),
        ({"rho2_per_s": (math.nan, 1.0)}, "rho2_per_s must be at least 1e-06"),
        ({"rho3_per_s": (1e-7, 1.0)}, "rho3_per_s must be at least 1e-06"),
        ({"beta": (1.0, math.inf)}, "beta must be at least 1e-06 and at most 1e+06, not inf"),
        ({"start_rate_rad_s": (-1.0, 1.0)}, "start_rate_rad_s must be at least 0"),
        ({"start_speed_m_s": (0.0, math.nan)}, "start_speed_m_s must be at least"),
        ({"speed_max_m_s": (0.0, 5.0)}, "speed_max_m_s must be at least 0.001"),
        ({"rate_max_rad_s": (1e-4, 5.0)}, "rate_max_rad_s must be at least 0.001"),
        ({"due_s": 0.0}, "due_s must be above 0"),
        ({"rate_max_rad_s": (5.0, 4.0)}, "rate_max_rad_s must be LOWEST:HIGHEST, not 5:4"),
        ({"speed_min_m_s": (0.0, 6.0)}, "speed_min_m_s must not exceed speed_max_m_s"),
        ({"delay_s": (0.0, 10.0), "step_s": 0.001}, "delay_s must be at most 500 steps"),
        ({"step_s": 0.0}, "step_s must be at least 1e-05"),
        ({"duration_s": 0.01}, "duration_s must be at least"),
        ({"within_m": -0.1}, "within_m must be above 0"),
        ({"acceleration_m_s2": 0.0}, "acceleration_m_s2 must be at least 0.001, not 0"),
        ({"acceleration_m_s2": 9e-4}, "acceleration_m_s2 must be at least 0.001"),
        ({"turn_acceleration_rad_s2": math.nan}, "turn_acceleration_rad_s2 must be at least 0.001"),
        ({"planar": True, "allocation": "roll-yaw"}, "allocation must be pitch-yaw in the plane"),
        (
            {"starts": (Start("bent", Vec3(0.0, 0.0, 0.0), Quaternion(1.0, 0.1, 0.0, 0.0)),)},
            "starts: 'bent' must have a finite position and a unit quaternion",
        ),
        (
            {"starts": (Start("lost", Vec3(0.0, math.nan, 0.0), Quaternion(1.0, 0.0, 0.0, 0.0)),)},
            "starts: 'lost' must have a finite position",
        ),
    ],
)
def test_a_plan_that_cannot_be_is_refused_with_key_and_reason(change: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ValueError, match="^" + re.escape(complaint)):
        Plan(**change)


def command(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["sitl", "campaign", *arguments])
    with pytest.raises(SystemExit) as exit_:
        cli.main()
    assert isinstance(exit_.value.code, int)
    return exit_.value.code


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--k", "-1"], "k must be at least 1e-06"),
        (["--k", "one"], "k must be a number or LOWEST:HIGHEST, not 'one'"),
        (["--start-rate", "5:0"], "start_rate_rad_s must be LOWEST:HIGHEST"),
        (["--turn-acceleration", "0"], "turn_acceleration_rad_s2 must be at least 0.001"),
        (["--wind", "nan"], "wind_m_s must be at least 0"),
        (["--law", "pid"], "law must be one of"),
        (["--preset", "chair"], "preset must be one of table, rover, airplane, not 'chair'"),
        (["--preset", "table", "--k", "2"], "k is set by the preset table"),
        (["--trajectory", "helix,radius_m=-1"], "trajectory.radius_m = -1"),
        (["--trajectory", "spiral"], 'trajectory.name = "spiral"'),
        (["--trajectory", "helix,radius"], "trajectory must be NAME,KEY=VALUE"),
        (["--error-function", "bounded"], "error_function.approach_m_s is missing"),
        (["--error-function", "bounded,approach_m_s=-2"], "error_function.approach_m_s = -2"),
        (["--output", "nowhere/x.npz"], "there is no directory nowhere"),
        (["--output", "x.csv"], "must end in .npz"),
        (["--plot", "x.npz"], "must end in .png"),
        (["--threads", "0"], "threads"),
        (["--output", "/proc/x.npz"], "/proc/x.npz: cannot be written"),
        (["--plot", "/proc/x.png"], "/proc/x.png: cannot be written"),
    ],
)
def test_bad_options_are_refused_with_key_and_reason(
    arguments: list[str],
    complaint: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert command(monkeypatch, *arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert complaint in said.err
    assert said.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_the_command_writes_results_and_a_plot_and_prints_a_table(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert command(monkeypatch, "--flights", "40", "--law", "global", "--speed-min", "0") == 0
    out = capsys.readouterr().out
    assert "converged" in out
    assert "60,000 steps" in out
    assert (tmp_path / "campaign.png").read_bytes().startswith(b"\x89PNG")
    assert len(load(tmp_path / "campaign.npz")["campaign"]["settled_s"]) == 40


def test_with_json_it_says_all_in_one_object_and_writes_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = ["--flights", "10", "--duration", "2", "--k", "0.5:2", "--json"]
    assert command(monkeypatch, *arguments) == 0
    found = json.loads(capsys.readouterr().out)
    (only,) = found["campaigns"]
    assert only["plan"]["k"] == [0.5, 2.0]
    assert only["summary"]["converged"] == 0.0
    assert found["steps"] == 1000
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("option", ["--output=taken.npz", "--plot=taken.png"])
def test_a_directory_is_refused_before_the_flights(
    option: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    taken = Path(option.partition("=")[2])
    taken.mkdir()
    # Nobody waits for as many flights.
    assert command(monkeypatch, "--flights", "10000000", option) == 2
    assert capsys.readouterr().err == f"sitl campaign: {taken}: is a directory, and must be a file\n"
    assert list(Path().iterdir()) == [taken]


def test_more_flights_than_memory_holds_are_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("os.sysconf", lambda name: {"SC_PHYS_PAGES": 1000, "SC_PAGE_SIZE": 1 << 20}[name])
    assert command(monkeypatch, "--flights", "1000000000", "--json") == 2
    # The pose at the start, and the outcomes.
    assert capsys.readouterr().err == (
        "sitl campaign: flights: 1,000,000,000 need 152.0 GB of memory, and this machine has 1.0 GB\n"
    )


def test_a_file_that_fails_leaves_the_older_one_the_summary_and_the_other_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def full(results: object, path: Path) -> None:
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(plots, "write", full)
    Path("campaign.png").write_bytes(b"older")
    assert command(monkeypatch, "--flights", "10", "--duration", "2") == 1
    said = capsys.readouterr()
    assert "converged" in said.out
    assert said.err == "sitl: campaign.png: cannot be written: No space left on device\n"
    assert Path("campaign.png").read_bytes() == b"older"
    assert len(load(Path("campaign.npz"))["campaign"]["settled_s"]) == 10
    assert sorted(path.name for path in Path().iterdir()) == ["campaign.npz", "campaign.png"]


def test_a_stdout_that_fails_takes_no_results_with_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def full(text: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("typer.echo", full)
    arguments = ["--flights", "10", "--duration", "2", "--json", "--output", "x.npz"]
    assert command(monkeypatch, *arguments) == 1
    assert capsys.readouterr().err == "sitl: [Errno 28] No space left on device\n"
    assert len(load(Path("x.npz"))["campaign"]["settled_s"]) == 10


@pytest.mark.parametrize(
    "arguments",
    ["paper --figure 1 --json", "bench --json", "campaign --flights 1 --duration 1 --json"],
)
def test_a_full_disk_under_stdout_is_one_line_and_status_1(arguments: str) -> None:
    code = "from sitl import bench, cli; bench.run = lambda step: []; cli.main()"
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-c", code, *arguments.split()],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert (done.returncode, done.stderr) == (1, "sitl: [Errno 28] No space left on device\n")
