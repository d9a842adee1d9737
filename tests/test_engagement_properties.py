"""Invariants of engaging over random sequences of what may be seen, commanded and waited for.

- TRACKING begins only in an update that saw the control mode, armed, connected and nothing blocked.
- A mode or disarm that nobody asked for while TRACKING hands over in the same update.
- While PAUSING or HOLDING any mode but those two, a lost link or (PAUSING) a disarm hands over at once.
- HOLDING goes on only by a command to resume that is young, or a switch that was seen.
- After a hand-over, a hold, an abort or a guard nothing engages without an accepted command that is still
  young or a switch that was seen, whatever `engage` says.
- Arming is commanded only if configured, in ARMING, in the control mode and with nothing blocked.
- Nothing streams before mode and arming are known, nor on a PX4 that might obey without anybody having
  asked, nor at all after a hand-over from `engage = "auto"`, nor after any to what is armed ever since.
- A command that the autopilot accepted is not sent again in its state, whatever is seen or answered after.
- Nothing streams after a silence longer than the firmware's unless arming and mode were heard since.
- Every update ends, after few changes.
"""

from __future__ import annotations

from collections import Counter
from typing import Final, NamedTuple

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from guidance.config import SupervisorConfig
from guidance.engagement import Change, Engagement
from guidance.mavlink.messages import CommandAck
from guidance.mavlink.modes import Mode
from guidance.mavlink.profiles import Profile
from guidance.supervisor import SETPOINTS, Event, Setpoints, State
from guidance.view import Trip, View
from tests.engagement_bench import BOTH, S, mode

STEP_S: Final = 2.0
ENGAGED: Final = frozenset({State.STREAMING, State.SWITCHING, State.ARMING, State.TRACKING})
COMMAND_OF: Final = {
    State.SWITCHING: 176,
    State.ARMING: 400,
    State.PAUSING: 176,
    State.ABORTING: 176,
}
#: What the random walks came across, so that none of the properties holds for want of examples.
seen: Counter[str] = Counter()


HAPPENS: Final = (
    "tracking", "taken over", "armed", "again", "accepted", "silence", "resumed", "hold taken over"
)  # fmt: skip
SPENT: Final = (State.HANDED_OVER, State.PAUSING, State.ABORTING, State.CANCELLING)


class Step(NamedTuple):
    """What happens next: time, an operator's act, and one thing that is seen to change."""

    dt_s: float
    act: str
    change: str


ACTS: Final = [*9 * [""], "engage", "engage", "hold", "hold", "resume", "abort"]
CHANGES: Final = [
    "nothing", "cooperate", "cooperate", "cooperate", "cooperate", "cooperate", "cooperate", "cooperate",
    "stream", "obey", "arm", "disarm", "control mode", "other mode", "third mode", "mode unknown",
    "intend control", "intend other", "intend unknown", "block", "unblock", "lose", "find", "silence",
    "quiet", "heard again", "heartbeat", "accept", "accept", "trip", "trip to silence", "untrip",
]  # fmt: skip
STEPS: Final = st.builds(
    Step, st.sampled_from([0.02, 0.05, 0.3, 1.0, 2.5]), st.sampled_from(ACTS), st.sampled_from(CHANGES)
)


#: An ordinary way into flight, so that much happens there, too.
TAKE_OFF: Final = [Step(0.05, "engage" * (i == 1), "cooperate") for i in range(8)]
BEGIN: Final[tuple[list[Step], ...]] = (
    [],
    TAKE_OFF,
    [*TAKE_OFF, *(Step(0.05, "hold", "cooperate") for _ in range(3))],
)


