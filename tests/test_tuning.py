"""[law] and [limits]: what they become, and what is refused with key and reason."""

from __future__ import annotations

from itertools import pairwise
from math import inf

import pytest

from guidance import error_function
from guidance.config import Config, ConfigError, from_json, parse, to_json
from guidance.law import GLOBAL, PAPER, REST, UNSTARTED, Parameters, guide_step
from guidance.records import Setpoint
from guidance.se3 import ZERO, Vec3
from guidance.tuning import LEAST_GAIN, MOST_GAIN, parameters
from tests.helpers import DEMO, ROVER, fly_until_tracking, make_config, make_flight, records_of
from tests.strategies import facing

TEXT = DEMO.read_text(encoding="utf-8")


def law_of(config: Config, origin: Vec3 = ZERO) -> Parameters:
    return parameters(config.law, config.limits, origin)


def refusal(*overrides: str, text: str = TEXT) -> str:
    """What the operator is told; the test fails if nothing is refused."""
    with pytest.raises(ConfigError) as caught:
        parse(text, "flight.toml", overrides)
    return str(caught.value)


def test_what_is_not_chosen_is_the_papers() -> None:
    p = law_of(make_config())
    assert (p.law, p.allocation, p.error_function) == (PAPER, 0, error_function.PAPER)
    assert p.limits[5:] == (True, inf, inf, inf, inf)


def test_an_error_function_is_one_table_of_the_file() -> None:
    text = f'{TEXT}\n[law.error_function]\nname = "bounded-apart"\nhorizontal_m_s = 2.0\nvertical_m_s = 0.5\n'
    assert law_of(parse(text, "")).error_function == error_function.bounded_apart(2.0, 0.5)
    # naming another forgets the first one's keys
    other = parse(text, "", ["law.error_function.name=bounded", "law.error_function.approach_m_s=3"])
    assert law_of(other).error_function == error_function.bounded(3.0)
    assert (
        law_of(parse(text, "", ["law.error_function.name=quadratic"])).error_function == error_function.PAPER
    )


def test_the_centre_of_k_of_r_moves_with_the_trajectory() -> None:
    table = [f"law.error_function.{s}" for s in ("name=k-of-r", "gain=0.5", "width_m=3", "east_m=2")]
    config = make_config(*table)
    expected = error_function.k_of_r(0.5, 3.0, Vec3(10.0, 22.0, 30.0))
    assert law_of(config, Vec3(10.0, 20.0, 30.0)).error_function == expected
    assert from_json(to_json(config)) == config


def test_law_and_limits_become_parameters() -> None:
    p = law_of(
        make_config(
            "law.name=global",
            "law.allocation=roll-yaw",
            "limits.keep_direction=false",
            "limits.acceleration_max_m_s2=1",
            "limits.roll_acceleration_max_rad_s2=2",
            "limits.pitch_acceleration_max_rad_s2=3",
            "limits.yaw_acceleration_max_rad_s2=4",
        )
    )
    assert (p.law, p.allocation) == (GLOBAL, 2)
    assert p.limits[5:] == (False, 1.0, 2.0, 3.0, 4.0)


def test_in_flight_setpoints_change_no_faster_than_they_may_and_from_what_was_measured() -> None:
    flight = make_flight(
        "law.name=global",
        "limits.acceleration_max_m_s2=1",
        "limits.pitch_acceleration_max_rad_s2=3",
        "limits.yaw_acceleration_max_rad_s2=3",
    )
    fly_until_tracking(flight)
    flight.run(12.0)
    sent = [s for s in records_of(flight, Setpoint) if not s.neutral]
    assert len(sent) > 500
    assert sent[0].speed_m_s < 0.1  # it stood
    assert max(s.speed_m_s for s in sent) > 4.0
    for before, after in pairwise(sent):
        dt_s = (after.t_ns - before.t_ns) * 1e-9
        assert abs(after.speed_m_s - before.speed_m_s) <= 1.0 * dt_s + 1e-9
        for axis in (1, 2):
            change = after.body_rates_frd_rad_s[axis] - before.body_rates_frd_rad_s[axis]
            assert abs(change) <= 3.0 * dt_s + 1e-9


