"""Which handler drives a profile's vehicle."""

from __future__ import annotations

from guidance.config import Config
from guidance.flying import Handler
from guidance.flying.airplane import Airplane
from guidance.flying.copter_rates import CopterRates
from guidance.flying.excited import Excited
from guidance.flying.excited_airplane import ExcitedAirplane
from guidance.flying.ground import Ground, Px4Rover
from guidance.flying.rates import Rates
from guidance.flying.velocity import Velocity
from guidance.mavlink.profiles import Asked, Handling, Profile


def handler_of(config: Config, profile: Profile) -> Handler:
    """A new one, for a checked configuration; around it the steps, if it has any."""
    own, steps = _own(config, profile), config.excitation
    if not steps.runs:
        return own
    if isinstance(own, Airplane):
        return ExcitedAirplane(own, steps)
    return Excited(own, steps, own.driven) if isinstance(own, Px4Rover) else Excited(own, steps)


def _own(config: Config, profile: Profile) -> Handler:
    match profile.handling:
        case Handling.GROUND if profile.asked is Asked.VELOCITY_YAW_RATE:
            return Px4Rover(config)
        case Handling.GROUND if config.ground.enabled:
            return Ground(config)
        case Handling.RATES | Handling.GROUND:
            return Rates(config, planar=profile.planar)
        case Handling.AIRPLANE:
            return Airplane(config)
        case Handling.VELOCITY if profile.asked is Asked.RATES_THROTTLE:
            return CopterRates(config)
        case Handling.VELOCITY:
            return Velocity(config)
