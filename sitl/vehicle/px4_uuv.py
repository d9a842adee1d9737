"""PX4 as a UUV: body rates, an attitude or both, and thrust along +x.

After `uuv_att_control.cpp` of 1.14 to main of 2026-03: with an attitude, torques are P of the angle to it
and D of what the rates miss; over the kinematic plant, which has its rates at once, that is a turn by P / D
on top of them. Rates alone move it since 1.17 (PX4/PX4-Autopilot#25052); an older one has no output by them.

PX4's land detector of rovers serves it: armed is not landed.
"""

from __future__ import annotations

import math
from typing import ClassVar, Final

from sitl.plant import STOP, PlantCommand
from sitl.vehicle.attitude_error import attitude_error
from sitl.vehicle.body import BodyState
from sitl.vehicle.controls import Control
from sitl.vehicle.px4 import COMMANDER_NS, Px4
from sitl.vehicle.px4_modes import OFFBOARD
from sitl.vehicle.px4_parameters import COMMON, UUV
from sitl.vehicle.px4_targets import AttitudeTarget, Target

#: The first version that turns by rates without an attitude.
BY_RATES_ALONE: Final = (1, 17, 0)


class Px4Uuv(Px4):
    """A submarine. There is nothing that navigates in it: in all other modes it stands still."""

    idle: ClassVar[Control] = STOP
    gives: ClassVar[tuple[type, ...]] = (PlantCommand,)
    parameter_defaults: ClassVar = {**COMMON, **UUV}

    @property
    def at_rest(self) -> bool:
        """It floats."""
        return False

    def offboard(self, target: Target | None, state: BodyState) -> Control:
        if not isinstance(target, AttitudeTarget):
            return STOP
        older = self.options.px4_version < BY_RATES_ALONE
        if older and target.attitude_wxyz is None:
            return STOP
        most = 1.0 if older else self.parameters["UUV_THRUST_SAT"]
        thrust = min(max(_finite(target.thrust), -most), most)
        speed = thrust * self.options.speed_at_full_thrust_m_s
        # A rate that is not a number reaches no actuator.
        p, q, r = (_finite(rate) for rate in target.body_rates_frd_rad_s)
        if target.attitude_wxyz is not None:
            if not all(map(math.isfinite, target.attitude_wxyz)):
                return STOP
            seen = state if self.seen is None else self.seen()
            ep, eq, er = attitude_error(seen.attitude_wxyz, target.attitude_wxyz)
            gains = self.parameters
            p += gains["UUV_ROLL_P"] / gains["UUV_ROLL_D"] * ep
            q += gains["UUV_PITCH_P"] / gains["UUV_PITCH_D"] * eq
            r += gains["UUV_YAW_P"] / gains["UUV_YAW_D"] * er
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