SPEED = "must be a number from 0.001 to 1000"
GAIN = "must be a number from 1e-06 to 1e+06"
ACCELERATION = "must be a number from 0.001 to 1e+06"


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["law.name=globl"], 'law.name = "globl": must be "paper" or "global"'),
        (
            ["law.allocation=roll"],
            'law.allocation = "roll": must be "pitch-yaw", "roll-pitch" or "roll-yaw"',
        ),
        (["law.error_function=3"], "law.error_function = 3: must be a table, [law.error_function]"),
        (
            ["law.error_function.name=bound"],
            'law.error_function.name = "bound": must be "quadratic", "k-of-r", "bounded" or "bounded-apart" '
            "(did you mean bounded?)",
        ),
        (
            ["law.error_function.name=bounded"],
            f"law.error_function.approach_m_s is missing: there is no default; {SPEED}",
        ),
        *(
            (
                ["law.error_function.name=bounded", f"law.error_function.approach_m_s={value}"],
                f"law.error_function.approach_m_s = {shown}: {SPEED}",
            )
            for value, shown in (("0", "0"), ("-1", "-1"), ("nan", "nan"), ("inf", "inf"), ("a", '"a"'))
        ),
        (
            [
                "law.error_function.name=bounded-apart",
                "law.error_function.horizontal_m_s=1",
                "law.error_function.vertical_m_s=-0.5",
            ],
            f"law.error_function.vertical_m_s = -0.5: {SPEED}",
        ),
        (
            ["law.error_function.name=k-of-r", "law.error_function.gain=-1", "law.error_function.width_m=1"],
            "law.error_function.gain = -1: must be a number above -1 and of at most 1000",
        ),
        (
            ["law.error_function.name=k-of-r", "law.error_function.gain=1", "law.error_function.width_m=0"],
            "law.error_function.width_m = 0: must be a number from 0.01 to 100000",
        ),
        (
            ["law.error_function.name=k-of-r", "law.error_function.gain=60", "law.error_function.width_m=1"],
            "law.error_function.gain = 60.0: (1 + gain) k / beta times the period of link.rate_hz = 50 is",
        ),
        (
            ["limits.yaw_acceleration_max_rad_s2=0"],
            f"limits.yaw_acceleration_max_rad_s2 = 0: {ACCELERATION}",
        ),
        (
            ["limits.acceleration_max_m_s2=inf"],
            f"limits.acceleration_max_m_s2 = inf: {ACCELERATION}",
        ),
        (["limits.keep_direction=1"], "limits.keep_direction = 1: must be true or false"),
        *(
            ([f"{key}={value}"], f"{key} = {shown}: {said}")
            for key, said in (
                ("law.k", GAIN),
                ("law.beta", GAIN),
                ("law.rho2_per_s", GAIN),
                ("law.rho3_per_s", GAIN),
                ("limits.acceleration_max_m_s2", ACCELERATION),
                ("limits.pitch_acceleration_max_rad_s2", ACCELERATION),
                ("limits.speed_max_m_s", SPEED),
                ("vehicle.speed_at_full_thrust_m_s", SPEED),
                ("trajectory.speed_m_s", SPEED),
                ("limits.yaw_rate_max_rad_s", "must be a number from 0.001 to 100"),
            )
            for value, shown in (("1e-200", "1e-200"), ("2e6", "2000000.0"))
        ),
        (["limits.pitch_rate_max_rad_s=101"], "= 101: must be a number from 0 to 100"),
        (["limits.speed_min_m_s=-1e200"], "= -1e+200: must be a number from -1000 to 1000"),
        *(
            (
                [f"limits.pitch_rate_max_rad_s={value}"],
                f'law.allocation = "pitch-yaw": limits.pitch_rate_max_rad_s = {value} leaves it without that '
                "rate: must be at least 0.001",
            )
            for value in ("0", "1e-200")
        ),
        (
            ["law.allocation=roll-pitch", "limits.roll_rate_max_rad_s=0"],
            'law.allocation = "roll-pitch": limits.roll_rate_max_rad_s = 0 leaves it without that rate',
        ),
        (
            ["law.allocation=roll-pitch", "limits.pitch_rate_max_rad_s=0"],
            'law.allocation = "roll-pitch": limits.pitch_rate_max_rad_s = 0 leaves it without that rate',
        ),
    ],
)
def test_a_wrong_choice_is_refused_with_key_and_reason(overrides: list[str], said: str) -> None:
    message = refusal(*overrides)
    assert said in message
    assert "\n" not in message


