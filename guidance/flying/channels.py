"""What the channels of steps (`tune.excitation`) are: fields of a demand, of a setpoint, and of the state.

Those of vehicles that drive; to step other vehicles, add theirs.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, sin
from typing import NamedTuple

from guidance.estimate import Estimate
from guidance.mavlink.setpoints import Demand
from guidance.records import Setpoint
from guidance.se3 import Vec3, yaw_of
from guidance.tune.excitation import SPEED, YAW_RATE


class Measured(NamedTuple):
    """A channel as the autopilot measured it at `instant_ns`."""

    instant_ns: int
    value: float


def asked(demand: Demand, values: Mapping[str, float]) -> Demand:
    """The demand with these channels in place of its own."""
    rates = demand.body_rates_frd_rad_s
    return demand._replace(
        body_rates_frd_rad_s=Vec3(rates.x, rates.y, values.get(YAW_RATE, rates.z)),
        speed_m_s=values.get(SPEED, demand.speed_m_s),
    )


def sent(channel: str, setpoint: Setpoint) -> float:
    """The channel's value in what was sent."""
    return setpoint.speed_m_s if channel == SPEED else setpoint.body_rates_frd_rad_s[2]


def measured(channel: str, estimate: Estimate) -> Measured:
    """The newest measurement of the channel, not predicted; the speed is over ground, along the heading."""
    attitude, position = estimate.attitude, estimate.position
    if channel == SPEED:
        yaw, velocity = yaw_of(attitude.attitude), position.velocity_ned_m_s
        return Measured(position.instant_ns, velocity.x * cos(yaw) + velocity.y * sin(yaw))
    return Measured(attitude.instant_ns, attitude.body_rates_frd_rad_s.z)
