"""The whole service on rotorpy's copters, from 30 g to 1 kg: PX4's shipped configuration, noise, lockstep."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import pytest

from sitl.plant import Triple
from sitl.scenarios.copter import ON_A_CIRCLE, ON_A_HELIX, ON_A_LEG, task
from sitl.scenarios.flight import Figures, Task, fly

CIRCLE: Final = task("px4-copter", ON_A_CIRCLE, (7.0, 0.0), 18.0)
HELIX: Final = task("px4-copter", ON_A_HELIX, (0.0, -3.0), 18.0)
STOP_S: Final = 6.0
LEG: Final = task("px4-copter", (*ON_A_LEG, f"trajectory.stop_at_s={STOP_S}"), (0.0, 2.0), STOP_S + 7.0)
#: What begins as PX4's simulated quadrotor in much air is told that there is less.
THIN: Final = ("copter.drag_per_s=0.1",)
CALM: Final = (0.0, 0.0, 0.0)
WIND: Final = (3.0, -4.0, 0.0)


def flown(asked: Task, vehicle: str, wind_ned_m_s: Triple, settings: tuple[str, ...] = ()) -> Figures:
    there = {**asked.vehicle, "model": f"rotorpy:{vehicle}", "wind_ned_m_s": wind_ned_m_s}
    return fly(replace(asked, vehicle=there, settings=(*asked.settings, *settings)), seed=1)


@pytest.mark.parametrize(
    ("asked", "vehicle", "wind_ned_m_s", "settings"),
    [
        pytest.param(CIRCLE, "hummingbird", CALM, (), id="circle, hummingbird"),
        pytest.param(CIRCLE, "px4_sihsim_quadx", CALM, THIN, id="circle, px4_sihsim_quadx"),
        pytest.param(HELIX, "crazyflie", WIND, (), id="helix in wind, crazyflie"),
    ],
)
def test_a_round_is_flown_to_15_cm(
    asked: Task, vehicle: str, wind_ned_m_s: Triple, settings: tuple[str, ...]
) -> None:
    figures = flown(asked, vehicle, wind_ned_m_s, settings)
    assert figures.converged_s < 8.0
    assert figures.rms_m < 0.15
    assert figures.max_m < 0.3
    assert not figures.stuck


def test_it_stops_where_its_trajectory_does_and_holds() -> None:
    figures = flown(LEG, "hummingbird", CALM)
    assert figures.converged_s < 8.0
    late = [error for t, error, *_ in figures.trace if t > STOP_S + 5.0]
    assert max(late) < 0.1