class Walk:
    """An engagement, a vehicle that changes at random, and what has been allowed so far."""

    def __init__(self, profile: Profile, config: SupervisorConfig, view: View) -> None:
        self.it = Engagement(config, profile)
        self.config = config
        self.profile = profile
        self.control = profile.control_mode.custom_mode
        self.view = view
        self.now_ns = S
        self.wanted: Mode | bool | None = None
        self.young_until_ns = 0
        self.resume_until_ns = 0
        self.auto_allowed = True
        self.given_away = False
        self.last_mode: int | None = None
        self.obeyed_in: State | None = None
        self.attempt_ns = 0
        self.attempt_sent = 0

    def change(self, name: str) -> None:
        """One thing is seen to change."""
        acro, hold = mode(self.profile, "acro"), mode(self.profile, "hold")
        simple = {
            "arm": {"armed": True},
            "disarm": {"armed": False},
            "control mode": {"custom_mode": self.control, "intended_mode": self.control},
            "other mode": {"custom_mode": acro, "intended_mode": acro},
            "third mode": {"custom_mode": hold, "intended_mode": hold},
            "mode unknown": {"custom_mode": None, "intended_mode": None, "connected": False, "armed": None},
            "intend control": {"intended_mode": self.control},
            "intend other": {"intended_mode": acro},
            "intend unknown": {"intended_mode": None},
            "block": {"blocked": "blocked"},
            "unblock": {"blocked": None},
            "lose": {"connected": False},
            "find": {"connected": True},
            "silence": {"silent_s": 100.0},
            "trip": {"trip": Trip("speed", "too fast", self.profile.mode("acro"))},
            "trip to silence": {"trip": Trip("speed", "too fast", None)},
            "untrip": {"trip": None},
            "quiet": {"unheard_s": 100.0, "certain": False},
            "heard again": {"unheard_s": 0.0},
            "heartbeat": {"heartbeat_ns": self.now_ns, "certain": self.view.unheard_s == 0.0},
        }
        if name in simple:
            self.view = self.view._replace(**simple[name])  # type: ignore[arg-type]
        elif name == "cooperate":
            for good in ("find", "unblock", "untrip", "heard again", "heartbeat", "stream", "obey"):
                self.change(good)
            if self.it.state is State.ARMING:
                self.change("arm")
        elif name == "accept" and self.wanted is not None and self.it.state in COMMAND_OF:
            seen["accepted"] += 1
            self.it.answered(CommandAck(COMMAND_OF[self.it.state], 0, 1, 191), self.now_ns)
            self.obeyed_in = self.it.state
        elif name == "obey" and self.wanted is True:
            self.view = self.view._replace(armed=True)
        elif name == "obey" and isinstance(self.wanted, Mode):
            mode_now = self.wanted.custom_mode
            self.view = self.view._replace(custom_mode=mode_now, intended_mode=mode_now)
        elif name == "stream" and SETPOINTS[self.it.state] is not Setpoints.NONE:
            self.view = self.view._replace(setpoints_sent=self.view.setpoints_sent + 10, silent_s=0.0)

    def step(self, step: Step) -> None:
        """Let it happen, and hold the invariants against what follows."""
        self.now_ns += round(step.dt_s * S)
        self.change(step.change)
        self.act(step.act)
        view, before = self.view, self.it.state
        switched = self.last_mode not in (None, self.control) and view.custom_mode == self.control
        switched = switched and view.certain
        changes = self.it.update(view, self.now_ns)
        self.last_mode = view.custom_mode if view.connected and view.certain else None
        self.check(before, changes, switched)
        self.check_stream(view)
        if changes:
            self.obeyed_in = None
        self.wanted = self.it.due_command(view, self.now_ns)
        assert self.wanted is None or self.obeyed_in is None
        if self.wanted is True:
            seen["armed"] += 1
            assert self.config.arm
            assert self.it.state is State.ARMING
            assert (view.custom_mode, view.blocked) == (self.control, None)
        if self.wanted == self.profile.control_mode:
            assert self.it.state is State.SWITCHING

    def act(self, name: str) -> None:
        """The operator commands."""
        until_ns = self.now_ns + round(self.config.step_timeout_s * S)
        if name == "engage" and self.it.engage(self.now_ns) is None:
            self.young_until_ns = until_ns
        elif name == "hold":
            self.it.hold(self.now_ns)
        elif name == "resume" and self.it.resume(self.now_ns) is None:
            self.resume_until_ns = until_ns
        elif name == "abort":
            refused = self.it.abort(self.now_ns)
            if refused is None and self.it.state in (State.CONNECTED, State.READY):
                self.auto_allowed, self.young_until_ns = False, 0

    def check_stream(self, view: View) -> None:
        """Nothing streams after a silence, unless what matters is known again."""
        timeout_s = self.profile.stream_timeout_s
        if self.it.state is State.READY:
            assert view.certain or not self.it.streaming
        elif (self.now_ns - self.attempt_ns) * 1e-9 > timeout_s and view.setpoints_sent > self.attempt_sent:
            seen["silence"] += max(view.unheard_s, view.silent_s) > timeout_s
            assert view.unheard_s <= timeout_s or not self.it.streaming
            known = self.it.state is State.STREAMING and not view.armed and view.certain
            assert view.silent_s <= timeout_s or known or not self.it.streaming

    def taken_over(self) -> bool:
        """Whether what is seen takes a vehicle that is held, or about to be, from the service."""
        return not self.view.connected or self.view.custom_mode not in (
            mode(self.profile, "hold"),
            self.control,  # on its way to hold, or a switch
        )

    def check(self, before: State, changes: list[Change], switched: bool) -> None:
        """The invariants of one update."""
        view = self.view
        assert len(changes) <= 6
        for old, new in zip([before, *(change.after for change in changes)], changes, strict=False):
            assert old is new.before
        if before is State.TRACKING and (
            not view.connected or not view.armed or view.custom_mode != self.control
        ):
            seen["taken over"] += 1
            assert changes[0].after is State.HANDED_OVER
            assert self.it.state not in ENGAGED
        if before in (State.PAUSING, State.HOLDING) and self.taken_over():
            seen["hold taken over"] += 1
            assert changes[0].after is State.HANDED_OVER
        for change in changes:
            if change.event is Event.RESUME:
                seen["resumed"] += 1
                assert self.now_ns < self.resume_until_ns
                assert (view.connected, view.blocked) == (True, None)
            if change.before in (State.PAUSING, State.HOLDING):
                self.resume_until_ns = 0 if change.after is not State.HOLDING else self.resume_until_ns
            if change.after in SPENT or change.event in (Event.ABORT, Event.GUARD_SILENCES):
                self.auto_allowed = False
            if change.after is State.TRACKING:
                seen["tracking"] += 1
                assert (view.connected, view.armed, view.blocked) == (True, True, None)
                assert view.custom_mode == self.control
            if change.after is State.HANDED_OVER:
                self.auto_allowed = False
                self.young_until_ns = 0
            if change.after in ENGAGED and change.before not in ENGAGED:
                commanded = self.now_ns < self.young_until_ns
                resumed = change.event is Event.RESUME
                assert (
                    resumed or switched or commanded or (self.config.engage == "auto" and self.auto_allowed)
                )
                assert view.custom_mode is not None
                assert view.armed is not None
                self.attempt_ns, self.attempt_sent = self.now_ns, view.setpoints_sent
                self.young_until_ns = 0
                if change.event is Event.ENGAGE and commanded:
                    seen["again"] += not self.auto_allowed
                    self.auto_allowed = True
            seen[change.after] += 1
            if change.after in (State.HANDED_OVER, State.ABORTED):
                self.given_away = True
            elif change.event in (Event.COMMANDED, Event.ENGAGE, Event.PILOT_SWITCHED):
                self.given_away = False
        if self.given_away and self.it.state is State.READY and self.profile.needs_stream:
            self.given_away = bool(view.armed)
            seen["left alone"] += self.given_away
            assert not (self.given_away and self.it.streaming)
        if self.it.state is State.READY and self.it.may_offer_stream(view):
            seen["offered"] += 1
            assert self.profile.needs_stream
            assert self.config.engage == "pilot" or self.auto_allowed
            assert view.custom_mode not in (None, self.control)
            assert view.intended_mode not in (None, self.control)


