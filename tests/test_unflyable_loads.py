"""A trajectory that the vehicle cannot fly is refused as it is loaded, with numbers, and changes nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import pytest

from guidance.changing import with_setting, with_trajectory
from guidance.commands import LoadTrajectory, Scalar
from guidance.config import Config, load, profile_of
from guidance.flying import Handler
from guidance.flying.choice import handler_of
from guidance.mavlink.profiles import PROFILES
from guidance.records import Answer
from guidance.se3 import ZERO
from guidance.supervisor import State
from sitl.lockstep import Lockstep
from sitl.vehicle import Firmware, Vehicle, VehicleOptions
from tests.helpers import records_of
from tests.mavlink_peer import SECOND
from tests.test_flying_velocity import ARDUPILOT, PX4
from tests.test_rover_px4 import VALUES

DEPLOY: Final = Path(__file__).parents[1] / "deploy"
CIRCLE: Final[dict[str, Scalar]] = {"name": "circle", "radius_m": 10.0}
#: Of each profile: what its autopilot says, what flies, and what is too fast for that autopilot alone.
CASES: Final[dict[str, tuple[dict[str, float], float, float, str]]] = {
    "px4-copter": (PX4 | {"MPC_XY_VEL_MAX": 3.5}, 2.0, 4.0, "horizontal speed: 4 m/s needed at t = 0 s"),
    "ardupilot-copter": (ARDUPILOT | {"WP_SPD": 3.5}, 2.0, 4.0, "horizontal speed: 4 m/s needed at t = 0 s"),
    "px4-rover": (VALUES | {"RO_SPEED_LIM": 1.5}, 1.0, 1.8, "speed: 1.8 m/s needed at t = 0 s"),
    "ardupilot-rover": ({"WP_SPEED": 1.5}, 1.0, 1.8, "speed: 1.8 m/s needed at t = 0 s"),
    "boat": ({"WP_SPEED": 1.5}, 1.0, 1.8, "speed: 1.8 m/s needed at t = 0 s"),
}


def shipped(name: str, speed_m_s: float, *settings: str) -> Config:
    if name == "boat":  # the law alone
        name, settings = "ardupilot-rover", ("ground.enabled=false", *settings)
    return load(
        DEPLOY / f"{name}.toml",
        (
            "trajectory.name=circle",
            "trajectory.radius_m=10",
            f"trajectory.speed_m_s={speed_m_s}",
            *settings,
        ),
    )


def known(name: str, *settings: str) -> tuple[Handler, Config]:
    """A handler that has read the autopilot's parameters, and flies."""
    values, slow, _, _ = CASES[name]
    config = shipped(name, slow, *settings)
    handler = handler_of(config, profile_of(config))
    assert handler.fit(values) is None
    return handler, config


def faster(config: Config, speed_m_s: float) -> Config:
    trajectory: dict[str, Scalar] = {**CIRCLE, "speed_m_s": speed_m_s}
    return with_trajectory(config, trajectory)


@pytest.mark.parametrize("name", CASES)
def test_what_the_autopilot_does_not_allow_is_refused_at_the_load_with_numbers(name: str) -> None:
    handler, config = known(name)
    refused = handler.configure(faster(config, CASES[name][2]), ZERO, config.law.allocation)
    assert refused is not None
    assert CASES[name][3] in refused
    assert "fly at most" in refused
    assert handler.fit(CASES[name][0]) is None, "nothing changed: the old one still flies"
    assert handler.configure(faster(config, 0.9), ZERO, config.law.allocation) is None


@pytest.mark.parametrize("name", CASES)
def test_before_the_parameters_are_known_anything_is_taken_and_judged_then(name: str) -> None:
    values, _, fast, said = CASES[name]
    config = shipped(name, fast)
    handler = handler_of(config, profile_of(config))
    assert handler.configure(faster(config, fast - 0.1), ZERO, config.law.allocation) is None
    assert handler.configure(config, ZERO, config.law.allocation) is None
    assert said in (handler.fit(values) or "")
    # what does not fly may be set right: by another trajectory, and no gain is held up by it meanwhile
    assert handler.configure(with_setting(config, "law.k", 0.7), ZERO, config.law.allocation) is None
    assert "fly at most" in (handler.configure(faster(config, fast - 0.01), ZERO, "pitch-yaw") or "")
    assert handler.configure(faster(config, 0.9), ZERO, config.law.allocation) is None


@pytest.mark.parametrize("name", ["px4-copter", "ardupilot-copter"])
def test_a_limit_that_is_set_too_low_for_what_is_flown_is_refused(name: str) -> None:
    """0.4 m/s^2 are needed; of what may be asked for, a tenth is kept for the loops."""
    handler, config = known(name)
    tight = with_setting(config, "limits.acceleration_max_m_s2", 0.42)
    refused = handler.configure(tight, ZERO, config.law.allocation)
    assert refused is not None
    assert "horizontal acceleration: 0.4 m/s^2 needed" in refused
    assert "0.378 m/s^2 available (limits.acceleration_max_m_s2 less 10 %)" in refused


def test_the_tilt_bounds_what_a_copter_is_asked_for_and_what_it_may_fly() -> None:
    """g tan 5 degrees is 0.858 m/s^2, and 3 m/s on 10 m take 0.9."""
    for name, values, parameter in (
        ("px4-copter", PX4, "MPC_TILTMAX_AIR"),
        ("ardupilot-copter", ARDUPILOT, "ATC_ANGLE_MAX"),
    ):
        config = shipped(name, 3.0)
        handler = handler_of(config, profile_of(config))
        assert handler.fit(values) is None
        said = handler.fit(values | {parameter: 5.0}) or ""
        assert "horizontal acceleration: 0.9 m/s^2 needed" in said
        assert f"0.77217 m/s^2 available (g tan {parameter} 5 less 10 %)" in said
        row = next(row for row in PROFILES[name].requirements if row.parameter == parameter)
        assert row.used


@pytest.mark.parametrize("profile", ["px4-copter", "px4-rover", "ardupilot-rover"])
def test_an_order_to_load_it_is_answered_with_the_reason(profile: str) -> None:
    slower = {"px4-copter": "MPC_XY_VEL_MAX", "px4-rover": "RO_SPEED_LIM", "ardupilot-rover": "WP_SPEED"}
    options = VehicleOptions(firmware=Firmware(profile), parameters={slower[profile]: 1.5})
    config = shipped(profile, 1.0, "flight.origin=ekf")
    flight = Lockstep(config, Vehicle(options, boot_ns=SECOND), start_ns=SECOND)
    flight.run(6.0)
    guide = flight.guide
    assert guide.fitting.unmet is None
    assert guide.engagement.state in (State.CONNECTED, State.READY)
    order = LoadTrajectory(trajectory={**CIRCLE, "speed_m_s": 1.8})
    guide.command(order, flight.now_ns)
    flight.run(0.1)
    (answer,) = records_of(flight, Answer)
    assert not answer.accepted
    assert "1.8 m/s needed" in answer.reason
    assert guide.config.trajectory == config.trajectory
