"""What the pilot does: a fresh switch to the control mode, or a mode or disarm that nobody here asked for.

And what was given away: a vehicle that was handed over or aborted, until it is seen disarmed
or asked for again. A link that is lost meanwhile changes nothing of that.
"""

from __future__ import annotations

from typing import Final

from guidance.mavlink.profiles import Profile
from guidance.supervisor import Event, State
from guidance.view import View

#: A mode command that was given up may act so much later, and that is no switch of the pilot's.
UNDER_WAY_S: Final = 2.0
_GIVEN_AWAY: Final = (State.HANDED_OVER, State.ABORTED)
_ASKED_FOR: Final = (Event.COMMANDED, Event.ENGAGE, Event.PILOT_SWITCHED)


class PilotWatch:
    """What must be remembered of earlier looks to tell the pilot's acts from the service's own."""

    def __init__(self, profile: Profile) -> None:
        self.armed_ns = 0
        self.given_away = False
        self._profile = profile
        self._control = profile.control_mode.custom_mode
        self._state = State.DISCONNECTED
        self._previous_mode: int | None = None
        self._mode_at_entry: int | None = None
        self._was_armed = False
        self._was_there = False
        self._under_way_until_ns = 0

    def begin(self, state: State, event: Event, view: View, now_ns: int) -> None:
        """A state begins, by this event."""
        if self._state is State.SWITCHING and event is not Event.MODE_CONFIRMED:
            self._under_way_until_ns = now_ns + round(UNDER_WAY_S * 1e9)
        if event is Event.PILOT_SWITCHED:
            self._previous_mode = view.custom_mode  # obeyed: one switch does not act twice
        self._state = state
        self.given_away |= state in _GIVEN_AWAY
        self.given_away &= event not in _ASKED_FOR
        self._see_down(view)
        self._was_there = False
        self._mode_at_entry = view.custom_mode
        self._was_armed = bool(view.armed)
        self.armed_ns = now_ns

    def doubt(self, view: View) -> None:
        """Before a look is judged: after a silence, or where modes alternate, nothing seen before counts."""
        if not (view.certain and view.settled):
            self._previous_mode = None
        self._see_down(view)

    def _see_down(self, view: View) -> None:
        disarmed = view.connected and view.certain and view.armed is False
        self.given_away &= self._state in _GIVEN_AWAY or not disarmed

    def looked(self, view: View) -> None:
        """After a look: a switch is fresh only if it was seen, not made while the link was silent."""
        self._previous_mode = view.custom_mode if view.connected and view.certain else None

    def switched(self, view: View, now_ns: int) -> bool:
        """The pilot has just switched to the control mode; a PX4 that was given away has another's stream."""
        if self.given_away and self._profile.needs_stream:
            return False
        changed = view.custom_mode == self._control and self._previous_mode not in (None, self._control)
        return changed and now_ns >= self._under_way_until_ns

    def engaged(self, view: View, now_ns: int) -> bool:
        """The same where nothing is streamed: a mode that needs a stream has somebody else's then."""
        return self.switched(view, now_ns) and not self._profile.needs_stream

    def unasked(self, view: View, expected: set[int | None], now_ns: int) -> tuple[Event, str] | None:
        """The mode was changed, to none that is `expected`, or the vehicle disarmed: the pilot wins."""
        if self._state is not State.HOLDING:
            expected = expected | {self._control}
        if self._state in (State.STREAMING, State.SWITCHING):
            expected = expected | {self._mode_at_entry}
        if self._state is State.SWITCHING and view.custom_mode != self._control:
            if view.intended_mode == self._control:
                self._was_there = True
            elif self._was_there and view.intended_mode is not None:  # and left again, before it was seen
                expected = set()
        if view.custom_mode not in expected:
            name = "unknown" if view.custom_mode is None else self._profile.mode_name(view.custom_mode)
            return Event.MODE_LEFT, f"the mode was changed to {name}"
        if self._was_armed and not view.armed:
            return Event.DISARMED, "the vehicle was disarmed"
        if view.armed and not self._was_armed:
            self._was_armed, self.armed_ns = True, now_ns
        return None
