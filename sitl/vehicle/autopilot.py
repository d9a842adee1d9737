"""What both firmwares share: the command, parameter, stream and time protocols, and the hooks they fill."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Final

from pymavlink.dialects.v20 import all as mavlink

from sitl.plant import Triple
from sitl.vehicle import telemetry
from sitl.vehicle.body import BodyState
from sitl.vehicle.command import (
    ACCEPTED,
    COMMANDS,
    DENIED,
    FAILED,
    FORCE,
    TEMPORARILY_REJECTED,
    UNSUPPORTED,
    Command,
)
from sitl.vehicle.controls import Control
from sitl.vehicle.link import Link
from sitl.vehicle.manual_parameters import manual_parameters
from sitl.vehicle.options import VehicleOptions
from sitl.vehicle.parameter_set import Parameter, ParameterSet
from sitl.vehicle.sample import Sample
from sitl.vehicle.schedule import Streams
from sitl.vehicle.telemetry import ID, Builder

STATUSTEXT_LENGTH: Final = 50

#: Message type -> the method that obeys it.
HANDLERS: Final[Mapping[str, str]] = {
    "COMMAND_LONG": "_on_command",
    "COMMAND_INT": "_on_command",
    "PARAM_REQUEST_LIST": "_on_parameters",
    "PARAM_REQUEST_READ": "_on_parameters",
    "PARAM_SET": "_on_parameters",
    "SET_ATTITUDE_TARGET": "_on_set_attitude_target",
    "SET_MODE": "_on_set_mode",
    "SET_POSITION_TARGET_LOCAL_NED": "_on_set_position_target_local_ned",
    "TIMESYNC": "_on_timesync",
}


class Autopilot(ABC):
    """A firmware: it sees messages, its loop's ticks and the estimator, and says what the body shall do.

    Instants are `boot_ns`, ns since boot of the vehicle's own clock. The firmware's closed loops on
    attitude see the plant as it is, without the estimate's noise; a bearing is steered to by the estimate.
    """

    idle: ClassVar[Control]
    """What the actuators get while disarmed."""
    gives: ClassVar[tuple[type, ...]]
    """Kinds of `Control` that it gives."""
    parameter_defaults: ClassVar[Mapping[str, Parameter]]
    integers_bytewise: ClassVar[bool]
    batches_datagrams: ClassVar[bool]
    handlers: ClassVar[Mapping[str, str]] = HANDLERS
    commands: ClassVar[Mapping[int, str]] = COMMANDS

    def __init__(self, options: VehicleOptions) -> None:
        self.options = options
        self.link = Link(
            options.system_id,
            options.component_id,
            batch=self.batches_datagrams,
            signing_key=options.signing_key,
        )
        told = {**manual_parameters(options.model, options.firmware), **options.parameters}
        self.parameters = ParameterSet(self.parameter_defaults, told, bytewise=self.integers_bytewise)
        self.refuses_modes = options.refuses_modes
        self.refuses_arming = options.refuses_arming
        self.armed = False
        self.reboot_requested = False
        self.home_ned_m: Triple = (0.0, 0.0, 0.0)
        self.ignored: dict[str, int] = {}
        self.now_ns = self._started_ns = 0
        self.sample: Sample | None = None
        self.body: BodyState | None = None
        self.seen: Callable[[], BodyState] | None = None  # what its estimator makes of it
        self._held: list[Any] | None = None
        self._builders = {i: build for i, build in self.builders().items() if i not in self._unknown()}
        self.withheld: set[int] = set()  # known, accepted when asked for, and not sent
        self.reset_counter = 0
        self.streams = Streams({}, 1, 0)
        self.restart(0)

    # --- what a firmware fills ------------------------------------------------------------------------

    @property
    @abstractmethod
    def loop_ms(self) -> int:
        """Period of the loop on whose ticks messages leave and closed loops run."""

    @property
    @abstractmethod
    def mode_name(self) -> str:
        """The mode now flown, in the firmware's words."""

    @abstractmethod
    def builders(self) -> dict[int, Builder]:
        """Message id -> what fills it; None from a builder sends nothing."""

    @abstractmethod
    def stream_defaults_us(self) -> dict[int, int]:
        """Message id -> interval after boot, in the order in which they leave within a loop."""

    @abstractmethod
    def start(self) -> None:
        """Modes and timers as after power-on."""

    @abstractmethod
    def next_wake_ns(self) -> int:
        """When the firmware wants its loop to run."""

    @abstractmethod
    def wake(self) -> None:
        """One run of the loop at `now_ns`: timeouts, failsafes."""

    @abstractmethod
    def demand(self, state: BodyState) -> Control:
        """What the body is told while armed, from the newest setpoint and the body as it is."""

    @abstractmethod
    def select_mode(self, custom_mode: int) -> int:
        """Switch to `custom_mode` as DO_SET_MODE or SET_MODE asks; a MAV_RESULT."""

    @abstractmethod
    def custom_mode_of(self, command: Command) -> int | None:
        """The custom_mode that DO_SET_MODE means; None: no such encoding."""

    @abstractmethod
    def arm(self, *, forced: bool) -> int:
        """Try to arm; a MAV_RESULT."""

    @abstractmethod
    def disarm(self, *, forced: bool) -> int:
        """Try to disarm; a MAV_RESULT."""

    # --- the loop ---------------------------------------------------------------------------------------

    def restart(self, boot_ns: int) -> None:
        """What a (re)boot does; parameters stay."""
        self.now_ns = self._started_ns = boot_ns
        self.armed = False
        self.reboot_requested = False
        self.link.restart()
        self.start()
        self.reset_counter = 0
        known = {i: us for i, us in self.stream_defaults_us().items() if i in self._builders}
        self.streams = Streams(known, self.loop_ms, boot_ns // 1_000_000)

    def _unknown(self) -> set[int]:
        """The ids of the messages that this build of the firmware was told not to have."""
        for name in self.options.without_messages:
            if name not in ID:
                raise ValueError(f"without_messages: there is no message {name}")
        return {ID[name] for name in self.options.without_messages}

    @property
    def estimator_ready(self) -> bool:
        """Whether position and home exist."""
        return self.now_ns - self._started_ns >= round(self.options.estimator_ready_s * 1e9)

    def command(self, state: BodyState) -> Control:
        """What the body is told until the next wake or message."""
        self.body = state
        return self.demand(state) if self.armed else self.idle

    def stream(self, message_ids: list[int], sample: Sample) -> None:
        """Send what is due in this loop."""
        self.sample = sample
        for message_id in message_ids:
            builder = None if message_id in self.withheld else self._builders.get(message_id)
            message = None if builder is None else builder(sample)
            if message is not None:
                self.link.send(message)
        self.link.end_of_loop()

    def receive(self, message: Any, boot_ns: int, sample: Sample) -> None:
        """Obey one message at the instant it came; messages for others are ignored."""
        self.now_ns = boot_ns
        self.sample = sample
        handler = self.handlers.get(message.get_type())
        target_system = getattr(message, "target_system", 0)
        target_component = getattr(message, "target_component", 0)
        if handler is None or target_system not in (0, self.options.system_id):
            return
        if target_component not in (0, self.options.component_id):
            return
        getattr(self, handler)(message)

    def say(self, message: Any) -> None:
        """Send a message of the firmware's own accord: after the ACK, while a command is being obeyed."""
        if self._held is None:
            self.link.send(message)
        else:
            self._held.append(message)

    def text(self, severity: int, text: str) -> None:
        """Send a STATUSTEXT."""
        self.say(mavlink.MAVLink_statustext_message(severity, text.encode()[:STATUSTEXT_LENGTH]))

    @property
    def answering(self) -> bool:
        """Whether a command is being obeyed: what is built now was asked for."""
        return self._held is not None

    def request(self, message_id: int) -> bool:
        """Send one message now; False if there is no such message. It may have nothing to say yet."""
        builder = self._builders.get(message_id)
        if builder is None or self.sample is None:
            return False
        message = builder(self.sample)
        if message is not None:
            self.link.send(message)
        return True

    def drop(self, why: str) -> None:
        """Count a message that a real one would silently ignore."""
        self.ignored[why] = self.ignored.get(why, 0) + 1

    # --- commands ---------------------------------------------------------------------------------------

    def obey(self, command: Command) -> None:
        """Carry out a command and acknowledge it; what it makes the firmware say comes after the ACK."""
        name = self.commands.get(command.id)
        held: list[Any] = []
        self._held = held
        if self._refused(command):
            result = TEMPORARILY_REJECTED
        else:
            result = UNSUPPORTED if name is None else getattr(self, name)(command)
        self._held = None
        self.acknowledge(command, result)
        for message in held:
            self.link.send(message)

    def _refused(self, command: Command) -> bool:
        """Whether this vehicle was told to refuse it whatever its firmware would say."""
        arming = command.id == 400 and command.params[0] == 1.0
        return (self.refuses_modes and command.id == 176) or (self.refuses_arming and arming)

    def acknowledge(self, command: Command, result: int) -> None:
        """Send a COMMAND_ACK."""
        asker = (command.source_system, command.source_component)
        self.link.send(mavlink.MAVLink_command_ack_message(command.id, result, 0, 0, *asker))

    def _on_command(self, message: Any) -> None:
        self.obey(Command.of(message))

    def _do_set_mode(self, command: Command) -> int:
        custom_mode = self.custom_mode_of(command)
        return DENIED if custom_mode is None else self.select_mode(custom_mode)

    def _arm_disarm(self, command: Command) -> int:
        forced = command.whole(2) == FORCE
        if command.params[0] == 1.0:
            return self.arm(forced=forced)
        return self.disarm(forced=forced) if command.params[0] == 0.0 else UNSUPPORTED

    @abstractmethod
    def _reboot_shutdown(self, command: Command) -> int:
        """MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN."""

    @abstractmethod
    def _set_message_interval(self, command: Command) -> int:
        """MAV_CMD_SET_MESSAGE_INTERVAL."""

    @abstractmethod
    def _request_message(self, command: Command) -> int:
        """MAV_CMD_REQUEST_MESSAGE."""

    def _get_message_interval(self, command: Command) -> int:
        message_id = command.whole(1)
        if message_id is None or message_id not in self._builders:
            return FAILED
        interval_us = self.streams.interval_us(message_id)
        self.link.send(mavlink.MAVLink_message_interval_message(message_id, interval_us or -1))
        return ACCEPTED

    def _request_capabilities(self, command: Command) -> int:
        return ACCEPTED if self.request(ID["AUTOPILOT_VERSION"]) else FAILED

    def _get_home(self, command: Command) -> int:
        if not self.estimator_ready:
            return FAILED
        self.request(ID["HOME_POSITION"])
        return ACCEPTED

    def _do_set_home(self, command: Command) -> int:
        if not self.estimator_ready or self.sample is None or command.params[0] != 1.0:
            return FAILED
        self.home_ned_m = self.sample.position_ned_m
        self.request(ID["HOME_POSITION"])
        return ACCEPTED

    # --- other protocols --------------------------------------------------------------------------------

    @abstractmethod
    def _on_set_mode(self, message: Any) -> None:
        """SET_MODE, the older way to switch."""

    @abstractmethod
    def _on_set_attitude_target(self, message: Any) -> None:
        """SET_ATTITUDE_TARGET."""

    @abstractmethod
    def _on_set_position_target_local_ned(self, message: Any) -> None:
        """SET_POSITION_TARGET_LOCAL_NED."""

    def _on_parameters(self, message: Any) -> None:
        for value in self.parameters.answers(message):
            self.link.send(value)

    def _on_timesync(self, message: Any) -> None:
        # tc1 = 0 asks; anything else is the answer to our own question, which nobody here needs.
        if message.tc1 == 0:
            self.link.send(mavlink.MAVLink_timesync_message(self.now_ns // 1000 * 1000, message.ts1))

    # --- messages that differ only in numbers -----------------------------------------------------------

    def ask_timesync(self, sample: Sample) -> Any:
        """TIMESYNC: the firmware's own question."""
        return mavlink.MAVLink_timesync_message(0, sample.boot_us * 1000)

    def system_time(self, sample: Sample) -> Any:
        """SYSTEM_TIME."""
        return mavlink.MAVLink_system_time_message(
            self.options.unix_at_zero_ns // 1000 + sample.boot_us, sample.boot_ms
        )

    def if_ready(self, builder: Builder) -> Builder:
        """A builder that has nothing to say before the estimator is ready."""

        def build(sample: Sample) -> Any:
            return builder(sample) if self.estimator_ready else None

        return build

    def gps_global_origin(self, sample: Sample) -> Any:
        """GPS_GLOBAL_ORIGIN."""
        return telemetry.gps_global_origin(sample, self.options.origin)
