"""PX4 as a multicopter: OFFBOARD takes a velocity, a position, an attitude or body rates with thrust upward.

After `MulticopterPositionControl.cpp`, `PositionControl.cpp`, `mc_att_control` and the recorded flight:
without sticks it sinks in the modes of a pilot.
"""

from __future__ import annotations

import math
from typing import ClassVar, Final

from sitl.plant import Triple
from sitl.vehicle.attitude_error import attitude_error
from sitl.vehicle.body import BodyState
from sitl.vehicle.controls import Control, RatesThrust, Velocity
from sitl.vehicle.copter_pilot import CopterPilot, Land, Manner, Plan, Return, Stand, on_ground, yaw_of
from sitl.vehicle.px4 import (
    LANDED_IN_AIR,
    LANDED_LANDING,
    LANDED_ON_GROUND,
    LANDED_TAKEOFF,
    Px4,
)
from sitl.vehicle.px4_modes import ALTCTL, AUTO, BASE_MODES, LAND, LOITER, OFFBOARD, POSCTL, RTL, TAKEOFF
from sitl.vehicle.px4_parameters import COMMON, COPTER
from sitl.vehicle.px4_targets import AttitudeTarget, Target, TrajectoryTarget

PERIOD_NS: Final = 20_000_000
#: What a failsafe of PX4 makes of it that has no valid setpoint, as recorded in POSCTL without sticks, m/s.
SINK_M_S: Final = 0.5
#: It has climbed this far below the height of take-off, m (NAV_MC_ALT_RAD).
CLIMBED_M: Final = 0.8


