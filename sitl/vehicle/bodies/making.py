"""The body that a vehicle's options name."""

from __future__ import annotations

from typing import Final

from sitl.models import airplane, copter, jsbsim_airplane, rotorpy_copter, rover, uuv
from sitl.models.files import JSBSIM_PREFIX, ROTORPY, ROTORPY_PREFIX, Model, load_model
from sitl.models.gusts import Wind
from sitl.plant import PlantParameters, PlantState, Triple
from sitl.vehicle.bodies.airplane import AirplaneBody
from sitl.vehicle.bodies.copter import CopterBody
from sitl.vehicle.bodies.ideal import IdealBody
from sitl.vehicle.bodies.jsbsim import JsbsimBody
from sitl.vehicle.bodies.rotorpy import RotorpyBody
from sitl.vehicle.bodies.rover import RoverBody
from sitl.vehicle.bodies.uuv import UuvBody
from sitl.vehicle.body import Body
from sitl.vehicle.options import AIRBORNE_M, IDEAL, VehicleOptions

#: Either one by this name: that which was recorded with the firmware.
AIRPLANE: Final = "airplane"
COPTER: Final = "copter"
#: The first of rotorpy's, by this name.
ANY_ROTORPY: Final = "rotorpy"
#: The speed of an airplane that begins in the air, times its stall speed, if its options do not say.
AIRPLANE_STALLS: Final = 1.5

_TAKES: Final[dict[type, tuple[type, ...]]] = {
    rover.Parameters: RoverBody.takes,
    airplane.Parameters: AirplaneBody.takes,
    copter.Parameters: CopterBody.takes,
    uuv.Parameters: UuvBody.takes,
    jsbsim_airplane.Parameters: JsbsimBody.takes,
    rotorpy_copter.Parameters: RotorpyBody.takes,
}
_CALM: Final[Triple] = (0.0, 0.0, 0.0)


def takes(model: str) -> tuple[type, ...]:
    """The kinds of `Control` that a model takes.

    Raises:
        ValueError: the model's file is missing or wrong.
    """
    return IdealBody.takes if model == IDEAL else _TAKES[type(_loaded(model, ""))]


def body_of(options: VehicleOptions, *, planar: bool, start_ns: int) -> Body:
    """A new body where and as the options say; a `planar` ideal one neither rolls nor pitches.

    Raises:
        ValueError: the model's file is missing or wrong, or what else is chosen does not go with the model.
    """
    if options.model == IDEAL:
        _refuse(options, wind=True, gusts=True, speed=True)
        first = PlantState(options.start_position_ned_m(), options.start_attitude_wxyz())
        return IdealBody(options.plant._replace(planar=planar), first, start_ns)
    if options.plant != PlantParameters():
        raise ValueError(f"{options.model}: bounds and lags are chosen for the ideal body only")
    parameters = _loaded(options.model, options.firmware)
    if isinstance(parameters, airplane.Parameters):
        return _airplane(options, parameters, start_ns)
    if isinstance(parameters, jsbsim_airplane.Parameters):
        return _jsbsim(options, parameters, start_ns)
    if isinstance(parameters, uuv.Parameters):
        _refuse(options, wind=True, gusts=True, speed=True)
        return UuvBody(parameters, options.start_position_ned_m(), options.start_attitude_wxyz(), start_ns)
    _refuse(options, wind=False, gusts=True, speed=True)
    if isinstance(parameters, copter.Parameters):
        return _copter(options, parameters, start_ns)
    if isinstance(parameters, rotorpy_copter.Parameters):
        return _rotorpy(options, parameters, start_ns)
    yaw_rad, wind_ned_m_s = options.initial_yaw_rad, options.wind_ned_m_s
    return RoverBody(parameters, options.start_position_ned_m(), yaw_rad, wind_ned_m_s, start_ns)


