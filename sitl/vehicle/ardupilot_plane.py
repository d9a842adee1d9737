"""ArduPilot as an airplane: GUIDED takes roll and pitch of q, and throttle, for 3 s; then it flies itself.

After `ArduPlane/GCS_MAVLink_Plane.cpp`, `ArduPlane/mode_guided.cpp`, `ArduPlane/mode.h`, the recorded flight.
The recorded pilot had no sticks: in the modes of a pilot it flies straight on and level.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, Final, NamedTuple

from pymavlink.dialects.v20 import all as mavlink

from sitl.plant import euler_from_attitude
from sitl.vehicle.airplane_pilot import (
    AirplanePilot,
    Circle,
    Envelope,
    Plan,
    Straight,
    Takeoff,
    course_of,
    height_of,
    on_ground,
    standing,
)
from sitl.vehicle.ardupilot import ArduPilot
from sitl.vehicle.ardupilot_parameters import COMMON, PLANE
from sitl.vehicle.ardupilot_targets import (
    IGNORE_ATTITUDE,
    IGNORE_PITCH_RATE,
    IGNORE_ROLL_RATE,
    IGNORE_THROTTLE,
    IGNORE_YAW_RATE,
)
from sitl.vehicle.body import BodyState
from sitl.vehicle.command import ACCEPTED, COMMANDS, FAILED, Command
from sitl.vehicle.controls import Attitude, Control

MANUAL: Final = 0
CIRCLE: Final = 1
AUTO: Final = 10
RTL: Final = 11
LOITER: Final = 12
TAKEOFF: Final = 13
GUIDED: Final = 15
INITIALISING: Final = 16
THERMAL: Final = 24
NAMES: Final = {
    MANUAL: "MANUAL",
    CIRCLE: "CIRCLE",
    2: "STABILIZE",
    3: "TRAINING",
    4: "ACRO",
    5: "FBWA",
    6: "FBWB",
    7: "CRUISE",
    8: "AUTOTUNE",
    AUTO: "AUTO",
    RTL: "RTL",
    LOITER: "LOITER",
    TAKEOFF: "TAKEOFF",
    GUIDED: "GUIDED",
    INITIALISING: "INITIALISING",
    THERMAL: "THERMAL",
}
_BY_ITSELF: Final = frozenset({CIRCLE, AUTO, RTL, LOITER, TAKEOFF, GUIDED, THERMAL})

PERIOD_NS: Final = 20_000_000
SETPOINT_TIMEOUT_NS: Final = 3_000_000_000
#: It says that it flies so long after it left the ground.
FLYING_NS: Final = 1_000_000_000


class Forced(NamedTuple):
    """One number that a setpoint said, and when."""

    value: float
    at_ns: int


class ArduPlane(ArduPilot):
    """A fixed wing."""

    idle: ClassVar[Control] = Attitude()
    gives: ClassVar[tuple[type, ...]] = (Attitude,)
    parameter_defaults: ClassVar = {**COMMON, **PLANE}
    commands: ClassVar = {**COMMANDS, 17: "_loiter", 20: "_return", 22: "_takeoff"}
    names: ClassVar = NAMES
    guided: ClassVar[int] = GUIDED
    initialising_mode: ClassVar = INITIALISING
    needs_position: ClassVar[frozenset[int]] = frozenset()
    texts: ClassVar = ("Throttle armed", "Throttle disarmed", "Arm: AHRS: waiting for home")
    title: ClassVar = "plane"
    capabilities: ClassVar = 0xF36F
    sensors: ClassVar = (325188671, 325188671, 51478591, 322042943)
    finds_wind: ClassVar = True
    airborne_mode: ClassVar = "LOITER"

    @property
    def mav_type(self) -> int:
        return int(mavlink.MAV_TYPE_FIXED_WING)

    def start(self) -> None:
        self._ground_ns = self.now_ns
        super().start()

    def forget(self) -> None:
        self._roll: Forced | None = None
        self._pitch: Forced | None = None
        self._throttle: Forced | None = None
        self._plan: Plan | None = None
        self._pilot = AirplanePilot()

    # --- setpoints ------------------------------------------------------------------------------------

    def _on_set_attitude_target(self, message: Any) -> None:
        if self.custom_mode != GUIDED:
            self.drop("SET_ATTITUDE_TARGET outside GUIDED")
            return
        mask, (w, x, y, z) = message.type_mask, message.q
        if not all(map(math.isfinite, (w, x, y, z, message.thrust))):
            self.drop("setpoint that is not finite")
            return
        # With the attitude all of it counts; without, the bits of the rates say which axes of q do.
        every = not mask & IGNORE_ATTITUDE
        roll, pitch, yaw = euler_from_attitude((w, x, y, z))
        if every or not mask & IGNORE_ROLL_RATE:
            self._roll = Forced(roll, self.now_ns)
        if every or not mask & IGNORE_PITCH_RATE:
            self._pitch = Forced(pitch, self.now_ns)
        if (every or not mask & IGNORE_YAW_RATE) and yaw:
            self.drop("yaw of q: the rudder's angle, and this airplane has none")
        if not mask & IGNORE_THROTTLE:
            self._throttle = Forced(message.thrust, self.now_ns)

    def _on_set_position_target_local_ned(self, message: Any) -> None:
        self.drop("SET_POSITION_TARGET_LOCAL_NED: this vehicle takes an offset of altitude at most")

    def demand(self, state: BodyState) -> Control:
        if self._plan is None or (on_ground(state) and not isinstance(self._plan, Takeoff)):
            self._plan = self._made(self.custom_mode, state)
        envelope = self._envelope()
        roll, pitch, throttle = (self._fresh(said) for said in (self._roll, self._pitch, self._throttle))
        if roll is None or pitch is None or throttle is None:
            own = self._pilot.fly(self._plan, envelope, state, self.now_ns)
        else:
            own = Attitude()
        roll_max = envelope.roll_max_rad
        return Attitude(
            own.roll_rad if roll is None else max(-roll_max, min(roll_max, roll)),
            own.pitch_rad
            if pitch is None
            else max(envelope.pitch_min_rad, min(envelope.pitch_max_rad, pitch)),
            own.throttle if throttle is None else max(0.0, min(envelope.throttle_max, throttle)),
        )

    def _fresh(self, said: Forced | None) -> float | None:
        fresh = said is not None and self.now_ns - said.at_ns < SETPOINT_TIMEOUT_NS
        return said.value if fresh and said is not None else None

    def _made(self, mode: int, state: BodyState) -> Plan:
        """The plan of a mode that begins here."""
        north, east, _ = state.position_ned_m
        height, radius = height_of(state), self.parameters["WP_LOITER_RAD"]
        home_m = -self.home_ned_m[2]
        if mode == TAKEOFF:
            return Takeoff(course_of(state), home_m + self.parameters["TKOFF_ALT"])
        if mode == RTL:
            radius = self.parameters["RTL_RADIUS"] or radius
            above_m = self.parameters["RTL_ALTITUDE"]
            return Circle(
                self.home_ned_m[0], self.home_ned_m[1], radius, home_m + above_m if above_m >= 0.0 else height
            )
        if mode in _BY_ITSELF:
            return Circle(north, east, radius, height)
        return Straight(course_of(state), height)

    def _envelope(self) -> Envelope:
        value = self.parameters
        return Envelope(
            value["AIRSPEED_MIN"],
            value["AIRSPEED_CRUISE"],
            math.radians(value["ROLL_LIMIT_DEG"]),
            math.radians(value["PTCH_LIM_MIN_DEG"]),
            math.radians(value["PTCH_LIM_MAX_DEG"]),
            value["TECS_CLMB_MAX"],
            value["TECS_SINK_MAX"],
            0.01 * value["THR_MAX"],
            math.radians(value["TKOFF_LVL_PITCH"]),
        )

    # --- loop, modes, arming --------------------------------------------------------------------------

    def period_ns(self) -> int:
        return max(PERIOD_NS, self.loop_ms * 1_000_000)

    def look(self) -> None:
        state = self.body
        if state is None or on_ground(state):
            self._ground_ns = self.now_ns
        elif isinstance(self._plan, Takeoff) and height_of(state) > self._plan.height_m - 2.0:
            # it stays in TAKEOFF and circles
            north, east, _ = state.position_ned_m
            self._plan = Circle(north, east, self.parameters["WP_LOITER_RAD"], self._plan.height_m)

    def arm(self, *, forced: bool) -> int:
        was_armed, result = self.armed, super().arm(forced=forced)
        if self.armed and not was_armed and self.landed and self.body is not None:
            self.home_ned_m = self.body.position_ned_m
        return result

    @property
    def landed(self) -> bool:
        return self.body is None or standing(self.body)

    def select_mode(self, custom_mode: int) -> int:
        if custom_mode == AUTO:
            self.text(5, "No Mission. Can't set AUTO.")
            return FAILED
        return super().select_mode(custom_mode)

    def _loiter(self, command: Command) -> int:
        self.switch(LOITER)
        return ACCEPTED

    def _return(self, command: Command) -> int:
        self.switch(RTL)
        return ACCEPTED

    def _takeoff(self, command: Command) -> int:
        """MAV_CMD_NAV_TAKEOFF outside a mission is for quadplanes."""
        return FAILED

    # --- telemetry ------------------------------------------------------------------------------------

    def mode_flag(self) -> int:
        if self.initialising:
            return 16
        return 64 | 16 | (8 if self.custom_mode in _BY_ITSELF else 0)

    def system_status(self) -> int:
        if self.initialising:
            return 2
        return 4 if self.now_ns - self._ground_ns > FLYING_NS else 3
