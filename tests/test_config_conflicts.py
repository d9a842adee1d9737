"""Settings that are each right and together are not: refused with key, place and what to do."""

from __future__ import annotations

import math
from typing import get_args

import msgspec
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from guidance.checking import one_of
from guidance.config import ConfigError, Locator, Zenoh, from_json, parse, profile_of, to_json
from guidance.feasibility import infeasible
from guidance.mavlink.profiles import PROFILES
from guidance.telemetry.zenoh_sink import zenoh_config
from guidance.trajectory import TRAJECTORIES, Helix, Lemniscate, sample
from guidance.tuning import Bounded
from tests.helpers import DEMO, ROVER, make_config

TEXT = DEMO.read_text(encoding="utf-8")
#: A level turn of 2 rad/s.
TURNING = ("trajectory.name=circle", "trajectory.radius_m=1", "trajectory.speed_m_s=2")


def refusal(*overrides: str, text: str = TEXT) -> str:
    """What the operator is told; the test fails if nothing is refused."""
    with pytest.raises(ConfigError) as caught:
        parse(text, "flight.toml", overrides)
    return str(caught.value)


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["limits.speed_min_m_s=5"], "limits.speed_min_m_s = 5: must be below speed_max_m_s = 5"),
        (["law.rho2_per_s=50"], "rho2_per_s times the period of link.rate_hz = 50 is 1: must be below 1"),
        (["law.rho3_per_s=11", "link.rate_hz=10.5"], "rho3_per_s times the period of link.rate_hz = 10.5 is"),
        (["law.k=5", "law.beta=0.1"], "law.k = 5.0: k / beta times the period of link.rate_hz = 50 is 1"),
        (
            ["trajectory.speed_m_s=6"],
            "speed: 6 m/s needed at t = 0 s (north 0 m, east 1 m), 5 m/s available (limits.speed_max_m_s)",
        ),
        (
            ["trajectory.down_m_s=7"],
            'trajectory.name = "helix": speed: 7 m/s needed',
        ),
        (
            ["trajectory.speed_m_s=4", "trajectory.down_m_s=4"],
            "speed: 5.66 m/s needed at t = 0 s (north 0 m, east 1 m), 5 m/s available "
            "(limits.speed_max_m_s): fly at most 5 m/s there",
        ),
        (["vehicle.speed_at_full_thrust_m_s=0.05"], "0.05 m/s available (vehicle.speed_at_full_thrust_m_s)"),
        (
            ["limits.speed_min_m_s=0.5", "law.name=global"],
            "speed: 0.141 m/s needed at t = 0 s (north 0 m, east 1 m), at least 0.5 m/s available "
            "(limits.speed_min_m_s): fly at least 0.5 m/s there",
        ),
        (["limits.speed_min_m_s=0"], 'limits.speed_min_m_s = 0: the law "paper" reverses'),
        (
            ["limits.speed_min_m_s=0.1"],
            'set law.name = "global", which only goes forward, or below -0.141, the trajectory\'s speed: '
            "reverse has to be as fast as it",
        ),
        (
            ["limits.speed_min_m_s=0", "trajectory.name=circle", "trajectory.speed_m_s=2"],
            "or below -2, the trajectory's speed",
        ),
        (
            ["trajectory.radius_m=0.01", "trajectory.speed_m_s=0.4"],
            "turn: 38.8 rad/s needed at t = 0 s (north 0 m, east 0.01 m), 7.0711 rad/s available "
            "(limits.pitch_rate_max_rad_s, limits.yaw_rate_max_rad_s): fly at most",
        ),
        (
            [*TURNING, "law.allocation=roll-pitch", "limits.pitch_rate_max_rad_s=1"],
            "turn: 2 rad/s needed at t = 0 s (north 1 m, east 0 m), 1 rad/s available "
            "(limits.pitch_rate_max_rad_s): fly at most 1 m/s there, or a radius of at least 2 m",
        ),
        (
            [*TURNING, "law.allocation=roll-yaw", "limits.yaw_rate_max_rad_s=1"],
            "turn: 2 rad/s needed at t = 0 s (north 1 m, east 0 m), 1 rad/s available (limits.yaw_rate_max",
        ),
        (
            [*ROVER, *TURNING, "limits.yaw_rate_max_rad_s=1", "limits.pitch_rate_max_rad_s=9"],
            "yaw rate: 2 rad/s needed at t = 0 s (north 1 m, east 0 m), 1 rad/s available "
            "(limits.yaw_rate_max_rad_s): fly at most 1 m/s there, or a radius of at least 2 m",
        ),
        (["trajectory.name=zigzag", "trajectory.speed_m_s=4"], "speed: 5.66 m/s needed"),
        (
            ["trajectory.name=lemniscate", "limits.acceleration_max_m_s2=0.01"],
            "change of speed: 0.065 m/s^2 needed at t = 7.55 s (north ",
        ),
        (
            ["trajectory.name=lemniscate", "limits.acceleration_max_m_s2=0.01"],
            "0.01 m/s^2 available (limits.acceleration_max_m_s2): fly at most 0.",
        ),
        (
            [*ROVER, "trajectory.name=lemniscate", "limits.yaw_acceleration_max_rad_s2=0.01"],
            "change of yaw rate: ",
        ),
        (
            [*ROVER, "trajectory.name=circle", "trajectory.radius_m=1", "ground.turning_radius_m=1.5"],
            "radius: 1 m needed at t = 0 s (north 1 m, east 0 m), at least 1.5 m available "
            "(ground.turning_radius_m): a radius of at least 1.5 m",
        ),
        (
            [*ROVER, "trajectory.name=circle", "trajectory.stop_at_s=20", "limits.acceleration_max_m_s2=0.3"],
            "take at least 5 s to stop (trajectory.stop_over_s)",
        ),
        (
            [
                "trajectory.name=line",
                "trajectory.stop_at_s=20",
                "law.name=global",
                "limits.speed_min_m_s=0.1",
            ],
            "at least 0.1 m/s available (limits.speed_min_m_s): leave out trajectory.stop_at_s",
        ),
        (
            ["law.error_function.name=bounded", "law.error_function.approach_m_s=5.1"],
            "law.error_function.approach_m_s = 5.1: the vehicle moves at most at 5 m/s "
            "(limits.speed_max_m_s)",
        ),
        *(
            (
                [
                    "law.error_function.name=bounded-apart",
                    "vehicle.speed_at_full_thrust_m_s=3",
                    f"law.error_function.{slow}=3",
                    f"law.error_function.{fast}=3.5",
                ],
                f"law.error_function.{fast} = 3.5: the vehicle moves at most at 3 m/s",
            )
            for slow, fast in (
                ("horizontal_m_s", "vertical_m_s"),
                ("vertical_m_s", "horizontal_m_s"),
            )
        ),
    ],
)
def test_settings_that_contradict_each_other_are_refused(overrides: list[str], said: str) -> None:
    message = refusal(*overrides)
    assert said in message
    assert "\n" not in message


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_a_trajectory_at_the_very_limit_of_speed_is_not_refused(name: str) -> None:
    speed = {"zigzag": 5.0 / math.sqrt(2.0), "helix": 3.0}.get(name, 5.0)
    settings = [f"trajectory.name={name}", f"trajectory.speed_m_s={speed!r}"]
    if name == "helix":
        settings.append("trajectory.down_m_s=-4")
    assert make_config(*settings).trajectory.speed_m_s == speed
    assert "speed: 5 m/s needed" in refusal(*settings, "limits.speed_max_m_s=4.9999")


