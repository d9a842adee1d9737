"""What is seen of the vehicle, how sure that is, and what may be concluded from it."""

from __future__ import annotations

from typing import Final, NamedTuple

from guidance.mavlink.link import AutopilotLink
from guidance.mavlink.modes import Mode
from guidance.mavlink.profiles import Profile
from guidance.mavlink.report import absence

#: More silence than this counts, or half the firmware's own time-out if that is less.
SILENCE_S: Final = 0.75
#: Setpoints that nobody answers for longer do not arrive. (A question goes out 25 times a second: with 30 %
#: of loss each way so many unanswered ones running come once in a day of flight.)
UNANSWERED_S: Final = 1.0
#: Where nothing is lost, unanswered for so long means that the other end does not read: what is sent waits in
#: its buffer, acknowledged, and is obeyed when it reads again, however old.
STALLED_S: Final = 0.25
#: A mode that was shown for less was none to switch from: HEARTBEAT comes once a second.
STOOD_S: Final = 1.2


class Trip(NamedTuple):
    """A guard that tripped: why, in words, and the mode to command, None to fall silent."""

    guard: str
    reason: str
    mode: Mode | None


class View(NamedTuple):
    """What the supervisor can see. `blocked` is the first unmet condition in words, None if there is none.

    `intended_mode` is None where nobody says it: then the control mode cannot be excluded. `silent_s` is the
    time since the last setpoint; `answer` the last refusal of a mode or arming command; `heartbeat_ns` the
    instant of the last HEARTBEAT. `unheard_s`, `certain` and `settled` are `Contact`'s; `unanswered_s` is the
    age of the newest packet of ours that was answered: what was sent since may never have arrived.
    `trip` is the guard that tripped, if one did.
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
    heartbeat_ns: int
    unheard_s: float
    certain: bool
    unanswered_s: float = 0.0
    trip: Trip | None = None
    settled: bool = True


class Contact:
    """Whether arming and mode were heard since the last silence.

    While the autopilot is not heard (the link has a gap, or this process was stopped) its failsafe may act
    and its pilot may switch. What was known before says nothing after. Nor does what is read at the end of
    the silence: it may have waited in a queue. So each must come once more, later than the silence.

    `settled`: the mode, or the one before it, stood for `STOOD_S`. Two vehicles of one id show their modes in
    turn, and that one of them is in the control mode is nobody's switch.
    """

    def __init__(self, profile: Profile) -> None:
        self.unheard_s = 0.0
        self.certain = True
        self.settled = True
        self._mode: int | None = None
        self._mode_ns: int | None = None
        self._limit_s = silence_limit_s(profile)
        self._heard = 0
        self._heard_ns: int | None = None
        self._silence_ns = -1

    def look(
        self, heard: int, heartbeat_ns: int, mode_ns: int | None, now_ns: int, custom_mode: int | None = None
    ) -> None:
        """Look again, often.

        Args:
            heard: how many messages of the autopilot were heard so far.
            heartbeat_ns, mode_ns: when the newest HEARTBEAT and CURRENT_MODE came, None if never.
            custom_mode: the mode that they show.
        """
        stood = self._mode_ns is None or now_ns - self._mode_ns >= round(STOOD_S * 1e9)
        if custom_mode != self._mode:
            self.settled = stood
            self._mode_ns = None if self._mode is None else now_ns
            self._mode = custom_mode
        else:
            self.settled |= stood
        # Before the count is looked at: the silence that has just ended counts, too.
        self.unheard_s = 0.0 if self._heard_ns is None else (now_ns - self._heard_ns) * 1e-9
        if heard != self._heard:
            self._heard, self._heard_ns = heard, now_ns
        if self.unheard_s > self._limit_s:
            self._silence_ns = now_ns
        self.certain = heartbeat_ns > self._silence_ns and (mode_ns is None or mode_ns > self._silence_ns)


class Attempt:
    """One attempt to engage: when it began, and whether a silence interrupted it."""

    def __init__(self, profile: Profile) -> None:
        self.broken = False
        self._limit_s = silence_limit_s(profile)
        self._needs_stream = profile.needs_stream
        self._began_ns = 0
        self._sent_before = 0

    def begin(self, view: View, now_ns: int) -> None:
        """It begins."""
        self.broken, self._began_ns, self._sent_before = False, now_ns, view.setpoints_sent

    def silence(self, view: View, now_ns: int, *, establishing: bool) -> str | None:
        """Too long a silence in this attempt, in words; it is `broken` from then on."""
        if view.setpoints_sent == self._sent_before and (establishing or not self._needs_stream):
            return None  # nothing is under way yet that could be interrupted
        began_s = (now_ns - self._began_ns) * 1e-9
        silent_s, unheard_s = min(view.silent_s, began_s), min(view.unheard_s, began_s)
        unanswered_s = min(view.unanswered_s, began_s)
        if max(silent_s, unheard_s) <= self._limit_s and unanswered_s <= UNANSWERED_S:
            return None
        self.broken = True
        if silent_s > self._limit_s:
            return f"no setpoint for {silent_s:.2f} s" + (f" ({view.blocked})" if view.blocked else "")
        if unheard_s > self._limit_s:
            return f"nothing heard of the autopilot for {unheard_s:.2f} s"
        return f"the autopilot has answered nothing for {unanswered_s:.2f} s: does what is sent arrive?"


def seen(
    link: AutopilotLink,
    contact: Contact,
    scheme: str,
    now_ns: int,
    *,
    blocked: str | None,
    setpoints_sent: int,
    sent_ns: int | None,
    answer: str,
    trip: Trip | None = None,
) -> View:
    """What the link shows now; `sent_ns` is when the last setpoint was sent, None if none was."""
    connected = link.connected(now_ns)
    return View(
        connected=connected,
        absent_because="" if connected else absence(link, scheme),
        armed=link.armed,
        custom_mode=link.custom_mode,
        intended_mode=link.intended_mode,
        blocked=blocked,
        setpoints_sent=setpoints_sent,
        silent_s=float("inf") if sent_ns is None else (now_ns - sent_ns) * 1e-9,
        answer=answer,
        heartbeat_ns=link.heartbeat_ns,
        unheard_s=contact.unheard_s,
        unanswered_s=link.uplink_age_s(now_ns) or 0.0,
        certain=contact.certain,
        settled=contact.settled,
        trip=trip,
    )


def silence_limit_s(profile: Profile) -> float:
    """How long nothing may be sent or heard: well before the firmware acts by itself."""
    return min(SILENCE_S, 0.5 * profile.stream_timeout_s)


def may_obey(profile: Profile, view: View) -> bool:
    """Whether a setpoint might act at once: the control mode is on, intended, or not excluded."""
    control = profile.control_mode.custom_mode
    if view.custom_mode == control:
        return True
    return profile.needs_stream and view.intended_mode in (None, control)


def withheld_reason(profile: Profile, view: View) -> str:
    """Why a vehicle that was found armed is left alone."""
    mode = profile.control_mode
    if view.custom_mode != mode.custom_mode and view.intended_mode is None:
        return f"armed, and CURRENT_MODE does not say yet whether {mode.name} is intended: silent"
    return f"found armed in {mode.name}: silent until the mode changes, it disarms, or engage is commanded"


def waiting_reason(profile: Profile, view: View, *, silenced: bool) -> str:
    """What READY waits for, and what the pilot can do. `silenced`: no stream is offered after a hand-over."""
    mode = profile.control_mode
    if not view.certain:
        heard = "HEARTBEAT and CURRENT_MODE" if profile.needs_stream else "HEARTBEAT"
        return f"the autopilot was silent: waiting for {heard}, then switch to {mode.name} or command engage"
    if view.custom_mode == mode.custom_mode:
        return f"already in {mode.name}: leave it and switch again, or command engage"
    if profile.needs_stream and view.intended_mode == mode.custom_mode:
        return (
            f"{mode.name} is intended but not flown: choose another mode and switch again, or command engage"
        )
    # Without a stream PX4 lets a disarmed vehicle into the mode, and refuses an armed one.
    instead = f"command engage, or switch to {mode.name} before arming"
    if profile.needs_stream and view.intended_mode is None:
        return f"no CURRENT_MODE tells the intended mode, so no stream is offered: {instead}"
    if profile.needs_stream and silenced:
        return f"control was handed over, so no stream is offered: {instead}"
    return f"waiting for the pilot to switch to {mode.name}"
