"""PX4's manners as a UUV: OFFBOARD with its proof of life and failsafe, body rates and thrust along +x.

After PX4 main of 2025-08: `mavlink_receiver.cpp` (SET_ATTITUDE_TARGET), `Commander.cpp` and
`UserModeIntention.cpp` (modes, arming), `RoverLandDetector` (a UUV uses it: armed is not landed), and the
recorded flights of PX4 1.16.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, Final

from pymavlink.dialects.v20 import all as mavlink

from sitl.plant import STOP, PlantCommand, Triple, Wxyz
from sitl.vehicle.autopilot import COMMANDS, HANDLERS, STATUSTEXT_LENGTH, Autopilot
from sitl.vehicle.body import BodyState
from sitl.vehicle.command import ACCEPTED, ARMED, DENIED, FAILED, TEMPORARILY_REJECTED, Command
from sitl.vehicle.controls import Control
from sitl.vehicle.parameter_set import INT32, Parameter
from sitl.vehicle.px4_messages import STREAM_RATES_HZ, px4_builders
from sitl.vehicle.px4_modes import (
    AUTO,
    BASE_MODES,
    COMMANDED,
    LAND,
    LOITER,
    LOSS_MODES,
    NAMES,
    OFFBOARD,
    custom,
)
from sitl.vehicle.telemetry import ID, Builder

#: The commander looks at the offboard stream this often.
COMMANDER_NS: Final = 100_000_000

IGNORE_ROLL_RATE: Final = 1
IGNORE_PITCH_RATE: Final = 2
IGNORE_YAW_RATE: Final = 4
IGNORE_THROTTLE: Final = 64
IGNORE_ATTITUDE: Final = 128


class Px4(Autopilot):
    """A PX4 submarine on its onboard link."""

    idle: ClassVar[Control] = STOP
    gives: ClassVar[tuple[type, ...]] = (PlantCommand,)
    parameter_defaults: ClassVar = {
        "COM_ARM_HFLT_CHK": Parameter(0, INT32),
        "COM_DISARM_LAND": Parameter(2.0),
        "COM_DISARM_PRFLT": Parameter(-1.0),
        "COM_OBL_RC_ACT": Parameter(0, INT32),
        "COM_OF_LOSS_T": Parameter(1.0),
        "COM_RCL_EXCEPT": Parameter(4, INT32),
        "COM_RC_IN_MODE": Parameter(4, INT32),
        "COM_RC_LOSS_T": Parameter(0.5),
        "MAV_COMP_ID": Parameter(1, INT32),
        "MAV_FWDEXTSP": Parameter(1, INT32),
        "MAV_HASH_CHK_EN": Parameter(1, INT32),
        "MAV_HB_FORW_EN": Parameter(1, INT32),
        "MAV_PROTO_VER": Parameter(2, INT32),
        "MAV_SYS_ID": Parameter(1, INT32),
        "MAV_TYPE": Parameter(12, INT32),
        "MIS_TAKEOFF_ALT": Parameter(2.5),
        "NAV_DLL_ACT": Parameter(0, INT32),
        "NAV_RCL_ACT": Parameter(2, INT32),
        "SYS_AUTOCONFIG": Parameter(0, INT32),
        "SYS_AUTOSTART": Parameter(60000, INT32),
        "UUV_PITCH_P": Parameter(4.0),
        "UUV_ROLL_P": Parameter(4.0),
        "UUV_YAW_P": Parameter(4.0),
    }
    integers_bytewise: ClassVar = True
    batches_datagrams: ClassVar = False
    handlers: ClassVar = {**HANDLERS, "HEARTBEAT": "_on_heartbeat"}
    commands: ClassVar = {**COMMANDS, **dict.fromkeys(COMMANDED, "_change_mode")}

    @property
    def loop_ms(self) -> int:
        return 4

    @property
    def mode_name(self) -> str:
        return NAMES[self.custom_mode]

    def builders(self) -> dict[int, Builder]:
        return px4_builders(self)

    def stream_defaults_us(self) -> dict[int, int]:
        return {ID[name]: round(1e6 / hz) for name, hz in STREAM_RATES_HZ.items()}

    def start(self) -> None:
        initial = self.options.initial_mode
        modes = {name: mode for mode, name in NAMES.items()}
        if initial is not None and initial not in modes:
            raise ValueError(f"unknown mode {initial}; PX4 has {', '.join(modes)}")
        self.intended_mode = LOITER if initial is None else modes[initial]
        self.custom_mode = self.intended_mode
        self.failsafe = False
        self.ground_station_seen = False
        self.statustext_id = 0
        self._life_ns: int | None = None
        self._land_since_ns: int | None = None
        self._clear_setpoint()
        # What ATTITUDE_TARGET goes on reporting in rates-only OFFBOARD.
        self.stale_attitude_wxyz: Wxyz = (1.0, 0.0, 0.0, 0.0)
        self.stale_thrust = 0.0

    def _clear_setpoint(self) -> None:
        self.wanted_rates: Triple | None = None
        self._wanted_attitude: Wxyz | None = None
        self._thrust_x = 0.0

    # --- setpoints ------------------------------------------------------------------------------------

    @property
    def stream_is_fresh(self) -> bool:
        """Whether the newest proof of life is younger than COM_OF_LOSS_T."""
        limit_ns = round(self.parameters["COM_OF_LOSS_T"] * 1e9)
        return self._life_ns is not None and self.now_ns < self._life_ns + limit_ns

    def _on_set_attitude_target(self, message: Any) -> None:
        mask = message.type_mask
        attitude = not mask & IGNORE_ATTITUDE
        rates = not mask & IGNORE_ROLL_RATE and not mask & IGNORE_PITCH_RATE
        if not attitude and not rates:
            self.drop("SET_ATTITUDE_TARGET with neither attitude nor roll and pitch rate")
            return
        self._life_ns = self.now_ns
        if self.custom_mode != OFFBOARD:
            return
        # The receiver passes values on unclamped, an ignored throttle as zero; the actuators saturate.
        self._thrust_x = 0.0 if mask & IGNORE_THROTTLE else message.thrust
        yaw_rate = math.nan if mask & IGNORE_YAW_RATE else message.body_yaw_rate
        if attitude:
            w, x, y, z = message.q
            self._wanted_attitude = self.stale_attitude_wxyz = (w, x, y, z)
            self.stale_thrust = self._thrust_x
            self.wanted_rates = (0.0, 0.0, yaw_rate)
        else:
            self._wanted_attitude = None
            self.wanted_rates = (message.body_roll_rate, message.body_pitch_rate, yaw_rate)

    def _on_set_position_target_local_ned(self, message: Any) -> None:
        # Proof of life whatever it says; the plant has no position controller and stands still.
        self._life_ns = self.now_ns
        self._clear_setpoint()

    def demand(self, state: BodyState) -> Control:
        if self.custom_mode != OFFBOARD or self.wanted_rates is None:
            return STOP
        speed = _finite(self._thrust_x) * self.options.speed_at_full_thrust_m_s
        # A rate that is not a number reaches no actuator.
        p, q, r = (_finite(rate) for rate in self.wanted_rates)
        if self._wanted_attitude is not None:
            if not all(map(math.isfinite, self._wanted_attitude)):
                return STOP
            ep, eq, er = _attitude_error(state.attitude_wxyz, self._wanted_attitude)
            # PX4's gains are torques per angle; over the kinematic plant they are rates per angle (1/s).
            gains = self.parameters
            p, q = gains["UUV_ROLL_P"] * ep, gains["UUV_PITCH_P"] * eq
            r += gains["UUV_YAW_P"] * er
        return PlantCommand((p, q, r), speed)

    # --- the commander --------------------------------------------------------------------------------

    def next_wake_ns(self) -> int:
        period_ns = COMMANDER_NS
        if self.armed and self.custom_mode == OFFBOARD and self._wanted_attitude is not None:
            period_ns = self.loop_ms * 1_000_000
        return (self.now_ns // period_ns + 1) * period_ns

    def wake(self) -> None:
        if self.now_ns % COMMANDER_NS:
            return
        lost = self.intended_mode == OFFBOARD and not self.stream_is_fresh
        if self.armed and lost and not self.failsafe:
            self.failsafe = True
            self.text(2, "Failsafe activated")
            action = round(self.parameters["COM_OBL_RC_ACT"])
            self._fly(LOSS_MODES.get(action, LOITER))
            if action == 7:
                self.disarm(forced=True)
        elif self.failsafe and not lost:
            # The intended mode is still OFFBOARD: a stream that resumes takes control back, unasked.
            self.failsafe = False
            self._fly(self.intended_mode)
        if self.armed and self.custom_mode == LAND:
            self._disarm_after_landing()
        else:
            self._land_since_ns = None

    def _disarm_after_landing(self) -> None:
        if self._land_since_ns is None:
            self._land_since_ns = self.now_ns
        delay_s = self.parameters["COM_DISARM_LAND"]
        if delay_s > 0.0 and self.now_ns - self._land_since_ns >= round(delay_s * 1e9):
            self.disarm(forced=True)

    def _fly(self, mode: int) -> None:
        if mode != self.custom_mode:
            self.custom_mode = mode
            self._clear_setpoint()

    def custom_mode_of(self, command: Command) -> int | None:
        base, main, sub = (command.whole(index) for index in (1, 2, 3))
        if base is None or main is None or not base & 1 or not 0 <= main <= 255:
            return None
        return custom(main, sub & 0xFF if main == 4 and sub is not None else 0)

    def obey(self, command: Command) -> None:
        if command.id == 176:
            # Newer versions answer twice, and the first answer says yes to anything.
            self.acknowledge(command, ACCEPTED)
        super().obey(command)

    def _on_set_mode(self, message: Any) -> None:
        source = (message.get_srcSystem(), message.get_srcComponent())
        custom_mode = message.custom_mode
        params = (
            float(message.base_mode),
            float(custom_mode >> 16 & 0xFF),
            float(custom_mode >> 24),
            0.0,
            0.0,
            0.0,
            0.0,
        )
        self.obey(Command(176, params, *source))

    def select_mode(self, custom_mode: int) -> int:
        if custom_mode not in NAMES:
            if custom_mode >> 16 & 0xFF == 4:
                self.text(2, "Unsupported auto mode")
                return TEMPORARILY_REJECTED
            # An unknown main mode changes nothing and is no error to the commander.
            return ACCEPTED
        if self.armed and custom_mode == OFFBOARD and not self.stream_is_fresh:
            return TEMPORARILY_REJECTED
        self.intended_mode = custom_mode
        self.failsafe = False
        self._fly(custom_mode)
        return ACCEPTED

    def _change_mode(self, command: Command) -> int:
        mode, text = COMMANDED[command.id]
        result = self.select_mode(mode)
        if text and result == ACCEPTED:
            self.text(6, text)
        return result

    @property
    def can_arm(self) -> bool:
        """Whether arming would be accepted now."""
        return self.estimator_ready and (self.intended_mode != OFFBOARD or self.stream_is_fresh)

    def arm(self, *, forced: bool) -> int:
        if self.armed:
            return ACCEPTED
        if not forced and not self.can_arm:
            self.text(2, "Arming denied: Resolve system health failures first")
            return TEMPORARILY_REJECTED
        self.armed = True
        self.text(6, "Armed by external command")
        return ACCEPTED

    def disarm(self, *, forced: bool) -> int:
        if not self.armed:
            return ACCEPTED
        if not forced and self.custom_mode != LAND:
            self.text(2, "Disarming denied: not landed")
            return TEMPORARILY_REJECTED
        self.armed = False
        self.failsafe = False
        self._fly(self.intended_mode)
        self.text(6, "Disarmed by external command")
        return ACCEPTED

    def _reboot_shutdown(self, command: Command) -> int:
        if self.armed:
            return DENIED
        if command.whole(1) == 1:
            self.reboot_requested = True
        return ACCEPTED

    # --- telemetry ------------------------------------------------------------------------------------

    def base_mode(self) -> int:
        """HEARTBEAT.base_mode."""
        return BASE_MODES.get(self.custom_mode, AUTO) | (ARMED if self.armed else 0)

    def system_status(self) -> int:
        """HEARTBEAT.system_status: 0 uninit, 3 standby, 4 active, 5 critical."""
        if self.armed:
            return 5 if self.failsafe else 4
        return 3 if self.can_arm else 0

    def text(self, severity: int, text: str) -> None:
        """STATUSTEXT in chunks of 50, and only on a link where a ground station has been heard."""
        if not self.ground_station_seen:
            return
        data = (text + "\t").encode()
        for chunk_seq, start in enumerate(range(0, len(data), STATUSTEXT_LENGTH)):
            chunk = data[start : start + STATUSTEXT_LENGTH]
            self.say(mavlink.MAVLink_statustext_message(severity, chunk, self.statustext_id, chunk_seq))
        self.statustext_id = (self.statustext_id + 1) % 65536

    def _on_heartbeat(self, message: Any) -> None:
        if message.type == mavlink.MAV_TYPE_GCS:
            self.ground_station_seen = True

    def _set_message_interval(self, command: Command) -> int:
        message_id, interval_us = command.whole(1), command.whole(2)
        if message_id is None or interval_us is None or message_id not in self._builders:
            return FAILED
        # HEARTBEAT keeps its rate whatever is asked.
        if message_id != ID["HEARTBEAT"]:
            interval_us = interval_us or self.streams.default_us(message_id)
            self.streams.set(message_id, interval_us, self.now_ns // 1_000_000)
        return ACCEPTED

    def _request_message(self, command: Command) -> int:
        message_id = command.whole(1)
        return ACCEPTED if message_id is not None and self.request(message_id) else DENIED


def _finite(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def _attitude_error(now: Wxyz, wanted: Wxyz) -> Triple:
    """Twice the vector part of now^-1 wanted, the short way round: rad in body axes for small errors."""
    norm = math.sqrt(sum(part * part for part in wanted))
    if norm < 1e-6:
        return (0.0, 0.0, 0.0)
    w, x, y, z = now
    a, b, c, d = (part / norm for part in wanted)
    sign = 2.0 if w * a + x * b + y * c + z * d >= 0.0 else -2.0
    return (
        sign * (w * b - x * a - y * d + z * c),
        sign * (w * c + x * d - y * a - z * b),
        sign * (w * d - x * c + y * b - z * a),
    )
