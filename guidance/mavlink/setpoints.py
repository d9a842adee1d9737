"""From what the handling asks for to the bytes of a setpoint: one message and mask for each profile's row.

Every field is clamped into the range that the firmware gives a meaning, and none that is not finite leaves:
to an autopilot NaN means anything but "nothing".
"""

from __future__ import annotations

from math import nan, sqrt
from struct import Struct
from typing import Final, NamedTuple

from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.codec import Payload
from guidance.mavlink.profiles import Asked, Profile
from guidance.se3 import IDENTITY, ZERO, Quaternion, Vec3

#: Time, attitude, body rates, thrust; target, mask. The extension, thrust_body, is zero and left out.
_ATTITUDE_TARGET: Final = Struct("<I8f3B")
#: Time, position, velocity, acceleration, yaw, yaw rate; mask; target, frame.
_POSITION_TARGET: Final = Struct("<I11fH3B")

#: No vehicle is asked to turn faster than this, whatever the configuration says (4 pi, two turns a second).
BODY_RATE_MAX_RAD_S: Final = 12.566370614359172
#: Nor to go faster, m/s.
VELOCITY_MAX_M_S: Final = 1000.0


class Demand(NamedTuple):
    """What a handling asks for; a profile sends those that its `asked` names.

    Body rates FRD, rad/s; forward speed, m/s; attitude body to NED; throttle 0 to 1; velocity NED, m/s; yaw
    rate to the right, rad/s.
    """

    body_rates_frd_rad_s: Vec3 = ZERO
    speed_m_s: float = 0.0
    attitude: Quaternion = IDENTITY
    throttle: float = 0.0
    velocity_ned_m_s: Vec3 = ZERO
    yaw_rate_rad_s: float = 0.0


class Outgoing(NamedTuple):
    """A demand after the profile's clamps; what the profile does not send is zero, the attitude identity.

    `speed_m_s` is the forward speed that `thrust` stands for, or the length of the velocity; 0 where thrust
    is throttle.
    """

    body_rates_frd_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    thrust: float = 0.0
    speed_m_s: float = 0.0
    attitude_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    velocity_ned_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def is_finite(self) -> bool:
        """Whether every number is."""
        total = self.thrust + self.speed_m_s
        total += sum(self.body_rates_frd_rad_s) + sum(self.attitude_wxyz) + sum(self.velocity_ned_m_s)
        return total - total == 0.0


def _clamp(value: float, low: float, high: float) -> float:
    """Into [low, high]; NaN stays NaN because it is neither below nor above."""
    return low if value < low else high if value > high else value


def _rate(value: float) -> float:
    return _clamp(value, -BODY_RATE_MAX_RAD_S, BODY_RATE_MAX_RAD_S)


def _unit(attitude: Quaternion) -> tuple[float, float, float, float]:
    """Of length 1; of length 0 it has no direction, and is NaN."""
    w, x, y, z = attitude
    length = sqrt(w * w + x * x + y * y + z * z)
    scale = 1.0 / length if length > 0.0 else nan
    return (scale * w, scale * x, scale * y, scale * z)


def outgoing(profile: Profile, demand: Demand, speed_at_full_thrust_m_s: float) -> Outgoing:
    """The demand in the ranges that the autopilot gives a meaning.

    Where thrust is a speed it is `clamp(speed / speed_at_full_thrust_m_s)`. Inputs should be finite: a NaN
    comes out as NaN, which the caller must refuse and `setpoint_message` will not pack.
    """
    p, q, r = demand.body_rates_frd_rad_s
    low, high = profile.thrust_min, profile.thrust_max
    match profile.asked:
        case Asked.RATES_SPEED | Asked.ATTITUDE_RATES_SPEED | Asked.YAW_RATE_SPEED:
            rates = (_rate(p), _rate(q), _rate(r))
            if profile.asked is Asked.YAW_RATE_SPEED:
                rates = (0.0, 0.0, rates[2])
            thrust = _clamp(demand.speed_m_s / speed_at_full_thrust_m_s, low, high)
            out = Outgoing(rates, thrust, thrust * speed_at_full_thrust_m_s)
            if profile.asked is Asked.ATTITUDE_RATES_SPEED:
                return out._replace(attitude_wxyz=_unit(demand.attitude))
            return out
        case Asked.RATES_THROTTLE:
            return Outgoing((_rate(p), _rate(q), _rate(r)), _clamp(demand.throttle, low, high))
        case Asked.ATTITUDE_THROTTLE:
            return Outgoing(thrust=_clamp(demand.throttle, low, high), attitude_wxyz=_unit(demand.attitude))
        case Asked.VELOCITY_YAW_RATE:
            x, y, z = (_clamp(v, -VELOCITY_MAX_M_S, VELOCITY_MAX_M_S) for v in demand.velocity_ned_m_s)
            return Outgoing(
                (0.0, 0.0, _rate(demand.yaw_rate_rad_s)),
                speed_m_s=sqrt(x * x + y * y + z * z),
                velocity_ned_m_s=(x, y, z),
            )


def setpoint_message(
    profile: Profile, setpoint: Outgoing, system: int, component: int, boot_ms: int
) -> Payload:
    """SET_ATTITUDE_TARGET (82) or SET_POSITION_TARGET_LOCAL_NED (84) for this autopilot.

    Raises ValueError for a number that is not finite.
    """
    if not setpoint.is_finite():
        raise ValueError(f"a setpoint that is not finite: {setpoint}")
    if profile.asked is Asked.VELOCITY_YAW_RATE:
        payload = _POSITION_TARGET.pack(
            boot_ms & 0xFFFFFFFF,
            *(0.0, 0.0, 0.0),
            *setpoint.velocity_ned_m_s,
            *(0.0, 0.0, 0.0),
            0.0,
            setpoint.body_rates_frd_rad_s[2],
            profile.type_mask,
            system,
            component,
            dialect.MAV_FRAME_LOCAL_NED,
        )
        return Payload(dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED, payload)
    payload = _ATTITUDE_TARGET.pack(
        boot_ms & 0xFFFFFFFF,
        *setpoint.attitude_wxyz,
        *setpoint.body_rates_frd_rad_s,
        setpoint.thrust,
        system,
        component,
        profile.type_mask,
    )
    return Payload(dialect.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET, payload)
