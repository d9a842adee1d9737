"""`sitl paper`: the numbers as JSON, the plots as files, and what it refuses."""

from __future__ import annotations

import json
import sys
from functools import cache
from math import hypot
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner

from sitl.cli import app

#: Coarse enough to be quick, and still within its goal before the corners.
QUICK = ["--step", "0.1", "--sample", "0.5"]


def run(*arguments: str) -> str:
    """What the command prints on stdout; it must succeed."""
    outcome = CliRunner().invoke(app, ["paper", *arguments])
    assert outcome.exit_code == 0, outcome.output
    return outcome.stdout


@cache
def numbers(*arguments: str) -> Any:
    """The JSON it prints, which must be JSON to the letter."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(run("--json", *QUICK, *arguments), parse_constant=refuse)


@pytest.mark.parametrize(
    ("number", "first"),
    [(1, [10.0, 31.0, 5.0]), (2, [-20.0, -100.0]), (3, [-20.0, -100.0]), (4, [-20.0, -100.0])],
)
def test_a_figure_is_one_object_with_its_times_errors_controls_and_parameters(
    number: int, first: list[float]
) -> None:
    figure = numbers("--figure", str(number))
    assert figure["figure"] == number
    assert figure["t"] == [0.5 * n for n in range(201)]
    assert len(figure["error"]) == len(figure["controls"]) == 201
    assert {len(e) for e in figure["error"]} == {len(first)}
    assert {len(u) for u in figure["controls"]} == {4}
    assert figure["error"][0] == first
    assert hypot(*figure["error"][59]) < 1e-4
    assert hypot(*figure["error"][-1]) < 1e-6
    parameters = figure["parameters"]
    assert parameters["gains"] == {"k": 1.0, "rho2": 10.0, "rho3": 10.0, "beta": 1.0}
    assert (parameters["step_s"], parameters["sample_s"], parameters["end_s"]) == (0.1, 0.5, 100.0)
    assert parameters["space"] == f"SE({len(first)})"
    assert ("reference" in figure, "position" in figure) == (number == 4, number == 4)


def test_parameters_say_the_start_the_reference_and_the_limits() -> None:
    helix = numbers("--figure", "1")["parameters"]
    assert helix["start"] == {"position_m": [-10.0, -30.0, -5.0], "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}
    paper = {"name": "helix", "radius_m": 1.0, "speed_m_s": 0.1, "down_m_s": 0.1}
    assert {key: helix["reference"][key] for key in paper} == paper
    assert set(helix["limits"].values()) == {None}
    zigzag = numbers("--figure", "3")["parameters"]
    assert zigzag["start"]["position_m"] == [20.0, 100.0]
    assert [row[n] for n, row in enumerate(zigzag["start"]["R"])] == [-1.0, -1.0]
    leg = {"name": "zigzag", "leg_m": 30.0, "speed_m_s": 1.0}
    assert {key: zigzag["reference"][key] for key in leg} == leg
    assert {abs(limit) for limit in zigzag["limits"].values()} == {5.0}
    assert zigzag["corners_s"] == [30.0, 60.0]


def test_controls_of_figure_2_are_unbounded_and_those_of_figure_3_within_5() -> None:
    free, bounded = (numbers("--figure", n)["controls"] for n in ("2", "3"))
    assert max(abs(u[2]) for u in free) > 50.0
    assert max(u[3] for u in free) > 15.0
    for component in (2, 3):
        assert max(abs(u[component]) for u in bounded) == 5.0
    assert all(u[0] == u[1] == 0.0 for u in free + bounded)


def test_figure_4_is_where_figure_3_was() -> None:
    third, fourth = numbers("--figure", "3"), numbers("--figure", "4")
    assert fourth["error"] == third["error"]
    assert fourth["reference"][:2] == [[0.0, 0.0], [0.5, 0.5]]
    assert fourth["reference"][60] == [30.0, 30.0]
    assert fourth["reference"][120] == [0.0, 60.0]
    assert fourth["position"][0] == [20.0, 100.0]
    for r, x, e in zip(fourth["reference"], fourth["position"], fourth["error"], strict=True):
        assert e == [r[0] - x[0], r[1] - x[1]]


def test_without_a_number_json_is_the_list_of_all_four() -> None:
    assert [figure["figure"] for figure in numbers()] == [1, 2, 3, 4]


def test_plots_go_to_the_directory_named_as_png_and_svg_with_the_labels_of_the_paper(tmp_path: Path) -> None:
    directory = tmp_path / "new" / "figures"
    printed = run(*QUICK, "--output", str(directory)).split()
    expected = [directory / f"figure-{n}.{kind}" for n in (1, 2, 3, 4) for kind in ("png", "svg")]
    assert [Path(line) for line in printed] == expected
    for n in (1, 2, 3, 4):
        png = (directory / f"figure-{n}.png").read_bytes()
        assert png.startswith(b"\x89PNG\r\n\x1a\n")
        assert len(png) > 20_000
        text = "".join(ElementTree.parse(directory / f"figure-{n}.svg").getroot().itertext())
        assert f"Fig. {n}." in text
        for label in ("reference r", "vehicle x", "x(0)") if n == 4 else ("t (s)", "r(t) - x(t) (m)"):
            assert label in text


def test_the_same_numbers_give_the_same_files_in_the_current_directory_if_none_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    drawn = []
    for _ in range(2):
        assert run(*QUICK, "--figure", "2").split() == ["figure-2.png", "figure-2.svg"]
        drawn.append([(tmp_path / f"figure-2.{kind}").read_bytes() for kind in ("png", "svg")])
    assert drawn[0] == drawn[1]


def test_json_draws_only_when_a_directory_is_named_and_keeps_stdout_json(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    numbers.__wrapped__("--figure", "1")
    assert list(tmp_path.iterdir()) == []
    numbers.__wrapped__("--figure", "1", "--output", "here")
    assert {path.name for path in (tmp_path / "here").iterdir()} == {"figure-1.png", "figure-1.svg"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--figure", "5"], "--figure must be 1, 2, 3 or 4, not 5"),
        (["--figure", "0"], "--figure must be"),
        (["--step", "0"], "--step must be 1e-05 to 0.1 s, not 0"),
        (["--step", "-0.01"], "not -0.01"),
        (["--step", "nan"], "--step must be"),
        (["--step", "inf"], "--step must be"),
        (["--sample", "0"], "--sample must be 0.001 to 100 s, not 0"),
        (["--sample", "101"], "--sample must be"),
        (["--sample", "nan"], "--sample must be"),
    ],
)
def test_bad_values_are_refused_with_the_option_and_what_it_may_be(arguments: list[str], said: str) -> None:
    outcome = CliRunner().invoke(app, ["paper", *arguments])
    assert outcome.exit_code == 2
    assert outcome.stdout == ""
    assert outcome.stderr.startswith("sitl paper: ")
    assert outcome.stderr.count("\n") == 1
    assert said in outcome.stderr


def test_a_directory_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    outcome = CliRunner().invoke(app, ["paper", *QUICK, "--figure", "1", "--output", str(tmp_path / "file")])
    assert outcome.exit_code == 2
    assert outcome.stderr.count("\n") == 1


def test_without_matplotlib_the_numbers_come_and_the_plots_name_the_extra(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delitem(sys.modules, "sitl.paper_plots", raising=False)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert numbers.__wrapped__("--figure", "1")["figure"] == 1
    outcome = CliRunner().invoke(app, ["paper", *QUICK, "--figure", "1"])
    assert outcome.exit_code == 2
    assert "matplotlib" in outcome.stderr
    assert "se3-guidance[sitl]" in outcome.stderr
