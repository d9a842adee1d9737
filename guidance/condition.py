"""What the autopilot says of itself beside its state: whether it flies, and what its estimator holds.

What flies is not taken over as it stands, nor as it takes off: setpoints break a copter's take-off off, and
hold an airplane's down. EXTENDED_SYS_STATE says which; where it never came, HEARTBEAT's status, which is
ACTIVE in the air (ArduPilot) or armed (PX4).

Whether PX4 hears sticks is the receiver among what SYS_STATUS has present (`HealthAndArmingChecks`).

ArduPilot goes on without a position of its estimator: by dead reckoning, which GLOBAL_POSITION_INT shows as
if nothing had happened. EKF_STATUS_REPORT tells; where it never came, nothing is withheld.
"""

from __future__ import annotations

from typing import Final

from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.messages import Body, EkfStatusReport, ExtendedSysState, Heartbeat, SysStatus
from guidance.mavlink.profiles import Handling, Profile

_NOT_FLYING: Final[dict[int, str]] = {
    dialect.MAV_LANDED_STATE_ON_GROUND: "stands on the ground",
    dialect.MAV_LANDED_STATE_TAKEOFF: "takes off",
    dialect.MAV_LANDED_STATE_LANDING: "lands",
}
_CLASSES: Final = {Handling.VELOCITY: "a copter", Handling.AIRPLANE: "an airplane"}
_NO_POSITION: Final = dialect.EKF_CONST_POS_MODE | dialect.EKF_UNINITIALIZED
_POSITION: Final = dialect.EKF_POS_HORIZ_REL | dialect.EKF_POS_HORIZ_ABS


class Condition:
    """The newest of what it says."""

    def __init__(self) -> None:
        self.rebooted()

    def rebooted(self) -> None:
        """Nothing is known of another autopilot."""
        self._landed_state = dialect.MAV_LANDED_STATE_UNDEFINED
        self._flags: int | None = None
        self._flags_ns = 0
        self.health: SysStatus | None = None

    def heard(self, body: Body, now_ns: int) -> None:
        """A message; others than the three are not looked at."""
        if isinstance(body, ExtendedSysState):
            self._landed_state = body.landed_state
        elif isinstance(body, EkfStatusReport):
            self._flags, self._flags_ns = body.flags, now_ns
        elif isinstance(body, SysStatus):
            self.health = body

    def not_flying(self, profile: Profile, beat: Heartbeat) -> str | None:
        """Why a copter or an airplane must not be taken over yet; None of one that flies, and of others."""
        vehicle = _CLASSES.get(profile.handling)
        if vehicle is None:
            return None
        if self._landed_state == dialect.MAV_LANDED_STATE_UNDEFINED:
            doing = None if beat.system_status == dialect.MAV_STATE_ACTIVE else "is not known to fly"
        else:
            doing = _NOT_FLYING.get(self._landed_state)
        return (
            None if doing is None else f"it {doing}: {vehicle} is taken over in the air, after its take-off"
        )

    def doubted(self, local_ns: int | None) -> bool:
        """Whether GLOBAL_POSITION_INT may be dead reckoning: none is held, or nothing was said of that since
        the newest LOCAL_POSITION_NED (at `local_ns`), which ends at that very instant."""
        unsaid = self._flags is not None and local_ns is not None and self._flags_ns <= local_ns
        return unsaid or self.no_position is not None

    @property
    def no_position(self) -> str | None:
        """Why the autopilot's position is none."""
        flags = self._flags
        if flags is None or (flags & _POSITION and not flags & _NO_POSITION):
            return None
        return f"the autopilot's estimator holds no position (EKF_STATUS_REPORT {flags}): has it GPS?"
