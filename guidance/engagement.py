"""Engaging and handing over: what is seen of the vehicle becomes events of the supervisor's table.

The sequence is stream -> mode -> (arm) -> verified by HEARTBEAT or CURRENT_MODE, never by an ACK: PX4 sends
two for one DO_SET_MODE, the first always positive. Each step has a deadline, and what blocks it is named.

A gap is as good as a hand-over: while nothing is sent or heard, the autopilot's failsafe may act and the
pilot may switch, and a stream that resumes would take control back unseen.
"""

from __future__ import annotations

from enum import Enum, auto
from typing import Final, NamedTuple

from guidance.commanding import Commands
from guidance.config import SupervisorConfig
from guidance.leaving import LEAVING, Leaving
from guidance.mavlink.messages import CommandAck
from guidance.mavlink.modes import Mode
from guidance.mavlink.profiles import Profile
from guidance.requests import Order, Requests
from guidance.supervisor import SETPOINTS, Event, Setpoints, State, transition
from guidance.takeover import PilotWatch
from guidance.view import Attempt, Contact, View, may_obey, waiting_reason, withheld_reason

#: Setpoints to send before the mode is asked for.
ESTABLISHED_AFTER: Final = 10
#: On the ground, a refusal is tried again after this time, and a hand-over becomes a new start.
RETRY_S: Final = 5.0
#: A HEARTBEAT this long after the answer to the arming command was sent after it, and tells what came of it.
ARMING_SHOWN_S: Final = 0.3


