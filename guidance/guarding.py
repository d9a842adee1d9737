"""The guards at work: what they have to know beside the estimate, how long each limit has been exceeded."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final

from pymavlink.dialects.v20 import all as dialect

from guidance.config import Config
from guidance.estimate import Estimate, Reset, Switch, together
from guidance.geofence import Fence
from guidance.guard_limits import SILENCE, GuardsConfig, fence_of
from guidance.guards import GUARDS, NOT_FINITE, NUMBER, Guard, Look
from guidance.mavlink.link import AutopilotLink
from guidance.mavlink.messages import BatteryStatus, Body, GpsGlobalOrigin, StatusText, SysStatus
from guidance.mavlink.profiles import Profile
from guidance.se3 import Vec3, norm
from guidance.supervisor import State
from guidance.tracker import Solution, Tracker, is_usable
from guidance.view import Trip

#: Where the service has control and a guard may end that.
IN_CONTROL: Final = frozenset({State.TRACKING, State.PAUSING})
#: Before a flight its whole way is looked at, no more often than this.
_PLAN_NS: Final = 500_000_000
#: What forbade to engage must have been well for so long: a battery at its limit is not ready twice a second.
_CALM_NS: Final = 3_000_000_000
#: How ArduPilot tells its emergency stop (`RC_Channel::read_aux`), of which nothing else speaks; a switch in
#: the middle changes nothing.
_STOP_SWITCH: Final = re.compile(rb"RC\d+: MotorEStop (HIGH|LOW)\b")
_OUTPUTS: Final = dialect.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS


class Guards:
    """`trip` is the guard that tripped as of the last look, `condition` what forbids to engage, in words."""

    def __init__(self, config: Config, profile: Profile, link: AutopilotLink, tracker: Tracker) -> None:
        self.trip: Trip | None = None
        self.condition: str | None = None
        self.late_s = 0.0
        self._in_control = False
        self._control_ns = 0
        self._config = config
        self._profile = profile
        self._link = link
        self._tracker = tracker
        self._solution: Solution | None = None
        self._jump: Reset | None = None
        self._fenced: tuple[GuardsConfig, GpsGlobalOrigin | None, Fence | str | None] | None = None
        self._since_ns: dict[str, int] = {}
        self._looked_ns = -_PLAN_NS
        self._condition_ns = 0
        self.rebooted()

    def reconfigure(self, config: Config) -> None:
        """Limits and trajectory are these from now on; another trajectory is looked at before it is flown."""
        if config.trajectory != self._config.trajectory:
            self._looked_ns = -_PLAN_NS
        self._config = config

    def rebooted(self) -> None:
        """Another autopilot, as it were: nothing is known of its batteries and switches."""
        self._percent: int | None = None
        self._armed = False
        self._stop_switch = False
        self._outputs_off = False
        self._batteries: dict[int, BatteryStatus] = {}

    def heard(self, body: Body) -> None:
        """A message that says something of batteries and switches; others are not looked at."""
        if isinstance(body, SysStatus):
            self._percent = None if body.battery_remaining < 0 else body.battery_remaining
            has, uses = body.onboard_control_sensors_present, body.onboard_control_sensors_enabled
            self._outputs_off = bool(has & ~uses & _OUTPUTS)
        elif isinstance(body, StatusText):
            told = _STOP_SWITCH.match(body.text)
            if told is not None:
                self._stop_switch = told[1] == b"HIGH"
        elif isinstance(body, BatteryStatus):
            self._batteries[body.id] = body

    def happened(self, news: Iterable[Reset | Switch]) -> bool:
        """What the estimator says, and whether a reset is among it: the next look judges what all come to."""
        resets = [one for one in news if isinstance(one, Reset)]
        for reset in resets:
            self._jump = reset if self._jump is None else together(self._jump, reset)
            self._looked_ns = -_PLAN_NS
        return bool(resets)

    def before_sending(self, solution: Solution, now_ns: int) -> str | None:
        """The law has spoken: why that must not be sent, if it must not. The other guards look 20 times a
        second, and as soon as the estimator says that it was reset."""
        self._solution = solution
        if is_usable(solution):
            return None
        if self._in_control and self.trip is None:
            self.trip = self._tripped(NUMBER, NOT_FINITE)
        return NOT_FINITE

    def look(self, state: Estimate | str, in_state: State, now_ns: int) -> None:
        """Look at all of them; `state` is the estimate, or why there is none."""
        armed = bool(self._link.armed)
        if self._armed and not armed:  # the next flight is another
            self._stop_switch = False
        self._armed = armed
        in_control = in_state in IN_CONTROL
        if in_control and not self._in_control:
            self._control_ns = now_ns
        self._in_control = in_control
        if not in_control:
            self._since_ns.clear()
            self._solution, self.trip, self.late_s = None, None, 0.0
            if now_ns - self._looked_ns < _PLAN_NS:
                return
            self._looked_ns = now_ns if isinstance(state, Estimate) else -_PLAN_NS
        begun = in_control or self._tracker.paused_s is not None
        if not begun:  # nothing was made of the frame before
            self._jump = None
        look = self._seen(state, now_ns)
        if in_control:  # a flight that is held goes on only where the frame still holds
            self._jump = None
        if not in_control:
            found = ((guard, guard.exceeded(look)) for guard in GUARDS if guard.before)
            condition = next((f"{guard.name}: {why}" for guard, why in found if why is not None), None)
            if condition is not None:
                self._condition_ns = now_ns
            if condition is not None or now_ns - self._condition_ns >= _CALM_NS:
                self.condition = condition
            return
        self.condition = None
        for guard in GUARDS:
            reason = guard.exceeded(look)
            if reason is None:
                self._since_ns.pop(guard.name, None)
                continue
            since_ns = self._since_ns.setdefault(guard.name, now_ns)
            if self.trip is None and now_ns - since_ns >= round(guard.patience_s(self._config.guards) * 1e9):
                self.trip = self._tripped(guard, reason)

    def _tripped(self, guard: Guard, reason: str) -> Trip:
        action = getattr(self._config.guards, f"{guard.name}_action")
        mode = None if action == SILENCE else self._profile.mode(action)
        return Trip(guard.name, f"{guard.name}: {reason}", mode)

    def _seen(self, state: Estimate | str, now_ns: int) -> Look:
        solution, tracker = self._solution, self._tracker
        origin: Vec3 | str | None = tracker.origin_ned_m
        if origin is None and isinstance(state, Estimate):
            origin = tracker.find_origin(state.pose.position, self._link.origin, self._link.home)
        percents = [battery.battery_remaining for battery in self._batteries.values()]
        known = [percent for percent in (self._percent, *percents) if percent is not None and percent >= 0]
        return Look(
            now_ns=now_ns,
            in_control=self._in_control,
            control_ns=self._control_ns,
            config=self._config,
            link=self._link,
            state=state,
            solution=solution,
            origin_ned_m=origin if isinstance(origin, Vec3) else None,
            trajectory_s=(tracker.paused_s or 0.0) if solution is None else solution.trajectory_s,
            fence=self._fence(),
            late_s=self.late_s,
            jump=self._jump,
            offset_m=norm(tracker.reference_offset_ned_m),
            battery_percent=min(known, default=None),
            charge_state=max(
                (b.charge_state for b in self._batteries.values() if b.charge_state in range(3, 7)), default=0
            ),
            stopped=self._stopped(),
        )

    def _stopped(self) -> str | None:
        """By what ArduPilot's motors stand still; PX4 tells it in HEARTBEAT, and means ESCs by the bit."""
        if self._profile.autopilot != dialect.MAV_AUTOPILOT_ARDUPILOTMEGA or not self._link.armed:
            return None
        if self._stop_switch:
            return "the motors are stopped by the emergency switch"
        return "the motors are off by the safety switch" if self._outputs_off else None

    def _fence(self) -> Fence | str | None:
        """In the autopilot's local frame as it is now."""
        guards, origin = self._config.guards, self._link.origin
        if self._fenced is None or self._fenced[0] is not guards or self._fenced[1] is not origin:
            self._fenced = guards, origin, self._find_fence(guards, origin)
        return self._fenced[2]

    def _find_fence(self, guards: GuardsConfig, origin: GpsGlobalOrigin | None) -> Fence | str | None:
        if not guards.fence_deg:
            fence = fence_of(guards, guards.fence_ned_m)
            return None if fence == Fence() else fence
        if origin is None:
            return "the fence's place is not known before GPS_GLOBAL_ORIGIN"
        at = (origin.latitude * 1e-7, origin.longitude * 1e-7, origin.altitude * 1e-3)
        corners = tuple(self._profile.project((*corner, at[2]), at)[:2] for corner in guards.fence_deg)
        return fence_of(guards, corners)
