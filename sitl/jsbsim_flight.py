"""Flights of JSBSim's airplanes without MAVLink: the plant of others, noise and record of `airplane_flight`.

Interpreted, for no compiler reaches into JSBSim: a minute of flight takes half a second. The tasks are those
of the built-in airplanes, as large as each one's speed makes them.
"""

from __future__ import annotations

from math import atan2, cos, inf, radians, sin, tan
from typing import Final

import numpy as np
from numpy.typing import NDArray

from guidance.handling import airplane
from guidance.handling.airplane import airplane_step
from guidance.handling.airplane_defaults import Airframe, handling
from guidance.se3 import Vec3
from sitl.airplane_flight import (
    AGE_S,
    BIAS_M,
    CIRCLE,
    COLUMNS,
    EIGHT,
    GUIDE_STEP_S,
    HELIX,
    Seen,
    Task,
    measured_of,
    phase_step,
    planned,
    sensed,
    wandered,
    write,
)
from sitl.airplane_tasks import NEAR, Scenario, drawn, patient
from sitl.models.files import load_jsbsim
from sitl.models.gusts import NO_GUSTS, Wind, blowing, gusts_step
from sitl.models.jsbsim_airplane import GRAVITY_M_S2, JsbsimAirplane, State
from sitl.models.manuals import MANUALS
from sitl.scenarios.jsbsim import airframe

AIRFRAMES: Final = {aircraft: airframe(manual) for aircraft, manual in MANUALS.items()}
#: Demands are taken to act so much later: about half of the inner loops' lag.
AHEAD_S: Final = 0.3
#: The bank of the tightest turn of each task.
TASK_BANK_RAD: Final = radians(27.0)


def jsbsim_scenarios(speed_m_s: float) -> dict[str, Scenario]:
    """Circle, helix and lemniscate, calm and in wind, with the limit of airplanes that others wrote."""
    radius_m = speed_m_s * speed_m_s / (GRAVITY_M_S2 * tan(TASK_BANK_RAD))
    tasks = {
        "circle": Task(CIRCLE, radius_m, speed_m_s, 0.0),
        "helix, 1 m/s up": Task(HELIX, radius_m, speed_m_s, 1.0),
        # an eight's tightest turn is an eighth of its length
        "lemniscate, +-10 m": Task(EIGHT, 8.0 * radius_m, speed_m_s, 10.0),
    }
    calm = {n: Scenario(t, NEAR, 80.0, False, 0.0, True, 60.0, 1.5, inf) for n, t in tasks.items()}
    windy = {
        f"{n}, 5 m/s wind estimated": Scenario(t, NEAR, 90.0, True, 5.0, False, inf, 2.0, inf)
        for n, t in tasks.items()
        if t.kind != HELIX  # a Cub has no climb to spare against the wind
    }
    return calm | windy


def flown_jsbsim(
    aircraft: str, scenario: Scenario, seed: int, believed: Airframe | None = None
) -> NDArray[np.float64]:
    """The record of one flight, `COLUMNS` a step; another airframe is what the guide believes, if given.

    Raises:
        ModuleNotFoundError: jsbsim is not installed.
    """
    guide = patient(handling(believed or AIRFRAMES[aircraft]), scenario)
    dice = drawn(scenario, seed)
    record = np.zeros((dice.normals.shape[0], len(COLUMNS)))
    body = _started(aircraft, scenario, dice.weather.wind)
    task, height_m = scenario.task, scenario.start.height_m
    ahead_s = AGE_S + AHEAD_S
    memory = airplane.unstarted(airplane.UNTRIMMED)
    phase = phase_step(task, 0.0, AHEAD_S)
    gusts = NO_GUSTS
    bias_m = Vec3(*(BIAS_M * dice.normals[0, 6:9]))
    for n, z in enumerate(dice.normals):
        true = _seen(body.state())
        seen = sensed(true, bias_m, dice.heading_bias_rad, z)
        bias_m = wandered(bias_m, z)
        # the vehicle flies on while the measurement is under way
        body.blow(blowing(dice.weather, gusts))
        body.advance(GUIDE_STEP_S)
        gusts = gusts_step(dice.weather, gusts, true.airspeed_m_s, (z[0], z[1], z[2]), GUIDE_STEP_S)

        r = planned(task, phase, height_m)
        then = planned(task, phase_step(task, phase, -ahead_s * memory.waiting.rate), height_m)
        before_s = memory.waiting.waited_s
        measured = measured_of(seen, True, scenario.wind_given, dice.weather.wind, ahead_s)
        memory, demand, found = airplane_step(guide, memory, measured, r, GUIDE_STEP_S)
        body.tell(demand.roll_rad, demand.pitch_rad, demand.throttle)
        phase = phase_step(task, phase, GUIDE_STEP_S - (memory.waiting.waited_s - before_s))
        write(record[n], n * GUIDE_STEP_S, seen, then, true.airspeed_m_s, demand, found)
    return record


def _started(aircraft: str, scenario: Scenario, wind: Wind) -> JsbsimAirplane:
    """In the air where the scenario starts, at its speed through the air."""
    start = scenario.start
    r = planned(scenario.task, 0.0, start.height_m)
    course = atan2(r.velocity.y, r.velocity.x)
    position_ned_m = (
        r.position.x - sin(course) * start.right_m,
        r.position.y + cos(course) * start.right_m,
        r.position.z - start.up_m,
    )
    return JsbsimAirplane(
        aircraft,
        load_jsbsim(aircraft),
        position_ned_m,
        course + start.off_rad,
        scenario.task.speed_m_s,
        wind=wind,
    )


def _seen(state: State) -> Seen:
    return Seen(
        Vec3(state.north_m, state.east_m, state.down_m),
        Vec3(state.velocity_north_m_s, state.velocity_east_m_s, state.velocity_down_m_s),
        state.roll_rad,
        state.pitch_rad,
        state.heading_rad,
        state.airspeed_m_s,
    )