_SPENDS_AUTO: Final = (State.HANDED_OVER, State.PAUSING, State.ABORTING)


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
        self.contact = Contact(profile)
        self.streaming = False  # whether setpoints may flow, as of the last update
        self._commands = Commands(config, profile)
        self._control = profile.control_mode.custom_mode
        self._leaving = Leaving(config, profile)
        self._requests = Requests(config.step_timeout_s)
        self._auto = _Auto.MAY_ENGAGE
        self._pilot = PilotWatch(profile)
        self._sent_at_entry = 0
        self._attempt = Attempt(profile)
        self._shutdown = False

    # Commands of the operator ------------------------------------------------------------------------

    def engage(self, now_ns: int) -> str | None:
        """The operator commands to engage; why that is refused, None if it is not."""
        return self._ask(Order.ENGAGE, now_ns)

    def hold(self, now_ns: int) -> str | None:
        """The operator commands to hold, by the autopilot's own mode; why that is refused, or None."""
        return self._ask(Order.HOLD, now_ns)

    def resume(self, now_ns: int) -> str | None:
        """The operator commands to go on where it was held; why that is refused, None if it is not."""
        return self._ask(Order.RESUME, now_ns)

    def abort(self, now_ns: int) -> str | None:
        """The operator commands to end the flight; why that is refused, None if it is not."""
        refused = self._ask(Order.ABORT, now_ns)
        if refused is None:
            self._auto = _Auto.SPENT  # also where engaging failed, which `auto` would try again
            if self.state in (State.CONNECTED, State.READY):
                self._requests.forget()  # nothing has begun that could be aborted, and nothing shall
        return refused

    def _ask(self, order: Order, now_ns: int) -> str | None:
        if self._shutdown:
            return f"{order} refused: the service is shutting down"
        return self._requests.ask(order, self.state, self.reason, now_ns)

    def shutdown(self) -> None:
        """The operator stops the service."""
        self._shutdown = True

    def expired(self, now_ns: int) -> str | None:
        """Says once that a command was given up, and why."""
        return self._requests.expired(self.reason, now_ns)

    # What follows from what is seen ------------------------------------------------------------------

    def update(self, view: View, now_ns: int) -> list[Change]:
        """All changes of state that follow from the view, in order."""
        changes: list[Change] = []
        self._pilot.doubt(view)
        while (happening := self._happening(view, now_ns)) is not None:
            event, reason = happening
            before, after = self.state, transition(self.state, event)
            if after is before:
                break
            self.state, self.reason, self.since_ns = after, reason, now_ns
            self._entered(event, view, now_ns)
            changes.append(Change(before, after, event, reason))
        self._pilot.looked(view)
        self.streaming = self._may_stream(view, now_ns)
        return changes

    def _entered(self, event: Event, view: View, now_ns: int) -> None:
        """What must be remembered of the instant at which a state began."""
        if event is Event.ENGAGE:
            self._auto = _Auto.MAY_ENGAGE
        if self.state in _SPENDS_AUTO or event in (Event.ABORT, Event.GUARD_SILENCES):
            self._auto = _Auto.SPENT
        if self.state not in (State.CONNECTED, State.READY):
            self._requests.forget()  # obeyed, or overtaken: a command never acts twice
        if self.state is State.STREAMING or event is Event.PILOT_SWITCHED:
            self._attempt.begin(view, now_ns)
        self._pilot.begin(self.state, event, view, now_ns)
        self._sent_at_entry = view.setpoints_sent
        self._leaving.begin(self.state, view, now_ns)
        self._commands.begin(self.state, self._leaving.mode)

    def due_command(self, view: View, now_ns: int) -> Mode | bool | None:
        """A mode to command now, True to arm, None for nothing; repeated until it worked or was accepted."""
        return self._commands.due(view, now_ns)

    def answered(self, ack: CommandAck, now_ns: int) -> None:
        """The autopilot answers a mode or arming command: an accepted one is not sent again."""
        self._commands.answered(ack, now_ns)

    def _happening(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        state = self.state
        if state is State.FINISHED:
            return None
        if state is not State.DISCONNECTED and not view.connected:
            return Event.LOST, view.absent_because
        if self._shutdown and (state not in LEAVING or state is State.PAUSING):
            return Event.SHUTDOWN, "the service was told to stop"
        match state:
            case State.DISCONNECTED:
                return self._when_disconnected(view)
            case State.WITHHELD:
                return self._when_withheld(view, now_ns)
            case State.CONNECTED | State.READY:
                return self._before_engaging(view, now_ns)
            case State.STREAMING | State.SWITCHING:
                return self._lost_hold(view, now_ns) or self._abort(now_ns) or self._engaging(view, now_ns)
            case State.ARMING:
                return self._lost_hold(view, now_ns) or self._abort(now_ns) or self._arming(view, now_ns)
            case State.TRACKING:
                return self._lost_hold(view, now_ns) or self._stopped(view, now_ns) or self._hold(now_ns)
            case State.PAUSING:
                ended = self._unasked(view, now_ns) or self._leaving.ended(view, now_ns)
                return ended or self._stopped(view, now_ns)
            case State.HOLDING:
                return self._holding(view, now_ns)
            case State.ABORTING | State.CANCELLING | State.BACKING_OUT | State.LEAVING:
                return self._leaving.ended(view, now_ns) or self._unasked(view, now_ns)
            case State.HANDED_OVER | State.ABORTED:
                return self._out_of_control(view, now_ns)

    def _when_disconnected(self, view: View) -> tuple[Event, str] | None:
        if not view.connected or view.armed is None or view.custom_mode is None:
            self.reason = view.absent_because
            return None
        used = view.armed or self._control in (view.custom_mode, view.intended_mode)
        if used and self._auto is _Auto.MAY_ENGAGE:
            # Somebody flies it, or did, perhaps with this service before it was killed: `auto` must not take
            # it from whoever has it, nor arm what the pilot disarmed.
            self._auto = _Auto.FOUND_IN_USE
        if view.armed and may_obey(self.profile, view):
            return Event.FOUND_IN_CONTROL, withheld_reason(self.profile, view)
        return Event.FOUND, "autopilot found"

    def _when_withheld(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        if self._requests.waits(Order.ENGAGE, now_ns):
            return Event.COMMANDED, "the operator commands"
        if not view.armed:
            return Event.RELEASED, "the vehicle is disarmed"
        if not may_obey(self.profile, view):
            return Event.RELEASED, f"the vehicle was taken out of {self.profile.control_mode.name}"
        self.reason = withheld_reason(self.profile, view)
        return None

    def _before_engaging(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        if view.blocked is not None:
            self.reason = view.blocked
            return (Event.CONDITIONS_LOST, view.blocked) if self.state is State.READY else None
        if self.state is State.CONNECTED:
            return Event.CONDITIONS_MET, self._waiting_for(view)
        if self._pilot.switched(view, now_ns):
            return Event.PILOT_SWITCHED, f"the pilot switched to {self.profile.control_mode.name}"
        if self._requests.waits(Order.ENGAGE, now_ns):
            return Event.ENGAGE, "the operator commands"
        if self._may_auto(view):
            return Event.ENGAGE, 'engage = "auto"'
        self.reason = self._waiting_for(view)
        return None

    def _lost_hold(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        return self._unasked(view, now_ns) or self._interrupted(view, now_ns)

    def _unasked(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        return self._pilot.unasked(view, self._leaving.expected(), now_ns)

    def _engaging(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        mode = self.profile.control_mode
        late = self._late(self.since_ns, now_ns)
        if self.state is State.STREAMING:
            if self._pilot.switched(view, now_ns):
                return Event.PILOT_SWITCHED, f"the pilot switched to {mode.name}"
            if view.setpoints_sent - self._sent_at_entry >= ESTABLISHED_AFTER:
                return Event.STREAM_ESTABLISHED, f"commanding {mode.name}"
            return _timeout(late, f"no stream of setpoints: {view.blocked or 'none sent'}")
        if view.custom_mode == mode.custom_mode:
            return Event.MODE_CONFIRMED, f"{mode.name} confirmed"
        if self._commands.accepted_ns is None:
            return _timeout(late, f"the autopilot does not enter {mode.name}{_answered(view)}")
        return _timeout(late, f"{mode.name} was accepted but is not on: left again, or refused after all")

    def _arming(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        if view.armed:
            if view.blocked is None:
                return Event.IN_CONTROL, f"{self.profile.control_mode.name} and armed, confirmed"
            return _timeout(self._late(self._pilot.armed_ns, now_ns), view.blocked)
        if self._config.arm:
            accepted_ns = self._commands.accepted_ns
            if accepted_ns is not None and view.heartbeat_ns >= accepted_ns + round(ARMING_SHOWN_S * 1e9):
                return Event.DISARMED, "the vehicle was disarmed after it had been armed by command"
            self.reason = view.blocked or "commanding to arm"
            why = view.blocked or f"the autopilot does not arm{_answered(view)}"
            return _timeout(self._late(self.since_ns, now_ns), why)
        self.reason = "waiting for the pilot to arm"
        return None

    def _interrupted(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        establishing = self.state is State.STREAMING
        why = self._attempt.silence(view, now_ns, establishing=establishing)
        if establishing:  # disarmed, no failsafe acts; but somebody may have armed it since
            why = (why or "armed after a silence") if self._attempt.broken and view.armed else None
        return None if why is None else (Event.INTERRUPTED, why)

    def _stopped(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        trip = view.trip
        if trip is None:
            return self._abort(now_ns)
        return Event.GUARD_SILENCES if trip.mode is None else Event.GUARD_TRIPPED, trip.reason

    def _abort(self, now_ns: int) -> tuple[Event, str] | None:
        waits = self._requests.waits(Order.ABORT, now_ns)
        return (Event.ABORT, "the operator aborts") if waits else None

    def _hold(self, now_ns: int) -> tuple[Event, str] | None:
        waits = self._requests.waits(Order.HOLD, now_ns)
        return (Event.HOLD, "the operator holds") if waits else None

    def _holding(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        if self._pilot.engaged(view, now_ns):
            return Event.PILOT_SWITCHED, f"the pilot switched to {self.profile.control_mode.name}"
        ended = self._unasked(view, now_ns) or self._abort(now_ns)
        if ended is not None:
            return ended
        self.reason = view.blocked or f"{self._leaving.mode.name} is on: resume or abort"
        if self._requests.waits(Order.RESUME, now_ns) and view.blocked is None:
            return Event.RESUME, "the operator resumes"
        return None

    def _out_of_control(self, view: View, now_ns: int) -> tuple[Event, str] | None:
        if self._requests.waits(Order.ENGAGE, now_ns):
            return Event.COMMANDED, "the operator commands"
        if self._pilot.engaged(view, now_ns):
            return Event.PILOT_SWITCHED, f"the pilot switched to {self.profile.control_mode.name}"
        waited = (now_ns - self.since_ns) * 1e-9 > RETRY_S
        if self.state is State.HANDED_OVER:
            if waited and not view.armed and not may_obey(self.profile, view):
                return Event.RELEASED, "the vehicle is disarmed and in another mode"
            return None
        if waited and not view.armed and (self._auto_unspent() or not may_obey(self.profile, view)):
            return Event.RETRY, "trying again"
        return None

    # Small judgements --------------------------------------------------------------------------------

    def _auto_unspent(self) -> bool:
        return self._config.engage == "auto" and self._auto is _Auto.MAY_ENGAGE

    def _may_auto(self, view: View) -> bool:
        """Whether `auto` may engage now: not a vehicle that somebody might have control of."""
        in_use = view.armed and may_obey(self.profile, view)
        return self._auto_unspent() and view.certain and not in_use

    def _late(self, since_ns: int, now_ns: int) -> bool:
        return (now_ns - since_ns) * 1e-9 > self._config.step_timeout_s

    def may_offer_stream(self, view: View) -> bool:
        """Whether neutral setpoints may flow in READY: the mode needs them and they cannot take control.

        Nothing flows to what was given away in flight, nor after `auto` was handed over, until commanded.
        """
        allowed = self.profile.needs_stream and not self._silenced()
        return allowed and view.certain and not may_obey(self.profile, view)

    def _silenced(self) -> bool:
        spent = self._config.engage == "auto" and self._auto is _Auto.SPENT
        return spent or self._pilot.given_away

    def _may_stream(self, view: View, now_ns: int) -> bool:
        if self.state is State.READY:
            return self.may_offer_stream(view)
        if self.state in LEAVING:
            # Commands to leave may go on, but a stream that was interrupted does not take control back.
            self._attempt.silence(view, now_ns, establishing=False)
            return not self._attempt.broken
        if self.state is State.STREAMING and self._attempt.broken and not view.certain:
            return False
        return SETPOINTS[self.state] is not Setpoints.NONE

    def _waiting_for(self, view: View) -> str:
        if self._may_auto(view):
            return "every condition is met"
        return waiting_reason(self.profile, view, silenced=self._silenced())


class _Auto(Enum):
    """What has become of `engage = "auto"`."""

    MAY_ENGAGE = auto()
    FOUND_IN_USE = auto()  # as good as spent; but PX4 gets a stream to switch to
    SPENT = auto()  # handed over, held or aborted: until the operator commands to engage


def _answered(view: View) -> str:
    return f"; its answer: {view.answer}" if view.answer else ""


def _timeout(late: bool, reason: str) -> tuple[Event, str] | None:
    return (Event.STEP_TIMEOUT, reason) if late else None
