"""ArduRover's manners: GUIDED takes yaw rate (or heading) and forward speed, and stops after 3 s of silence.

After ArduPilot 4.7.0-dev: `Rover/GCS_MAVLink_Rover.cpp` (setpoints), `Rover/mode_guided.cpp` (time-out),
`Rover/mode.h` (numbers), and the recorded flight. The answer of the real rover (delay, slew, gain) is
that of the body.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, Final

from sitl.plant import euler_from_attitude
from sitl.vehicle.ardupilot_messages import STREAM_GROUPS, STREAM_PARAMETERS, ardupilot_builders
from sitl.vehicle.autopilot import HANDLERS, Autopilot
from sitl.vehicle.body import BodyState
from sitl.vehicle.command import ACCEPTED, ARMED, DENIED, FAILED, UNSUPPORTED, Command
from sitl.vehicle.controls import Control, Drive
from sitl.vehicle.parameter_set import INT8, INT16, INT32, Parameter
from sitl.vehicle.telemetry import ID, Builder

STAND: Final = Drive()

HOLD: Final = 4
AUTO: Final = 10
GUIDED: Final = 15
INITIALISING: Final = 16
NAMES: Final = {
    0: "MANUAL",
    1: "ACRO",
    3: "STEERING",
    HOLD: "HOLD",
    5: "LOITER",
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

#: How long initialisation lasts at most, while the estimator is not ready yet (recorded: 2.4 s after start).
INITIALISING_NS: Final = 1_400_000_000
SETPOINT_TIMEOUT_NS: Final = 3_000_000_000
#: SET_MESSAGE_INTERVAL is refused for rates above this part of SCHED_LOOP_RATE.
MAX_RATE_OF_LOOP: Final = 0.8
#: param2 that forces arming; disarming knows `FORCE` only.
FORCE_ARM: Final = 2989

IGNORE_YAW_RATE: Final = 4
IGNORE_THROTTLE: Final = 64
#: Bits of SET_POSITION_TARGET_LOCAL_NED.type_mask: any of a group ignores the group.
IGNORE_POSITION: Final = 0b111
IGNORE_VELOCITY: Final = 0b111 << 3
IGNORE_ACCELERATION: Final = 0b111 << 6
IGNORE_YAW: Final = 1 << 10
IGNORE_TARGET_YAW_RATE: Final = 1 << 11
_LOCAL_FRAMES: Final = frozenset({1, 7, 8, 9})
_BODY_FRAMES: Final = frozenset({8, 9})


class ArduRover(Autopilot):
    """An ArduPilot rover on its first telemetry link."""

    idle: ClassVar[Control] = STAND
    gives: ClassVar[tuple[type, ...]] = (Drive,)
    parameter_defaults: ClassVar = {
        "ARMING_CHECK": Parameter(1, INT32),
        "ARMING_REQUIRE": Parameter(1, INT8),
        "ATC_ACCEL_MAX": Parameter(1.0),
        "ATC_DECEL_MAX": Parameter(0.0),
        "ATC_SPEED_I": Parameter(0.2),
        "ATC_SPEED_P": Parameter(0.1),
        "ATC_STR_ACC_MAX": Parameter(120.0),
        "ATC_STR_ANG_P": Parameter(2.0),
        "ATC_STR_RAT_FF": Parameter(0.75),
        "ATC_STR_RAT_MAX": Parameter(120.0),
        "ATC_STR_RAT_P": Parameter(0.2),
        "ATC_TURN_MAX_G": Parameter(0.6),
        "CRUISE_SPEED": Parameter(5.0),
        "CRUISE_THROTTLE": Parameter(30, INT8),
        "FORMAT_VERSION": Parameter(16, INT16),
        "FRAME_CLASS": Parameter(1, INT8),
        "FRAME_TYPE": Parameter(0, INT8),
        "FS_ACTION": Parameter(2, INT8),
        "FS_GCS_ENABLE": Parameter(0, INT8),
        "GUID_OPTIONS": Parameter(0, INT32),
        "INITIAL_MODE": Parameter(0, INT8),
        **{f"MAV1_{name}": Parameter(1, INT16) for name in STREAM_PARAMETERS.values()},
        "MAV_GCS_SYSID": Parameter(255, INT16),
        "MAV_OPTIONS": Parameter(0, INT16),
        "MAV_SYSID": Parameter(1, INT16),
        "SCHED_LOOP_RATE": Parameter(50, INT16),
        "SERIAL0_PROTOCOL": Parameter(2, INT8),
        "WP_RADIUS": Parameter(2.0),
        "WP_SPEED": Parameter(5.0),
    }
    integers_bytewise: ClassVar = False
    batches_datagrams: ClassVar = True
    handlers: ClassVar = {**HANDLERS, "REQUEST_DATA_STREAM": "_on_request_data_stream"}

    @property
    def loop_ms(self) -> int:
        """Whole milliseconds of 1/SCHED_LOOP_RATE, as it was at boot."""
        return self._loop_ms

    @property
    def mode_name(self) -> str:
        return NAMES[self.custom_mode]

    def builders(self) -> dict[int, Builder]:
        return ardupilot_builders(self)

    def stream_defaults_us(self) -> dict[int, int]:
        defaults = {ID["HEARTBEAT"]: 1_000_000, ID["TIMESYNC"]: 10_000_000}
        for group, names in STREAM_GROUPS.items():
            for name in names:
                defaults[ID[name]] = self._group_interval_us(group)
        return defaults

    def _group_interval_us(self, group: int) -> int:
        hz = self.parameters[f"MAV1_{STREAM_PARAMETERS[group]}"]
        return round(1e6 / hz) if hz > 0.0 else 0

    def start(self) -> None:
        rate = max(1.0, self.parameters["SCHED_LOOP_RATE"])
        self._loop_ms = max(1, round(1000.0 / rate))
        self._loop_rate_hz = rate
        initial = self.options.initial_mode
        modes = {name: mode for mode, name in NAMES.items()}
        if initial is not None and initial not in modes:
            raise ValueError(f"unknown mode {initial}; ArduRover has {', '.join(modes)}")
        first = round(self.parameters["INITIAL_MODE"])
        self._first_mode = modes[initial] if initial is not None else first if first in NAMES else 0
        # With an estimator that is ready at once there is nothing to wait for, and no initialisation.
        self.custom_mode = INITIALISING if self.options.estimator_ready_s > 0.0 else self._first_mode
        self._was_ready = self.options.estimator_ready_s <= 0.0
        self._init_end_ns = self.now_ns + INITIALISING_NS
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
        if message.coordinate_frame not in _LOCAL_FRAMES:
            return
        if not mask & IGNORE_ACCELERATION:
            self.text(6, "Ignoring SET_POSITION_TARGET_LOCAL_NED; set ACC_IGNORE in mask")
            return
        if not mask & IGNORE_POSITION:
            self.drop("SET_POSITION_TARGET_LOCAL_NED with a position: this vehicle does not navigate")
            return
        velocity, yaw = not mask & IGNORE_VELOCITY, not mask & IGNORE_YAW
        yaw_rate = not mask & IGNORE_TARGET_YAW_RATE
        turn = self._yaw_rad() if message.coordinate_frame in _BODY_FRAMES else 0.0
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
        if self.custom_mode != GUIDED or self._target_ns is None:
            return STAND
        rate = self._target_rate_rad_s
        if self._target_heading_rad is not None:
            error = self._target_heading_rad - euler_from_attitude(state.attitude_wxyz)[2]
            error = math.remainder(error, 2.0 * math.pi)
            rate = self.parameters["ATC_STR_ANG_P"] * error
            limit = math.radians(self.parameters["ATC_STR_RAT_MAX"])
            if limit > 0.0:
                rate = max(-limit, min(limit, rate))
        return Drive(rate, self._target_speed_m_s)

    # --- loop, modes, arming --------------------------------------------------------------------------

    def next_wake_ns(self) -> int:
        period_ns = self._loop_ms * 1_000_000
        return (self.now_ns // period_ns + 1) * period_ns

    def wake(self) -> None:
        if self.custom_mode == INITIALISING and (self.now_ns >= self._init_end_ns or self.estimator_ready):
            self.text(6, "ArduPilot Ready")
            self._switch(self._first_mode)
        if self.estimator_ready and not self._was_ready:
            self._was_ready = True
            self.text(6, "EKF3 IMU0 is using GPS")
            self.text(6, "AHRS: EKF3 active")
        if self._target_ns is not None and self.now_ns - self._target_ns > SETPOINT_TIMEOUT_NS:
            self._target_ns = None
            if self.custom_mode == GUIDED:
                self.text(4, "target not received last 3secs, stopping")

    def _switch(self, mode: int) -> None:
        if mode != self.custom_mode:
            self.custom_mode = mode
            self._target_ns = None
            # At once, not at the next second.
            if self.sample is not None:
                self.say(self._builders[ID["HEARTBEAT"]](self.sample))

    def custom_mode_of(self, command: Command) -> int | None:
        base, mode = command.whole(1), command.whole(2)
        return None if base is None or mode is None or not base & 1 else mode

    def select_mode(self, custom_mode: int) -> int:
        if custom_mode not in NAMES or custom_mode == INITIALISING:
            self.text(4, f"No such mode {custom_mode}")
            return FAILED
        if custom_mode == AUTO:
            self.text(5, "No Mission. Can't set AUTO.")
            return FAILED
        if self.armed and not self.estimator_ready and custom_mode not in _STICKS | {HOLD}:
            return FAILED
        self._switch(custom_mode)
        return ACCEPTED

    def _on_set_mode(self, message: Any) -> None:
        result = self.select_mode(message.custom_mode) if message.base_mode & 1 else DENIED
        source = (message.get_srcSystem(), message.get_srcComponent())
        self.acknowledge(Command(ID["SET_MODE"], (0.0,) * 7, *source), result)

    def _arm_disarm(self, command: Command) -> int:
        if command.params[0] == 1.0:
            return self.arm(forced=command.whole(2) == FORCE_ARM)
        return self.disarm(forced=False) if command.params[0] == 0.0 else UNSUPPORTED

    def arm(self, *, forced: bool) -> int:
        if self.armed:
            return ACCEPTED
        if self.custom_mode == INITIALISING:
            self.text(2, "Arm: System not initialised")
            return FAILED
        if not forced and not self.estimator_ready:
            self.text(2, "Arm: AHRS: not using configured AHRS type")
            return FAILED
        self.armed = True
        self.text(6, "Throttle armed")
        return ACCEPTED

    def disarm(self, *, forced: bool) -> int:
        if self.armed:
            self.armed = False
            self.text(6, "Throttle disarmed")
        return ACCEPTED

    def _reboot_shutdown(self, command: Command) -> int:
        if command.whole(1) not in (1, 3):
            return UNSUPPORTED
        if self.armed:
            return FAILED
        self.reboot_requested = True
        return ACCEPTED

    # --- telemetry ------------------------------------------------------------------------------------

    def base_mode(self) -> int:
        """HEARTBEAT.base_mode."""
        flag = 64 if self.custom_mode in _STICKS else 0 if self.custom_mode in _NO_FLAG else 8
        armed = self.armed and self.custom_mode != INITIALISING
        return 1 | flag | (ARMED if armed else 0)

    def system_status(self) -> int:
        """HEARTBEAT.system_status: 2 calibrating, 3 standby in HOLD, else 4 active, armed or not."""
        return 2 if self.custom_mode == INITIALISING else 3 if self.custom_mode == HOLD else 4

    def _yaw_rad(self) -> float:
        return self.sample.euler_rad[2] if self.sample is not None else 0.0

    def _set_message_interval(self, command: Command) -> int:
        message_id, interval_us = command.whole(1), command.whole(2)
        if message_id is None or interval_us is None or message_id not in self._builders:
            return DENIED
        interval_us = interval_us or self.streams.default_us(message_id)
        if interval_us > 0:
            interval_us = max(1, min(60_000, interval_us // 1000)) * 1000
            if 1e6 / interval_us > MAX_RATE_OF_LOOP * self._loop_rate_hz:
                return DENIED
        self.streams.set(message_id, interval_us, self.now_ns // 1_000_000)
        return ACCEPTED

    def _request_message(self, command: Command) -> int:
        """The answer follows the ACK, as recorded; PX4 does it the other way round."""
        message_id = command.whole(1)
        if message_id is None or message_id not in self._builders or self.sample is None:
            return FAILED
        message = self._builders[message_id](self.sample)
        if message is not None:
            self.say(message)
        return ACCEPTED

    def _on_request_data_stream(self, message: Any) -> None:
        groups = range(1, 13) if message.req_stream_id == 0 else [message.req_stream_id]
        hz = message.req_message_rate if message.start_stop else 0
        hz = min(hz, int(MAX_RATE_OF_LOOP * self._loop_rate_hz))
        for group in groups:
            for name in STREAM_GROUPS.get(group, ()):
                self.streams.set(ID[name], round(1e6 / hz) if hz else 0, self.now_ns // 1_000_000)
