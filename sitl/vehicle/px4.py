"""PX4's manners, whatever the vehicle: modes, OFFBOARD with its proof of life, failsafe, arming, answers.

After PX4 main of 2025-08: `mavlink_receiver.cpp` (setpoints), `Commander.cpp` and `UserModeIntention.cpp`
(modes, arming), and the recorded flights of PX4 1.16. What a setpoint becomes and what flies in the other
modes, a vehicle class says: `px4_uuv`, `px4_plane`, `px4_copter`, `px4_rover`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Final

from pymavlink.dialects.v20 import all as mavlink

from sitl.plant import Wxyz
from sitl.vehicle.autopilot import HANDLERS, STATUSTEXT_LENGTH, Autopilot
from sitl.vehicle.body import BodyState
from sitl.vehicle.command import (
    ACCEPTED,
    ARMED,
    COMMANDS,
    DENIED,
    FAILED,
    TEMPORARILY_REJECTED,
    Command,
)
from sitl.vehicle.controls import Control
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
from sitl.vehicle.px4_targets import Target, attitude_target, trajectory_target
from sitl.vehicle.telemetry import ID, Builder

#: The commander looks at the offboard stream this often.
COMMANDER_NS: Final = 100_000_000

LANDED_ON_GROUND: Final = 1
LANDED_IN_AIR: Final = 2
LANDED_TAKEOFF: Final = 3
LANDED_LANDING: Final = 4


class Px4(Autopilot):
    """A PX4 vehicle on its onboard link."""

    sensors: ClassVar[tuple[int, int, int, int]] = (50348077, 50413613, 589334591, 857786431)
    """Of SYS_STATUS: present, enabled, healthy before and after the estimator is ready, as recorded."""
    standard_modes: ClassVar[Mapping[int, int]] = {}
    """custom_mode -> MAV_STANDARD_MODE, beyond those of every vehicle."""
    loss_modes: ClassVar[Mapping[int, int]] = LOSS_MODES
    """COM_OBL_RC_ACT -> the mode that the loss of OFFBOARD leads to."""
    finds_wind: ClassVar[bool] = False
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
        self.target: Target | None = None
        self.enter(self.custom_mode)
        # What ATTITUDE_TARGET goes on reporting in rates-only OFFBOARD.
        self.stale_attitude_wxyz: Wxyz = (1.0, 0.0, 0.0, 0.0)
        self.stale_thrust = 0.0

    # --- what a vehicle class says ----------------------------------------------------------------------

    @abstractmethod
    def offboard(self, target: Target | None, state: BodyState) -> Control:
        """What its controllers make of the newest setpoint in OFFBOARD; None: there was none since."""

    @abstractmethod
    def automatic(self, state: BodyState) -> Control:
        """What it flies in every other mode, armed."""

    @abstractmethod
    def period_ns(self) -> int:
        """How often its controllers look at the body now."""

    def enter(self, mode: int) -> None:
        """A mode begins to be flown."""

    def progress(self) -> None:
        """Ten times a second: what ends a mode."""

    @property
    def landed(self) -> bool:
        """As its land detector sees it: a vehicle that stays where it is counts as landed in LAND only."""
        return self.custom_mode == LAND

    @property
    def at_rest(self) -> bool:
        """Whether its estimator sees nothing move."""
        return self.landed_state == LANDED_ON_GROUND

    @property
    def landed_state(self) -> int:
        """EXTENDED_SYS_STATE.landed_state."""
        return LANDED_IN_AIR if self.armed else LANDED_ON_GROUND

    # --- setpoints ------------------------------------------------------------------------------------

    @property
    def stream_is_fresh(self) -> bool:
        """Whether the newest proof of life is younger than COM_OF_LOSS_T."""
        limit_ns = round(self.parameters["COM_OF_LOSS_T"] * 1e9)
        return self._life_ns is not None and self.now_ns < self._life_ns + limit_ns

    def _on_set_attitude_target(self, message: Any) -> None:
        target = attitude_target(message)
        if target is None:
            self.drop("SET_ATTITUDE_TARGET with neither attitude nor roll and pitch rate")
            return
        self._take(target)
        if self.custom_mode == OFFBOARD and target.attitude_wxyz is not None:
            self.stale_attitude_wxyz, self.stale_thrust = target.attitude_wxyz, target.thrust

    def _on_set_position_target_local_ned(self, message: Any) -> None:
        yaw_rad = self.sample.euler_rad[2] if self.sample is not None else 0.0
        try:
            self._take(trajectory_target(message, yaw_rad))
        except ValueError as error:
            self.text(2, str(error))

    def _take(self, target: Target) -> None:
        """Proof of life whatever the mode; it acts in OFFBOARD only."""
        self._life_ns = self.now_ns
        if self.custom_mode == OFFBOARD:
            self.target = target

    def demand(self, state: BodyState) -> Control:
        return self.offboard(self.target, state) if self.custom_mode == OFFBOARD else self.automatic(state)

    # --- the commander --------------------------------------------------------------------------------

    def next_wake_ns(self) -> int:
        period_ns = min(self.period_ns(), COMMANDER_NS) if self.armed else COMMANDER_NS
        return (self.now_ns // period_ns + 1) * period_ns

    def wake(self) -> None:
        if self.now_ns % COMMANDER_NS:
            return
        lost = self.intended_mode == OFFBOARD and not self.stream_is_fresh
        if self.armed and lost and not self.failsafe:
            self.failsafe = True
            self.text(2, "Failsafe activated")
            action = round(self.parameters["COM_OBL_RC_ACT"])
            self.fly(self.loss_modes.get(action, LOITER))
            if action == 7:
                self.disarm(forced=True)
        elif self.failsafe and not lost:
            # The intended mode is still OFFBOARD: a stream that resumes takes control back, unasked.
            self.failsafe = False
            self.fly(self.intended_mode)
        if self.armed:
            self.progress()
        if self.armed and self.custom_mode == LAND and self.landed:
            self._disarm_after_landing()
        else:
            self._land_since_ns = None

    def _disarm_after_landing(self) -> None:
        if self._land_since_ns is None:
            self._land_since_ns = self.now_ns
        delay_s = self.parameters["COM_DISARM_LAND"]
        if delay_s > 0.0 and self.now_ns - self._land_since_ns >= round(delay_s * 1e9):
            self.disarm(forced=True)

    def fly(self, mode: int) -> None:
        """Fly in this mode, whatever was intended."""
        if mode != self.custom_mode:
            self.custom_mode = mode
            self.target = None
            self.enter(mode)

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
        self.fly(custom_mode)
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
        if not forced and not self.landed:
            self.text(2, "Disarming denied: not landed")
            return TEMPORARILY_REJECTED
        self.armed = False
        self.failsafe = False
        self.fly(self.intended_mode)
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
