"""What the channels of steps (`tune.excitation`) are: fields of a demand, of a setpoint, and of the state."""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, sin
from typing import Final, NamedTuple

from guidance.estimate import Estimate
from guidance.mavlink.setpoints import Demand
from guidance.records import Setpoint
from guidance.se3 import Quaternion, Vec3, from_euler, norm, pitch_of, roll_of, yaw_of
from guidance.tune.excitation import GRAVITY_M_S2

#: Axes of a velocity in NED.
_AXES: Final = {"north_m_s": 0, "east_m_s": 1, "down_m_s": 2}


class Measured(NamedTuple):
    """A channel as the autopilot measured it at `instant_ns`, and what else moves it, in units a second."""

    instant_ns: int
    value: float
    push: float = 0.0


def asked(demand: Demand, estimate: Estimate, values: Mapping[str, float]) -> Demand:
    """The demand with these channels in place of its own."""
    rates, velocity, own = demand.body_rates_frd_rad_s, demand.velocity_ned_m_s, demand.attitude
    roll = values.get("roll_rad", roll_of(own))
    pitch = values.get("pitch_rad", pitch_of(own))
    return Demand(
        body_rates_frd_rad_s=Vec3(rates.x, rates.y, values.get("yaw_rate_rad_s", rates.z)),
        speed_m_s=values.get("speed_m_s", demand.speed_m_s),
        attitude=from_euler(roll, pitch, yaw_of(estimate.pose.attitude)),
        throttle=values.get("throttle", demand.throttle),
        velocity_ned_m_s=Vec3(*(values.get(name, velocity[n]) for name, n in _AXES.items())),
        yaw_rate_rad_s=values.get("yaw_rate_rad_s", demand.yaw_rate_rad_s),
    )


def sent(channel: str, setpoint: Setpoint) -> float:
    """The channel's value in what was sent; KeyError for none."""
    if channel in _AXES:
        return setpoint.velocity_ned_m_s[_AXES[channel]]
    attitude = Quaternion(*setpoint.attitude_wxyz)
    return {
        "yaw_rate_rad_s": setpoint.body_rates_frd_rad_s[2],
        "speed_m_s": setpoint.speed_m_s,
        "roll_rad": roll_of(attitude),
        "pitch_rad": pitch_of(attitude),
        "throttle": setpoint.thrust,
    }[channel]


def measured(channel: str, estimate: Estimate) -> Measured:
    """The newest measurement of the channel, not predicted; KeyError for none.

    Speed is over ground, along the level heading; that of a throttle is the whole, which climbing slows.
    """
    attitude, position = estimate.attitude, estimate.position
    velocity = position.velocity_ned_m_s
    if channel in _AXES:
        return Measured(position.instant_ns, velocity[_AXES[channel]])
    if channel == "speed_m_s":
        yaw = yaw_of(attitude.attitude)
        return Measured(position.instant_ns, velocity.x * cos(yaw) + velocity.y * sin(yaw))
    if channel == "throttle":
        speed = norm(velocity)
        return Measured(position.instant_ns, speed, GRAVITY_M_S2 * velocity.z / speed if speed > 1.0 else 0.0)
    found = {
        "yaw_rate_rad_s": attitude.body_rates_frd_rad_s.z,
        "roll_rad": roll_of(attitude.attitude),
        "pitch_rad": pitch_of(attitude.attitude),
    }
    return Measured(attitude.instant_ns, found[channel])
