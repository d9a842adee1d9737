"""What a setpoint commands, channel by channel: those of its fields that its message carries."""

from __future__ import annotations

from collections.abc import Callable
from math import degrees
from typing import Final, NamedTuple

from guidance.mavlink.profiles import Asked, Profile
from guidance.records import Setpoint
from guidance.se3 import Quaternion, pitch_of, roll_of


class Channel(NamedTuple):
    """A quantity of a setpoint, in its unit."""

    name: str
    unit: str
    of: Callable[[Setpoint], float]


_YAW_RATE: Final = Channel("yaw rate", "rad/s", lambda s: s.body_rates_frd_rad_s[2])
_RATES: Final = (
    Channel("roll rate", "rad/s", lambda s: s.body_rates_frd_rad_s[0]),
    Channel("pitch rate", "rad/s", lambda s: s.body_rates_frd_rad_s[1]),
    _YAW_RATE,
)
_SPEED: Final = Channel("speed", "m/s", lambda s: s.speed_m_s)
_THRUST: Final = Channel("thrust", "", lambda s: s.thrust)
_ATTITUDE: Final = (
    Channel("bank", "deg", lambda s: degrees(roll_of(Quaternion(*s.attitude_wxyz)))),
    Channel("pitch", "deg", lambda s: degrees(pitch_of(Quaternion(*s.attitude_wxyz)))),
)
_LEVEL_VELOCITY: Final = (
    Channel("velocity north", "m/s", lambda s: s.velocity_ned_m_s[0]),
    Channel("velocity east", "m/s", lambda s: s.velocity_ned_m_s[1]),
)
_VELOCITY: Final = (
    *_LEVEL_VELOCITY,
    Channel("velocity down", "m/s", lambda s: s.velocity_ned_m_s[2]),
    Channel("yaw rate about down", "rad/s", lambda s: s.body_rates_frd_rad_s[2]),
)


def channels_of(profile: Profile) -> tuple[Channel, ...]:
    """What the profile sends. The attitude beside an underwater vehicle's rates is its own: no command."""
    match profile.asked:
        case Asked.RATES_SPEED | Asked.ATTITUDE_RATES_SPEED:
            return (*_RATES, _SPEED, _THRUST)
        case Asked.YAW_RATE_SPEED:
            return (_YAW_RATE, _SPEED, _THRUST)
        case Asked.ATTITUDE_THROTTLE:
            return (*_ATTITUDE, _THRUST)
        case Asked.RATES_THROTTLE:
            return (*_RATES, _THRUST)
        case Asked.VELOCITY_YAW_RATE:
            return _LEVEL_VELOCITY if profile.planar else _VELOCITY
