"""Flights of a vehicle's plan: its configuration's handling on its model, compiled, from draw to outcome.

The autopilot's parameters are those of the firmware that is built in here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from math import atan2, cos, hypot, sin
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from guidance import trajectory
from guidance.config import Config, ConfigError, load
from guidance.flying.airplane_feasible import cannot_fly
from guidance.flying.airplane_fit import fitted
from guidance.flying.ground import ground_parameters
from guidance.handling import airplane
from guidance.se3 import ZERO, Reference
from sitl import airplane_flight, rover_flight
from sitl.campaign.flight import TRAJECTORIES, Rows
from sitl.campaign.judging import judged
from sitl.campaign.plan import shape_of
from sitl.campaign.vehicle_draw import drawn, normals
from sitl.campaign.vehicle_plan import OUTCOMES, PARAMETERS, VehiclePlan
from sitl.compiled import compiled
from sitl.models import airplane as airplane_model
from sitl.models import rover as rover_model
from sitl.models.files import load_airplane, load_rover
from sitl.models.gusts import Turbulence, Wind
from sitl.vehicle import ardupilot_parameters, px4_parameters
from sitl.vehicle.estimator import USUAL
from sitl.vehicle.parameter_set import Parameter

#: Where the shipped configurations are, in a checkout.
DEPLOY: Final = Path(__file__).parents[2] / "deploy"
#: What the autopilot says of itself.
_FIRMWARE: Final[dict[str, Mapping[str, Parameter]]] = {
    "ardupilot-rover": ardupilot_parameters.ROVER,
    "ardupilot-plane": ardupilot_parameters.PLANE,
    "px4-plane": px4_parameters.PLANE,
}
#: Vertical sigma of gusts, as a part of the level one, and their lengths: MIL-F-8785C's at 50 m of height.
_VERTICAL: Final = 0.6
_LENGTHS_M: Final = (200.0, 50.0)

#: Where an airplane's reference starts, m above the origin: no lower than this.
_HEIGHT_M: Final = 60.0

Record = NDArray[np.float64]
Draw = dict[str, float]
Fly = Callable[..., Any]


class Rover(NamedTuple):
    """What all flights of a plan share."""

    body: rover_model.Parameters
    guide: rover_flight.Guide
    path: rover_flight.Path

    @property
    def dt_s(self) -> float:
        """Of a guide's step."""
        return self.guide.steps * rover_flight.STEP_S

    def columns(self) -> tuple[str, ...]:
        """Of its record."""
        return rover_flight.COLUMNS

    def flown(self, plan: VehiclePlan, index: int, draw: Draw, fly: Fly | None = None) -> Record:
        """The record of one flight; `fly` is `rover_flight.fly`, by default as machine code."""
        record = np.zeros((round(plan.duration_s / self.dt_s), len(rover_flight.COLUMNS)))
        estimates = len(record) * self.guide.steps // rover_flight.ESTIMATOR_STEPS + 1
        dice = normals(plan, index, estimates, rover_flight.NOISES)
        dice[:, : rover_flight.GUSTS] *= draw["noise"]
        p = self.body
        body = p._replace(
            yaw_gain=p.yaw_gain * draw["gain"],
            yaw_slew_rad_s2=p.yaw_slew_rad_s2 * draw["slew"],
            delay_s=max(0.0, p.delay_s + draw["delay_s"]),
        )
        (fly or compiled(rover_flight.fly))(
            body,
            draw["power"],
            self.guide,
            self.path,
            rover_flight.beside(self.path, draw["right_m"], draw["ahead_m"], draw["off_rad"]),
            _weather(draw),
            USUAL,
            draw["heading_bias_rad"],
            dice,
            record,
        )
        return record


class Airplane(NamedTuple):
    """What all flights of a plan share."""

    body: airplane_model.Parameters
    guide: airplane.Parameters
    ahead_s: float
    task: airplane_flight.Task
    height_m: float

    @property
    def dt_s(self) -> float:
        """Of a guide's step: 50 Hz, whatever the configuration says."""
        return airplane_flight.GUIDE_STEP_S

    def columns(self) -> tuple[str, ...]:
        """Of its record."""
        return airplane_flight.COLUMNS

    def flown(self, plan: VehiclePlan, index: int, draw: Draw, fly: Fly | None = None) -> Record:
        """The record of one flight; `fly` is `airplane_flight.fly`, by default as machine code."""
        dice = normals(plan, index, round(plan.duration_s / self.dt_s), airplane_flight.NOISES)
        dice[:, airplane_flight.GUSTS :] *= draw["noise"]
        record = np.zeros((len(dice), len(airplane_flight.COLUMNS)))
        p, weather = self.body, _weather(draw)
        body = p._replace(
            roll_gain=p.roll_gain * draw["gain"],
            pitch_gain=p.pitch_gain * draw["gain"],
            roll_slew_rad_s=p.roll_slew_rad_s * draw["slew"],
            pitch_slew_rad_s=p.pitch_slew_rad_s * draw["slew"],
            roll_delay_s=max(0.0, p.roll_delay_s + draw["delay_s"]),
            pitch_delay_s=max(0.0, p.pitch_delay_s + draw["delay_s"]),
            throttle_delay_s=max(0.0, p.throttle_delay_s + draw["delay_s"]),
            thrust_m_s2=p.thrust_m_s2 * draw["power"],
        )
        north, east, course = _beside(
            airplane_flight.planned(self.task, 0.0, self.height_m), draw["right_m"], draw["ahead_m"]
        )
        state = airplane_model.flying(
            body,
            north,
            east,
            -self.height_m - draw["up_m"],
            course + draw["off_rad"],
            self.task.speed_m_s,
            weather.wind,
        )
        (fly or compiled(airplane_flight.fly))(
            body,
            self.guide,
            airplane.UNTRIMMED,
            self.ahead_s,
            self.task,
            self.height_m,
            state,
            weather,
            True,
            True,
            draw["heading_bias_rad"],
            dice,
            record,
        )
        return record


