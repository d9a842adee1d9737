"""Campaigns of vehicles: the handling that flies, compiled, with what is wrong drawn by the seed."""

from __future__ import annotations

import json
import math
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from guidance.prediction import NOTHING_SENT, predict, sent
from guidance.se3 import Pose, Twist, Vec3, from_yaw
from sitl import airplane_flight, cli, rover_flight
from sitl.campaign.judging import judged
from sitl.campaign.report import summary
from sitl.campaign.run import Result, fly_range, load, run
from sitl.campaign.vehicle_draw import drawn
from sitl.campaign.vehicle_flights import DEPLOY, Airplane, Rover, vehicle_of
from sitl.campaign.vehicle_plan import DRAWN, OUTCOMES, PARAMETERS, VehiclePlan, changed, read_plan
from sitl.campaign.vehicle_presets import airplane, rover
from sitl.scenarios import flight as lockstep
from sitl.scenarios import rover as tasks

pytestmark = pytest.mark.timeout(180)  # the first of these compiles, and other work may keep the machine busy

ROOT: Final = Path(__file__).parents[1]
ROVER: Final = changed(rover(6, seed=5)[0], {"duration_s": 8.0})
AIRPLANE: Final = changed(airplane(4, seed=5)[0], {"duration_s": 6.0})
#: Nothing is wrong, but for the estimator's noise.
RIGHT: Final = {
    **dict.fromkeys(PARAMETERS, 0.0),
    **dict.fromkeys(("gain", "power", "slew", "noise"), 1.0),
    "right_m": 2.0,
}


def draws(plan: VehiclePlan, count: int) -> list[dict[str, float]]:
    return [dict(zip(PARAMETERS, row, strict=True)) for row in drawn(plan, 0, count)]


def test_a_compiled_drive_is_the_interpreted_one() -> None:
    vehicle = vehicle_of(ROVER)
    for i, draw in enumerate(draws(ROVER, 3)):
        ours = vehicle.flown(ROVER, i, draw)
        assert_allclose(ours, vehicle.flown(ROVER, i, draw, rover_flight.fly), rtol=0.0, atol=1e-9)
        assert np.ptp(ours[:, 2]) > 1.0


