"""PX4 as an airplane: OFFBOARD takes attitude or body rates, and throttle; it turns by banking.

After `FixedwingAttitudeControl.cpp`, `FixedwingRateControl.cpp` and the recorded flight. The recorded pilot
had no sticks: in the modes of a pilot it flies straight on and level.
"""

from __future__ import annotations

import math
from typing import ClassVar, Final

from sitl.plant import euler_from_attitude
from sitl.vehicle.airplane_pilot import (
    AirplanePilot,
    Circle,
    Envelope,
    Landing,
    Plan,
    Straight,
    Takeoff,
    course_of,
    height_of,
    on_ground,
    standing,
)
from sitl.vehicle.body import BodyState
from sitl.vehicle.controls import Attitude, Control, RatesThrottle
from sitl.vehicle.px4 import (
    COMMANDER_NS,
    LANDED_IN_AIR,
    LANDED_LANDING,
    LANDED_ON_GROUND,
    LANDED_TAKEOFF,
    Px4,
)
from sitl.vehicle.px4_modes import ALTCTL, LAND, LOITER, MISSION, OFFBOARD, POSCTL, RTL, TAKEOFF
from sitl.vehicle.px4_parameters import COMMON, PLANE
from sitl.vehicle.px4_targets import AttitudeTarget, Target

PERIOD_NS: Final = 20_000_000
#: It counts as climbed this far below the height of take-off, m (NAV_FW_ALT_RAD).
CLIMBED_M: Final = 10.0


class Px4Plane(Px4):
    """A fixed wing."""

    idle: ClassVar[Control] = Attitude()
    gives: ClassVar[tuple[type, ...]] = (Attitude, RatesThrottle)
    parameter_defaults: ClassVar = {**COMMON, **PLANE}
    sensors: ClassVar = (50348093, 50413629, 589334591, 857786431)
    standard_modes: ClassVar = {POSCTL: 3, ALTCTL: 4}
    finds_wind: ClassVar = True

    def enter(self, mode: int) -> None:
        self._plan: Plan | None = None
        self._pilot = AirplanePilot()

    def offboard(self, target: Target | None, state: BodyState) -> Control:
        if not isinstance(target, AttitudeTarget):
            # A trajectory is proof of life; nothing follows it here.
            return self.automatic(state)
        throttle = _throttle(target.thrust)
        if target.attitude_wxyz is not None:
            if not all(map(math.isfinite, target.attitude_wxyz)):
                return Attitude(0.0, 0.0, throttle)
            roll, pitch, _ = euler_from_attitude(target.attitude_wxyz)
            return Attitude(roll, pitch, throttle)
        p, q, r = target.body_rates_frd_rad_s
        if self.parameters["FW_ACRO_YAW_EN"] == 0.0:
            r = 0.0
        if not all(map(math.isfinite, (p, q, r))):
            # One torque that is no number drops all three: the surfaces go to their trim.
            p = q = r = 0.0
        return RatesThrottle((p, q, r), throttle)

    def automatic(self, state: BodyState) -> Control:
        if self._plan is None or (on_ground(state) and not isinstance(self._plan, Takeoff)):
            self._plan = self._made(self.custom_mode, state)
        return self._pilot.fly(self._plan, self._envelope(), state, self.now_ns)

    def _made(self, mode: int, state: BodyState) -> Plan:
        """The plan of a mode that begins here."""
        north, east, _ = state.position_ned_m
        height, radius = height_of(state), self.parameters["NAV_LOITER_RAD"]
        home_m = -self.home_ned_m[2]
        if mode == TAKEOFF:
            climb_m = self.parameters["MIS_TAKEOFF_ALT"]
            self.text(6, f"Using default takeoff altitude: {climb_m:.1f} m")
            return Takeoff(course_of(state), home_m + climb_m)
        if mode == LAND:
            return Landing(course_of(state))
        if mode == RTL:
            height = max(height, home_m + self.parameters["RTL_RETURN_ALT"])
            return Circle(self.home_ned_m[0], self.home_ned_m[1], radius, height)
        if mode in (LOITER, MISSION):
            return Circle(north, east, radius, height)
        return Straight(course_of(state), height)

    def _envelope(self) -> Envelope:
        value = self.parameters
        return Envelope(
            value["FW_AIRSPD_MIN"],
            value["FW_AIRSPD_TRIM"],
            math.radians(value["FW_R_LIM"]),
            math.radians(value["FW_P_LIM_MIN"]),
            math.radians(value["FW_P_LIM_MAX"]),
            value["FW_T_CLMB_MAX"],
            value["FW_T_SINK_R_SP"],
            value["FW_THR_MAX"],
            math.radians(value["FW_TKO_PITCH_MIN"]),
        )

    def period_ns(self) -> int:
        flown = self.custom_mode == OFFBOARD and isinstance(self.target, AttitudeTarget)
        return COMMANDER_NS if flown else PERIOD_NS

    def progress(self) -> None:
        plan, state = self._plan, self.body
        if not isinstance(plan, Takeoff) or state is None or height_of(state) < plan.height_m - CLIMBED_M:
            return
        north, east, _ = state.position_ned_m
        self.intended_mode = LOITER
        self.fly(LOITER)
        self._plan = Circle(north, east, self.parameters["NAV_LOITER_RAD"], plan.height_m)

    def arm(self, *, forced: bool) -> int:
        was_armed, result = self.armed, super().arm(forced=forced)
        if self.armed and not was_armed and self.landed and self.body is not None:
            self.home_ned_m = self.body.position_ned_m
        return result

    @property
    def landed(self) -> bool:
        return self.body is None or standing(self.body)

    @property
    def landed_state(self) -> int:
        if self.landed:
            return LANDED_ON_GROUND
        if self.custom_mode == LAND:
            return LANDED_LANDING
        return LANDED_TAKEOFF if self.custom_mode == TAKEOFF else LANDED_IN_AIR


def _throttle(thrust: float) -> float:
    """The receiver clamps nothing, the motor does."""
    return min(1.0, max(0.0, thrust)) if math.isfinite(thrust) else 0.0
