"""ArduPilot's manners, whatever the vehicle: start, modes, arming, streams, answers.

After ArduPilot 4.7.0-dev (`GCS_Common.cpp`, `AP_Arming`, each vehicle's `GCS_MAVLink`), the recorded flights.
What a setpoint becomes, how long it lasts and what flies in the other modes, a vehicle class says:
`ardupilot_rover`, `ardupilot_plane`, `ardupilot_copter`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Final

from sitl.vehicle.ardupilot_messages import STREAM_GROUPS, STREAM_PARAMETERS, ardupilot_builders
from sitl.vehicle.autopilot import HANDLERS, Autopilot
from sitl.vehicle.command import ACCEPTED, ARMED, DENIED, FAILED, FORCE, UNSUPPORTED, Command
from sitl.vehicle.telemetry import ID, Builder

#: How long initialisation lasts at most, while the estimator is not ready yet (recorded: 2.4 s after start).
INITIALISING_NS: Final = 1_400_000_000
#: SET_MESSAGE_INTERVAL is refused for rates above this part of SCHED_LOOP_RATE.
MAX_RATE_OF_LOOP: Final = 0.8
#: param2 that forces arming; disarming knows `FORCE`.
FORCE_ARM: Final = 2989


class ArduPilot(Autopilot):
    """An ArduPilot vehicle on its first telemetry link."""

    names: ClassVar[Mapping[int, str]]
    """custom_mode -> name; without those that a vehicle of this kind does not have."""
    guided: ClassVar[int]
    initialising_mode: ClassVar[int | None] = None
    needs_position: ClassVar[frozenset[int]]
    """Modes that are refused while armed without a position."""
    texts: ClassVar[tuple[str, str, str]] = (
        "Throttle armed",
        "Throttle disarmed",
        "Arm: AHRS: not using configured AHRS type",
    )
    """Said when armed, disarmed, and not armed before the estimator is ready."""
    title: ClassVar[str] = "rover"
    capabilities: ClassVar[int] = 0xF1EF
    sensors: ClassVar[tuple[int, int, int, int]] = (322034735, 320986159, 51478831, 322034991)
    """Of SYS_STATUS: present, enabled, healthy before and after the estimator is ready, as recorded."""
    finds_wind: ClassVar[bool] = False
    airborne_mode: ClassVar[str] = ""
    """The mode in which one starts that starts in the air."""
    integers_bytewise: ClassVar = False
    batches_datagrams: ClassVar = True
    handlers: ClassVar = {**HANDLERS, "REQUEST_DATA_STREAM": "_on_request_data_stream"}

    @property
    def loop_ms(self) -> int:
        """Whole milliseconds of 1/SCHED_LOOP_RATE, as it was at boot."""
        return self._loop_ms

    @property
    def mode_name(self) -> str:
        return self.names[self.custom_mode]

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
        self._first_mode = self._chosen_first()
        # With an estimator that is ready at once there is nothing to wait for, and no initialisation.
        self._was_ready = not self.options.estimator_ready_s > 0.0
        self.initialising = not self._was_ready
        self.custom_mode = self._first_mode
        if self.initialising and self.initialising_mode is not None:
            self.custom_mode = self.initialising_mode
        self._init_end_ns = self.now_ns + INITIALISING_NS
        self.forget()

    def _chosen_first(self) -> int:
        initial = self.options.initial_mode or (self.airborne_mode if self.options.airborne else None)
        modes = {name: mode for mode, name in self.names.items()}
        if initial is None:
            first = round(self.parameters["INITIAL_MODE"])
            return first if first in self.names else 0
        if initial not in modes:
            raise ValueError(f"unknown mode {initial}; {type(self).__name__} has {', '.join(modes)}")
        return modes[initial]

    # --- what a vehicle class says ----------------------------------------------------------------------

    @property
    @abstractmethod
    def mav_type(self) -> int:
        """Of HEARTBEAT."""

    @abstractmethod
    def forget(self) -> None:
        """A mode begins: no setpoint, no plan."""

    @abstractmethod
    def period_ns(self) -> int:
        """How often it looks at the body now."""

    def look(self) -> None:
        """So often: time-outs, and what ends a mode."""

    @abstractmethod
    def mode_flag(self) -> int:
        """Bits of HEARTBEAT.base_mode beyond "custom" and "armed"."""

    @abstractmethod
    def system_status(self) -> int:
        """HEARTBEAT.system_status."""

    @property
    def landed(self) -> bool:
        """Whether it may be disarmed without force."""
        return True

    @property
    def landed_state(self) -> int:
        """A MAV_LANDED_STATE, for EXTENDED_SYS_STATE."""
        return 1 if self.landed else 2

    def may_arm(self) -> str:
        """Why not in this mode; empty if it may."""
        return ""

    # --- loop, modes, arming --------------------------------------------------------------------------

    def next_wake_ns(self) -> int:
        period_ns = self.period_ns()
        return (self.now_ns // period_ns + 1) * period_ns

    def wake(self) -> None:
        if self.initialising and (self.now_ns >= self._init_end_ns or self.estimator_ready):
            self.initialising = False
            self.text(6, "ArduPilot Ready")
            self.switch(self._first_mode)
        if self.estimator_ready and not self._was_ready:
            self._was_ready = True
            self.text(6, "EKF3 IMU0 is using GPS")
            self.text(6, "AHRS: EKF3 active")
        self.look()

    def switch(self, mode: int) -> None:
        """Begin a mode."""
        if mode != self.custom_mode:
            self.custom_mode = mode
            self.forget()
            # At once, not at the next second.
            if self.sample is not None:
                self.say(self._builders[ID["HEARTBEAT"]](self.sample))

    def custom_mode_of(self, command: Command) -> int | None:
        base, mode = command.whole(1), command.whole(2)
        return None if base is None or mode is None or not base & 1 else mode

    def select_mode(self, custom_mode: int) -> int:
        if custom_mode not in self.names or custom_mode == self.initialising_mode:
            self.text(4, f"No such mode {custom_mode}")
            return FAILED
        if self.armed and not self.estimator_ready and custom_mode in self.needs_position:
            return FAILED
        self.switch(custom_mode)
        return ACCEPTED

    def _on_set_mode(self, message: Any) -> None:
        result = self.select_mode(message.custom_mode) if message.base_mode & 1 else DENIED
        source = (message.get_srcSystem(), message.get_srcComponent())
        self.acknowledge(Command(ID["SET_MODE"], (0.0,) * 7, *source), result)

    def _arm_disarm(self, command: Command) -> int:
        if command.params[0] == 1.0:
            return self.arm(forced=command.whole(2) == FORCE_ARM)
        return self.disarm(forced=command.whole(2) == FORCE) if command.params[0] == 0.0 else UNSUPPORTED

    def arm(self, *, forced: bool) -> int:
        if self.armed:
            return ACCEPTED
        why = "Arm: System not initialised" if self.initialising else self.may_arm()
        if not why and not forced and not self.estimator_ready:
            why = self.texts[2]
        if why:
            self.text(2, why)
            return FAILED
        self.armed = True
        self.text(6, self.texts[0])
        return ACCEPTED

    def disarm(self, *, forced: bool) -> int:
        if self.armed:
            if not forced and not self.landed:
                return FAILED
            self.armed = False
            self.text(6, self.texts[1])
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
        return 1 | self.mode_flag() | (ARMED if self.armed and not self.initialising else 0)

    @property
    def yaw_rad(self) -> float:
        """As estimated."""
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