def test_a_compiled_airplane_is_the_interpreted_one() -> None:
    plan = changed(AIRPLANE, {"duration_s": 2.0})
    vehicle = vehicle_of(plan)
    for i, draw in enumerate(draws(plan, 2)):
        plain = vehicle.flown(plan, i, draw, airplane_flight.fly)
        assert_allclose(vehicle.flown(plan, i, draw), plain, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("count", [0, 1, 3, 40, 66, 200])
def test_the_prediction_is_that_of_the_service(count: int) -> None:
    dice = np.random.default_rng(count)
    history = NOTHING_SENT
    instants, rates = np.zeros(rover_flight.REMEMBERED, np.int64), np.zeros(rover_flight.REMEMBERED)
    for i in range(count):
        rate = float(dice.normal())
        history = sent(history, i * 25_000_000, Vec3(0.0, 0.0, rate))
        instants[i % len(instants)], rates[i % len(rates)] = i * 25_000_000, rate
    pose = Pose(Vec3(1.0, 2.0, 0.0), from_yaw(0.3))
    twist = Twist(Vec3(0.0, 0.0, 0.4), Vec3(2.0, 0.1, 0.0))
    start_ns = max(0, count - 6) * 25_000_000 + 3_000_000
    for until_ns in (start_ns, start_ns + 120_000_000):
        ours = rover_flight.predicted(instants, rates, count, pose, twist, start_ns, until_ns)
        assert ours == predict(history, pose, twist, start_ns, until_ns)


@pytest.mark.parametrize(
    ("settings", "start", "right_m", "off_rad", "power"),
    [
        (tasks.ON_A_CIRCLE, (8.0, 0.0, 0.5 * math.pi), 2.0, 0.0, 1.0),
        (tasks.ON_A_CIRCLE, (8.0, 0.0, 0.5 * math.pi), 2.0, 0.0, 0.7),
        ((*tasks.ON_A_CIRCLE, "link.rate_hz=10"), (8.0, 0.0, 0.5 * math.pi), 2.0, 0.0, 1.0),
        ((*tasks.ON_A_CIRCLE, *tasks.WAITS), (25.0, 0.0, 0.0), -15.0, -0.5 * math.pi, 1.0),
    ],
    ids=["circle", "30 % slower", "10 Hz", "facing away"],
)
def test_a_drive_is_that_of_the_whole_service_in_lockstep(
    settings: tuple[str, ...],
    start: tuple[float, float, float],
    right_m: float,
    off_rad: float,
    power: float,
) -> None:
    """Other noise and other ages of a state, the same figures: 0.4 s, RMS by 40 %, maximum by 5 cm."""
    plan = VehiclePlan(profile="ardupilot-rover", settings=settings, duration_s=25.0)
    found = []
    for i in range(8):
        bias = math.radians(2.0) * (-1.0) ** i
        wrong = {"right_m": right_m, "off_rad": off_rad, "power": power, "heading_bias_rad": bias}
        found.append(outcomes_of(plan, i, {**RIGHT, **wrong}))
    median = {name: float(np.median([each[name] for each in found])) for name in OUTCOMES}
    theirs = lockstep.fly(replace(tasks.task(settings, start, 25.0), speed_part=power))
    assert median["settled_s"] == pytest.approx(theirs.converged_s, abs=0.4)
    assert median["rms_m"] == pytest.approx(theirs.rms_m, rel=0.4)
    assert median["max_m"] == pytest.approx(theirs.max_m, abs=0.05)


def outcomes_of(plan: VehiclePlan, index: int, draw: dict[str, float]) -> dict[str, float]:
    vehicle = vehicle_of(plan)
    record = vehicle.flown(plan, index, draw)
    return dict(zip(OUTCOMES, judged(plan, record, vehicle.columns(), vehicle.dt_s), strict=True))


@pytest.mark.parametrize("plan", [ROVER, AIRPLANE], ids=["rover", "airplane"])
def test_the_same_seed_gives_the_same_numbers_however_it_is_cut(plan: VehiclePlan) -> None:
    rows, outcomes = fly_range(plan, 0, plan.flights)
    result = run(plan, threads=2, chunk=1)
    assert_array_equal(result.outcomes, outcomes)
    for name, values in result.parameters.items():
        assert_array_equal(values, rows[:, PARAMETERS.index(name)])
    assert_array_equal(fly_range(plan, 2, 2)[1], outcomes[2:4])
    other = fly_range(changed(plan, {"seed": 6}), 0, 2)
    assert not np.any(other[0][:, :2] == rows[:2, :2])


def test_what_is_drawn_fills_its_ranges() -> None:
    plan = airplane(4000)[0]
    rows = dict(zip(PARAMETERS, drawn(plan, 0, 4000).T, strict=True))
    rows["wind_m_s"] = np.hypot(rows["wind_north_m_s"], rows["wind_east_m_s"])
    rows["distance_m"] = np.hypot(rows["right_m"], rows["ahead_m"])
    for name in ("gain", "power", "slew", "delay_s", "up_m", "wind_m_s", "distance_m"):
        low, high = getattr(plan, name)
        assert low <= rows[name].min()
        assert rows[name].max() <= high
        assert np.ptp(rows[name]) > 0.98 * (high - low)
    assert np.abs(rows["off_rad"]).max() == pytest.approx(math.pi, abs=0.01)
    assert np.mean(rows["off_rad"]) == pytest.approx(0.0, abs=0.1)
    assert np.mean(rows["right_m"]) == pytest.approx(0.0, abs=5.0)
    assert np.mean(rows["ahead_m"]) == pytest.approx(0.0, abs=5.0)
    assert np.mean(rows["wind_north_m_s"]) == pytest.approx(0.0, abs=0.2)
    assert np.mean(rows["distance_m"] > 150.0 / math.sqrt(2.0)) == pytest.approx(0.5, abs=0.03)
    assert_allclose(rows["gusts_m_s"], 0.16 * rows["wind_m_s"])


@pytest.mark.parametrize("plan", [ROVER, AIRPLANE], ids=["rover", "airplane"])
@pytest.mark.parametrize("name", PARAMETERS)
def test_everything_that_is_drawn_changes_the_flight(plan: VehiclePlan, name: str) -> None:
    vehicle = vehicle_of(plan)
    still = isinstance(vehicle, Rover) and name in ("up_m", "wind_north_m_s", "wind_east_m_s", "gusts_m_s")
    right = {**RIGHT, "off_rad": 0.5}
    # the airplane's gains ask for no more than half of its slew
    wrong = {**right, name: 0.3 if name == "slew" else right[name] + 0.1}
    same = np.array_equal(vehicle.flown(plan, 0, right), vehicle.flown(plan, 0, wrong))
    assert same == still  # a rover's wheels feel no wind


@pytest.mark.parametrize("plan", [ROVER, AIRPLANE], ids=["rover", "airplane"])
def test_each_flight_has_noise_of_its_own(plan: VehiclePlan) -> None:
    vehicle = vehicle_of(plan)
    assert not np.array_equal(vehicle.flown(plan, 0, RIGHT), vehicle.flown(plan, 1, RIGHT))


def test_a_delay_that_is_known_is_predicted_by_what_was_sent() -> None:
    settings = (*tasks.ON_A_CIRCLE, "link.actuation_delay_s=0.3")
    plan = VehiclePlan(profile="ardupilot-rover", settings=settings, duration_s=30.0)
    found = [outcomes_of(plan, i, {**RIGHT, "delay_s": 0.2})["rms_m"] for i in range(4)]
    assert max(found) < 0.036


def test_wind_moves_a_boat() -> None:
    plan = changed(ROVER, {"model": "boat"})
    vehicle = vehicle_of(plan)
    windy = vehicle.flown(plan, 0, {**RIGHT, "wind_north_m_s": 5.0})
    assert not np.array_equal(vehicle.flown(plan, 0, RIGHT), windy)


def test_a_delay_is_never_negative() -> None:
    vehicle = vehicle_of(ROVER)
    assert_array_equal(
        vehicle.flown(ROVER, 0, {**RIGHT, "delay_s": -0.1}),
        vehicle.flown(ROVER, 0, {**RIGHT, "delay_s": -0.5}),
    )


def test_the_shipped_rover_converges_whatever_is_wrong_but_for_half_its_slew() -> None:
    """A yaw rate that changes half as fast as configured, and is overdone as well, ends in a limit cycle."""
    plan = changed(rover(40, seed=3)[0], {"slew": (0.7, 1.5)})
    assert summary(run(plan))["converged"] == 1.0
    weak = {"gain": 1.28, "slew": 0.51, "delay_s": 0.04, "off_rad": -2.9}
    assert math.isnan(outcomes_of(plan, 0, {**RIGHT, **weak})["settled_s"])


def test_both_airplanes_converge_with_nothing_wrong() -> None:
    for plan in airplane():
        found = outcomes_of(plan, 0, {**RIGHT, "right_m": 20.0, "off_rad": 0.5})
        assert found["settled_s"] < 25.0
        assert found["rms_m"] < 0.5
        assert found["airspeed_min_m_s"] > 10.0
        assert found["height_min_m"] > 45.0


def test_what_came_of_a_flight() -> None:
    plan = VehiclePlan(profile="ardupilot-rover", within_m=1.0, settling_s=2.0)
    error = np.array([5.0, 0.5, 3.0, 0.5, 0.4, 0.3, 0.2, 0.6])
    record = np.stack([error, np.array([1.0] * 6 + [1.0, 0.0]), -error, 0.0 * error], axis=1)
    columns = ("error_m", "saturated", "speed_asked_m_s", "stuck")
    found = dict(zip(OUTCOMES, judged(plan, record, columns, 1.0), strict=True))
    assert found["start_error_m"] == 5.0
    assert found["entered_s"] == 1.0
    assert found["settled_s"] == 3.0
    assert found["final_error_m"] == 0.6
    assert found["excursion_m"] == 3.0
    # from step 4 on: the second half, for 3 s + 2 s is later
    assert found["rms_m"] == pytest.approx(math.sqrt((0.16 + 0.09 + 0.04 + 0.36) / 4.0))
    assert found["max_m"] == 0.6
    assert found["saturated"] == 0.75
    assert found["reverse_m_s"] == 5.0
    assert found["finite"] == 1.0
    assert math.isnan(found["airspeed_min_m_s"])

    patient = changed(plan, {"settling_s": 0.0})
    late = dict(zip(OUTCOMES, judged(patient, record, columns, 1.0), strict=True))
    assert late["rms_m"] == pytest.approx(math.sqrt((0.25 + 0.16 + 0.09 + 0.04 + 0.36) / 5.0))

    record[-1, 0] = math.nan
    found = dict(zip(OUTCOMES, judged(plan, record, columns, 1.0), strict=True))
    assert math.isnan(found["settled_s"])
    assert found["entered_s"] == 1.0
    assert found["finite"] == 0.0


def test_flights_are_counted_by_what_became_of_them() -> None:
    ends: list[dict[str, float]] = [
        {"settled_s": 1.0, "entered_s": 1.0},
        {"settled_s": math.nan, "entered_s": 1.0},
        {"settled_s": math.nan, "entered_s": math.nan},
        {"settled_s": 1.0, "entered_s": 1.0, "stuck": 1.0},
        {"settled_s": 1.0, "entered_s": 1.0, "height_min_m": -1.0},
        {"settled_s": 1.0, "entered_s": 1.0, "finite": 0.0},
    ]
    usual = {"finite": 1.0, "rms_m": 0.1, "height_min_m": 50.0}
    rows = np.array([[{**usual, **end}.get(name, 0.0) for name in OUTCOMES] for end in ends])
    plan = VehiclePlan(profile="px4-plane", flights=len(ends))
    gains = np.arange(float(len(ends)))
    found = summary(Result(plan, {"gain": gains}, rows))
    assert found["outcome"] == {
        "not finite": 1,
        "in the ground": 1,
        "stuck": 1,
        "converged": 1,
        "left again": 1,
        "never there": 1,
    }
    assert found["worst"][:2] == [{"flight": 1, "gain": 1.0}, {"flight": 2, "gain": 2.0}]


PLAN_FILE: Final = """\
profile = "ardupilot-rover"
name = "ours"
settings = ["trajectory.name=circle", "trajectory.speed_m_s=1.5"]
flights = 3
duration_s = 5
gain = [0.9, 1.1]
distance_m = [0, 2]
"""


def test_a_plan_file_is_flown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN_FILE)
    plan = read_plan(path)
    assert plan.gain == (0.9, 1.1)
    monkeypatch.chdir(tmp_path)
    assert command(monkeypatch, "--plan", str(path), "--seed", "4", "--within", "2") == 0
    assert "3 flights, 600 steps" in capsys.readouterr().out
    stored = json.loads(str(load(tmp_path / "campaign.npz")["ours"]["plan"]))
    assert (stored["seed"], stored["within_m"], stored["model"]) == (4, 2.0, "rover")
    assert (tmp_path / "campaign.png").stat().st_size > 0


