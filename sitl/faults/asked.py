"""What a setpoint asks for, read from its bytes, and what each number may be.

Written apart from the guide's own limits, by what the configuration and the autopilot's parameters mean.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import asin, atan2, hypot, inf, isfinite, nan, radians
from struct import Struct
from typing import Final, NamedTuple

from guidance.config import Config
from guidance.mavlink.profiles import Asked, Profile

SET_ATTITUDE_TARGET: Final = 82
SET_POSITION_TARGET_LOCAL_NED: Final = 84
SETPOINTS: Final = frozenset({SET_ATTITUDE_TARGET, SET_POSITION_TARGET_LOCAL_NED})

_ATTITUDE_TARGET: Final = Struct("<I8f")
_POSITION_TARGET: Final = Struct("<I11f")
_FLOAT: Final = Struct("<f")
#: Of an angle that was a quaternion of 32 bits on its way.
_ROUNDED_RAD: Final = 1e-6
#: What stands is asked for less: of the speed (RO_SPEED_TH, 0.1 m/s) from which a PX4 rover moves its wheels.
_STANDS_M_S: Final = 0.05
#: Of an airplane's pitch, whatever its autopilot would do.
_NOSE_DOWN_DEG: Final = -30.0
_NOSE_UP_DEG: Final = 25.0


class Range(NamedTuple):
    """A number of a setpoint, and its lowest and highest."""

    name: str
    low: float
    high: float


#: The autopilot's own limits that are known here, by what they bound.
_BANK: Final = ("FW_R_LIM", "ROLL_LIMIT_DEG")
_PITCH_LOW: Final = ("FW_P_LIM_MIN", "PTCH_LIM_MIN_DEG")
_PITCH_HIGH: Final = ("FW_P_LIM_MAX", "PTCH_LIM_MAX_DEG")
_UP: Final = ("MPC_Z_VEL_MAX_UP", "WP_SPD_UP")
_DOWN: Final = ("MPC_Z_VEL_MAX_DN", "WP_SPD_DN")
OWN_LIMITS: Final = (*_BANK, *_PITCH_LOW, *_PITCH_HIGH, *_UP, *_DOWN, "WP_SPEED")


def ranges(config: Config, profile: Profile, told: Mapping[str, float]) -> tuple[Range, ...]:
    """Of the numbers of `numbers`, as the wire rounds them; `told` are parameters of `OWN_LIMITS`."""

    def of(names: tuple[str, ...], otherwise: float) -> float:
        return next((told[name] for name in names if name in told), otherwise)

    limits = config.limits
    rates = tuple(
        Range(f"{name} rate", -_float32(rate), _float32(rate))
        for name, rate in (
            ("roll", limits.roll_rate_max_rad_s),
            ("pitch", limits.pitch_rate_max_rad_s),
            ("yaw", limits.yaw_rate_max_rad_s),
        )
    )
    throttle = Range("throttle", profile.thrust_min, profile.thrust_max)
    match profile.asked:
        case Asked.RATES_SPEED | Asked.YAW_RATE_SPEED:
            full_m_s = told.get(profile.full_thrust_parameter, config.vehicle.speed_at_full_thrust_m_s)
            low, high = limits.speed_min_m_s / full_m_s, limits.speed_max_m_s / full_m_s
            return (*rates, Range("thrust", _float32(max(low, -1.0)), _float32(min(high, 1.0))))
        case Asked.RATES_THROTTLE:
            return (*rates, throttle)
        case Asked.ATTITUDE_THROTTLE:
            bank = radians(min(config.airplane.bank_max_deg or inf, of(_BANK, inf))) + _ROUNDED_RAD
            lowest = radians(max(_NOSE_DOWN_DEG, of(_PITCH_LOW, -inf))) - _ROUNDED_RAD
            highest = radians(min(_NOSE_UP_DEG, of(_PITCH_HIGH, inf))) + _ROUNDED_RAD
            return (Range("bank", -bank, bank), Range("pitch", lowest, highest), throttle)
        case Asked.VELOCITY_YAW_RATE:
            up, down = (0.0, 0.0) if profile.planar else (of(_UP, inf), of(_DOWN, inf))
            return (
                Range("level speed", 0.0, limits.speed_max_m_s * (1.0 + 1e-6)),
                Range("velocity down", -_float32(up), _float32(down)),
                rates[2],
            )


def numbers(profile: Profile, message_id: int, payload: bytes) -> tuple[int, tuple[float, ...]]:
    """The setpoint's time (ms) and what it asks for, as `ranges` has it; NaN where a message of the other
    kind, or an attitude that is none, leaves nothing to be read."""
    if message_id == SET_POSITION_TARGET_LOCAL_NED:
        boot_ms, *fields = _unpacked(_POSITION_TARGET, payload)
        north, east, down = fields[3:6]
        asked = (hypot(north, east), down, fields[10])
        return int(boot_ms), asked if profile.asked is Asked.VELOCITY_YAW_RATE else (nan,)
    boot_ms, w, x, y, z, p, q, r, thrust = _unpacked(_ATTITUDE_TARGET, payload)
    if profile.asked is Asked.VELOCITY_YAW_RATE:
        return int(boot_ms), (nan,)
    if profile.asked is not Asked.ATTITUDE_THROTTLE:
        return int(boot_ms), (p, q, r, thrust)
    length = w * w + x * x + y * y + z * z
    if not (isfinite(length) and abs(length - 1.0) < 1e-5):
        return int(boot_ms), (nan, nan, thrust)
    roll = atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    return int(boot_ms), (roll, pitch, thrust)


def stays(profile: Profile, asked: tuple[float, ...]) -> bool:
    """Whether it asks the vehicle to stay as it is: an airplane to fly straight on. A PX4 rover's velocity
    has a length even then, as its direction is the heading."""
    if profile.asked is Asked.ATTITUDE_THROTTLE:
        return abs(asked[0]) <= _ROUNDED_RAD
    if profile.asked is Asked.VELOCITY_YAW_RATE and profile.planar:
        return asked[0] <= _STANDS_M_S and not any(asked[1:])
    return not any(asked)


def _float32(value: float) -> float:
    return float(_FLOAT.unpack(_FLOAT.pack(value))[0])


def _unpacked(form: Struct, payload: bytes) -> tuple[float, ...]:
    """The first fields of a payload, whose last zeros are not sent."""
    return form.unpack(payload[: form.size].ljust(form.size, b"\0"))