#: Longer than ten minutes, a turn of a fraction of a second in them, and each way between.
EIGHTS = [
    Lemniscate(length_m=length_m, width_m=width_m, speed_m_s=speed_m_s)
    for length_m, width_m in ((20.0, 10.0), (8.0, 8.0), (1e5, 3e4), (1e5, 300.0), (300.0, 1e5), (60.0, 0.5))
    for speed_m_s in (0.2, 4.0)
]


@pytest.mark.parametrize("eight", EIGHTS, ids=repr)
def test_the_extremes_of_a_lemniscate_are_found_within_1_percent(eight: Lemniscate) -> None:
    """Beside the closed forms, r = (A sin p, B/2 sin 2p), sampled most densely where they peak."""
    A, B = 0.5 * eight.length_m, eight.width_m
    w = eight.speed_m_s / math.hypot(A, B)
    near = np.geomspace(1e-9, 1.0, 20_000)
    p = np.concatenate([peak + side * near for peak in (0.5 * np.pi, 0.25 * np.pi) for side in (-1.0, 1.0)])
    cos2 = np.cos(p) ** 2
    speed = w * np.sqrt(A * A * cos2 + B * B * (2.0 * cos2 - 1.0) ** 2)
    turn = w**3 * A * B * np.abs(np.sin(p)) * (1.0 + 2.0 * cos2) / speed**2
    change = w**3 * np.abs(np.sin(2.0 * p)) * np.abs(0.5 * A * A + 2.0 * B * B * np.cos(2.0 * p)) / speed
    fastest_turn, fastest_change = float(turn.max()), float(change.max())
    slowest = float(speed.min())

    def refused(
        turn_rad_s: float = 90.0, change_m_s2: float = 1e5, speed_min_m_s: float = -5.0
    ) -> str | None:
        limits = msgspec.structs.replace(
            make_config().limits,
            pitch_rate_max_rad_s=0.0,
            yaw_rate_max_rad_s=turn_rad_s,
            acceleration_max_m_s2=change_m_s2,
            speed_min_m_s=speed_min_m_s,
        )
        law = msgspec.structs.replace(make_config().law, name="global")
        return next((problem.text for problem in infeasible(eight, limits, law, 5.0, planar=True)), None)

    assert "yaw rate: " in str(refused(turn_rad_s=0.99 * fastest_turn))
    assert refused(turn_rad_s=1.0001 * fastest_turn) is None
    assert "change of speed: " in str(refused(turn_rad_s=1e9, change_m_s2=0.99 * fastest_change))
    assert refused(turn_rad_s=1e9, change_m_s2=1.0001 * fastest_change) is None
    assert "(limits.speed_min_m_s)" in str(refused(turn_rad_s=1e9, speed_min_m_s=1.01 * slowest))
    assert refused(turn_rad_s=1e9, speed_min_m_s=0.9999 * slowest) is None


