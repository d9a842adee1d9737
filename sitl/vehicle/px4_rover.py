"""PX4 as a rover: OFFBOARD takes a velocity; SET_ATTITUDE_TARGET keeps OFFBOARD alive, and it stands.

After `AckermannPosVelControl.cpp` and what was measured. PX4's land detector of rovers: armed is not landed.
There is nothing here that navigates: in all other modes it stands.
"""

from __future__ import annotations

import math
from typing import ClassVar, Final

from sitl.models.rover import steered
from sitl.plant import euler_from_attitude
from sitl.vehicle.body import BodyState
from sitl.vehicle.controls import Control, Drive
from sitl.vehicle.px4 import COMMANDER_NS, Px4
from sitl.vehicle.px4_modes import OFFBOARD
from sitl.vehicle.px4_parameters import COMMON, ROVER
from sitl.vehicle.px4_targets import Target, TrajectoryTarget

PERIOD_NS: Final = 20_000_000


class Px4Rover(Px4):
    """An Ackermann rover."""

    idle: ClassVar[Control] = Drive()
    gives: ClassVar[tuple[type, ...]] = (Drive,)
    parameter_defaults: ClassVar = {**COMMON, **ROVER}

    def offboard(self, target: Target | None, state: BodyState) -> Control:
        if not isinstance(target, TrajectoryTarget):
            return self.idle
        value, speed_max = self.parameters, self.parameters["RO_SPEED_LIM"]
        north, east, _ = target.velocity_ned_m_s
        if not math.isfinite(north + east):
            north, east = (
                to - at for to, at in zip(target.position_ned_m[:2], state.position_ned_m[:2], strict=True)
            )
        if not math.isfinite(north + east):
            return self.idle
        seen = state if self.seen is None else self.seen()
        heading = euler_from_attitude(seen.attitude_wxyz)[2]
        yaw_rate_max = math.radians(value["RO_YAW_RATE_LIM"])
        yaw_rate, speed = steered(value["RO_YAW_P"], yaw_rate_max, heading, north, east)
        return Drive(yaw_rate, min(speed, speed_max))

    def automatic(self, state: BodyState) -> Control:
        return self.idle

    def period_ns(self) -> int:
        steers = self.custom_mode == OFFBOARD and isinstance(self.target, TrajectoryTarget)
        return PERIOD_NS if steers else COMMANDER_NS
