"""ArduPilot as a rover: GUIDED takes yaw rate (or heading) and forward speed, and stops after 3 s of silence.

After ArduPilot 4.7.0-dev: `Rover/GCS_MAVLink_Rover.cpp` (setpoints), `Rover/mode_guided.cpp` (time-out),
`Rover/mode.h` (numbers), and the recorded flight. The answer of the real rover (delay, slew, gain) is
that of the body.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, Final

from pymavlink.dialects.v20 import all as mavlink

from sitl.plant import Triple, euler_from_attitude
from sitl.vehicle.ardupilot import ArduPilot
from sitl.vehicle.ardupilot_parameters import COMMON, ROVER
from sitl.vehicle.ardupilot_targets import (
    BODY_FRAMES,
    IGNORE_ACCELERATION,
    IGNORE_POSITION,
    IGNORE_TARGET_YAW_RATE,
    IGNORE_THROTTLE,
    IGNORE_VELOCITY,
    IGNORE_YAW,
    IGNORE_YAW_RATE,
    LOCAL_FRAMES,
)
from sitl.vehicle.body import BodyState
from sitl.vehicle.command import FAILED
from sitl.vehicle.controls import Control, Drive

STAND: Final = Drive()

HOLD: Final = 4
LOITER: Final = 5
AUTO: Final = 10
GUIDED: Final = 15
INITIALISING: Final = 16
NAMES: Final = {
    0: "MANUAL",
    1: "ACRO",
    3: "STEERING",
    HOLD: "HOLD",
    LOITER: "LOITER",
    6: "FOLLOW",
    7: "SIMPLE",
    9: "CIRCLE",
    AUTO: "AUTO",
    11: "RTL",
    12: "SMART_RTL",
    GUIDED: "GUIDED",
    INITIALISING: "INITIALISING",
}
#: base_mode of each mode without the custom and armed bits: 64 takes sticks, 8 is guided by the autopilot.
_STICKS: Final = frozenset({0, 1, 3, 7, INITIALISING})
_NO_FLAG: Final = frozenset({HOLD})

#: FRAME_CLASS of a boat.
BOAT: Final = 2
SETPOINT_TIMEOUT_NS: Final = 3_000_000_000
#: Speed at which a loitering boat drives back, per m beyond its radius.
LOITER_PER_S: Final = 0.5


class ArduRover(ArduPilot):
    """A rover, or with FRAME_CLASS 2 a boat."""

    idle: ClassVar[Control] = STAND
    gives: ClassVar[tuple[type, ...]] = (Drive,)
    parameter_defaults: ClassVar = {**COMMON, **ROVER}
    names: ClassVar = NAMES
    guided: ClassVar[int] = GUIDED
    initialising_mode: ClassVar = INITIALISING
    needs_position: ClassVar = frozenset(NAMES) - _STICKS - {HOLD}

    def start(self) -> None:
        if self.options.model == "boat" and "FRAME_CLASS" not in self.options.parameters:
            self.parameters.set("FRAME_CLASS", BOAT)
        super().start()

    @property
    def _boat(self) -> bool:
        return self.parameters["FRAME_CLASS"] == BOAT

    @property
    def mav_type(self) -> int:
        return int(mavlink.MAV_TYPE_SURFACE_BOAT if self._boat else mavlink.MAV_TYPE_GROUND_ROVER)

    def forget(self) -> None:
        self._stays_ned_m: Triple | None = None
        self._target_heading_rad: float | None = None
        self._target_rate_rad_s = 0.0
        self._target_speed_m_s = 0.0
        self._target_ns: int | None = None

    # --- setpoints ------------------------------------------------------------------------------------

    def _on_set_attitude_target(self, message: Any) -> None:
        mask = message.type_mask
        if self.custom_mode != GUIDED or mask & IGNORE_THROTTLE:
            self.drop("SET_ATTITUDE_TARGET outside GUIDED or without thrust")
            return
        thrust = message.thrust
        if math.isnan(thrust):
            # The firmware's clamp answers NaN with the middle of the range, and remembers the fault.
            self.text(2, "Internal Errors 0x400")
            thrust = 0.0
        speed = self.parameters["WP_SPEED"] * max(-1.0, min(1.0, thrust))
        if mask & IGNORE_YAW_RATE:
            w, x, y, z = message.q
            self._set_target(
                speed, heading_rad=math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
            )
        else:
            self._set_target(speed, rate_rad_s=message.body_yaw_rate)

    def _on_set_position_target_local_ned(self, message: Any) -> None:
        mask = message.type_mask
        if self.custom_mode != GUIDED or not self.estimator_ready:
            return
        if message.coordinate_frame not in LOCAL_FRAMES:
            return
        if not mask & IGNORE_ACCELERATION:
            self.text(6, "Ignoring SET_POSITION_TARGET_LOCAL_NED; set ACC_IGNORE in mask")
            return
        if not mask & IGNORE_POSITION:
            self.drop("SET_POSITION_TARGET_LOCAL_NED with a position: this vehicle does not navigate")
            return
        velocity, yaw = not mask & IGNORE_VELOCITY, not mask & IGNORE_YAW
        yaw_rate = not mask & IGNORE_TARGET_YAW_RATE
        turn = self.yaw_rad if message.coordinate_frame in BODY_FRAMES else 0.0
        heading = message.yaw + turn if yaw else math.atan2(message.vy, message.vx) + turn
        speed = 0.0
        if velocity:
            limit = self.parameters["WP_SPEED"]
            speed = min(limit, math.hypot(message.vx, message.vy))
            if (yaw or yaw_rate) and message.vx < 0.0:
                speed = -speed
        if yaw_rate and not yaw:
            self._set_target(speed, rate_rad_s=message.yaw_rate)
        elif not yaw_rate and (velocity or yaw):
            self._set_target(speed, heading_rad=heading)

    def _set_target(
        self, speed_m_s: float, *, heading_rad: float | None = None, rate_rad_s: float = 0.0
    ) -> None:
        if not math.isfinite(speed_m_s + rate_rad_s + (heading_rad or 0.0)):
            self.drop("setpoint that is not finite")
            return
        self._target_speed_m_s = speed_m_s
        self._target_heading_rad = heading_rad
        self._target_rate_rad_s = rate_rad_s
        self._target_ns = self.now_ns

    def demand(self, state: BodyState) -> Control:
        if self.custom_mode == GUIDED and self._target_ns is not None:
            self._stays_ned_m = None
            if self._target_heading_rad is None:
                return Drive(self._target_rate_rad_s, self._target_speed_m_s)
            return Drive(self._turn(state, self._target_heading_rad), self._target_speed_m_s)
        # A boat that stops drifts: it loiters.
        loiters = self._boat and self.custom_mode in (GUIDED, LOITER)
        return self._loiter(state) if loiters else STAND

    def _turn(self, state: BodyState, heading_rad: float) -> float:
        error = math.remainder(heading_rad - euler_from_attitude(state.attitude_wxyz)[2], 2.0 * math.pi)
        rate = self.parameters["ATC_STR_ANG_P"] * error
        limit = math.radians(self.parameters["ATC_STR_RAT_MAX"])
        return max(-limit, min(limit, rate)) if limit > 0.0 else rate

    def _loiter(self, state: BodyState) -> Drive:
        """Drift within LOIT_RADIUS of where it came to, and drive back from beyond."""
        if self._stays_ned_m is None:
            self._stays_ned_m = state.position_ned_m
        north, east, _ = (to - at for to, at in zip(self._stays_ned_m, state.position_ned_m, strict=True))
        beyond_m = math.hypot(north, east) - self.parameters["LOIT_RADIUS"]
        if beyond_m <= 0.0:
            return STAND
        speed = min(self.parameters["WP_SPEED"], LOITER_PER_S * beyond_m)
        return Drive(self._turn(state, math.atan2(east, north)), speed)

    # --- loop, modes ------------------------------------------------------------------------------------

    def period_ns(self) -> int:
        return self.loop_ms * 1_000_000

    def look(self) -> None:
        if self._target_ns is not None and self.now_ns - self._target_ns > SETPOINT_TIMEOUT_NS:
            self._target_ns = None
            if self.custom_mode == GUIDED:
                self.text(4, "target not received last 3secs, stopping")

    def select_mode(self, custom_mode: int) -> int:
        if custom_mode == AUTO:
            self.text(5, "No Mission. Can't set AUTO.")
            return FAILED
        return super().select_mode(custom_mode)

    def mode_flag(self) -> int:
        return 64 if self.custom_mode in _STICKS else 0 if self.custom_mode in _NO_FLAG else 8

    def system_status(self) -> int:
        return 2 if self.initialising else 3 if self.custom_mode == HOLD else 4