@lru_cache(maxsize=16)
def vehicle_of(plan: VehiclePlan) -> Rover | Airplane:
    """What the plan's flights share.

    Raises:
        ValueError: configuration, model or trajectory cannot be flown; says which and why.
    """
    path = Path(plan.configuration) if plan.configuration else DEPLOY / f"{plan.profile}.toml"
    try:
        config = load(path, plan.settings)
    except ConfigError as error:
        raise ValueError(str(error)) from None
    if config.vehicle.profile != plan.profile:
        raise ValueError(f"{path}: profile is {config.vehicle.profile}, and the plan's {plan.profile}")
    if config.trajectory.stop_at_s > 0.0:
        raise ValueError("trajectory: a campaign flies none that stops; leave out stop_at_s")
    values = {name: parameter.default for name, parameter in _FIRMWARE[plan.profile].items()}
    return _airplane(plan, config, values) if plan.is_airplane else _rover(plan, config, values)


def fly_range(plan: VehiclePlan, first: int, count: int) -> tuple[Rows, Rows]:
    """Parameters and outcomes of flights `first` to `first + count - 1`, a function of these and the plan."""
    vehicle = vehicle_of(plan)
    rows = drawn(plan, first, count)
    outcomes = np.zeros((count, len(OUTCOMES)))
    for i, row in enumerate(rows):
        draw = dict(zip(PARAMETERS, map(float, row), strict=True))
        record = vehicle.flown(plan, first + i, draw)
        outcomes[i] = judged(plan, record, vehicle.columns(), vehicle.dt_s)
        outcomes[i, OUTCOMES.index("start_heading_error_rad")] = abs(draw["off_rad"])
    return rows, outcomes


def _rover(plan: VehiclePlan, config: Config, values: Mapping[str, float]) -> Rover:
    if type(config.trajectory) not in TRAJECTORIES:
        raise ValueError(f"trajectory: a campaign of rovers cannot fly {type(config.trajectory).__name__}")
    per_step = 1.0 / (config.link.rate_hz * rover_flight.STEP_S)
    steps = round(per_step)
    if steps < rover_flight.AGE_STEPS or abs(per_step - steps) > 1e-9:
        raise ValueError(f"link.rate_hz must be 50, 40, 25, 20, 10 or 5 here, not {config.link.rate_hz:g}")
    ahead_ns = round(config.link.actuation_delay_s * 1e9)
    path = rover_flight.Path(TRAJECTORIES[type(config.trajectory)], shape_of(config.trajectory))
    guide = rover_flight.Guide(ground_parameters(config, ZERO, values), steps, ahead_ns)
    return Rover(load_rover(plan.model_name), guide, path)


def _airplane(plan: VehiclePlan, config: Config, values: Mapping[str, float]) -> Airplane:
    found = fitted(config, values)
    why = (
        found
        if isinstance(found, str)
        else cannot_fly(config.trajectory, found.parameters, airplane.UNTRIMMED)
    )
    if isinstance(found, str) or why is not None:
        raise ValueError(why)
    task, height_m = _task(config.trajectory)
    return Airplane(
        load_airplane(plan.model_name),
        found.parameters,
        config.link.actuation_delay_s,
        task,
        max(_HEIGHT_M, height_m),
    )


def _task(flown: trajectory.Trajectory) -> tuple[airplane_flight.Task, float]:
    """The trajectory as the airplane's flight knows it, and its start's height."""
    match flown:
        case trajectory.Circle(radius_m=r, speed_m_s=v, clockwise=True, down_m=down):
            return airplane_flight.Task(airplane_flight.CIRCLE, r, v, 0.0), -down
        case trajectory.Helix(radius_m=r, speed_m_s=v, down_m_s=sinks, down_m=down, levels_off_m=0.0):
            return airplane_flight.Task(airplane_flight.HELIX, r, v, -sinks), -down
        case trajectory.Eight(length_m=length, width_m=width, speed_m_s=v, down_m=down, rise_m=rise) if (
            abs(2.0 * width - length) < 1e-9
        ):
            return airplane_flight.Task(airplane_flight.EIGHT, length, v, rise), -down
    raise ValueError(
        "trajectory: a campaign of airplanes flies circles clockwise, helices that do not level off and "
        f"eights half as wide as long, not {flown}"
    )


def _weather(draw: Draw) -> Turbulence:
    gusts = draw["gusts_m_s"]
    wind = Wind(draw["wind_north_m_s"], draw["wind_east_m_s"], 0.0)
    return Turbulence(wind, gusts, _VERTICAL * gusts, *_LENGTHS_M)


def _beside(r: Reference, right_m: float, ahead_m: float) -> tuple[float, float, float]:
    """North, east (m) and course (rad) of a place beside the reference."""
    speed = hypot(r.velocity.x, r.velocity.y)
    c, s = r.velocity.x / speed, r.velocity.y / speed
    course = atan2(s, c)
    return (
        r.position.x + ahead_m * cos(course) - right_m * sin(course),
        r.position.y + ahead_m * sin(course) + right_m * cos(course),
        course,
    )