@pytest.mark.parametrize("name", TRAJECTORIES)
def test_within_its_cycle_a_trajectory_shows_all_its_velocities(name: str) -> None:
    curve = make_config(f"trajectory.name={name}").trajectory
    shown = np.array(
        [sample(curve, t_s).velocity for t_s in np.linspace(0.0, curve.cycle_s, 8000, endpoint=False)]
    )
    for t_s in np.linspace(0.0, 500.0, 300):
        assert np.abs(shown - sample(curve, t_s).velocity).max(axis=1).min() < 0.005


def test_an_approach_at_the_very_limit_of_speed_is_not_refused() -> None:
    bounded = ("law.error_function.name=bounded", "law.error_function.approach_m_s=5")
    assert make_config(*bounded).law.error_function == Bounded(approach_m_s=5.0)


def test_a_planar_vehicle_is_held_to_what_it_does_in_the_plane() -> None:
    assert make_config(*ROVER, "trajectory.down_m_s=7").trajectory == Helix(down_m_s=7.0)
    limits = ("limits.yaw_rate_max_rad_s=1.9999", "limits.pitch_rate_max_rad_s=9")
    assert make_config(*TURNING, *limits).limits.yaw_rate_max_rad_s == 1.9999  # in space, by pitching too
    assert "yaw rate: 2 rad/s needed" in refusal(*ROVER, *TURNING, *limits)
    assert make_config(*ROVER, *TURNING, "limits.yaw_rate_max_rad_s=2").limits.yaw_rate_max_rad_s == 2.0


def test_what_the_law_global_does_without_reverse_is_not_refused() -> None:
    assert make_config("law.name=global", "limits.speed_min_m_s=0").limits.speed_min_m_s == 0.0
    assert make_config("law.name=global", "limits.speed_min_m_s=0.14").limits.speed_min_m_s == 0.14
    assert make_config("limits.speed_min_m_s=-1e-3").law.name == "paper"


ROVER_EXITS = (
    '"manual", "acro", "steering", "hold", "loiter", "follow", "simple", "dock", "circle", "auto", "rtl", '
    '"smart_rtl" or "initialising"'
)


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        (
            "vehicle.profile=px4-uv",
            f'"px4-uv": must be {one_of(sorted(PROFILES))} (did you mean px4-uuv?)',
        ),
        ("vehicle.profile=zeppelin", f'"zeppelin": must be {one_of(sorted(PROFILES))}'),
        (
            "supervisor.exit_mode=holt",
            '"holt": not a mode that px4-uuv can be left in; must be "hold", "manual", "altitude", '
            '"position", "takeoff", "loiter", "mission", "return", "land", "acro" or "stabilized" '
            "(did you mean hold?)",
        ),
        (
            "supervisor.exit_mode=offboard",
            '"offboard": not a mode that px4-uuv can be left in; must be "hold',
        ),
        ("supervisor.exit_mode=guided", '"guided": not a mode that px4-uuv can be left in; must be "hold'),
    ],
)
def test_names_that_only_the_profile_knows_are_refused_in_their_place(setting: str, said: str) -> None:
    key, _, value = setting.partition("=")
    table, _, name = key.partition(".")
    assert refusal(setting).startswith(f"--set {setting}: {key} = {said}")
    lines = [line for line in TEXT.splitlines() if not line.startswith(f"{name} =")]
    number = lines.index(f"[{table}]") + 1
    lines.insert(number, f'{name} = "{value}"')
    message = refusal(text="\n".join(lines))
    assert message.startswith(f"flight.toml:{number + 1}: {key} = {said}")
    assert "\n" not in message