def walk(profile: Profile, engage: str, arm: bool, shutdown: bool, steps: list[Step]) -> None:
    """One random walk, and perhaps a shutdown at its end."""
    hold = mode(profile, "hold")
    view = View(True, "lost", False, hold, hold, None, 0, 0.0, "", 0, 0.0, True)
    config = SupervisorConfig(
        engage="auto" if engage == "auto" else "pilot",
        arm=arm,
        engage_max_error_m=1.0,
        step_timeout_s=STEP_S,
    )
    it = Walk(profile, config, view)
    for step in steps:
        it.step(step)
    if shutdown:
        it.it.shutdown()
        for _ in range(30):
            it.step(Step(0.05, "engage", "nothing"))
        assert it.it.state is State.FINISHED


@BOTH
@pytest.mark.parametrize("engage", ["auto", "pilot"])
def test_the_invariants_hold_whatever_happens(profile: Profile, engage: str) -> None:
    seen.clear()

    @settings(max_examples=250)
    @example(True, TAKE_OFF, True, [])
    @given(st.booleans(), st.sampled_from(BEGIN), st.booleans(), st.lists(STEPS, min_size=10, max_size=60))
    def explore(arm: bool, begin: list[Step], shutdown: bool, steps: list[Step]) -> None:
        walk(profile, engage, arm, shutdown, [*begin, *steps])

    explore()
    for what in (*HAPPENS, *["left alone"] * profile.needs_stream, *State):
        assert seen[what] > 0, f"no example came across {what}: {seen}"
    if engage == "pilot":
        assert (seen["offered"] > 0) is profile.needs_stream
