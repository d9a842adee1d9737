"""Leaving the control mode: for which mode, and whether that is seen or has taken too long.

Fresh setpoints go on until then, so that nothing happens between the two modes.
"""

from __future__ import annotations

from typing import Final

from guidance.config import SupervisorConfig
from guidance.mavlink.profiles import Profile
from guidance.supervisor import Event, State
from guidance.view import View

#: How long a mode is commanded when the flight ends; it ends with the first look after that.
LEAVE_S: Final = 1.0
#: How long the hold mode is: a flight that shall go on is worth the wait for a HEARTBEAT that was lost.
PAUSE_S: Final = 3.0

#: The states that command a mode to leave the control mode.
LEAVING: Final = frozenset(
    {State.PAUSING, State.ABORTING, State.CANCELLING, State.BACKING_OUT, State.LEAVING}
)
_FROM_ENGAGING: Final = (State.CANCELLING, State.BACKING_OUT)


class Leaving:
    """The mode of the present state, and since when it is commanded."""

    def __init__(self, config: SupervisorConfig, profile: Profile) -> None:
        exit_mode, hold_mode = profile.mode(config.exit_mode), profile.mode(config.hold_mode)
        if exit_mode is None or hold_mode is None:
            raise ValueError(f"{profile.name} lacks {config.exit_mode} or {config.hold_mode}")
        self._exit_mode, self._hold_mode = exit_mode, hold_mode
        self._control_mode = profile.control_mode
        self._state = State.DISCONNECTED
        self._mode_at_entry: int | None = None
        self._since_ns = 0
        self.mode = exit_mode

    def begin(self, state: State, view: View, now_ns: int) -> None:
        """A state begins."""
        self._state, self._since_ns, self._mode_at_entry = state, now_ns, view.custom_mode
        self.mode = self._hold_mode if state in (State.PAUSING, State.HOLDING) else self._exit_mode
        if state is State.ABORTING and view.trip is not None and view.trip.mode is not None:
            self.mode = view.trip.mode

    def expected(self) -> set[int | None]:
        """The modes that are no surprise, beside the control mode."""
        if self._state in _FROM_ENGAGING:
            return {self._mode_at_entry}
        return {self.mode.custom_mode} if self._state in (*LEAVING, State.HOLDING) else set()

    def ended(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        """The mode is on, or it took too long."""
        pausing = self._state is State.PAUSING
        # Backing out of that mode itself, a command to leave it may still be on its way.
        sure = self._state not in _FROM_ENGAGING or view.custom_mode != self._mode_at_entry
        if view.custom_mode == self.mode.custom_mode and sure:
            return Event.HOLD_CONFIRMED if pausing else Event.LEFT, f"{self.mode.name} confirmed"
        limit_s = PAUSE_S if pausing else LEAVE_S
        if now_ns - self._since_ns < round(limit_s * 1e9):
            return None
        event = Event.STEP_TIMEOUT if pausing else Event.LEFT
        if self._state in _FROM_ENGAGING and view.custom_mode != self._control_mode.custom_mode:
            return event, f"{self._control_mode.name} is not on"  # nor was another one commanded
        return event, f"{self.mode.name} not confirmed within {limit_s:g} s"