def test_each_profile_has_its_own_modes() -> None:
    exit_mode = "supervisor.exit_mode=smart_rtl"
    assert make_config(*ROVER, exit_mode).supervisor.exit_mode == "smart_rtl"
    assert profile_of(make_config(*ROVER)) is PROFILES["ardupilot-rover"]
    assert refusal(*ROVER, "supervisor.exit_mode=land").endswith(f"must be {ROVER_EXITS}")


LOCATORS = "must be a list of texts (PROTOCOL/ADDRESS, such as tcp/192.168.1.2:7447)"


@pytest.mark.parametrize("key", ["zenoh.connect", "zenoh.listen"])
@pytest.mark.parametrize(
    "locator",
    [
        "",
        "no locator",
        "tcp",
        "tcp/",
        "/a:1",
        "192.168.1.2:7447",
        "tcp/a:1#b?c",
        "tcp/a:1#",
        "tcp/a:1?;",
        "tcp/a:1\\n",
    ],
)
def test_what_is_no_locator_is_refused_before_zenoh_sees_it(key: str, locator: str) -> None:
    setting = f'{key}=["tcp/127.0.0.1:7447", "{locator}"]'
    shown = locator.replace("\\n", "\n")
    assert refusal(setting) == f"--set {setting}: {key} = {['tcp/127.0.0.1:7447', shown]!r}: {LOCATORS}"
    table, name = key.split(".")
    text = f'{TEXT}[{table}]\n{name} = ["{locator}"]\n'
    number = text.count("\n")
    assert refusal(text=text).startswith(f"flight.toml:{number}: {key} = [")


@settings(max_examples=300)
@given(st.from_regex(get_args(Locator)[1].pattern))
@example("unixsock-stream//tmp/zenoh.sock")
@example("tcp/[::1]:7447?prio=1-3;rel=1#iface=eth0;bind=10.0.0.1:0")
def test_every_locator_that_is_not_refused_is_one_to_zenoh(locator: str) -> None:
    zenoh = msgspec.convert({"connect": [locator], "listen": [locator]}, Zenoh)
    config = zenoh_config(mode=zenoh.mode, connect=zenoh.connect, listen=zenoh.listen)
    assert config.get_json("connect/endpoints")


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (
            ["zenoh.mode=client"],
            '--set zenoh.mode=client: zenoh.mode = "client": a client needs a router; name it in '
            "zenoh.connect, or set zenoh.multicast_scouting",
        ),
        (
            ["zenoh.config_file=z.json5", 'zenoh.listen=["tcp/a:1"]'],
            """--set zenoh.listen=["tcp/a:1"]: zenoh.listen = ['tcp/a:1']: zenoh.config_file replaces it; """
            "set only one of the two",
        ),
        (
            ["zenoh.config_file=z.json5", "zenoh.mode=client"],
            '--set zenoh.mode=client: zenoh.mode = "client": zenoh.config_file replaces it; '
            "set only one of the two",
        ),
    ],
)
def test_zenoh_settings_that_contradict_each_other_are_refused(overrides: list[str], said: str) -> None:
    assert refusal(*overrides) == said


def test_zenoh_settings_that_belong_together_are_not_refused() -> None:
    assert make_config("zenoh.config_file=z.json5", "zenoh.mode=peer").zenoh.config_file == "z.json5"
    assert make_config("zenoh.mode=client", "zenoh.multicast_scouting=true").zenoh.mode == "client"
    assert make_config("zenoh.mode=client", 'zenoh.connect=["tcp/a:1"]').zenoh.connect == ("tcp/a:1",)


@pytest.mark.parametrize(
    ("written", "instead", "said"),
    [
        ('"px4-uuv"', '"zeppelin"', r"vehicle\.profile = .zeppelin.: must be"),
        ('"speed_min_m_s":-5.0', '"speed_min_m_s":0.0', r"limits\.speed_min_m_s = 0: the law"),
    ],
)
def test_a_log_of_what_would_not_have_flown_is_refused(written: str, instead: str, said: str) -> None:
    text = to_json(make_config())
    assert text.count(written) == 1
    with pytest.raises(ConfigError, match=f"the configuration in the log: {said}"):
        from_json(text.replace(written, instead))
