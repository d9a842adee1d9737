"""Engaging and handing over: what is seen of the vehicle becomes events of the supervisor's table.

The sequence is stream -> mode -> (arm) -> verified by HEARTBEAT or CURRENT_MODE, never by an ACK: PX4 sends
two for one DO_SET_MODE, the first always positive. Each step has a deadline, and what blocks it is named.
"""

from __future__ import annotations

from enum import Enum, auto
from typing import Final, NamedTuple

from guidance.config import SupervisorConfig
from guidance.mavlink.profiles import Mode, Profile
from guidance.supervisor import Event, State, transition

#: Setpoints to send before the mode is asked for.
ESTABLISHED_AFTER: Final = 10
#: How long the exit mode is commanded on shutdown; it ends with the first look after that.
LEAVE_S: Final = 1.0
#: On the ground, a refusal is tried again after this time, and a hand-over becomes a new start.
RETRY_S: Final = 5.0
#: Silence while tracking: more than this hands over, or half the firmware's own time-out if that is less.
INTERRUPTED_S: Final = 0.75

_COMMAND_PERIOD_NS: Final = 1_000_000_000
_LEAVE_PERIOD_NS: Final = 200_000_000


class View(NamedTuple):
    """What the supervisor can see. `blocked` is the first unmet condition in words, None if there is none.

    `silent_s` is the time since the last setpoint; `answer` the last refusal of a mode or arming command.
    """

    connected: bool
    absent_because: str
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
        self._exit_mode = profile.mode(config.exit_mode)  # known: checked with the configuration
        self._auto = _Auto.MAY_ENGAGE
        self._requested_until_ns = 0
        self._previous_mode: int | None = None
        self._mode_at_entry: int | None = None
        self._was_armed = False
        self._armed_ns = 0
        self._sent_at_entry = 0
        self._commanded_ns: int | None = None
        self._shutdown = False

    # Commands of the operator ------------------------------------------------------------------------

    def engage(self, now_ns: int) -> str | None:
        """The operator commands to engage; why that is refused, None if it is not."""
        if self._shutdown:
            return "engage refused: the service is shutting down"
        if self.state is State.DISCONNECTED:
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
            if after is before:
                break
            self.state, self.reason, self.since_ns = after, reason, now_ns
            self._entered(event, view, now_ns)
            changes.append(Change(before, after, event, reason))
        # A switch is fresh only if it was seen: not one made while the link was down.
        self._previous_mode = view.custom_mode if view.connected else None
        return changes

    def _entered(self, event: Event, view: View, now_ns: int) -> None:
        """What must be remembered of the instant at which a state began."""
        if event is Event.ENGAGE:
            self._auto = _Auto.MAY_ENGAGE
        if self.state is State.HANDED_OVER:
            self._auto = _Auto.HANDED_OVER
        if self.state not in (State.CONNECTED, State.READY):
            self._requested_until_ns = 0  # obeyed, or overtaken: a command never acts twice
        self._mode_at_entry = view.custom_mode
        self._was_armed = bool(view.armed)
        self._armed_ns = now_ns
        self._sent_at_entry = view.setpoints_sent
        self._commanded_ns = None

    def due_command(self, view: View, now_ns: int) -> Mode | bool | None:
        """A mode to command now, True to arm, None for nothing; repeated until it is seen to have worked."""
        period_ns = _COMMAND_PERIOD_NS
        wanted: Mode | bool | None = None
        if self.state is State.SWITCHING:
            wanted = self.profile.control_mode
        elif self.state is State.ARMING and self._config.arm and not view.armed and view.blocked is None:
            wanted = True
        elif self.state is State.LEAVING or (
            # A mode that somebody else chose is left alone.
            self.state is State.BACKING_OUT and view.custom_mode == self._control
        ):
            wanted, period_ns = self._exit_mode, _LEAVE_PERIOD_NS
        if wanted is None or (self._commanded_ns is not None and now_ns - self._commanded_ns < period_ns):
            return None
        self._commanded_ns = now_ns
        return wanted

    def _happening(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        state = self.state
        if state is State.FINISHED:
            return None
        if state is not State.DISCONNECTED and not view.connected:
            return Event.LOST, view.absent_because
        if self._shutdown and state not in (State.LEAVING, State.BACKING_OUT):
            return Event.SHUTDOWN, "the service was told to stop"
        match state:
            case State.DISCONNECTED:
                return self._when_disconnected(view)
            case State.WITHHELD:
                return self._when_withheld(view, now_ns)
            case State.CONNECTED | State.READY:
                return self._before_engaging(view, now_ns)
            case State.STREAMING | State.SWITCHING:
                return self._unasked(view, now_ns) or self._engaging(view, now_ns)
            case State.ARMING:
                return self._unasked(view, now_ns) or self._arming(view, now_ns)
            case State.TRACKING:
                return self._unasked(view, now_ns) or self._interrupted(view, now_ns)
            case State.BACKING_OUT | State.LEAVING:
                return self._leaving(view, now_ns) or self._unasked(view, now_ns)
            case State.HANDED_OVER | State.ABORTED:
                return self._out_of_control(view, now_ns)

    def _when_disconnected(self, view: View) -> tuple[Event, str] | None:
        if not view.connected or view.armed is None or view.custom_mode is None:
            self.reason = view.absent_because
            return None
        if view.armed and self._may_obey(view):
            return Event.FOUND_IN_CONTROL, self._withheld_reason(view)
        return Event.FOUND, "autopilot found"

    def _when_withheld(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        if view.intended_mode == self._control or view.custom_mode == self._control:
            # Somebody flew it: `auto` must not take it from whoever has it then.
            self._auto = _Auto.FOUND_FLYING if self._auto is _Auto.MAY_ENGAGE else self._auto
        if now_ns < self._requested_until_ns:
            return Event.COMMANDED, "the operator commands"
        if not view.armed:
            # Down, and not by a hand-over in this run: as good as found disarmed.
            self._auto = _Auto.MAY_ENGAGE if self._auto is _Auto.FOUND_FLYING else self._auto
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
            return Event.ENGAGE, "the operator commands"
        if self._may_auto():
            return Event.ENGAGE, 'engage = "auto"'
        self.reason = self._waiting_for(view)
        return None

    def _unasked(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        """The mode was changed or the vehicle disarmed, and not by this service: the pilot wins."""
        expected: set[int | None] = {self._control}
        if self.state in (State.STREAMING, State.SWITCHING, State.BACKING_OUT):
            expected.add(self._mode_at_entry)
        elif self.state is State.LEAVING and self._exit_mode is not None:
            expected.add(self._exit_mode.custom_mode)
        if view.custom_mode not in expected:
            return Event.MODE_LEFT, f"the mode was changed to {self._name(view.custom_mode)}"
        if self._was_armed and not view.armed:
            return Event.DISARMED, "the vehicle was disarmed"
        if view.armed and not self._was_armed:
            self._was_armed, self._armed_ns = True, now_ns
        return None

    def _engaging(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        mode = self.profile.control_mode
        late = self._late(self.since_ns, now_ns)
        if self.state is State.STREAMING:
            if self._switched(view):
                return Event.PILOT_SWITCHED, f"the pilot switched to {mode.name}"
            if view.setpoints_sent - self._sent_at_entry >= ESTABLISHED_AFTER:
                return Event.STREAM_ESTABLISHED, f"commanding {mode.name}"
            return _timeout(late, f"no stream of setpoints: {view.blocked or 'none sent'}")
        if view.custom_mode == mode.custom_mode:
            return Event.MODE_CONFIRMED, f"{mode.name} confirmed"
        return _timeout(late, f"the autopilot does not enter {mode.name}{_answered(view)}")

    def _arming(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        if view.armed:
            if view.blocked is None:
                return Event.IN_CONTROL, f"{self.profile.control_mode.name} and armed, confirmed"
            return _timeout(self._late(self._armed_ns, now_ns), view.blocked)
        if self._config.arm:
            self.reason = view.blocked or "commanding to arm"
            why = view.blocked or f"the autopilot does not arm{_answered(view)}"
            return _timeout(self._late(self.since_ns, now_ns), why)
        self.reason = "waiting for the pilot to arm"
        return None

    def _interrupted(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        silent_s = min(view.silent_s, (now_ns - self.since_ns) * 1e-9)
        if silent_s > min(INTERRUPTED_S, 0.5 * self.profile.stream_timeout_s):
            why = f" ({view.blocked})" if view.blocked else ""
            return Event.INTERRUPTED, f"no setpoint for {silent_s:.2f} s{why}"
        return None

    def _leaving(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        left = self._exit_mode is not None and view.custom_mode == self._exit_mode.custom_mode
        # Backing out of the exit mode itself, a command to leave it may still be on its way.
        if left and (self.state is State.LEAVING or view.custom_mode != self._mode_at_entry):
            return Event.LEFT, f"{self._config.exit_mode} confirmed"
        if now_ns - self.since_ns >= round(LEAVE_S * 1e9):
            return Event.LEFT, f"{self._config.exit_mode} not confirmed within {LEAVE_S:g} s"
        return None

    def _out_of_control(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        if now_ns < self._requested_until_ns:
            return Event.COMMANDED, "the operator commands"
        # Where the mode needs a stream, an edge that comes without one of ours belongs to somebody else.
        if self._switched(view) and not self.profile.needs_stream:
            return Event.PILOT_SWITCHED, f"the pilot switched to {self.profile.control_mode.name}"
        waited = (now_ns - self.since_ns) * 1e-9 > RETRY_S
        if self.state is State.HANDED_OVER:
            if waited and not view.armed and not self._may_obey(view):
                return Event.RELEASED, "the vehicle is disarmed and in another mode"
            return None
        if waited and not view.armed and (self._may_auto() or not self._may_obey(view)):
            return Event.RETRY, "trying again"
        return None

    # Small judgements --------------------------------------------------------------------------------

    def _may_auto(self) -> bool:
        return self._config.engage == "auto" and self._auto is _Auto.MAY_ENGAGE

    def _late(self, since_ns: int, now_ns: int) -> bool:
        return (now_ns - since_ns) * 1e-9 > self._config.step_timeout_s

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
        """Whether neutral setpoints may flow in READY: the mode needs them and they cannot take control.

        Where `auto` was handed over, nothing at all flows until it is commanded.
        """
        silenced = self._config.engage == "auto" and self._auto is _Auto.HANDED_OVER
        return self.profile.needs_stream and not silenced and not self._may_obey(view)

    def _withheld_reason(self, view: View) -> str:
        mode = self.profile.control_mode.name
        if view.custom_mode != self._control and view.intended_mode is None:
            return f"armed, and CURRENT_MODE does not say yet whether {mode} is intended: silent"
        return f"found armed in {mode}: silent until the mode changes, it disarms, or engage is commanded"

    def _waiting_for(self, view: View) -> str:
        mode = self.profile.control_mode.name
        if self._may_auto():
            return "every condition is met"
        if view.custom_mode == self._control:
            return f"already in {mode}: leave it and switch again, or command engage"
        return f"waiting for the pilot to switch to {mode}"

    def _name(self, custom_mode: int | None) -> str:
        return "unknown" if custom_mode is None else self.profile.mode_name(custom_mode)


class _Auto(Enum):
    """What has become of `engage = "auto"`."""

    MAY_ENGAGE = auto()
    FOUND_FLYING = auto()  # spent until the vehicle is disarmed
    HANDED_OVER = auto()  # spent until the operator commands


def _answered(view: View) -> str:
    return f"; its answer: {view.answer}" if view.answer else ""


def _timeout(late: bool, reason: str) -> tuple[Event, str] | None:
    return (Event.STEP_TIMEOUT, reason) if late else None
