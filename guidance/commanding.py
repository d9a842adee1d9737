"""What is commanded while engaging, holding and leaving: how often, and when no more.

A command is repeated because it may have been lost. One that was obeyed must not be: what undid it since
was the pilot. HEARTBEAT and CURRENT_MODE show that up to a second late, so the answer forbids repetition; it
never confirms anything.
"""

from __future__ import annotations

from typing import Any, Final

from pymavlink.dialects.v20 import all as dialect

from guidance.config import SupervisorConfig
from guidance.mavlink.messages import CommandAck
from guidance.mavlink.modes import Mode
from guidance.mavlink.profiles import Profile, command_long, set_mode_command
from guidance.supervisor import State
from guidance.view import View

_COMMAND_PERIOD_NS: Final = 1_000_000_000
_LEAVE_PERIOD_NS: Final = 200_000_000
_COMMAND_OF: Final = {
    State.SWITCHING: dialect.MAV_CMD_DO_SET_MODE,
    State.PAUSING: dialect.MAV_CMD_DO_SET_MODE,
    State.ABORTING: dialect.MAV_CMD_DO_SET_MODE,
    State.ARMING: dialect.MAV_CMD_COMPONENT_ARM_DISARM,
}


class Commands:
    """The mode and arming commands of the present state."""

    def __init__(self, config: SupervisorConfig, profile: Profile) -> None:
        self.accepted_ns: int | None = None  # the answer to what was commanded in this state
        self._state = State.DISCONNECTED
        self._arm = config.arm
        self._control_mode = profile.control_mode
        self._leave_for: Mode | None = None
        self._sent_ns: int | None = None

    def begin(self, state: State, leave_for: Mode | None) -> None:
        """A state begins; if it is one that leaves the control mode, then for `leave_for`."""
        self._state, self._leave_for = state, leave_for
        self._sent_ns = self.accepted_ns = None

    def answered(self, ack: CommandAck, now_ns: int) -> None:
        """The autopilot answers a command of ours, or one of nobody knows whom."""
        if self._sent_ns is None or ack.command != _COMMAND_OF.get(self._state):
            return
        if ack.result == dialect.MAV_RESULT_ACCEPTED:
            self.accepted_ns = now_ns
        elif (
            # PX4 may answer twice, first with a yes: a refusal that is surely ours has the last word.
            ack.command == dialect.MAV_CMD_DO_SET_MODE
            and ack.result != dialect.MAV_RESULT_IN_PROGRESS
            and ack.target_system != 0
            and ack.target_component != 0
        ):
            self.accepted_ns = None

    def due(self, view: View, now_ns: int) -> Mode | bool | None:
        """A mode to command now, True to arm, None for nothing."""
        period_ns = _COMMAND_PERIOD_NS
        wanted: Mode | bool | None = None
        if self.accepted_ns is not None:
            return None
        if self._state is State.SWITCHING:
            wanted = self._control_mode
        elif self._state is State.ARMING and self._arm and not view.armed and view.blocked is None:
            wanted = True
        elif not view.certain:  # a mode may have been chosen in the silence, and the stream has ended
            return None
        elif self._state in (State.PAUSING, State.ABORTING, State.LEAVING) or (
            # A mode that somebody else chose is left alone.
            self._state in (State.CANCELLING, State.BACKING_OUT)
            and view.custom_mode == self._control_mode.custom_mode
        ):
            wanted, period_ns = self._leave_for, _LEAVE_PERIOD_NS
        if wanted is None or (self._sent_ns is not None and now_ns - self._sent_ns < period_ns):
            return None
        self._sent_ns = now_ns
        return wanted


def command_of(wanted: Mode | bool, system: int, component: int) -> Any:
    """COMMAND_LONG for a mode, or to arm."""
    if isinstance(wanted, Mode):
        return set_mode_command(wanted, system, component)
    return command_long(system, component, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