def _loaded(model: str, firmware: str) -> Model:
    if model == AIRPLANE:
        model = "airplane_20" if firmware.startswith("ardupilot") else "airplane_12"
    if model == COPTER:
        model = "copter_ardupilot" if firmware.startswith("ardupilot") else "copter_px4"
    if model == ANY_ROTORPY:
        model = ROTORPY_PREFIX + ROTORPY[0]
    return load_model(model)


def _refuse(options: VehicleOptions, *, wind: bool, gusts: bool, speed: bool) -> None:
    """What this body would not feel is no option of it."""
    chosen = {
        "wind_ned_m_s": wind and options.wind_ned_m_s != _CALM,
        "gusts_m_s": gusts and options.gusts_m_s != 0.0,
        "initial_speed_m_s": speed and bool(options.initial_speed_m_s),
    }
    for name, refused in chosen.items():
        if refused:
            raise ValueError(f"the model {options.model} has no {name}")


def _airplane(options: VehicleOptions, parameters: airplane.Parameters, start_ns: int) -> AirplaneBody:
    position = options.start_position_ned_m()
    height, speed = -position[2], options.initial_speed_m_s
    if speed is None:
        speed = AIRPLANE_STALLS * parameters.stall_m_s if height > 0.0 else 0.0
    if height < 0.0 or (height > 0.0 and speed < parameters.stall_m_s) or (height == 0.0 and speed > 0.0):
        raise ValueError(
            f"the model {options.model} starts above the ground at {parameters.stall_m_s:g} m/s or more, "
            f"or on it at rest, not at a height of {height:g} m and {speed:g} m/s"
        )
    return AirplaneBody(
        parameters,
        position,
        options.initial_yaw_rad,
        speed,
        options.wind_ned_m_s,
        options.gusts_m_s,
        options.seed,
        start_ns,
    )


def _jsbsim(options: VehicleOptions, parameters: jsbsim_airplane.Parameters, start_ns: int) -> JsbsimBody:
    speed = options.initial_speed_m_s
    try:
        flying = jsbsim_airplane.JsbsimAirplane(
            options.model.removeprefix(JSBSIM_PREFIX),
            parameters,
            _in_the_air(options),
            options.initial_yaw_rad,
            parameters.trim_speed_m_s if speed is None else speed,
            wind=Wind(*options.wind_ned_m_s),
            place=jsbsim_airplane.Place(*options.origin),
        )
    except ModuleNotFoundError as error:
        raise ValueError(str(error)) from error
    return JsbsimBody(flying, options.wind_ned_m_s, options.gusts_m_s, options.seed, start_ns)


def _in_the_air(options: VehicleOptions) -> Triple:
    """The chosen position, or one high enough to fly."""
    north_m, east_m, down_m = options.start_position_ned_m()
    return (north_m, east_m, -AIRBORNE_M if options.initial_position_ned_m is None else down_m)


def _copter(options: VehicleOptions, parameters: copter.Parameters, start_ns: int) -> CopterBody:
    position = _not_below_ground(options)
    return CopterBody(parameters, position, options.initial_yaw_rad, options.wind_ned_m_s, start_ns)


def _rotorpy(options: VehicleOptions, parameters: rotorpy_copter.Parameters, start_ns: int) -> RotorpyBody:
    vehicle = ROTORPY[0] if options.model == ANY_ROTORPY else options.model.removeprefix(ROTORPY_PREFIX)
    position = _not_below_ground(options)
    try:
        flying = rotorpy_copter.RotorpyCopter(vehicle, parameters)
    except ModuleNotFoundError as error:
        raise ValueError(str(error)) from error
    return RotorpyBody(flying, position, options.initial_yaw_rad, options.wind_ned_m_s, start_ns)


def _not_below_ground(options: VehicleOptions) -> Triple:
    """Where it starts, which must be there or above."""
    position = options.start_position_ned_m()
    if position[2] > 0.0:
        raise ValueError(
            f"the model {options.model} starts on the ground or above, not {position[2]:g} m below"
        )
    return position
