"""From answers to configuration lines: the rules, and that what they propose is accepted and flies."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from io import StringIO
from math import inf
from pathlib import Path

import pytest
from numpy.testing import assert_allclose
from rich.console import Console

from guidance.config import load
from guidance.tune.answer import Answer, Form
from guidance.tune.excitation import ground_runs
from guidance.tune.fitting import Errors, Spread
from guidance.tune.identify import Identified, Refused, identified
from guidance.tune.propose import Known, Line, Results, airplane_lines, copter_lines, ground_lines, toml
from guidance.tune.report import as_json, show
from sitl.models.files import load_rover
from sitl.scenarios import rover
from sitl.scenarios.table import fly_row, in_words
from tests.steps_flown import driven
from tests.test_tune_identify import GROUND

SHIPPED = Path(__file__).parent.parent / "deploy" / "ardupilot-rover.toml"
KNOWN = Known(5.0, 2.0, 0.9, 5.0)


def seen(answer: Answer, step: float) -> Identified:
    delay, gain = answer.delay_s, answer.gain
    spread = Spread((delay - 0.01, delay + 0.01), (gain - 0.01, gain + 0.01), 4)
    return Identified(answer, Errors(0.001, 0.01, 0.1, 0.01), spread, 0.01, 0.01, step)


YAW = seen(Answer(Form.ONE_LAG, 0.07, 0.93, 0.0, inf, 0.054), 1.0)
SPEED = seen(Answer(Form.LED, 0.1, 1.0, 0.0, 1.0, 0.75, 0.667, 0.8), 1.2)


def by_key(lines: tuple[Line, ...]) -> dict[str, float | str]:
    return {f"{line.table}.{line.key}": line.value for line in lines}


def test_ground_rules() -> None:
    lines = by_key(ground_lines({"yaw_rate_rad_s": YAW, "speed_m_s": SPEED}, KNOWN))
    # rho 0.5/(0.07 + 0.054); k 0.5/(0.1 + 0.5 - 0.05): delay, slewing to 1 m/s, lag and lead
    assert lines == {
        "link.actuation_delay_s": 0.124,
        "law.k": 0.9,
        "law.rho2_per_s": 4.0,
        "law.rho3_per_s": 4.0,
        "law.error_function.name": "bounded",
        "law.error_function.approach_m_s": 4.0,
        "limits.acceleration_max_m_s2": 0.95,
        "ground.yaw_gain": 0.93,
        "ground.crawl_m_s": 1.8,
        "ground.speed_lag_s": 0.45,
    }


def test_a_slew_limit_lowers_rho_and_is_told_to_the_law() -> None:
    slewing = YAW._replace(answer=YAW.answer._replace(slew=1.0, tau_s=0.001))
    lines = by_key(ground_lines({"yaw_rate_rad_s": slewing}, KNOWN))
    # a change by 0.3 of 0.93 rad/s takes 0.28 s, 0.14 on average
    assert lines["law.rho3_per_s"] == 2.3
    assert lines["limits.yaw_acceleration_max_rad_s2"] == 1.0
    assert "law.k" not in lines


def test_a_wrong_map_from_thrust_to_speed_is_put_right() -> None:
    slow = SPEED._replace(answer=SPEED.answer._replace(gain=0.7))
    assert by_key(ground_lines({"speed_m_s": slow}, KNOWN))["vehicle.speed_at_full_thrust_m_s"] == 3.5
    unsure = slow._replace(errors=slow.errors._replace(gain=0.11))
    assert "vehicle.speed_at_full_thrust_m_s" not in by_key(ground_lines({"speed_m_s": unsure}, KNOWN))


def test_airplane_rules() -> None:
    bank = seen(Answer(Form.TWO_LAGS, 0.1, 0.98, 0.0, 2.0, 0.3, 0.1), 0.7)
    lines = by_key(airplane_lines({"roll_rad": bank}))
    assert lines == {
        "link.actuation_delay_s": 0.1,
        "airplane.bank_lag_s": 0.5,
        "law.rho2_per_s": 0.7,
        "law.rho3_per_s": 0.7,
        "law.k": 0.23,
        "limits.roll_rate_max_rad_s": 1.4,
    }
    config = load(SHIPPED.with_name("px4-plane.toml"), [f"{key}={value}" for key, value in lines.items()])
    assert config.law.rho3_per_s == 0.7
    quick = bank._replace(answer=bank.answer._replace(tau_s=0.05))
    assert by_key(airplane_lines({"roll_rad": quick}))["law.rho3_per_s"] == 1.4


def test_copter_rules_take_the_slower_axis() -> None:
    north = seen(Answer(Form.ONE_LAG, 0.1, 1.0, 0.0, 2.5, 0.3), 2.0)
    east = seen(Answer(Form.ONE_LAG, 0.2, 1.0, 0.0, inf, 0.6), 2.0)
    lines = by_key(copter_lines({"north_m_s": north, "east_m_s": east}, KNOWN))
    assert lines["link.actuation_delay_s"] == 0.2
    assert lines["law.k"] == 0.62
    settings = [f"{key}={value}" for key, value in lines.items()]
    assert load(SHIPPED.with_name("px4-copter.toml"), settings).law.k == 0.62
    assert lines["limits.acceleration_max_m_s2"] == 2.2
    assert "law.rho3_per_s" not in lines


def test_a_velocity_that_the_autopilot_shapes_is_not_later_than_its_yaw() -> None:
    shaped = seen(Answer(Form.ONE_LAG, 0.31, 1.0, 0.0, 2.3, 0.4), 2.0)
    lines = by_key(copter_lines({"north_m_s": shaped, "yaw_rate_rad_s": YAW}, KNOWN))
    assert lines["link.actuation_delay_s"] == 0.07
    assert "link.actuation_delay_s" not in by_key(copter_lines({"north_m_s": shaped}, KNOWN))


@pytest.mark.parametrize("lines", [ground_lines, copter_lines])
def test_what_was_refused_gives_no_line(lines: object) -> None:
    assert callable(lines)
    nothing: Results = {"yaw_rate_rad_s": Refused("no motion"), "speed_m_s": Refused("no motion")}
    proposed = {line.table for line in lines(nothing, KNOWN)}
    assert proposed <= {"law.error_function"}
    assert airplane_lines(nothing) == ()


def test_every_line_has_a_reason_with_numbers() -> None:
    for line in ground_lines({"yaw_rate_rad_s": YAW, "speed_m_s": SPEED}, KNOWN):
        assert len(line.why) > 15
        assert "\n" not in line.why


def test_toml_is_toml() -> None:
    lines = ground_lines({"yaw_rate_rad_s": YAW, "speed_m_s": SPEED}, KNOWN)
    parsed = tomllib.loads(toml(lines))
    assert parsed["law"]["error_function"] == {"name": "bounded", "approach_m_s": 4.0}
    assert parsed["ground"]["yaw_gain"] == 0.93
    assert toml(lines).count("\n# ") == len(lines)


def test_a_rover_flies_what_its_own_steps_propose() -> None:
    """Steps with noise, identified, proposed, accepted by the configuration: the tasks are held."""
    model = load_rover("rover")
    results = {
        run.channel: identified(driven(model, run).measurement) for run in ground_runs(GROUND["rover"])
    }
    lines = ground_lines(results, Known(5.0, 2.09, 0.9, 5.0))
    settings = [f"{key}={value}" for key, value in by_key(lines).items()]
    for row in rover.rows()[:2]:
        task = replace(row.task, settings=(*row.task.settings, *settings))
        result = fly_row(replace(row, task=task), seeds=1)
        assert not result.missed, in_words(result)


def test_report_as_text_and_as_json() -> None:
    yaw = YAW._replace(answer=YAW.answer._replace(slew=1.95))
    results: Results = {"yaw_rate_rad_s": yaw, "speed_m_s": Refused("no motion: [nothing] moved"), "x": SPEED}
    lines = ground_lines(results, KNOWN)
    out = StringIO()
    show(results, lines, Console(file=out, width=120))
    text = out.getvalue()
    assert "yaw_rate_rad_s  one lag  0.070 ±0.001  0.930 ±0.010  1.95 ±0.10" in text
    assert "speed_m_s: not identified: no motion: [nothing] moved" in text
    assert "rho3_per_s = " in text
    data = json.loads(json.dumps(as_json(results, lines), allow_nan=False))
    assert data["channels"]["speed_m_s"] == {"refused": "no motion: [nothing] moved"}
    assert data["channels"]["yaw_rate_rad_s"]["answer"]["slew"] == 1.95
    assert as_json({"y": YAW}, ())["channels"]["y"]["answer"]["slew"] is None
    assert data["proposals"][0]["key"] == "actuation_delay_s"
    assert tomllib.loads(data["toml"])["link"]["actuation_delay_s"] == 0.124
    assert_allclose(data["channels"]["x"]["overshoot"], 0.27, atol=0.05)
