"""PX4 as a UUV: body rates, an attitude or both, and thrust along +x.

After `uuv_att_control.cpp` of 1.14 to main of 2026-03: with an attitude, torques are P of the angle to it
and D of what the rates miss; over the kinematic plant, which has its rates at once, that is a turn by P / D
on top of them. Rates alone move it since 1.17 (PX4/PX4-Autopilot#25052); an older one has no output by them.

The other modes are flown as `uuv_att_control.cpp` and `uuv_pos_control.cpp` fly them, with sticks at neutral.
MANUAL gives the thrusters nothing. Before 1.17 no other mode stops them: the automatic ones (Hold, Return,
Land, until that disarms) go on to the last attitude with the last thrust, those of sticks go on with the last
output. Since 1.17 they hold where it is; the way back to where it was up to UUV_SP_MAX_AGE (2 s) before is
left out here.

PX4's land detector of rovers serves it: armed is not landed.
"""

from __future__ import annotations

import math
from typing import ClassVar, Final

from sitl.plant import STOP, PlantCommand
from sitl.vehicle.attitude_error import attitude_error
from sitl.vehicle.body import BodyState
from sitl.vehicle.command import TEMPORARILY_REJECTED
from sitl.vehicle.controls import Control
from sitl.vehicle.px4 import COMMANDER_NS, Px4
from sitl.vehicle.px4_modes import ACRO, ALTCTL, LOSS_MODES, MANUAL, OFFBOARD, POSCTL, STABILIZED
from sitl.vehicle.px4_parameters import COMMON, UUV
from sitl.vehicle.px4_targets import AttitudeTarget, Target

#: The first version that turns by rates without an attitude.
BY_RATES_ALONE: Final = (1, 17, 0)
#: Of COM_RC_IN_MODE.
_NO_STICKS: Final = 4
_BY_HAND: Final = frozenset({MANUAL, ALTCTL, POSCTL, ACRO, STABILIZED})
#: What it would fly to if it was never told: level, to the north, without thrust.
_NEVER_TOLD: Final = AttitudeTarget((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)


class Px4Uuv(Px4):
    """A submarine. There is nothing that navigates in it."""

    idle: ClassVar[Control] = STOP
    gives: ClassVar[tuple[type, ...]] = (PlantCommand,)
    parameter_defaults: ClassVar = {**COMMON, **UUV}
    # With MAV_SYS_STATUS_SENSOR_RC_RECEIVER: sticks are heard, by its tether.
    sensors: ClassVar = (50413613, 50413613, 589400127, 857851967)
    # "Manual" is Stabilized (`failsafe.cpp`); a terminated one has nothing at its outputs.
    loss_modes: ClassVar = {**LOSS_MODES, 2: STABILIZED, 6: MANUAL}

    def start(self) -> None:
        super().start()
        self._told: AttitudeTarget = _NEVER_TOLD
        self._given: PlantCommand = STOP

    @property
    def _older(self) -> bool:
        return self.options.px4_version < BY_RATES_ALONE

    def demand(self, state: BodyState) -> Control:
        if isinstance(self.target, AttitudeTarget) and self.target.attitude_wxyz is not None:
            self._told = self.target
        given = super().demand(state)
        assert isinstance(given, PlantCommand)
        self._given = given
        return given

    def select_mode(self, custom_mode: int) -> int:
        unheard = self.parameters["COM_RC_IN_MODE"] == _NO_STICKS
        if self.armed and unheard and custom_mode in _BY_HAND:
            return TEMPORARILY_REJECTED
        return super().select_mode(custom_mode)

    @property
    def at_rest(self) -> bool:
        """It floats."""
        return False

    def offboard(self, target: Target | None, state: BodyState) -> PlantCommand:
        if not isinstance(target, AttitudeTarget):
            return STOP
        older = self._older
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

    def automatic(self, state: BodyState) -> PlantCommand:
        if not self._older or self.custom_mode == MANUAL:
            return STOP
        return self._given if self.custom_mode in _BY_HAND else self.offboard(self._told, state)

    def period_ns(self) -> int:
        if self.custom_mode != OFFBOARD:
            goes_on = self._older and self.custom_mode not in _BY_HAND
            return self.loop_ms * 1_000_000 if goes_on else COMMANDER_NS
        target = self.target
        looks = isinstance(target, AttitudeTarget)
        if looks and target is not None and target[0] is not None:
            return self.loop_ms * 1_000_000
        return COMMANDER_NS


def _finite(value: float) -> float:
    return value if math.isfinite(value) else 0.0
