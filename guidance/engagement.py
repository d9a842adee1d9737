"""Engaging and handing over: what is seen of the vehicle becomes events of the supervisor's table.

The sequence is stream -> mode -> (arm) -> verified by HEARTBEAT or CURRENT_MODE, never by an ACK: PX4 sends
two for one DO_SET_MODE, the first always positive. Each step has a deadline, and what blocks it is named.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from guidance.config import SupervisorConfig
from guidance.mavlink.profiles import Mode, Profile
from guidance.supervisor import Event, State, transition

#: Setpoints to send before the mode is asked for.
ESTABLISHED_AFTER: Final = 10
#: How long the exit mode is commanded on shutdown.
LEAVE_S: Final = 1.0
#: After a refusal on the ground, `engage = "auto"` tries again.
RETRY_S: Final = 5.0

_COMMAND_PERIOD_NS: Final = 1_000_000_000
_LEAVE_PERIOD_NS: Final = 200_000_000


class View(NamedTuple):
    """What the supervisor can see. `blocked` is the first unmet condition in words, None if there is none.

    `silent_s` is the time since the last setpoint; `answer` the last refusal of a mode or arming command.
    """

    connected: bool
    lost_because: str
    armed: bool | None
    custom_mode: int | None
    intended_mode: int | None
    blocked: str | None
    setpoints_sent: int
    silent_s: float
    answer: str


class Change(NamedTuple):
    """The state changed: by which event, and why in words."""

    before: State
    after: State
    event: Event
    reason: str


class Engagement:
    """The supervisor's state and the little that it must remember beside it."""

    def __init__(self, config: SupervisorConfig, profile: Profile) -> None:
        self.state = State.DISCONNECTED
        self.reason = "no heartbeat of the autopilot yet"
        self.since_ns = 0
        self._config = config
        self.profile = profile
        self._control = profile.control_mode.custom_mode
        self._auto_spent = False
        self._requested_until_ns = 0
        self._previous_mode: int | None = None
        self._was_armed = False
        self._sent_at_entry = 0
        self._command_ns = 0
        self._shutdown = False

    # Commands of the operator ------------------------------------------------------------------------

    def engage(self, now_ns: int) -> str | None:
        """The operator commands to engage; why that is refused, None if it is not."""
        if self.state in (State.DISCONNECTED, State.LEAVING, State.FINISHED):
            return f"engage refused: {self.state}: {self.reason}"
        if self.state in (State.STREAMING, State.SWITCHING, State.ARMING, State.TRACKING):
            return f"engage ignored: already {self.state}"
        self._requested_until_ns = now_ns + round(self._config.step_timeout_s * 1e9)
        return None

    def shutdown(self) -> None:
        """The operator stops the service."""
        self._shutdown = True

    # What follows from what is seen ------------------------------------------------------------------

    def update(self, view: View, now_ns: int) -> list[Change]:
        """All changes of state that follow from the view, in order."""
        changes: list[Change] = []
        while (happening := self._happening(view, now_ns)) is not None:
            event, reason = happening
            before, after = self.state, transition(self.state, event)
            if event is Event.COMMANDED or event is Event.ENGAGE:
                self._auto_spent = False
            if after is State.HANDED_OVER:
                self._auto_spent = True
            if after is before:
                break
            self.state, self.reason, self.since_ns = after, reason, now_ns
            self._sent_at_entry = view.setpoints_sent
            self._was_armed = bool(view.armed)
            self._command_ns = 0
            changes.append(Change(before, after, event, reason))
        self._previous_mode = view.custom_mode
        return changes

    def due_command(self, view: View, now_ns: int) -> Mode | bool | None:
        """A mode to command now, True to arm, None for nothing; repeated until it is seen to have worked."""
        wanted: Mode | bool
        period_ns = _COMMAND_PERIOD_NS
        if self.state is State.SWITCHING:
            wanted = self.profile.control_mode
        elif self.state is State.ARMING and self._config.arm and not view.armed:
            wanted = True
        elif self.state is State.LEAVING:
            exit_mode = self.profile.mode(self._config.exit_mode)
            assert exit_mode is not None  # checked with the configuration
            wanted, period_ns = exit_mode, _LEAVE_PERIOD_NS
        else:
            return None
        if self._command_ns and now_ns - self._command_ns < period_ns:
            return None
        self._command_ns = now_ns
        return wanted

    def _happening(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        state = self.state
        if state is State.FINISHED:
            return None
        if state is not State.DISCONNECTED and not view.connected:
            return Event.LOST, view.lost_because
        if self._shutdown and state is not State.LEAVING:
            return Event.SHUTDOWN, "the service was told to stop"
        match state:
            case State.DISCONNECTED:
                return self._when_disconnected(view)
            case State.WITHHELD:
                return self._when_withheld(view, now_ns)
            case State.CONNECTED | State.READY:
                return self._before_engaging(view, now_ns)
            case State.STREAMING | State.SWITCHING | State.ARMING:
                return self._engaging(view, now_ns)
            case State.TRACKING | State.LEAVING:
                return self._in_control(view, now_ns)
            case State.HANDED_OVER | State.ABORTED:
                return self._out_of_control(view, now_ns)

    def _when_disconnected(self, view: View) -> tuple[Event, str] | None:
        if not view.connected or view.armed is None or view.custom_mode is None:
            return None
        if view.armed and self._may_obey(view):
            return Event.FOUND_IN_CONTROL, self._withheld_reason(view)
        return Event.FOUND, "autopilot found"

    def _when_withheld(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        if view.intended_mode == self._control or view.custom_mode == self._control:
            self._auto_spent = True  # somebody flew it: `auto` must not take it back from whoever has it then
        if now_ns < self._requested_until_ns:
            return Event.COMMANDED, "the operator commands"
        if not view.armed:
            self._auto_spent = False
            return Event.RELEASED, "the vehicle is disarmed"
        if not self._may_obey(view):
            return Event.RELEASED, f"the vehicle was taken out of {self.profile.control_mode.name}"
        self.reason = self._withheld_reason(view)
        return None

    def _before_engaging(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        if view.blocked is not None:
            self.reason = view.blocked
            return (Event.CONDITIONS_LOST, view.blocked) if self.state is State.READY else None
        if self.state is State.CONNECTED:
            return Event.CONDITIONS_MET, self._waiting_for(view)
        if self._switched(view):
            return Event.PILOT_SWITCHED, f"the pilot switched to {self.profile.control_mode.name}"
        if now_ns < self._requested_until_ns:
            self._requested_until_ns = 0
            return Event.ENGAGE, "the operator commands"
        if self._config.engage == "auto" and not self._auto_spent:
            return Event.ENGAGE, 'engage = "auto"'
        self.reason = self._waiting_for(view)
        return None

    def _engaging(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        mode = self.profile.control_mode
        late = (now_ns - self.since_ns) * 1e-9 > self._config.step_timeout_s
        answer = f"; its answer: {view.answer}" if view.answer else ""
        if self.state is State.STREAMING:
            if self._switched(view):
                return Event.PILOT_SWITCHED, f"the pilot switched to {mode.name}"
            if view.setpoints_sent - self._sent_at_entry >= ESTABLISHED_AFTER:
                return Event.STREAM_ESTABLISHED, f"commanding {mode.name}"
            return _timeout(late, f"no stream of setpoints: {view.blocked or 'none sent'}")
        if self.state is State.SWITCHING:
            if view.custom_mode == mode.custom_mode:
                return Event.MODE_CONFIRMED, f"{mode.name} confirmed"
            return _timeout(late, f"the autopilot does not enter {mode.name}{answer}")
        if view.custom_mode != mode.custom_mode:
            return Event.MODE_LEFT, f"the mode was changed to {self._name(view.custom_mode)}"
        if self._was_armed and not view.armed:
            return Event.DISARMED, "the vehicle was disarmed"
        self._was_armed = bool(view.armed)
        if view.armed and view.blocked is None:
            return Event.IN_CONTROL, f"{mode.name} and armed, confirmed"
        if view.armed:
            return _timeout(late, view.blocked or "")
        if self._config.arm:
            return _timeout(late, f"the autopilot does not arm{answer}")
        self.reason = "waiting for the pilot to arm"
        return None

    def _in_control(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        if self.state is State.LEAVING:
            exit_mode = self.profile.mode(self._config.exit_mode)
            if exit_mode is not None and view.custom_mode == exit_mode.custom_mode:
                return Event.LEFT, f"{exit_mode.name} confirmed"
            if (now_ns - self.since_ns) * 1e-9 > LEAVE_S:
                return Event.LEFT, f"{self._config.exit_mode} not seen within {LEAVE_S} s"
            if not self._was_armed:
                return None  # shut down while engaging: the mode may not be reached yet
        if view.custom_mode != self._control:
            return Event.MODE_LEFT, f"the mode was changed to {self._name(view.custom_mode)}"
        if not view.armed:
            return Event.DISARMED, "the vehicle was disarmed"
        silent_s = min(view.silent_s, (now_ns - self.since_ns) * 1e-9)
        if silent_s > 0.5 * self.profile.stream_timeout_s:
            why = f" ({view.blocked})" if view.blocked else ""
            return Event.INTERRUPTED, f"no setpoint for {silent_s:.2f} s{why}"
        return None

    def _out_of_control(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        if now_ns < self._requested_until_ns:
            return Event.COMMANDED, "the operator commands"
        # Where the mode needs a stream, an edge that comes without one of ours belongs to somebody else.
        if self._switched(view) and not self.profile.needs_stream:
            return Event.PILOT_SWITCHED, f"the pilot switched to {self.profile.control_mode.name}"
        if self.state is State.HANDED_OVER:
            if not view.armed and not self._may_obey(view):
                return Event.RELEASED, "the vehicle is disarmed and in another mode"
            return None
        waited = (now_ns - self.since_ns) * 1e-9 > RETRY_S
        if waited and self._config.engage == "auto" and not self._auto_spent and not view.armed:
            return Event.RETRY, "trying again"
        return None

    # Small judgements --------------------------------------------------------------------------------

    def _switched(self, view: View) -> bool:
        """The mode has just become the control mode."""
        return view.custom_mode == self._control and self._previous_mode not in (None, self._control)

    def _may_obey(self, view: View) -> bool:
        """Whether a setpoint might act at once: the control mode is on, intended, or not excluded."""
        if view.custom_mode == self._control:
            return True
        if not self.profile.needs_stream:
            return False
        return view.intended_mode is None or view.intended_mode == self._control

    def may_offer_stream(self, view: View) -> bool:
        """Whether neutral setpoints may flow in READY: the mode needs them and they cannot take control."""
        return self.profile.needs_stream and not self._may_obey(view)

    def _withheld_reason(self, view: View) -> str:
        mode = self.profile.control_mode.name
        if view.custom_mode != self._control and view.intended_mode is None:
            return f"armed, and CURRENT_MODE does not say yet whether {mode} is intended: silent"
        return f"found armed in {mode}: silent until the mode changes, it disarms, or engage is commanded"

    def _waiting_for(self, view: View) -> str:
        mode = self.profile.control_mode.name
        if view.custom_mode == self._control:
            return f"ready; already in {mode}: leave it and switch again, or command engage"
        return f"ready; waiting for the pilot to switch to {mode}"

    def _name(self, custom_mode: int | None) -> str:
        return "unknown" if custom_mode is None else self.profile.mode_name(custom_mode)


def _timeout(late: bool, reason: str) -> tuple[Event, str] | None:
    return (Event.STEP_TIMEOUT, reason) if late else None
