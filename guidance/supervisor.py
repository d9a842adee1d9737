"""Who may fly: the states of the service, what can happen, and what follows, as one table.

A pair that is not in `TRANSITIONS` leaves the state as it is. The core turns what it sees into events; no
decision is taken anywhere else. Two rules shape the table: the pilot always wins, and nothing that comes
back (a link, a reboot, a restarted process) takes control again without a fresh command or mode switch.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Final


class State(StrEnum):
    """Where the service stands. `SETPOINTS` says what is sent in each."""

    DISCONNECTED = "disconnected"
    CONNECTED = "connected"
    WITHHELD = "withheld"
    READY = "ready"
    STREAMING = "streaming"
    SWITCHING = "switching"
    ARMING = "arming"
    TRACKING = "tracking"
    PAUSING = "pausing"
    HOLDING = "holding"
    ABORTING = "aborting"
    CANCELLING = "cancelling"
    BACKING_OUT = "backing-out"
    LEAVING = "leaving"
    HANDED_OVER = "handed-over"
    ABORTED = "aborted"
    FINISHED = "finished"


class Event(StrEnum):
    """What can happen."""

    FOUND = "found"
    FOUND_IN_CONTROL = "found-in-control"
    LOST = "lost"
    RELEASED = "released"
    CONDITIONS_MET = "conditions-met"
    CONDITIONS_LOST = "conditions-lost"
    ENGAGE = "engage"
    COMMANDED = "commanded"
    PILOT_SWITCHED = "pilot-switched"
    STREAM_ESTABLISHED = "stream-established"
    MODE_CONFIRMED = "mode-confirmed"
    IN_CONTROL = "in-control"
    MODE_LEFT = "mode-left"
    DISARMED = "disarmed"
    INTERRUPTED = "interrupted"
    STEP_TIMEOUT = "step-timeout"
    HOLD = "hold"
    HOLD_CONFIRMED = "hold-confirmed"
    RESUME = "resume"
    ABORT = "abort"
    GUARD_TRIPPED = "guard-tripped"
    GUARD_SILENCES = "guard-silences"
    RETRY = "retry"
    SHUTDOWN = "shutdown"
    LEFT = "left"


#: A guard ends the flight.
GUARDED: Final = frozenset({Event.GUARD_TRIPPED, Event.GUARD_SILENCES})


class Setpoints(StrEnum):
    """What a state streams."""

    NONE = "none"
    NEUTRAL = "neutral"
    LAW = "law"


SETPOINTS: Final[dict[State, Setpoints]] = {
    State.DISCONNECTED: Setpoints.NONE,
    State.CONNECTED: Setpoints.NONE,
    State.WITHHELD: Setpoints.NONE,
    State.READY: Setpoints.NEUTRAL,  # only where the firmware wants a stream before its mode; see core
    State.STREAMING: Setpoints.NEUTRAL,
    State.SWITCHING: Setpoints.NEUTRAL,
    State.ARMING: Setpoints.NEUTRAL,
    State.TRACKING: Setpoints.LAW,
    State.PAUSING: Setpoints.LAW,  # fresh ones go on until the hold mode is seen
    State.HOLDING: Setpoints.NONE,
    State.ABORTING: Setpoints.LAW,  # until the mode that was chosen is seen
    State.CANCELLING: Setpoints.NEUTRAL,
    State.BACKING_OUT: Setpoints.NEUTRAL,
    State.LEAVING: Setpoints.LAW,  # fresh ones go on until the exit mode is seen
    State.HANDED_OVER: Setpoints.NONE,
    State.ABORTED: Setpoints.NONE,
    State.FINISHED: Setpoints.NONE,
}

#: Each state in words, for the generated table.
MEANINGS: Final[dict[State, str]] = {
    State.DISCONNECTED: "no heartbeat of the autopilot, or its arming and mode are not known yet",
    State.CONNECTED: "the autopilot is heard; a condition for flying is not met",
    State.WITHHELD: "found armed where a setpoint might act at once: left alone",
    State.READY: "may engage; streams only to PX4, and only where that cannot take control",
    State.STREAMING: "engaging, first step: setpoints are established",
    State.SWITCHING: "engaging, second step: the control mode is commanded until it is seen or accepted",
    State.ARMING: "engaging, third step: armed by command if so configured, else by the pilot",
    State.TRACKING: "follows the trajectory",
    State.PAUSING: "told to hold: commands the hold mode until it is seen, 3 s at most",
    State.HOLDING: "the autopilot holds by its own mode; the trajectory's time stands still",
    State.ABORTING: "aborted while tracking: commands the chosen mode until it is seen, 1 s at most",
    State.CANCELLING: "aborted while engaging: commands the exit mode if the control mode is on",
    State.BACKING_OUT: "stopped while engaging: commands the exit mode if the control mode is on",
    State.LEAVING: "stopped while tracking: commands the exit mode until it is seen, 1 s at most",
    State.HANDED_OVER: "somebody else has control",
    State.ABORTED: "engaging did not work out, or the flight was aborted",
    State.FINISHED: "the service ends",
}

#: The cause of each event in words, for the generated table.
CAUSES: Final[dict[Event, str]] = {
    Event.FOUND: "heartbeats come; arming and mode are known",
    Event.FOUND_IN_CONTROL: "the same, but armed, and the control mode is on, intended (PX4) or not excluded",
    Event.LOST: "the heartbeat stopped, or the autopilot rebooted",
    Event.RELEASED: "disarmed, or taken out of the control mode (after a hand-over: both, and 5 s later)",
    Event.CONDITIONS_MET: "right vehicle, clock, state streams, origin and distance to the start",
    Event.CONDITIONS_LOST: "one of them is not met any more",
    Event.ENGAGE: 'the operator commands, or `engage = "auto"` and nobody took control from it before',
    Event.COMMANDED: "the operator commands to engage",
    Event.PILOT_SWITCHED: "the pilot switches to the control mode",
    Event.STREAM_ESTABLISHED: "10 setpoints were sent",
    Event.MODE_CONFIRMED: "HEARTBEAT or CURRENT_MODE shows the control mode",
    Event.IN_CONTROL: "armed in the control mode, every condition met",
    Event.MODE_LEFT: "a mode that the service did not ask for",
    Event.DISARMED: "disarmed without being asked",
    Event.INTERRUPTED: "nothing could be sent, or nothing was heard, for longer than the limit",
    Event.STEP_TIMEOUT: "a step took longer than `step_timeout_s`, or the hold mode than 3 s",
    Event.HOLD: "the operator commands to hold",
    Event.HOLD_CONFIRMED: "the hold mode is seen",
    Event.RESUME: "the operator commands to go on, and every condition is met",
    Event.ABORT: "the operator commands to abort",
    Event.GUARD_TRIPPED: "a guard whose action is a mode",
    Event.GUARD_SILENCES: "a guard whose action is silence",
    Event.RETRY: 'on the ground, 5 s later, and `engage = "auto"` or out of the control mode',
    Event.SHUTDOWN: "SIGTERM, SIGINT or SIGHUP",
    Event.LEFT: "the mode that was commanded is seen, or 1 s has passed",
}

#: The same in so few words that they fit into a STATUSTEXT of 50 bytes behind any state's name.
BRIEFS: Final[dict[Event, str]] = {
    Event.FOUND: "autopilot found",
    Event.FOUND_IN_CONTROL: "found armed, silent",
    Event.LOST: "autopilot lost",
    Event.RELEASED: "vehicle released",
    Event.CONDITIONS_MET: "conditions met",
    Event.CONDITIONS_LOST: "condition not met",
    Event.ENGAGE: "engaging",
    Event.COMMANDED: "engage commanded",
    Event.PILOT_SWITCHED: "pilot switched",
    Event.STREAM_ESTABLISHED: "stream established",
    Event.MODE_CONFIRMED: "mode confirmed",
    Event.IN_CONTROL: "in control",
    Event.MODE_LEFT: "mode was changed",
    Event.DISARMED: "vehicle was disarmed",
    Event.INTERRUPTED: "was interrupted",
    Event.STEP_TIMEOUT: "no success, see log",
    Event.HOLD: "hold commanded",
    Event.HOLD_CONFIRMED: "hold confirmed",
    Event.RESUME: "resume commanded",
    Event.ABORT: "abort commanded",
    Event.GUARD_TRIPPED: "guard",
    Event.GUARD_SILENCES: "guard",
    Event.RETRY: "trying again",
    Event.SHUTDOWN: "service stops",
    Event.LEFT: "exit mode or time over",
}
_STATUSTEXT_BYTES: Final = 50

_S, _E = State, Event

TRANSITIONS: Final[dict[tuple[State, Event], State]] = {
    # An autopilot appears. Armed in the control mode (or in nobody knows which), any setpoint would take
    # control at once: it is left alone until that changes or the operator commands.
    (_S.DISCONNECTED, _E.FOUND): _S.CONNECTED,
    (_S.DISCONNECTED, _E.FOUND_IN_CONTROL): _S.WITHHELD,
    (_S.WITHHELD, _E.RELEASED): _S.CONNECTED,
    (_S.WITHHELD, _E.COMMANDED): _S.CONNECTED,
    # State, clock and origin are known, or not any more.
    (_S.CONNECTED, _E.CONDITIONS_MET): _S.READY,
    (_S.READY, _E.CONDITIONS_LOST): _S.CONNECTED,
    # Engaging: stream -> mode -> (arm) -> verified. A pilot's own switch skips ahead.
    (_S.READY, _E.ENGAGE): _S.STREAMING,
    (_S.READY, _E.PILOT_SWITCHED): _S.ARMING,
    (_S.STREAMING, _E.PILOT_SWITCHED): _S.ARMING,
    (_S.STREAMING, _E.STREAM_ESTABLISHED): _S.SWITCHING,
    (_S.SWITCHING, _E.MODE_CONFIRMED): _S.ARMING,
    (_S.ARMING, _E.IN_CONTROL): _S.TRACKING,
    (_S.STREAMING, _E.STEP_TIMEOUT): _S.ABORTED,
    (_S.SWITCHING, _E.STEP_TIMEOUT): _S.ABORTED,
    (_S.ARMING, _E.STEP_TIMEOUT): _S.ABORTED,
    # Not asked for: hand over at once and be silent.
    (_S.STREAMING, _E.MODE_LEFT): _S.HANDED_OVER,
    (_S.STREAMING, _E.DISARMED): _S.HANDED_OVER,
    (_S.SWITCHING, _E.MODE_LEFT): _S.HANDED_OVER,
    (_S.SWITCHING, _E.DISARMED): _S.HANDED_OVER,
    (_S.ARMING, _E.MODE_LEFT): _S.HANDED_OVER,
    (_S.ARMING, _E.DISARMED): _S.HANDED_OVER,
    (_S.TRACKING, _E.MODE_LEFT): _S.HANDED_OVER,
    (_S.TRACKING, _E.DISARMED): _S.HANDED_OVER,
    # After a silence the autopilot's failsafe may have acted: a stream that resumed would take control back.
    (_S.STREAMING, _E.INTERRUPTED): _S.HANDED_OVER,
    (_S.SWITCHING, _E.INTERRUPTED): _S.HANDED_OVER,
    (_S.ARMING, _E.INTERRUPTED): _S.HANDED_OVER,
    (_S.TRACKING, _E.INTERRUPTED): _S.HANDED_OVER,
    (_S.TRACKING, _E.LOST): _S.HANDED_OVER,
    # The operator holds the flight and lets it go on, the whole way through: stream -> mode -> verified.
    (_S.TRACKING, _E.HOLD): _S.PAUSING,
    (_S.PAUSING, _E.HOLD_CONFIRMED): _S.HOLDING,
    (_S.PAUSING, _E.STEP_TIMEOUT): _S.ABORTED,
    (_S.HOLDING, _E.RESUME): _S.STREAMING,
    (_S.HOLDING, _E.PILOT_SWITCHED): _S.ARMING,
    (_S.HOLDING, _E.ABORT): _S.ABORTED,  # the autopilot holds already
    # The operator or a guard ends it: a mode of the autopilot's, or silence, so that its own failsafe acts.
    (_S.STREAMING, _E.ABORT): _S.CANCELLING,
    (_S.SWITCHING, _E.ABORT): _S.CANCELLING,
    (_S.ARMING, _E.ABORT): _S.CANCELLING,
    (_S.TRACKING, _E.ABORT): _S.ABORTING,
    (_S.PAUSING, _E.ABORT): _S.ABORTING,
    (_S.TRACKING, _E.GUARD_TRIPPED): _S.ABORTING,
    (_S.PAUSING, _E.GUARD_TRIPPED): _S.ABORTING,
    (_S.TRACKING, _E.GUARD_SILENCES): _S.ABORTED,
    (_S.PAUSING, _E.GUARD_SILENCES): _S.ABORTED,
    (_S.ABORTING, _E.LEFT): _S.ABORTED,
    (_S.CANCELLING, _E.LEFT): _S.ABORTED,
    # In all of these the pilot wins, too.
    **{
        (state, event): _S.HANDED_OVER
        for state in (_S.PAUSING, _S.HOLDING, _S.ABORTING, _S.CANCELLING)
        for event in (_E.MODE_LEFT, _E.DISARMED, _E.LOST)
    },
    # Back only by a fresh command or a fresh switch; a vehicle that is put down and taken out of the control
    # mode is a new start.
    (_S.HANDED_OVER, _E.COMMANDED): _S.CONNECTED,
    (_S.HANDED_OVER, _E.PILOT_SWITCHED): _S.ARMING,
    (_S.HANDED_OVER, _E.RELEASED): _S.CONNECTED,
    (_S.HANDED_OVER, _E.LOST): _S.DISCONNECTED,
    (_S.ABORTED, _E.COMMANDED): _S.CONNECTED,
    (_S.ABORTED, _E.PILOT_SWITCHED): _S.ARMING,
    (_S.ABORTED, _E.RETRY): _S.CONNECTED,
    # The autopilot falls silent or reboots before anything was asked of it.
    (_S.CONNECTED, _E.LOST): _S.DISCONNECTED,
    (_S.WITHHELD, _E.LOST): _S.DISCONNECTED,
    (_S.READY, _E.LOST): _S.DISCONNECTED,
    (_S.STREAMING, _E.LOST): _S.DISCONNECTED,
    (_S.SWITCHING, _E.LOST): _S.HANDED_OVER,
    (_S.ARMING, _E.LOST): _S.HANDED_OVER,
    (_S.ABORTED, _E.LOST): _S.DISCONNECTED,
    # The operator stops the service: a vehicle that is under control is put into the exit mode.
    (_S.STREAMING, _E.SHUTDOWN): _S.BACKING_OUT,
    (_S.SWITCHING, _E.SHUTDOWN): _S.BACKING_OUT,
    (_S.ARMING, _E.SHUTDOWN): _S.BACKING_OUT,
    (_S.TRACKING, _E.SHUTDOWN): _S.LEAVING,
    (_S.PAUSING, _E.SHUTDOWN): _S.LEAVING,
    (_S.BACKING_OUT, _E.LEFT): _S.FINISHED,
    (_S.BACKING_OUT, _E.MODE_LEFT): _S.FINISHED,
    (_S.BACKING_OUT, _E.DISARMED): _S.FINISHED,
    (_S.BACKING_OUT, _E.LOST): _S.FINISHED,
    (_S.LEAVING, _E.LEFT): _S.FINISHED,
    (_S.LEAVING, _E.MODE_LEFT): _S.FINISHED,
    (_S.LEAVING, _E.DISARMED): _S.FINISHED,
    (_S.LEAVING, _E.LOST): _S.FINISHED,
    **{
        (state, _E.SHUTDOWN): _S.FINISHED
        for state in (
            _S.DISCONNECTED,
            _S.CONNECTED,
            _S.WITHHELD,
            _S.READY,
            _S.HOLDING,
            _S.HANDED_OVER,
            _S.ABORTED,
        )
    },
}


def transition(state: State, event: Event) -> State:
    """The state after `event`; the same state where the table has no row."""
    return TRANSITIONS.get((state, event), state)


def status_text(after: State, event: Event, reason: str) -> str:
    """A change of state for STATUSTEXT: with its reason if 50 bytes hold it, else with the event's brief.

    The brief of a guard ends with its name, with which its reason begins.
    """
    whole = f"guidance: {after}: {reason}"
    if len(whole) <= _STATUSTEXT_BYTES:
        return whole
    guard = f" {reason.partition(':')[0]}" if event in GUARDED else ""
    return f"guidance: {after}: {BRIEFS[event]}{guard}"


def table_markdown() -> str:
    """The table for people: each state with what it streams and where every event leads, then the events."""
    sent = {Setpoints.NONE: "nothing", Setpoints.NEUTRAL: "neutral", Setpoints.LAW: "the law's"}
    lines = ["| state | setpoints | event → next state |", "| --- | --- | --- |"]
    for state in State:
        leads: dict[State, list[str]] = {}
        for event in Event:
            if (after := transition(state, event)) is not state:
                leads.setdefault(after, []).append(f"`{event}`")
        ways = "<br>".join(f"{', '.join(events)} → **{after}**" for after, events in leads.items())
        lines.append(f"| **{state}**: {MEANINGS[state]} | {sent[SETPOINTS[state]]} | {ways or 'none'} |")
    lines += ["", "| event | cause |", "| --- | --- |"]
    lines += [f"| `{event}` | {CAUSES[event]} |" for event in Event]
    return "\n".join(lines) + "\n"
