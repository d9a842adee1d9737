"""What ends a flight beside the pilot and the operator: the guards, as one table.

A row says what is watched, which keys of [guards] limit it, how long that must last, and from what is known
now whether it is exceeded, in words. `guarding` looks at them in flight; those marked `before` are conditions
for engaging, too. What a guard does is `guards.<name>_action`: a mode that is commanded, or silence.

"At rate" bears loss and does not bear a gap: at 50 Hz and 50 % of random loss, less than 0.3 of the rate
within a second is seen once in 700 seconds, and not for 2 s running; a gap of 1 s is longer than every
silence that the supervisor bears (0.75 s, or half of the firmware's own time-out).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

from pymavlink.dialects.v20 import all as dialect

from guidance.config import Config, profile_of
from guidance.estimate import ATTITUDES, POSITIONS, Estimate, Reset
from guidance.flying.channels import place_of
from guidance.geofence import Fence
from guidance.guard_limits import GuardsConfig, leaves_after_s
from guidance.handling_config import ExcitationConfig
from guidance.mavlink.link import AutopilotLink
from guidance.mavlink.profiles import Asked
from guidance.records import AirplaneHandling, Stepping
from guidance.se3 import Quaternion, Vec3, dot, norm, roll_of, rotate, scale
from guidance.tracker import Solution, is_usable
from guidance.tune import room

#: Commands below this part of the limits may well have no visible effect.
_COMMANDED: Final = 0.25
#: And an effect is at least this part of the command.
_EFFECT: Final = 0.1
#: And so does a bank that is asked for below this.
_BANKED_RAD: Final = math.radians(10.0)
#: A limit on the speed is not exceeded by one noisy sample.
_SPEED_S: Final = 0.5
#: A front may turn the wind by more than an airplane's airspeed can spare, but not in less.
_BLIND_S: Final = 5.0
#: SYS_STATUS may show a dip under load.
_BATTERY_S: Final = 3.0

#: A HEARTBEAT so long after control began was sent since.
_HEARTBEAT_SHOWN_NS: Final = 500_000_000

_FAILSAFE: Final = {
    dialect.MAV_STATE_CRITICAL: "CRITICAL",
    dialect.MAV_STATE_EMERGENCY: "EMERGENCY",
    dialect.MAV_STATE_POWEROFF: "POWEROFF",
    dialect.MAV_STATE_FLIGHT_TERMINATION: "FLIGHT_TERMINATION",
}
NOT_FINITE: Final = "the law gave a number that is not finite"
_CHARGE: Final = {
    dialect.MAV_BATTERY_CHARGE_STATE_CRITICAL: "critical",
    dialect.MAV_BATTERY_CHARGE_STATE_EMERGENCY: "an emergency",
    dialect.MAV_BATTERY_CHARGE_STATE_FAILED: "failed",
    dialect.MAV_BATTERY_CHARGE_STATE_UNHEALTHY: "unhealthy",
}


class Look(NamedTuple):
    """What is known now.

    `state` is the estimate or why there is none; `solution` the newest of the law while in control;
    `origin_ned_m` the trajectory's, or where it would be; `fence` may be why it is not known. `stopped` says
    by what the motors stand still, though the autopilot is armed.
    """

    now_ns: int
    in_control: bool
    control_ns: int
    config: Config
    link: AutopilotLink
    state: Estimate | str
    solution: Solution | None
    origin_ned_m: Vec3 | None
    trajectory_s: float
    fence: Fence | str | None
    late_s: float
    jump: Reset | None
    offset_m: float
    battery_percent: int | None
    charge_state: int
    stopped: str | None

    @property
    def guards(self) -> GuardsConfig:
        """Their limits."""
        return self.config.guards


class Guard(NamedTuple):
    """One row: `for_s` is a key of [guards] or a number."""

    name: str
    watches: str
    limits: tuple[str, ...]
    for_s: str | float
    before: bool
    exceeded: Callable[[Look], str | None]

    def patience_s(self, config: GuardsConfig) -> float:
        """How long it must be exceeded."""
        if not isinstance(self.for_s, str):
            return self.for_s
        return float(getattr(config, self.for_s) or 0.0)


def _failsafe(look: Look) -> str | None:
    if look.stopped is not None:
        return look.stopped
    beat = look.link.heartbeat
    status = None if beat is None else _FAILSAFE.get(beat.system_status)
    if look.in_control and look.link.heartbeat_ns < look.control_ns + _HEARTBEAT_SHOWN_NS:
        return None  # from before
    wants_stream = look.link.intended_mode == profile_of(look.config).control_mode.custom_mode
    if status == "CRITICAL" and wants_stream and not look.in_control:
        return None  # PX4's, for want of our own setpoints: a command to engage is the cure
    return None if status is None else f"the autopilot's state is {status}"


def _battery(look: Look) -> str | None:
    charge = _CHARGE.get(look.charge_state)
    if charge is not None:
        return f"the battery is {charge}"
    percent, limit = look.battery_percent, look.guards.battery_min_percent
    return None if percent is None or percent >= limit else f"battery at {percent} %, below {limit:g} %"


def _number(look: Look) -> str | None:
    solution = look.solution
    return None if solution is None or is_usable(solution) else NOT_FINITE


def _fence(look: Look) -> str | None:
    if look.fence is None or isinstance(look.fence, str):
        return look.fence
    if isinstance(look.state, Estimate):
        outside_m = look.fence.outside_m(look.state.pose.position)
        if outside_m > 0.0:
            return f"{outside_m:.1f} m outside the fence"
    if look.config.excitation.runs:
        return None if look.in_control else _without_room(look.fence, look.config.excitation, look.state)
    if look.origin_ned_m is None:
        return None
    ahead_s = look.guards.fence_ahead_s if look.in_control else look.guards.fence_plan_s
    after_s = leaves_after_s(
        look.fence, look.config.trajectory, look.origin_ned_m, look.trajectory_s, ahead_s
    )
    return None if after_s is None else f"the trajectory leaves the fence in {after_s:.0f} s"


def _without_room(fence: Fence, steps: ExcitationConfig, state: Estimate | str) -> str | None:
    if isinstance(state, str):
        return None
    box, place = steps.box, place_of(state, steps.way)
    outside_m = room.outside_m(fence, box, place, state.pose.position.z)
    if outside_m == 0.0:
        return None
    return (
        f"the steps need {room.in_words(box)}, {outside_m:.0f} m of it outside: go elsewhere, turn, or "
        f"guards.{room.fence_in_words(box, place)}"
    )


def _state(look: Look) -> str | None:
    if look.guards.state_max_s is None or isinstance(look.state, Estimate):
        return None
    return look.state


def _rate(look: Look) -> str | None:
    limit = look.guards.rate_part
    for alternatives in (ATTITUDES, POSITIONS):
        found = [s.status(look.now_ns) for s in map(look.link.streams.get, alternatives) if s is not None]
        best = max(found, key=lambda status: status.rate_hz / status.wanted_hz, default=None)
        if best is not None and best.rate_hz < limit * best.wanted_hz:
            return f"{best.message} at {best.rate_hz:.0f} of {best.wanted_hz:.0f} Hz"
    return None


def _delay(look: Look) -> str | None:
    if isinstance(look.state, str):
        return None  # older still: another guard's
    age_s = (look.now_ns - look.state.attitude.instant_ns) * 1e-9
    limit_s = look.guards.delay_max_s
    return (
        None
        if limit_s is None or age_s <= limit_s
        else f"the state comes {age_s:.2f} s late, {limit_s:g} s at most"
    )


def _jump(look: Look) -> str | None:
    if look.offset_m > look.guards.jump_max_m:
        return f"estimator off by {look.offset_m:.1f} m"
    if look.jump is None:
        return None
    moved_m, turned_deg = norm(look.jump.moved_ned_m), math.degrees(norm(look.jump.turned_ned_rad))
    if not moved_m <= look.guards.jump_max_m:
        return f"estimator jumped by {moved_m:.1f} m"
    if not turned_deg <= look.guards.jump_max_deg:
        return f"estimator turned by {turned_deg:.0f} deg"
    return None


def _error(look: Look) -> str | None:
    limit_m = look.guards.error_max_m
    if limit_m is None or look.solution is None:
        return None
    error_m = norm(look.solution.evaluation.e)
    return None if error_m <= limit_m else f"{error_m:.1f} m off the trajectory"


def _speed(look: Look) -> str | None:
    limit = look.guards.speed_max_m_s
    if limit is None or isinstance(look.state, str):
        return None
    speed_m_s = norm(look.state.twist.linear)
    return None if speed_m_s <= limit else f"{speed_m_s:.1f} m/s, above {limit:g} m/s"


def _tilt(look: Look) -> str | None:
    limit = look.guards.tilt_max_deg
    if limit is None or isinstance(look.state, str):
        return None
    down = rotate(look.state.seen.attitude, Vec3(0.0, 0.0, 1.0)).z
    tilt_deg = math.degrees(math.acos(min(max(down, -1.0), 1.0)))
    return None if tilt_deg <= limit else f"tilted by {tilt_deg:.0f} deg, above {limit:g} deg"


def _effect(look: Look) -> str | None:
    if isinstance(look.state, str) or look.solution is None:
        return None
    limits, out, twist = look.config.limits, look.solution.outgoing, look.state.twist
    row = profile_of(look.config)
    if row.asked is Asked.ATTITUDE_THROTTLE:
        asked, banked = roll_of(Quaternion(*out.attitude_wxyz)), roll_of(look.state.pose.attitude)
        if abs(asked) <= _BANKED_RAD or banked * asked >= _EFFECT * asked * asked:
            return None
        return f"banks by {math.degrees(banked):.0f} of {math.degrees(asked):.0f} deg: no effect"
    speed_m_s = out.speed_m_s
    along_m_s = twist.linear.x
    if row.asked is Asked.VELOCITY_YAW_RATE and speed_m_s > 0.0:
        along_m_s = dot(look.state.velocity_ned_m_s, Vec3(*out.velocity_ned_m_s)) / speed_m_s
    if abs(speed_m_s) > _COMMANDED * limits.speed_max_m_s and (
        along_m_s * speed_m_s < _EFFECT * speed_m_s * speed_m_s
    ):
        return f"{along_m_s:.1f} of {speed_m_s:.1f} m/s: setpoints have no effect"
    rates = Vec3(*out.body_rates_frd_rad_s)
    asked = norm(rates)
    fastest = max(limits.roll_rate_max_rad_s, limits.pitch_rate_max_rad_s, limits.yaw_rate_max_rad_s)
    if asked <= _COMMANDED * fastest:
        return None
    # as measured: the predicted rates are those that were sent
    turning = dot(look.state.attitude.body_rates_frd_rad_s, scale(1.0 / asked, rates))
    return None if turning >= _EFFECT * asked else f"{turning:.1f} of {asked:.1f} rad/s: no effect"


def _air(look: Look) -> str | None:
    around = None if look.solution is None else look.solution.flown.around
    blind = isinstance(around, AirplaneHandling | Stepping) and around.blind
    return "neither airspeed nor wind is known any more" if blind else None


def _late(look: Look) -> str | None:
    limit_s = look.guards.late_max_s
    return None if look.late_s <= limit_s else f"setpoints {look.late_s * 1e3:.0f} ms late"


#: Looked at before each setpoint, too: none is ever sent.
NUMBER: Final = Guard("number", "the law: any number that is not finite", (), 0.0, False, _number)

#: In the order in which they are believed: the first one that trips is the reason.
GUARDS: Final = (
    Guard("failsafe", "HEARTBEAT: the autopilot's own failsafe acts (CRITICAL and above); STATUSTEXT, "
          "SYS_STATUS: a switch has stopped ArduPilot's motors", (), 0.0, True, _failsafe),
    NUMBER,
    Guard("fence", "vehicle and trajectory against polygon and band of depth",
          ("fence_ned_m", "fence_deg", "fence_down_min_m", "fence_down_max_m", "fence_ahead_s",
           "fence_plan_s"), 0.0, True, _fence),
    Guard("tilt", "the angle between the body's and the world's down", ("tilt_max_deg",), 0.0, True, _tilt),
    Guard("jump", "a reset of the autopilot's estimator, and all that is still blended",
          ("jump_max_m", "jump_max_deg"), 0.0, True, _jump),
    Guard("state", "attitude and position: none that is valid and young enough (`link.*_timeout_s`)",
          ("state_max_s",), "state_max_s", False, _state),
    Guard("rate", "attitude and position: part of the wanted rate", ("rate_part", "rate_s"), "rate_s", False,
          _rate),
    Guard("delay", "how old the attitude is when it is used", ("delay_max_s", "delay_s"), "delay_s", False,
          _delay),
    Guard("error", "the distance from the reference", ("error_max_m", "error_s"), "error_s", False, _error),
    Guard("speed", "the vehicle's speed", ("speed_max_m_s",), _SPEED_S, True, _speed),
    Guard("effect", "speed, rates or bank: less than a tenth of what is asked for", ("effect_s",), "effect_s",
          False, _effect),
    Guard("air", "an airplane's airspeed and wind: neither is told and believed", (), _BLIND_S, False, _air),
    Guard("late", "the control loop: how late setpoints are", ("late_max_s", "late_s"), "late_s", False,
          _late),
    Guard("battery", "SYS_STATUS, BATTERY_STATUS: charge and its state", ("battery_min_percent",),
          _BATTERY_S, True, _battery),
)  # fmt: skip


def table_markdown() -> str:
    """The table for people."""
    config = GuardsConfig()
    lines = ["| guard | watches | keys of `[guards]` | for | default action |", "|" + 5 * " --- |"]
    for guard in GUARDS:
        keys = ", ".join(f"`{key}`" for key in guard.limits) or "none"
        lasts = f"`{guard.for_s}`" if isinstance(guard.for_s, str) else f"{guard.for_s:g} s"
        lasts = lasts if guard.for_s else "at once"
        action = getattr(config, f"{guard.name}_action")
        condition = " \\*" if guard.before else ""
        lines.append(f"| `{guard.name}`{condition} | {guard.watches} | {keys} | {lasts} | {action} |")
    return "\n".join(lines) + "\n"
