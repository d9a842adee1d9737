"""Campaigns: the same seed gives the same numbers, flights fly as they should, the law keeps its promises."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from guidance import error_function
from guidance.allocation import PITCH_YAW
from guidance.law import GLOBAL, UNSTARTED, Gains, Limits, Parameters, desired_field, guide_step
from guidance.limits import Controls
from guidance.se3 import Pose, Quaternion, Twist, Vec3, body_axes, dot, norm
from guidance.trajectory import TRAJECTORIES as ALL_TRAJECTORIES
from guidance.trajectory import Circle, Helix, Lemniscate, Line, Zigzag, sample
from sitl import cli
from sitl.bench_campaign import PLAN, UnavailableError, c_loop, difference
from sitl.campaign.flight import OUTCOMES, PARAMETERS, TRAJECTORIES, Rows, reference_at
from sitl.campaign.plan import Plan, Start
from sitl.campaign.presets import hard_starts, table
from sitl.campaign.report import summary
from sitl.campaign.run import Result, fly_range, load, run, save
from sitl.plant import PlantCommand, PlantParameters, PlantState, step

pytestmark = pytest.mark.timeout(120)  # the first of these compiles, and other work may keep the machine busy

SMALL = Plan(
    flights=50,
    seed=7,
    duration_s=3.0,
    law="global",
    k=(0.5, 2.0),
    wind_m_s=(0.0, 0.5),
    delay_s=(0.0, 0.1),
    rate_lag_s=(0.0, 0.1),
)


def outcome(rows: Rows, name: str) -> Rows:
    return rows[:, OUTCOMES.index(name)]


def parameter(rows: Rows, name: str) -> Rows:
    return rows[:, PARAMETERS.index(name)]


@pytest.mark.parametrize(("threads", "chunk"), [(1, 50), (2, 7), (3, 1), (2, 64)])
def test_the_same_seed_gives_the_same_numbers_however_it_is_cut(threads: int, chunk: int) -> None:
    parameters, outcomes = fly_range(SMALL, 0, 50)
    flown: list[int] = []
    result = run(SMALL, threads, chunk, flown.append)
    assert sum(flown) == 50
    assert_array_equal(result.outcomes, outcomes)
    for name, values in result.parameters.items():
        assert_array_equal(values, parameter(parameters, name))
    assert_array_equal(fly_range(SMALL, 31, 8)[1], outcomes[31:39])


def test_another_seed_gives_other_numbers() -> None:
    ours, theirs = fly_range(SMALL, 0, 20)[0], fly_range(replace(SMALL, seed=8), 0, 20)[0]
    assert not np.any(parameter(ours, "north_m") == parameter(theirs, "north_m"))


def test_what_is_drawn_fills_its_ranges() -> None:
    plan = replace(SMALL, flights=4000, duration_s=0.1, distance_m=(10.0, 20.0), start_s=(0.0, 50.0))
    rows, outcomes = fly_range(plan, 0, plan.flights)
    for name, (low, high) in {"k": (0.5, 2.0), "delay_s": (0.0, 0.1), "start_s": (0.0, 50.0)}.items():
        values = parameter(rows, name)
        assert low <= values.min() < low + 0.01 * (high - low)
        assert high - 0.01 * (high - low) < values.max() < high
        assert np.mean(values) == pytest.approx(0.5 * (low + high), rel=0.05)
    distance = outcome(outcomes, "start_error_m")
    assert distance.min() >= 10.0 - 1e-9
    assert distance.max() <= 20.0 + 1e-9
    # Uniform in volume: half of it is outside the cube root of the mean of the cubes.
    assert np.mean(distance > ((1000.0 + 8000.0) / 2.0) ** (1.0 / 3.0)) == pytest.approx(0.5, abs=0.03)
    attitudes = rows[:, 3:7]
    assert_allclose(np.linalg.norm(attitudes, axis=1), 1.0, atol=1e-12)
    # Of uniform attitudes each component has mean 0 and mean square 1/4.
    assert_allclose(np.mean(attitudes, axis=0), 0.0, atol=0.03)
    assert_allclose(np.mean(attitudes**2, axis=0), 0.25, atol=0.02)
    assert set(plan.varying()) >= {"k", "start_s", "wind_north_m_s", "delay_s", "rate_lag_s", "north_m"}
    for name in set(PARAMETERS) - set(plan.varying()):
        assert np.ptp(parameter(rows, name)) == 0.0 or name == "gust_phase_rad"


@pytest.mark.parametrize(
    "curve", [Helix(radius_m=2.0), Circle(), Line(heading_deg=30.0), Zigzag(), Lemniscate()]
)
def test_a_campaigns_reference_is_the_trajectorys(curve: Helix | Circle | Line | Zigzag | Lemniscate) -> None:
    common = Plan(trajectory=curve).common()
    for t in (0.0, 3.3, 40.0, 77.0):
        assert reference_at(common.trajectory, common.shape, t) == sample(curve, t)


def test_every_trajectory_can_be_flown() -> None:
    assert set(TRAJECTORIES) == set(ALL_TRAJECTORIES.values())


def test_a_flight_with_delay_and_wind_is_what_law_and_plant_give_in_a_loop_of_their_own() -> None:
    plan = Plan(
        flights=1,
        seed=5,
        law="global",
        duration_s=6.0,
        speed_min_m_s=(0.0, 0.0),
        wind_m_s=(0.4, 0.4),
        delay_s=(0.09, 0.09),
        speed_lag_s=(0.1, 0.1),
    )
    rows, outcomes = fly_range(plan, 0, 1)
    values = dict(zip(PARAMETERS, map(float, rows[0]), strict=True))
    limits = Limits(0.0, 5.0, 5.0, 5.0, 5.0, keep_direction=True)
    parameters = Parameters(GLOBAL, PITCH_YAW, Gains(1.0, 10.0, 10.0, 1.0), error_function.PAPER, limits)
    body = PlantParameters(5.0, 5.0, 0.0, 0.1)
    x = (values["north_m"], values["east_m"], values["down_m"])
    state = PlantState(x, (values["qw"], values["qx"], values["qy"], values["qz"]))
    memory = UNSTARTED
    sent = [Controls(0.0, 0.0, 0.0, 0.0)] * 5  # 0.09 s is five steps of 0.02 s
    errors = []
    for n in range(301):
        pose = Pose(Vec3(*state.position_ned_m), Quaternion(*state.attitude_wxyz))
        twist = Twist(Vec3(*state.body_rates_frd_rad_s), Vec3(state.speed_m_s, 0.0, 0.0))
        memory, found = guide_step(parameters, memory, pose, twist, sample(Helix(), 0.02 * n), 0.02)
        errors.append(norm(found.e))
        sent.append(found.controls)
        u = sent.pop(0)
        state = step(body, state, PlantCommand((u.u1, u.u2, u.u3), u.u4), 0.02)
        carried = [
            at + 0.02 * values[f"wind_{axis}_m_s"]
            for at, axis in zip(state.position_ned_m, ("north", "east", "down"), strict=True)
        ]
        state = state._replace(position_ned_m=(carried[0], carried[1], carried[2]))
    assert errors[0] == pytest.approx(outcome(outcomes, "start_error_m")[0], abs=1e-12)
    assert errors[-1] == pytest.approx(outcome(outcomes, "final_error_m")[0], abs=1e-9)
    tail = np.array(errors[225:])
    assert math.sqrt(np.mean(tail**2)) == pytest.approx(outcome(outcomes, "rms_m")[0], abs=1e-9)


def test_a_wind_that_the_law_does_not_know_of_leaves_wind_over_lambda_k() -> None:
    # e' = -lambda k e + w once aligned; the turn of the reference, by which the nose lags, adds a little.
    plan = Plan(flights=20, wind_m_s=(0.05, 0.05), k=(2.0, 2.0), duration_s=60.0, within_m=0.2)
    _, outcomes = fly_range(plan, 0, plan.flights)
    assert np.all(np.isfinite(outcome(outcomes, "settled_s")))
    assert np.all(outcome(outcomes, "rms_m") > 0.025)
    assert np.all(outcome(outcomes, "rms_m") < 0.025 * 1.25)


def test_times_say_when_the_error_was_below_the_radius_first_and_for_good() -> None:
    plan = Plan(flights=8, within_m=5.0, law="global", delay_s=(0.3, 0.3), duration_s=20.0, k=(2.0, 2.0))
    _, outcomes = fly_range(plan, 0, plan.flights)
    entered, settled = outcome(outcomes, "entered_s"), outcome(outcomes, "settled_s")
    came = np.isfinite(settled)
    assert came.sum() >= 4
    assert np.all(settled[came] >= entered[came])
    excursion = outcome(outcomes, "excursion_m")
    assert np.all((settled > entered) == (excursion >= 5.0), where=came)
    # Below the radius from the start is 0 s; never is NaN.
    near = fly_range(replace(plan, distance_m=(0.0, 0.1), within_m=50.0), 0, 4)[1]
    assert_array_equal(outcome(near, "entered_s"), 0.0)
    assert_array_equal(outcome(near, "settled_s"), 0.0)
    short = fly_range(replace(plan, distance_m=(40.0, 50.0), duration_s=1.0), 0, 4)[1]
    assert np.all(np.isnan(outcome(short, "entered_s")))
    assert np.all(np.isnan(outcome(short, "settled_s")))
    assert np.all(np.isnan(outcome(short, "excursion_m")))


def test_hard_starts_are_as_hard_as_their_names() -> None:
    reference = sample(Helix(), 0.0)
    gains = Gains(1.0, 10.0, 10.0, 1.0)
    seen = set()
    for start in hard_starts():
        field = desired_field(gains, start.position_ned_m, reference).Xr
        b1, b2, b3 = body_axes(start.attitude)
        y = (dot(b1, field), dot(b2, field), dot(b3, field))
        kind = start.name.split(",")[0]
        seen.add(kind)
        if kind == "exactly opposite":
            assert y[0] < 0.0
            assert y[1] == y[2] == 0.0
        elif kind == "field zero":
            assert norm(field) == 0.0
        elif kind == "field orthogonal":
            assert abs(y[0]) < 1e-12 * norm(field)
        elif "away" in start.name or kind == "ahead on the tangent":
            assert y[0] < 0.0
    assert seen >= {"exactly opposite", "field zero", "field orthogonal", "ahead on the axis"}


def test_in_the_table_global_converges_from_everywhere_and_paper_without_reverse_does_not() -> None:
    found = {}
    for plan in table(flights=200):
        result = run(plan, threads=1)
        found[plan.name] = summary(result)
    for name, figures in found.items():
        assert figures["not_finite"] == 0
        if "forward only" in name:
            assert 0.2 < figures["converged"] < 0.8
            assert figures["not_converged"]
        else:
            assert figures["converged"] == 1.0, name
            assert figures["not_converged"] == []
    everywhere = found["global, random"]
    assert everywhere["flights"] == 200
    assert everywhere["in_time"] == 1.0
    assert found["global, hard starts"]["in_time"] == 1.0
    assert found["global, reference at 0.9 v_max"]["flights"] == 20


def synthetic() -> Result:
    """Four flights: one that settled at 5 s, one at 25 s, one that left again, one that never came."""
    outcomes = np.zeros((4, len(OUTCOMES)))
    columns = {
        "entered_s": [5.0, 5.0, 5.0, np.nan],
        "settled_s": [5.0, 25.0, np.nan, np.nan],
        "final_error_m": [0.001, 0.002, 1.0, 40.0],
        "excursion_m": [0.009, 0.5, 2.0, np.nan],
        "finite": [1.0, 1.0, 1.0, 1.0],
        "start_error_m": [1.0, 10.0, 20.0, 40.0],
        "start_heading_error_rad": [0.0, 1.0, 2.0, math.pi],
    }
    for name, values in columns.items():
        outcomes[:, OUTCOMES.index(name)] = values
    return Result(Plan(flights=4), {"north_m": np.arange(4.0)}, outcomes)


def test_the_summary_counts_what_converged_what_was_in_time_and_what_left() -> None:
    found = summary(synthetic())
    assert found["converged"] == 0.5
    assert found["in_time"] == 0.25
    assert found["entered"] == 0.75
    assert found["left"] == 0.25
    assert found["not_converged"] == [2, 3]
    assert found["settled_s"]["median"] == 15.0
    assert found["settled_s"]["max"] == 25.0
    assert found["final_error_m"]["max"] == 40.0
    assert found["excursion_m"]["max"] == 2.0
    json.dumps(found, allow_nan=False)


def test_a_file_holds_the_plan_and_a_value_per_flight(tmp_path: Path) -> None:
    path = tmp_path / "campaign.npz"
    result = run(SMALL, threads=1)
    save([result, replace(synthetic(), plan=replace(SMALL, name="other, with / in it", flights=4))], path)
    found = load(path)
    assert set(found) == {"campaign", "other, with / in it"}
    assert json.loads(str(found["campaign"]["plan"]))["seed"] == 7
    assert_array_equal(found["campaign"]["settled_s"], result.outcome("settled_s"))
    assert found["campaign"]["k"].shape == (50,)
    assert "beta" not in found["campaign"]


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"flights": 0}, "flights must be a whole number from 1"),
        ({"seed": -1}, "seed must be a whole number from 0"),
        ({"law": "pid"}, "law must be one of paper, global, not 'pid'"),
        ({"allocation": "yaw"}, "allocation must be one of"),
        ({"k": (0.0, 1.0)}, "k must be above 0"),
        ({"k": (-1.0, 1.0)}, "k must be above 0"),
        ({"rho2_per_s": (math.nan, 1.0)}, "rho2_per_s must be above 0"),
        ({"beta": (1.0, math.inf)}, "beta must be above 0"),
        ({"rate_max_rad_s": (5.0, 4.0)}, "rate_max_rad_s must be LOWEST:HIGHEST, not 5:4"),
        ({"speed_min_m_s": (0.0, 6.0)}, "speed_min_m_s must not exceed speed_max_m_s"),
        ({"delay_s": (0.0, 10.0), "step_s": 0.001}, "delay_s must be at most 500 steps"),
        ({"step_s": 0.0}, "step_s must be at least 1e-05"),
        ({"duration_s": 0.01}, "duration_s must be at least"),
        ({"within_m": -0.1}, "within_m must be above 0"),
        ({"acceleration_m_s2": 0.0}, "acceleration_m_s2 must be above 0"),
        ({"turn_acceleration_rad_s2": math.nan}, "turn_acceleration_rad_s2 must be above 0"),
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
def test_a_plan_that_cannot_be_is_refused_with_key_and_reason(
    change: dict[str, object], complaint: str
) -> None:
    with pytest.raises(ValueError, match="^" + complaint.replace("(", r"\(")):
        replace(SMALL, **change)  # type: ignore[arg-type]


def command(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["sitl", "campaign", *arguments])
    with pytest.raises(SystemExit) as exit_:
        cli.main()
    assert isinstance(exit_.value.code, int)
    return exit_.value.code


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--k", "-1"], "k must be above 0"),
        (["--k", "one"], "k must be a number or LOWEST:HIGHEST, not 'one'"),
        (["--wind", "nan"], "wind_m_s must be at least 0"),
        (["--law", "pid"], "law must be one of"),
        (["--preset", "chair"], "preset must be one of table, not 'chair'"),
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


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_c_loop_of_the_benchmark_flies_the_same_flights() -> None:
    plan = replace(PLAN, flights=100)
    starts, outcomes = fly_range(plan, 0, plan.flights)
    try:
        loop = c_loop()
    except UnavailableError as reason:
        pytest.skip(str(reason))
    assert difference(outcomes, loop(plan, starts[:, :8], 2)) < 1e-9
    other = replace(plan, k=(1.001, 1.001))
    assert difference(outcomes, loop(other, starts[:, :8], 2)) > 1e-6