class Px4Copter(Px4):
    """A quadrotor."""

    idle: ClassVar[Control] = RatesThrust()
    gives: ClassVar[tuple[type, ...]] = (Velocity, RatesThrust)
    parameter_defaults: ClassVar = {**COMMON, **COPTER}
    standard_modes: ClassVar = {POSCTL: 1, ALTCTL: 4}

    def enter(self, mode: int) -> None:
        self._pilot: CopterPilot | None = None
        self._takeoff_m: float | None = None

    # --- OFFBOARD ---------------------------------------------------------------------------------------

    def offboard(self, target: Target | None, state: BodyState) -> Control:
        match target:
            case AttitudeTarget():
                return self._attitude(target, state)
            case TrajectoryTarget():
                return self._trajectory(target, state)
        return self._stand(state)

    def _attitude(self, target: AttitudeTarget, state: BodyState) -> Control:
        value = self.parameters
        p, q, r = target.body_rates_frd_rad_s
        if target.attitude_wxyz is not None:
            if not all(map(math.isfinite, target.attitude_wxyz)):
                return self._stand(state)
            ep, eq, er = attitude_error(state.attitude_wxyz, target.attitude_wxyz)
            p, q = value["MC_ROLL_P"] * ep, value["MC_PITCH_P"] * eq
            r = value["MC_YAW_P"] * er + _finite(r)
        limits = (value["MC_ROLLRATE_MAX"], value["MC_PITCHRATE_MAX"], value["MC_YAWRATE_MAX"])
        rates = _within((_finite(p), _finite(q), _finite(r)), limits)
        return RatesThrust(rates, max(0.0, min(value["MPC_THR_MAX"], _finite(target.thrust))))

    def _trajectory(self, target: TrajectoryTarget, state: BodyState) -> Control:
        value = self.parameters
        gains = (value["MPC_XY_P"], value["MPC_XY_P"], value["MPC_Z_P"])
        velocity = [
            _finite(fed) + (gain * (to - at) if math.isfinite(to) else 0.0)
            for fed, to, at, gain in zip(
                target.velocity_ned_m_s, target.position_ned_m, state.position_ned_m, gains, strict=True
            )
        ]
        part = min(1.0, value["MPC_XY_VEL_MAX"] / max(1e-9, math.hypot(velocity[0], velocity[1])))
        down = max(-value["MPC_Z_VEL_MAX_UP"], min(value["MPC_Z_VEL_MAX_DN"], velocity[2]))
        turn = _finite(target.yaw_rate_rad_s)
        if math.isfinite(target.yaw_rad):
            turn += value["MC_YAW_P"] * math.remainder(target.yaw_rad - yaw_of(state), 2.0 * math.pi)
        turn_max = math.radians(value["MC_YAWRATE_MAX"])
        return Velocity((part * velocity[0], part * velocity[1], down), max(-turn_max, min(turn_max, turn)))

    # --- what flies by itself ---------------------------------------------------------------------------

    def automatic(self, state: BodyState) -> Control:
        mode = self.custom_mode
        if mode == TAKEOFF:
            return self._climb(state)
        if BASE_MODES.get(mode, AUTO) != AUTO:
            return self.idle if on_ground(state) else Velocity((0.0, 0.0, SINK_M_S))
        if mode not in (RTL, LAND):
            return self._stand(state)
        if self._pilot is None:
            self._pilot = CopterPilot(self._made(mode, state))
        return self.idle if on_ground(state) else self._pilot.fly(self._manner(), state)

    def _stand(self, state: BodyState) -> Control:
        if on_ground(state):
            self._pilot = None
            return self.idle
        self._pilot = self._pilot or CopterPilot(Stand())
        return self._pilot.fly(self._manner(), state)

    def _climb(self, state: BodyState) -> Control:
        value = self.parameters
        if self._takeoff_m is None:
            climb_m = value["MIS_TAKEOFF_ALT"]
            self.text(6, f"Using default takeoff altitude: {climb_m:.1f} m")
            self._takeoff_m = climb_m - self.home_ned_m[2]
            north, east, _ = state.position_ned_m
            self._pilot = CopterPilot(Stand((north, east, -self._takeoff_m)))
        ready_ns = self._armed_ns + round(1e9 * (value["COM_SPOOLUP_TIME"] + value["MPC_TKO_RAMP_T"]))
        if self._pilot is None or (on_ground(state) and self.now_ns < ready_ns):
            return self.idle
        return self._pilot.fly(self._manner()._replace(up_m_s=value["MPC_TKO_SPEED"]), state)

    def _made(self, mode: int, state: BodyState) -> Plan:
        if mode == LAND:
            return Land()
        above_m = self.parameters["RTL_RETURN_ALT"] - self.home_ned_m[2]
        return Return(self.home_ned_m, max(above_m, -state.position_ned_m[2]))

    def _manner(self) -> Manner:
        value = self.parameters
        return Manner(
            value["MPC_XY_P"],
            value["MPC_Z_P"],
            value["MPC_XY_CRUISE"],
            value["MPC_Z_V_AUTO_UP"],
            value["MPC_Z_V_AUTO_DN"],
            value["MPC_LAND_SPEED"],
            value["MPC_LAND_ALT2"],
        )

    def period_ns(self) -> int:
        by_attitude = self.custom_mode == OFFBOARD and isinstance(self.target, AttitudeTarget)
        return self.loop_ms * 1_000_000 if by_attitude else PERIOD_NS

    # --- the commander ----------------------------------------------------------------------------------

    def start(self) -> None:
        self._armed_ns = self.now_ns
        self._flew = True
        super().start()

    def arm(self, *, forced: bool) -> int:
        was_armed, result = self.armed, super().arm(forced=forced)
        if self.armed and not was_armed:
            self._armed_ns = self.now_ns
            self._flew = not self.landed
            if self.landed and self.body is not None:
                self.home_ned_m = self.body.position_ned_m
        return result

    def progress(self) -> None:
        state = self.body
        if state is None:
            return
        self._flew = self._flew or not on_ground(state)
        waits_s = self.parameters["COM_DISARM_PRFLT"]
        waited = self.now_ns - self._armed_ns > round(1e9 * waits_s)
        if waits_s > 0.0 and waited and not self._flew:
            self.armed = False
            self.text(6, "Disarmed by auto preflight disarming")
        elif self.custom_mode == RTL and on_ground(state):
            self.disarm(forced=True)
        elif self._takeoff_m is not None and -state.position_ned_m[2] > self._takeoff_m - CLIMBED_M:
            pilot = self._pilot
            self.intended_mode = LOITER
            self.fly(LOITER)
            self._pilot = pilot

    @property
    def landed(self) -> bool:
        return self.body is None or on_ground(self.body)

    @property
    def landed_state(self) -> int:
        if self.landed:
            return LANDED_ON_GROUND
        if self.custom_mode == LAND:
            return LANDED_LANDING
        return LANDED_TAKEOFF if self.custom_mode == TAKEOFF else LANDED_IN_AIR


def _finite(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def _within(rates: Triple, limits_deg_s: Triple) -> Triple:
    p, q, r = (
        max(-math.radians(most), min(math.radians(most), rate))
        for rate, most in zip(rates, limits_deg_s, strict=True)
    )
    return (p, q, r)
