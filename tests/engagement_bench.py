"""A bench for the engaging sequence: an `Engagement`, and a view of the vehicle that is changed by hand."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import pytest

from guidance.config import SupervisorConfig
from guidance.engagement import ESTABLISHED_AFTER, Change, Engagement
from guidance.mavlink.profiles import PROFILES, Profile
from guidance.supervisor import Event, State
from guidance.view import View

S: Final = 1_000_000_000
PX4: Final = PROFILES["px4-uuv"]
ROVER: Final = PROFILES["ardupilot-rover"]
BOTH: Final = pytest.mark.parametrize("profile", [PX4, ROVER], ids=lambda profile: profile.name)


class Bench(NamedTuple):
    """An engagement, and a view that each step changes a little."""

    it: Engagement
    views: list[View]
    now_ns: list[int]

    def see(self, after_s: float = 0.05, **changed: Any) -> list[Change]:
        """Time passes, and what is seen changes."""
        self.now_ns[0] += round(after_s * S)
        self.views[0] = self.views[0]._replace(**changed)
        return self.it.update(self.views[0], self.now_ns[0])

    def state(self) -> State:
        """The supervisor's state; a call, so that a type checker does not take it for constant."""
        return self.it.state

    def reason(self) -> str:
        """Why."""
        return self.it.reason

    def streams(self) -> bool:
        """Whether setpoints may flow."""
        return self.it.streaming

    def command(self) -> object:
        """What would be commanded now."""
        return self.it.due_command(self.views[0], self.now_ns[0])

    def engage(self) -> str | None:
        """The operator's command."""
        return self.it.engage(self.now_ns[0])

    def reach_auto(self) -> None:
        """Let `engage = "auto"` take an obedient vehicle into tracking."""
        control = self.it.profile.control_mode.custom_mode
        self.see()
        self.see(setpoints_sent=ESTABLISHED_AFTER)
        self.see(custom_mode=control)
        self.see(armed=True)
        assert self.state() is State.TRACKING, self.reason()

    def reach(self, state: State) -> None:
        """Take the ordinary way to a state."""
        profile = self.it.profile
        ways: list[tuple[State, dict[str, Any]]] = [
            (State.READY, {}),
            (State.STREAMING, {}),
            (State.SWITCHING, {"setpoints_sent": ESTABLISHED_AFTER}),
            (State.ARMING, {"custom_mode": profile.control_mode.custom_mode}),
            (State.TRACKING, {"armed": True}),
        ]
        for step, changed in ways:
            if step is State.STREAMING:
                assert self.engage() is None
            self.see(**changed)
            if self.state() is state:
                return
            assert self.state() is step, self.reason()
        raise AssertionError(f"no way to {state}")


def bench(profile: Profile, engage: str = "pilot", *, arm: bool = False, **seen: Any) -> Bench:
    """Connected to a disarmed vehicle in `hold`, nothing blocked."""
    hold = profile.mode("hold")
    assert hold is not None
    config = SupervisorConfig(engage="auto" if engage == "auto" else "pilot", arm=arm, engage_max_error_m=1.0)
    view = View(
        connected=True,
        absent_because="the autopilot's heartbeat stopped",
        armed=False,
        custom_mode=hold.custom_mode,
        intended_mode=hold.custom_mode,
        blocked=None,
        setpoints_sent=0,
        silent_s=0.0,
        answer="",
        heartbeat_ns=0,
        unheard_s=0.0,
        certain=True,
    )
    return Bench(Engagement(config, profile), [view._replace(**seen)], [100 * S])


def mode(profile: Profile, name: str) -> int:
    """A mode's `custom_mode`."""
    found = profile.mode(name)
    assert found is not None
    return found.custom_mode


def ways(changes: list[Change]) -> list[tuple[State, Event]]:
    """The states entered and by which events."""
    return [(change.after, change.event) for change in changes]