def test_a_wrong_value_in_the_file_is_named_with_its_line() -> None:
    text = f'{TEXT}\n[law.error_function]\nname = "bounded"\napproach_m_s = 0\n'
    line = text.splitlines().index("approach_m_s = 0") + 1
    assert refusal(text=text) == f"flight.toml:{line}: law.error_function.approach_m_s = 0: {SPEED}"
    nameless = f"{TEXT}\n[law.error_function]\napproach_m_s = 1\n"
    assert "law.error_function.name is missing: must be" in refusal(text=nameless)


@pytest.mark.parametrize("roll_rate", [0, 1])
def test_a_planar_profile_refuses_to_turn_by_rolling(roll_rate: int) -> None:
    said = 'law.allocation = "roll-yaw": ardupilot-rover is planar and cannot roll; must be "pitch-yaw"'
    overrides = (*ROVER, f"limits.roll_rate_max_rad_s={roll_rate}")
    assert refusal(*overrides, "law.allocation=roll-yaw") == f"--set law.allocation=roll-yaw: {said}"
    text = TEXT.replace("[law]\n", '[law]\nallocation = "roll-yaw"\n')
    line = text.splitlines().index('allocation = "roll-yaw"') + 1
    assert refusal(*overrides, text=text) == f"flight.toml:{line}: {said}"


def test_a_planar_vehicle_turns_by_yaw_alone() -> None:
    config = make_config(*ROVER, "limits.pitch_rate_max_rad_s=0", "limits.pitch_acceleration_max_rad_s2=0.1")
    assert config.limits.pitch_rate_max_rad_s == 0.0
    assert law_of(config).limits.pitch_acceleration_rad_s2 == 0.1
    in_the_plane = parameters(config.law, config.limits, ZERO, planar=True)
    assert in_the_plane.limits == law_of(config).limits._replace(pitch_acceleration_rad_s2=inf)
    sent = []
    for pitch in ("2", "0.001"):
        flight = make_flight(*ROVER, "law.name=global", f"limits.pitch_acceleration_max_rad_s2={pitch}")
        fly_until_tracking(flight)
        flight.run(1.0)
        sent.append([s.body_rates_frd_rad_s for s in records_of(flight, Setpoint)])
    assert sent[0] == sent[1]
    assert any(yaw_rate != 0.0 for _, _, yaw_rate in sent[0])


@pytest.mark.parametrize("law", ["paper", "global"])
@pytest.mark.parametrize("gain", [LEAST_GAIN, MOST_GAIN])
def test_from_the_least_to_the_most_only_k_over_beta_matters(law: str, gain: float) -> None:
    pose, reference = facing(0.6, 1.0)
    pose = pose._replace(position=Vec3(1.0, -2.0, 3.0))
    same, expected = (
        guide_step(law_of(make_config(f"law.name={law}", *scale)), UNSTARTED, pose, REST, reference, 0.02)[1]
        for scale in ((f"law.k={gain}", f"law.beta={gain}"), ())
    )
    assert same.demanded == pytest.approx(expected.demanded, rel=1e-9)
    assert abs(same.demanded.u2) > 0.1