@pytest.mark.parametrize(("preset", "rows"), [("rover", 2), ("airplane", 4)])
def test_a_preset_is_flown(
    preset: str, rows: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(monkeypatch, "--preset", preset, "--flights", "2", "--json") == 0
    campaigns = json.loads(capsys.readouterr().out)["campaigns"]
    assert len(campaigns) == rows
    for each in campaigns:
        assert each["plan"]["flights"] == each["summary"]["flights"] == 2
        assert sum(each["summary"]["outcome"].values()) == 2
        assert len(each["summary"]["worst"]) == 2


def command(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["sitl", "campaign", *arguments])
    with pytest.raises(SystemExit) as exit_:
        cli.main()
    assert isinstance(exit_.value.code, int)
    return exit_.value.code


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("flights = 5", "plan.toml: profile is missing"),
        (PLAN_FILE + "gane = [1, 2]", "plan.toml:8: gane = [1, 2]: "),
        (PLAN_FILE + "slew = [0, 1]", "plan.toml:8: slew = [0, 1]: must be"),
        (PLAN_FILE + "slew = [1.2, 1]", "slew must be [LOWEST, HIGHEST], not [1.2, 1]"),
        (PLAN_FILE + "delay_s = [nan, 1]", "plan.toml:8: delay_s"),
        (PLAN_FILE.replace("ardupilot-rover", "px4-uuv"), "plan.toml:1: profile"),
        (PLAN_FILE + 'model = "airplane_12"', "missing delay_s"),
        (PLAN_FILE + 'configuration = "nowhere.toml"', "nowhere.toml: cannot be read"),
        (PLAN_FILE.replace("speed_m_s=1.5", "speed_m_s=-1"), "trajectory.speed_m_s"),
        (PLAN_FILE.replace("=circle", "=eight"), "a campaign of rovers cannot fly Eight"),
        (PLAN_FILE.replace("speed_m_s=1.5", "stop_at_s=9"), "flies none that stops"),
        (PLAN_FILE.replace("trajectory.speed_m_s=1.5", "link.rate_hz=60"), "link.rate_hz must be 50, 40"),
        ("profile = ", "plan.toml: not valid TOML"),
    ],
)
def test_a_plan_that_cannot_be_flown_is_refused(
    text: str,
    complaint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "plan.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    assert command(monkeypatch, "--plan", "plan.toml") == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert complaint in said.err
    assert "Traceback" not in said.err
    assert [path.name for path in tmp_path.iterdir()] == ["plan.toml"]


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"settings": ("trajectory.name=line", "trajectory.speed_m_s=12")}, "flies circles clockwise"),
        ({"settings": ("trajectory.clockwise=false",)}, "flies circles clockwise"),
        ({"settings": ("trajectory.radius_m=12",)}, "the trajectory: .* needed at t = 0 s"),
        ({"settings": ("airplane.airspeed_cruise_m_s=9",)}, "airspeed"),
        (
            {"configuration": str(DEPLOY / "ardupilot-plane.toml")},
            "profile is ardupilot-plane, and the plan's",
        ),
    ],
)
def test_what_an_airplane_cannot_fly_is_refused(change: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        vehicle_of(VehiclePlan(profile="px4-plane", **change))


def test_options_of_ideal_bodies_do_not_go_with_a_plan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN_FILE)
    assert command(monkeypatch, "--plan", str(path), "--k", "2") == 2
    assert "k is set by the plan" in capsys.readouterr().err
    assert command(monkeypatch, "--plan", str(path), "--preset", "rover") == 2
    assert "preset and plan cannot be given together" in capsys.readouterr().err
    assert command(monkeypatch, "--preset", "rover", "--wind", "2") == 2
    assert "wind_m_s is set by the preset rover" in capsys.readouterr().err


def test_every_pair_of_a_plan_is_checked() -> None:
    pairs = {name for name, value in vars_of(VehiclePlan(profile="px4-plane")).items() if is_pair(value)}
    assert pairs == set(DRAWN)
    assert isinstance(vehicle_of(AIRPLANE), Airplane)


def vars_of(plan: VehiclePlan) -> dict[str, object]:
    return {name: getattr(plan, name) for name in VehiclePlan.__struct_fields__}


def is_pair(value: object) -> bool:
    return isinstance(value, tuple) and len(value) == 2


def test_the_plan_in_the_results_has_every_key_with_its_default(tmp_path: Path) -> None:
    blocks = (ROOT / "docs" / "results.md").read_text(encoding="utf-8").split("```toml\n")[1:]
    text = next(block.split("```")[0] for block in blocks if "off_deg" in block)
    (tmp_path / "plan.toml").write_text(text)
    assert read_plan(tmp_path / "plan.toml") == VehiclePlan(profile="ardupilot-rover")
    assert set(tomllib.loads(text)) == set(VehiclePlan.__struct_fields__)
