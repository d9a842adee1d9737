"""The body that a vehicle's options name, and whether it takes what the firmware gives."""

from __future__ import annotations

from sitl.models import airplane
from sitl.models.files import load_model
from sitl.plant import PlantState
from sitl.vehicle.bodies.airplane import AirplaneBody
from sitl.vehicle.bodies.ideal import IdealBody
from sitl.vehicle.bodies.rover import RoverBody
from sitl.vehicle.body import Body
from sitl.vehicle.options import IDEAL, VehicleOptions

#: Where an airplane begins whose options do not say, m of height and times its stall speed.
AIRPLANE_HEIGHT_M = 100.0
AIRPLANE_STALLS = 1.5


def body_of(options: VehicleOptions, *, planar: bool, start_ns: int) -> Body:
    """A new body where and as the options say.

    Raises:
        ValueError: the model's file is missing or wrong, or the start is none for such a body.
    """
    position = options.start_position_ned_m()
    if options.model == IDEAL:
        if options.initial_speed_m_s:
            raise ValueError("the ideal body starts at rest: initial_speed_m_s must be 0")
        first = PlantState(position, options.start_attitude_wxyz())
        return IdealBody(options.plant._replace(planar=planar), first, start_ns)
    parameters = load_model(options.model)
    yaw, wind = options.initial_yaw_rad, options.wind_ned_m_s
    if isinstance(parameters, airplane.Parameters):
        if options.initial_position_ned_m is None:
            position = (position[0], position[1], -AIRPLANE_HEIGHT_M)
        speed = options.initial_speed_m_s
        if speed is None:
            speed = AIRPLANE_STALLS * parameters.stall_m_s
        if position[2] > 0.0 or (speed == 0.0 and position[2] < 0.0):
            raise ValueError(
                f"{options.model}: an airplane starts above the ground, or with initial_speed_m_s = 0 on it, "
                f"not {-position[2]:g} m above it at {speed:g} m/s"
            )
        return AirplaneBody(parameters, position, yaw, speed, wind, options.gusts_m_s, options.seed, start_ns)
    return RoverBody(parameters, position, yaw, wind, start_ns)
