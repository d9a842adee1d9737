"""What the channels of steps (`tune.excitation`) are: fields of a demand, of a setpoint, and of the state.

To step other vehicles, add theirs.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import atan2, cos, hypot, sin
from typing import Final, NamedTuple

from guidance.estimate import Estimate
from guidance.mavlink.setpoints import Demand
from guidance.records import Setpoint
from guidance.se3 import Quaternion, Vec3, from_euler, norm, pitch_of, roll_of, subtract, yaw_of
from guidance.tune.excitation import GRAVITY_M_S2, PITCH, ROLL, SPEED, THROTTLE, VELOCITY, YAW_RATE
from guidance.tune.way_back import Place

#: Slower (m/s) than this, what flies has no course to speak of.
MOVING_M_S: Final = 3.0
#: What was held comes out of quaternions and lengths the same to so many digits.
DIGITS: Final = 9


class Measured(NamedTuple):
    """A channel as the autopilot measured it at `instant_ns`, and what else changes it, in units a second."""

    instant_ns: int
    value: float
    push: float = 0.0


def place_of(estimate: Estimate, way: str) -> Place:
    """Where the room of a tuning flight would begin, and along what: the heading, the course of what
    "flies", north of what "hovers" (`ExcitationConfig.way`)."""
    at, velocity = estimate.pose.position, estimate.velocity_ned_m_s
    heading = 0.0 if way == "hovers" else yaw_of(estimate.pose.attitude)
    if way == "flies" and hypot(velocity.x, velocity.y) > MOVING_M_S:
        heading = atan2(velocity.y, velocity.x)
    return Place(at.x, at.y, heading)


def asked(demand: Demand, values: Mapping[str, float]) -> Demand:
    """The demand with these channels in place of its own."""
    rates, attitude = demand.body_rates_frd_rad_s, demand.attitude
    if ROLL in values or PITCH in values:
        roll, pitch = values.get(ROLL, roll_of(attitude)), values.get(PITCH, pitch_of(attitude))
        attitude = from_euler(roll, pitch, yaw_of(attitude))
    velocity = (values.get(axis, own) for axis, own in zip(VELOCITY, demand.velocity_ned_m_s, strict=True))
    return demand._replace(
        body_rates_frd_rad_s=Vec3(rates.x, rates.y, values.get(YAW_RATE, rates.z)),
        speed_m_s=values.get(SPEED, demand.speed_m_s),
        attitude=attitude,
        throttle=values.get(THROTTLE, demand.throttle),
        velocity_ned_m_s=Vec3(*velocity),
        yaw_rate_rad_s=values.get(YAW_RATE, demand.yaw_rate_rad_s),
    )


def sent(channel: str, setpoint: Setpoint) -> float:
    """The channel's value in what was sent."""
    match channel:
        case "speed_m_s":
            return round(setpoint.speed_m_s, DIGITS)
        case "roll_rad":
            return round(roll_of(Quaternion(*setpoint.attitude_wxyz)), DIGITS)
        case "pitch_rad":
            return round(pitch_of(Quaternion(*setpoint.attitude_wxyz)), DIGITS)
        case "throttle":
            return setpoint.thrust
        case "yaw_rate_rad_s":
            return setpoint.body_rates_frd_rad_s[2]
    return setpoint.velocity_ned_m_s[VELOCITY.index(channel)]


def measured(channel: str, estimate: Estimate, wind_ned_m_s: Vec3) -> Measured:
    """The newest measurement of the channel, not predicted: the speed is over ground, along the heading;
    what the throttle gives is the airspeed in this wind."""
    attitude, position = estimate.attitude, estimate.position
    velocity = position.velocity_ned_m_s
    match channel:
        case "speed_m_s":
            yaw = yaw_of(attitude.attitude)
            return Measured(position.instant_ns, velocity.x * cos(yaw) + velocity.y * sin(yaw))
        case "roll_rad":
            return Measured(attitude.instant_ns, roll_of(attitude.attitude))
        case "pitch_rad":
            return Measured(attitude.instant_ns, pitch_of(attitude.attitude))
        case "throttle":
            through = subtract(velocity, wind_ned_m_s)
            airspeed = norm(through)
            # a climb takes from the speed what a throttle does not
            push = GRAVITY_M_S2 * through.z / max(airspeed, MOVING_M_S)
            return Measured(position.instant_ns, airspeed, push)
        case "yaw_rate_rad_s":
            return Measured(attitude.instant_ns, attitude.body_rates_frd_rad_s.z)
    return Measured(position.instant_ns, velocity[VELOCITY.index(channel)])
