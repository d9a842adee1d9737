"""Steps flown by the models of `sitl.models`, open loop, measured as by an estimator; and recorded ones."""

from __future__ import annotations

import gzip
from math import cos, radians, sqrt
from pathlib import Path
from random import Random
from typing import Final, NamedTuple

from guidance.tune.answer import Command, Sample
from guidance.tune.excitation import Run, demand_at
from guidance.tune.identify import Measurement
from sitl.models import airplane, rover
from sitl.models.gusts import CALM

RECORDED: Final = Path(__file__).parent / "data" / "steps.csv.gz"
PERIOD_S: Final = 0.02
MODEL_STEP_S: Final = 0.004
#: Measurements that are lost, so that the others come at irregular times.
LOST: Final = 0.05


class Noise(NamedTuple):
    """White, at every measurement: of a gyro, an attitude and a velocity."""

    yaw_rate_rad_s: float = 0.005
    attitude_rad: float = radians(0.3)
    velocity_m_s: float = 0.05


NOISE: Final = Noise()
SILENT: Final = Noise(0.0, 0.0, 0.0)


class Flown(NamedTuple):
    """What was measured, and where it went, m from its start (north, east, down)."""

    measurement: Measurement
    path: tuple[tuple[float, float, float], ...]


def driven(model: rover.Parameters, run: Run, noise: Noise = NOISE, seed: int = 0) -> Flown:
    """A ground run from rest, heading north."""
    dice = Random(seed)
    state = rover.at_rest(0.0, 0.0, 0.0)
    along = run.channel == "speed_m_s"
    commands, samples, path = [], [], []
    for n in range(round(run.lasts_s / PERIOD_S)):
        asked = demand_at(run, n * PERIOD_S)
        commands.append(Command(n * PERIOD_S, asked[run.channel]))
        state = rover.told(model, state, asked["yaw_rate_rad_s"], asked["speed_m_s"])
        for _ in range(round(PERIOD_S / MODEL_STEP_S)):
            state = rover.step(model, state, 0.0, 0.0, MODEL_STEP_S)
        path.append((state.north_m, state.east_m, 0.0))
        if dice.random() >= LOST:
            seen = (
                state.speed_m_s + dice.gauss(0.0, noise.velocity_m_s)
                if along
                else state.yaw_rate_rad_s + dice.gauss(0.0, noise.yaw_rate_rad_s)
            )
            samples.append(Sample(state.time_s, seen))
    return Flown(Measurement(commands, samples, led=along), tuple(path))


def banked(model: airplane.Parameters, speed_m_s: float, run: Run, seed: int = 0) -> Flown:
    """An airplane's run from level flight to the north; height and speed are held where the run lets them."""
    dice = Random(seed)
    noise, p = NOISE, model
    state = airplane.flying(p, 0.0, 0.0, 0.0, 0.0, speed_m_s, CALM)
    commands, samples, path = [], [], []
    for n in range(round(run.lasts_s / PERIOD_S)):
        asked = {**_held(p, state, speed_m_s), **demand_at(run, n * PERIOD_S)}
        commands.append(Command(n * PERIOD_S, asked[run.channel]))
        state = airplane.told(state, asked["roll_rad"], asked["pitch_rad"], asked["throttle"])
        for _ in range(round(PERIOD_S / MODEL_STEP_S)):
            state = airplane.step(p, state, CALM, MODEL_STEP_S)
        path.append((state.north_m, state.east_m, state.down_m))
        if dice.random() >= LOST:
            samples.append(_seen(state, run.channel, noise, dice))
    return Flown(Measurement(commands, samples, offset=True), tuple(path))


def recorded(channel: str, *, led: bool = False, offset: bool = False) -> Measurement:
    """Of `data/steps.csv.gz`."""
    rows = [line.split(",") for line in gzip.decompress(RECORDED.read_bytes()).decode().splitlines()[1:]]
    found: dict[str, list[tuple[float, float]]] = {"asked": [], "measured": []}
    for name, what, t_ms, value in rows:
        if name == channel:
            found[what].append((int(t_ms) * 1e-3, int(value) * 1e-3))
    return Measurement(
        [Command(*row) for row in found["asked"]], [Sample(*row) for row in found["measured"]], offset, led
    )


def _held(p: airplane.Parameters, state: airplane.State, speed_m_s: float) -> dict[str, float]:
    """Pitch and throttle as a guidance that knows the airplane would ask for them, and wings level."""
    speed = state.airspeed_m_s
    load = 1.0 / cos(state.roll_rad)
    climb_rad = max(-0.15, min(0.15, 0.5 * state.down_m / speed))
    alpha = p.alpha_zero_rad + p.alpha_per_load_rad_m2_s2 * load / speed**2
    drag = p.drag_per_m * speed_m_s**2 + p.induced_m3_s4 * load**2 / speed_m_s**2
    return {
        "roll_rad": 0.0,
        "pitch_rad": (alpha * cos(state.roll_rad) + climb_rad - p.pitch_offset_rad) / p.pitch_gain,
        "throttle": drag / p.thrust_m_s2 + 0.1 * (speed_m_s - speed),
    }


def _seen(state: airplane.State, channel: str, noise: Noise, dice: Random) -> Sample:
    if channel != "throttle":
        angle = state.roll_rad if channel == "roll_rad" else state.pitch_rad
        return Sample(state.time_s, angle + dice.gauss(0.0, noise.attitude_rad))
    velocity = (state.velocity_north_m_s, state.velocity_east_m_s, state.velocity_down_m_s)
    north, east, down = (part + dice.gauss(0.0, noise.velocity_m_s) for part in velocity)
    speed = sqrt(north * north + east * east + down * down)
    return Sample(state.time_s, speed, airplane.GRAVITY_M_S2 * down / speed)
