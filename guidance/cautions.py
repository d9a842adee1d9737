"""What forbids no flight and must be known before it: looked for while none is under way, and told once.

What flies the vehicle knows most of it (`Handler.cautions`). How much the position jitters is found here.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from math import sqrt
from typing import Final

from pymavlink.dialects.v20 import all as dialect

from guidance.estimate import Estimate, PositionSample
from guidance.flying import Caution
from guidance.mavlink.link import AutopilotLink
from guidance.mavlink.messages import AutopilotVersion, SysStatus
from guidance.mavlink.profiles import FLIES, Profile
from guidance.se3 import add, scale, subtract
from guidance.tracker import Tracker

#: Between two looks.
LOOK_NS: Final = 1_000_000_000
#: What was away for so long is told again.
AGAIN_NS: Final = 60_000_000_000
#: The jitter is taken over so many positions.
JITTER_SAMPLES: Final = 60
#: Three times what the shipped configurations are flown with and their smoothing is made for.
JITTER_MAX_M: Final = 0.15
#: Of COM_OBL_RC_ACT, those that are flown by hand.
_BY_HAND: Final = {0: "position mode", 1: "altitude mode", 2: "stabilized"}
#: Of COM_OBL_RC_ACT: terminate and disarm, from here on.
_TERMINATES: Final = 6
#: What an underwater vehicle is given back in.
_MANUAL: Final = "manual"
#: Of COM_RC_IN_MODE.
_NO_STICKS: Final = 4


class Jitter:
    """White noise of a position: what velocity does not explain of the way from one sample to the next."""

    def __init__(self) -> None:
        self._last: PositionSample | None = None
        self._squares: deque[float] = deque(maxlen=JITTER_SAMPLES)

    def take(self, sample: PositionSample) -> None:
        """The newest; one that was taken before is no news."""
        last, self._last = self._last, sample
        if last is None or sample.instant_ns <= last.instant_ns:
            return
        half_s = 0.5e-9 * (sample.instant_ns - last.instant_ns)
        moved = subtract(sample.position_ned_m, last.position_ned_m)
        meant = scale(half_s, add(sample.velocity_ned_m_s, last.velocity_ned_m_s))
        self._squares.append((moved.x - meant.x) ** 2 + (moved.y - meant.y) ** 2)

    @property
    def sigma_m(self) -> float:
        """Of each level component, m; 0 before enough was taken. A jump is no noise: the largest are out."""
        if len(self._squares) < JITTER_SAMPLES:
            return 0.0
        usual = sorted(self._squares)[: JITTER_SAMPLES - JITTER_SAMPLES // 10]
        return sqrt(sum(usual) / len(usual)) / 2.0


def about_sticks(
    profile: Profile, answers: Mapping[str, float], health: SysStatus | None
) -> tuple[Caution, ...]:
    """Where PX4 would fly by sticks that are not there when setpoints stop. It runs no such mode: a copter
    sank, landed and disarmed. An underwater vehicle is given back to them. `answers` are its parameters."""
    action = round(answers.get("COM_OBL_RC_ACT", -1.0))
    steered = profile.handling in FLIES and action in _BY_HAND
    given_back = profile.holding == _MANUAL and 0 <= action < _TERMINATES
    if not steered and not given_back:
        return ()
    off = answers.get("COM_RC_IN_MODE") == _NO_STICKS
    receiver = dialect.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    if not off and (health is None or health.onboard_control_sensors_present & receiver):
        return ()
    how = f"COM_RC_IN_MODE = {_NO_STICKS}" if off else "SYS_STATUS has no receiver present"
    if given_back:
        text = (
            f"no sticks are heard ({how}), and without them PX4 refuses manual, which ends a flight here: "
            "the thrusters go on until the setpoints stop; set COM_OBL_RC_ACT to 7 (disarm)"
        )
        return (Caution("sticks", text),)
    text = (
        f"no sticks are heard ({how}), and COM_OBL_RC_ACT = {action}, {_BY_HAND[action]}, needs them: "
        "when the setpoints stop it sinks and lands; set COM_OBL_RC_ACT to 5 (hold)"
    )
    return (Caution("sticks", text),)


def about_stopping(
    profile: Profile, answers: Mapping[str, float], version: AutopilotVersion | None
) -> tuple[Caution, ...]:
    """Where PX4 would go on with the last thrust when setpoints stop: an underwater vehicle before 1.17
    (`uuv_att_control.cpp`), in each mode that COM_OBL_RC_ACT can stand for."""
    action = round(answers.get("COM_OBL_RC_ACT", -1.0))
    older = profile.for_version(version) is not profile
    if profile.holding != _MANUAL or not older or not 0 <= action < _TERMINATES:
        return ()
    which = "of a version that is not known" if version is None else "before 1.17"
    text = (
        f"PX4 {which}, and COM_OBL_RC_ACT = {action}: when the setpoints stop the thrusters go on with "
        "the last one; set COM_OBL_RC_ACT to 7 (disarm), if the vehicle floats up"
    )
    return (Caution("stopping", text),)


class Cautions:
    """`standing` are those of the last look before a flight, and in it."""

    def __init__(self) -> None:
        self.standing: tuple[Caution, ...] = ()
        self._jitter = Jitter()
        self._look_ns = 0
        self._stood_ns: dict[str, int] = {}

    def look(
        self,
        tracker: Tracker,
        link: AutopilotLink,
        estimate: Estimate | str,
        now_ns: int,
        others: tuple[Caution, ...] = (),
    ) -> list[Caution]:
        """Look, if it is time: those that were not told yet, `others` among them. Only while no flight
        is under way, and of a vehicle that can be flown at all."""
        if isinstance(estimate, str):
            return []
        self._jitter.take(estimate.position)
        if now_ns < self._look_ns:
            return []
        self._look_ns = now_ns + LOOK_NS
        self.standing = (*tracker.cautions(estimate, link.origin, link.home), *others, *self._noise())
        new = []
        for caution in self.standing:
            stood_ns = self._stood_ns.get(caution.about)
            if stood_ns is None or now_ns - stood_ns > AGAIN_NS:
                new.append(caution)
            self._stood_ns[caution.about] = now_ns
        return new

    def _noise(self) -> tuple[Caution, ...]:
        sigma_m = self._jitter.sigma_m
        if sigma_m <= JITTER_MAX_M:
            return ()
        text = (
            f"the position jitters by {sigma_m:.2f} m from one sample to the next, smoothing is made for "
            f"{JITTER_MAX_M / 3.0:g} m: has the estimator settled?"
        )
        return (Caution("noise", text),)
