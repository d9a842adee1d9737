"""ArduPilot as a multicopter: GUIDED takes velocity and yaw rate, a position, attitude or rates with thrust.

After `ArduCopter/GCS_MAVLink_Copter.cpp`, `ArduCopter/mode_guided.cpp`, `ArduCopter/mode.h` and the recorded
flight. The pilot's sticks are in the middle: in the pilot's modes it stands.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, Final, NamedTuple

from pymavlink.dialects.v20 import all as mavlink

from sitl.plant import Triple, Wxyz
from sitl.vehicle.ardupilot import ArduPilot
from sitl.vehicle.ardupilot_parameters import COMMON, COPTER
from sitl.vehicle.ardupilot_targets import (
    BODY_FRAMES,
    IGNORE_ATTITUDE,
    IGNORE_PITCH_RATE,
    IGNORE_POSITION,
    IGNORE_ROLL_RATE,
    IGNORE_TARGET_YAW_RATE,
    IGNORE_THROTTLE,
    IGNORE_VELOCITY,
    IGNORE_YAW,
    IGNORE_YAW_RATE,
    LOCAL_FRAMES,
)
from sitl.vehicle.attitude_error import attitude_error
from sitl.vehicle.body import BodyState
from sitl.vehicle.command import ACCEPTED, COMMANDS, FAILED, Command
from sitl.vehicle.controls import Control, RatesThrust, Velocity
from sitl.vehicle.copter_pilot import CopterPilot, Land, Manner, Plan, Return, Stand, on_ground, yaw_of

AUTO: Final = 3
GUIDED: Final = 4
LOITER: Final = 5
RTL: Final = 6
CIRCLE: Final = 7
LAND: Final = 9
NAMES: Final = {
    0: "STABILIZE",
    1: "ACRO",
    2: "ALT_HOLD",
    AUTO: "AUTO",
    GUIDED: "GUIDED",
    LOITER: "LOITER",
    RTL: "RTL",
    CIRCLE: "CIRCLE",
    LAND: "LAND",
    11: "DRIFT",
    13: "SPORT",
    15: "AUTOTUNE",
    16: "POSHOLD",
    17: "BRAKE",
    20: "GUIDED_NOGPS",
    21: "SMART_RTL",
}
_BY_ITSELF: Final = frozenset({AUTO, GUIDED, LOITER, RTL, CIRCLE, 16, 17, 21})
_NOT_TO_ARM_IN: Final = frozenset({AUTO, RTL, CIRCLE, LAND, 15, 17, 21})

PERIOD_NS: Final = 20_000_000
ATTITUDE_PERIOD_NS: Final = 4_000_000
#: GUID_OPTIONS: thrust is thrust, not a climb rate.
RAW_THRUST: Final = 8
#: How far a quaternion's length may be from 1.
UNIT: Final = 1e-3
_ALL_RATES: Final = IGNORE_ROLL_RATE | IGNORE_PITCH_RATE | IGNORE_YAW_RATE
GRAVITY_M_S2: Final = 9.80665
#: Of the loop that holds a climb rate with thrust.
CLIMB_PER_S: Final = 2.0
HEIGHT_PER_S: Final = 1.0
COS_MIN: Final = 0.5
#: It rises so long after the command (recorded: 3 s of spooling up).
SPOOL_NS: Final = 3_000_000_000

#: A take-off is over so close (m) below its height.
CLIMBED_M: Final = 0.5


class AttitudeTarget(NamedTuple):
    """An attitude (none: rates alone), rates to add, and a climb rate, or with `raw` a thrust."""

    attitude_wxyz: Wxyz | None
    body_rates_frd_rad_s: Triple
    climb_m_s: float
    raw: bool


class VelocityTarget(NamedTuple):
    """In NED; without a position NaN stands there, and without a yaw."""

    position_ned_m: Triple
    velocity_ned_m_s: Triple
    yaw_rad: float
    yaw_rate_rad_s: float


class ArduCopter(ArduPilot):
    """A quadrotor."""

    idle: ClassVar[Control] = RatesThrust()
    gives: ClassVar[tuple[type, ...]] = (Velocity, RatesThrust)
    parameter_defaults: ClassVar = {**COMMON, **COPTER}
    commands: ClassVar = {**COMMANDS, 17: "_switched", 20: "_switched", 21: "_switched", 22: "_takeoff"}
    names: ClassVar = NAMES
    guided: ClassVar[int] = GUIDED
    needs_position: ClassVar = _BY_ITSELF
    texts: ClassVar = ("Arming motors", "Disarming motors", "Arm: AHRS: not using configured AHRS type")
    title: ClassVar = "copter"
    capabilities: ClassVar = 0xFBEF
    sensors: ClassVar = (1399979055, 1398930479, 1196530735, 1467087919)
    finds_wind: ClassVar = True
    airborne_mode: ClassVar = "LOITER"

    @property
    def mav_type(self) -> int:
        return int(mavlink.MAV_TYPE_QUADROTOR)

    def start(self) -> None:
        self._armed_ns = self._risen_ns = self.now_ns
        super().start()

    def forget(self) -> None:
        self._target: AttitudeTarget | VelocityTarget | None = None
        self._target_ns = 0
        self._height_m: float | None = None
        self._height_ns = 0
        self._pilot: CopterPilot | None = None
        self._rising_ns: int | None = None
        self._climbs_to_m = 0.0

    # --- setpoints ------------------------------------------------------------------------------------

    def _on_set_attitude_target(self, message: Any) -> None:
        mask, rated = message.type_mask, message.type_mask & _ALL_RATES
        if self.custom_mode not in (GUIDED, 20) or mask & IGNORE_THROTTLE or rated not in (0, _ALL_RATES):
            self.drop("SET_ATTITUDE_TARGET outside GUIDED, without thrust, or with one rate of three")
            return
        w, x, y, z = message.q
        rates = (0.0, 0.0, 0.0)
        if not rated:
            rates = (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
        attitude = None if mask & IGNORE_ATTITUDE else (w, x, y, z)
        off = 0.0 if attitude is None else abs(math.sqrt(w * w + x * x + y * y + z * z) - 1.0)
        if not math.isfinite(sum(rates) + message.thrust) or not off < UNIT:
            self.drop("attitude that is not finite or not of length 1")
            return
        raw = bool(int(self.parameters["GUID_OPTIONS"]) & RAW_THRUST)
        climb = message.thrust
        if not raw:
            part = 2.0 * max(0.0, min(1.0, message.thrust)) - 1.0
            climb = 0.01 * part * self.parameters["WPNAV_SPEED_UP" if part > 0.0 else "WPNAV_SPEED_DN"]
        self._take(AttitudeTarget(attitude, rates, climb, raw))

    def _on_set_position_target_local_ned(self, message: Any) -> None:
        mask, frame = message.type_mask, message.coordinate_frame
        if self.custom_mode != GUIDED or not self.estimator_ready or frame not in LOCAL_FRAMES:
            return
        turn = self.yaw_rad if frame in BODY_FRAMES else 0.0
        c, s, nan = math.cos(turn), math.sin(turn), math.nan
        velocity, position = (0.0, 0.0, 0.0), (nan, nan, nan)
        if not mask & IGNORE_VELOCITY:
            velocity = (c * message.vx - s * message.vy, s * message.vx + c * message.vy, message.vz)
        if not mask & IGNORE_POSITION:
            if frame != 1:
                self.drop("SET_POSITION_TARGET_LOCAL_NED with an offset of position")
                return
            position = (message.x, message.y, message.z)
        if mask & IGNORE_VELOCITY and mask & IGNORE_POSITION:
            self.drop("SET_POSITION_TARGET_LOCAL_NED with neither position nor velocity")
            return
        yaw = nan if mask & IGNORE_YAW else message.yaw + turn
        yaw_rate = 0.0 if mask & IGNORE_TARGET_YAW_RATE else message.yaw_rate
        if not math.isfinite(sum(velocity) + yaw_rate):
            self.drop("setpoint that is not finite")
            return
        self._take(VelocityTarget(position, velocity, yaw, yaw_rate))

    def _take(self, target: AttitudeTarget | VelocityTarget) -> None:
        if type(target) is not type(self._target):
            self._height_m = None
        self._target, self._target_ns = target, self.now_ns
        # Even the take-off ends.
        self._pilot = self._rising_ns = None

    def demand(self, state: BodyState) -> Control:
        match self._target:
            case AttitudeTarget() as target:
                return self._by_attitude(target, state)
            case VelocityTarget() as target if not on_ground(state):
                return self._by_velocity(target, state)
        if on_ground(state) and (self._rising_ns is None or self.now_ns - self._rising_ns < SPOOL_NS):
            # On the ground nothing but a take-off, or an attitude with thrust, makes it rise.
            return self.idle
        if self._pilot is None:
            self._pilot = CopterPilot(self._made(state))
        return self._pilot.fly(self._manner(), state)

    def _by_attitude(self, target: AttitudeTarget, state: BodyState) -> Control:
        if on_ground(state) and not target.climb_m_s > 0.0:
            return self.idle
        value = self.parameters
        p, q, r = target.body_rates_frd_rad_s
        if target.attitude_wxyz is not None:
            ep, eq, er = attitude_error(state.attitude_wxyz, target.attitude_wxyz)
            p, q = p + value["ATC_ANG_RLL_P"] * ep, q + value["ATC_ANG_PIT_P"] * eq
            r += value["ATC_ANG_YAW_P"] * er
        _, x, y, _ = state.attitude_wxyz
        upright = 1.0 - 2.0 * (x * x + y * y)
        if target.raw:
            # `get_throttle_boosted`, whatever the thrust is meant to be
            boost = (
                max(0.0, min(1.0, 10.0 * upright)) / max(0.1, upright) if value["ATC_ANGLE_BOOST"] else 1.0
            )
            return RatesThrust((p, q, r), max(0.0, min(1.0, boost * target.climb_m_s)))
        height = -state.position_ned_m[2]
        if self._height_m is None:
            self._height_m = height
        else:
            self._height_m += target.climb_m_s * (self.now_ns - self._height_ns) * 1e-9
            self._height_m = max(height - 1.0, min(height + 1.0, self._height_m))
        self._height_ns = self.now_ns
        climb = target.climb_m_s + HEIGHT_PER_S * (self._height_m - height)
        share = 1.0 + CLIMB_PER_S * (climb + state.velocity_ned_m_s[2]) / GRAVITY_M_S2
        return RatesThrust(
            (p, q, r), max(0.0, min(1.0, value["MOT_THST_HOVER"] * share / max(COS_MIN, upright)))
        )

    def _by_velocity(self, target: VelocityTarget, state: BodyState) -> Control:
        value = self.parameters
        gains = (value["PSC_POSXY_P"], value["PSC_POSXY_P"], value["PSC_POSZ_P"])
        north, east, down = (
            fed + (gain * (to - at) if math.isfinite(to) else 0.0)
            for fed, to, at, gain in zip(
                target.velocity_ned_m_s, target.position_ned_m, state.position_ned_m, gains, strict=True
            )
        )
        part = min(1.0, 0.01 * value["WPNAV_SPEED"] / max(1e-9, math.hypot(north, east)))
        turn = target.yaw_rate_rad_s
        if math.isfinite(target.yaw_rad):
            off = math.remainder(target.yaw_rad - yaw_of(state), 2.0 * math.pi)
            most = math.radians(0.01 * value["ATC_SLEW_YAW"])
            turn += max(-most, min(most, value["ATC_ANG_YAW_P"] * off))
        return Velocity((part * north, part * east, down), turn)

    # --- what flies by itself ---------------------------------------------------------------------------

    def _made(self, state: BodyState) -> Plan:
        if self.custom_mode == LAND:
            return Land()
        if self.custom_mode == RTL:
            above_m = 0.01 * self.parameters["RTL_ALT"] - self.home_ned_m[2]
            return Return(self.home_ned_m, max(above_m, -state.position_ned_m[2]))
        return Stand()

    def _manner(self) -> Manner:
        value = self.parameters
        return Manner(
            value["PSC_POSXY_P"],
            value["PSC_POSZ_P"],
            0.01 * value["WPNAV_SPEED"],
            0.01 * value["WPNAV_SPEED_UP"],
            0.01 * value["WPNAV_SPEED_DN"],
            0.01 * value["LAND_SPEED"],
            0.01 * value["LAND_ALT_LOW"],
        )

    def _takeoff(self, command: Command) -> int:
        """MAV_CMD_NAV_TAKEOFF: param7 above home, armed on the ground in GUIDED only."""
        height, state = command.params[6], self.body
        ready = self.armed and self.custom_mode == GUIDED and state is not None and self.landed
        if not ready or state is None or not height > 0.0:
            return FAILED
        north, east, _ = state.position_ned_m
        self.forget()
        self._rising_ns = self.now_ns
        self._climbs_to_m = self.home_ned_m[2] - height
        self._pilot = CopterPilot(Stand((north, east, self._climbs_to_m)))
        return ACCEPTED

    def _switched(self, command: Command) -> int:
        """MAV_CMD_NAV_LOITER_UNLIM, NAV_RETURN_TO_LAUNCH, NAV_LAND."""
        return self.select_mode({17: LOITER, 20: RTL, 21: LAND}[command.id])

    # --- loop, modes, arming --------------------------------------------------------------------------

    def period_ns(self) -> int:
        by_attitude = isinstance(self._target, AttitudeTarget)
        return ATTITUDE_PERIOD_NS if by_attitude else max(PERIOD_NS, self.loop_ms * 1_000_000)

    def look(self) -> None:
        state, value = self.body, self.parameters
        if self._target is not None and self.now_ns - self._target_ns > round(1e9 * value["GUID_TIMEOUT"]):
            # It levels and stops, says nothing, and stays in GUIDED.
            self._target = None
        if state is None or not self.armed:
            return
        if not on_ground(state):
            self._risen_ns = self.now_ns
            return
        delay_s = value["DISARM_DELAY"]
        waits = self._rising_ns is None or self.now_ns - self._rising_ns > 2 * SPOOL_NS
        down = self._risen_ns > self._armed_ns and self.custom_mode in (LAND, RTL)
        since_ns = max(self._armed_ns, self._risen_ns)
        if down or (delay_s > 0.0 and waits and self.now_ns - since_ns > round(1e9 * delay_s)):
            self.disarm(forced=True)

    def may_arm(self) -> str:
        if self.custom_mode not in _NOT_TO_ARM_IN:
            return ""
        return f"Arm: {NAMES[self.custom_mode]} mode not armable"

    def arm(self, *, forced: bool) -> int:
        was_armed, result = self.armed, super().arm(forced=forced)
        if self.armed and not was_armed:
            self._armed_ns = self.now_ns
            if self.landed and self.body is not None:
                self.home_ned_m = self.body.position_ned_m
        return result

    @property
    def landed(self) -> bool:
        return self.body is None or on_ground(self.body)

    @property
    def landed_state(self) -> int:
        if self.landed or self.body is None:
            return 1
        if self.custom_mode == LAND:
            return 4
        climbs = self._rising_ns is not None and self.custom_mode == GUIDED
        return 3 if climbs and self.body.position_ned_m[2] > self._climbs_to_m + CLIMBED_M else 2

    def select_mode(self, custom_mode: int) -> int:
        if custom_mode == AUTO:
            self.text(4, "Mode change to AUTO failed: no mission")
            return FAILED
        if self.armed and not self.estimator_ready and custom_mode in _BY_ITSELF:
            self.text(4, f"Mode change to {NAMES[custom_mode]} failed: requires position")
        return super().select_mode(custom_mode)

    # --- telemetry ------------------------------------------------------------------------------------

    def mode_flag(self) -> int:
        return 64 | 16 | (8 if self.custom_mode in _BY_ITSELF or self.initialising else 0)

    def system_status(self) -> int:
        if self.initialising:
            return 1
        return 4 if self.armed and not self.landed else 3
