"""PX4 as a UUV: body rates or an attitude, and thrust along +x.

PX4's land detector of rovers serves it: armed is not landed.
"""

from __future__ import annotations

import math
from typing import ClassVar

from sitl.plant import STOP, PlantCommand
from sitl.vehicle.attitude_error import attitude_error
from sitl.vehicle.body import BodyState
from sitl.vehicle.controls import Control
from sitl.vehicle.px4 import COMMANDER_NS, Px4
from sitl.vehicle.px4_modes import OFFBOARD
from sitl.vehicle.px4_parameters import COMMON, UUV
from sitl.vehicle.px4_targets import AttitudeTarget, Target


class Px4Uuv(Px4):
    """A submarine. There is nothing that navigates in it: in all other modes it stands still."""

    idle: ClassVar[Control] = STOP
    gives: ClassVar[tuple[type, ...]] = (PlantCommand,)
    parameter_defaults: ClassVar = {**COMMON, **UUV}

    def offboard(self, target: Target | None, state: BodyState) -> Control:
        if not isinstance(target, AttitudeTarget):
            return STOP
        most = self.parameters["UUV_THRUST_SAT"]
        thrust = min(max(_finite(target.thrust), -most), most)
        speed = thrust * self.options.speed_at_full_thrust_m_s
        # A rate that is not a number reaches no actuator.
        p, q, r = (_finite(rate) for rate in target.body_rates_frd_rad_s)
        if target.attitude_wxyz is not None:
            if not all(map(math.isfinite, target.attitude_wxyz)):
                return STOP
            ep, eq, er = attitude_error(state.attitude_wxyz, target.attitude_wxyz)
            # PX4's gains are torques per angle; over the kinematic plant they are rates per angle (1/s).
            gains = self.parameters
            p, q = gains["UUV_ROLL_P"] * ep, gains["UUV_PITCH_P"] * eq
            r += gains["UUV_YAW_P"] * er
        return PlantCommand((p, q, r), speed)

    def automatic(self, state: BodyState) -> Control:
        return STOP

    def period_ns(self) -> int:
        target = self.target
        looks = self.custom_mode == OFFBOARD and isinstance(target, AttitudeTarget)
        if looks and target is not None and target[0] is not None:
            return self.loop_ms * 1_000_000
        return COMMANDER_NS


def _finite(value: float) -> float:
    return value if math.isfinite(value) else 0.0
