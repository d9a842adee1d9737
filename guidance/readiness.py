"""What must hold before the service may fly, in the order in which an operator would look for it."""

from __future__ import annotations

from typing import Final

from pymavlink.dialects.v20 import all as dialect

from guidance.condition import Condition
from guidance.config import Config, Link
from guidance.connection import Connection
from guidance.estimate import ATTITUDES, POSITIONS, Estimate
from guidance.mavlink.link import AutopilotLink
from guidance.mavlink.profiles import Profile, fitting
from guidance.records import StreamStatus
from guidance.se3 import norm
from guidance.tracker import Tracker
from guidance.view import STALLED_S

#: Slower than this it stands; an estimator's noise is less.
STANDS_M_S: Final = 0.5


def young(estimate: Estimate | None, config: Link, now_ns: int) -> Estimate | str:
    """The estimate if attitude and position are younger than their time-outs, else why it must not be used.

    They are as old as they are now: that the setpoint acts later makes them no older.
    """
    if estimate is None:
        return "no attitude or no position yet"
    attitude_age_s = (now_ns - estimate.attitude.instant_ns) * 1e-9
    position_age_s = (now_ns - estimate.position.instant_ns) * 1e-9
    if attitude_age_s > config.attitude_timeout_s:
        return f"the attitude is {attitude_age_s:.2f} s old"
    if position_age_s > config.position_timeout_s:
        return f"the position is {position_age_s:.2f} s old"
    return estimate


def stalled(connection: Connection, unanswered_s: float | None) -> str | None:
    """Why a setpoint would wait in a buffer, to be obeyed late; None if it would not, or nobody knows yet.

    `unanswered_s` is the age of the newest packet of ours that was answered, None before the first.
    """
    if not connection.reliable or unanswered_s is None or unanswered_s <= STALLED_S:
        return None
    return f"the other end has not answered for {unanswered_s:.2f} s: not reading?"


def first_unmet(
    config: Config,
    profile: Profile,
    link: AutopilotLink,
    tracker: Tracker,
    condition: Condition,
    estimate: Estimate | str,
    now_ns: int,
    engaging: bool,
    parameters: str | None = None,
) -> str | None:
    """The first condition that is not met, in words that say what to do; None if the service may fly.

    `parameters` is what those of the autopilot forbid. Once `engaging`, neither they nor a stream below its
    rate nor a refused sample block anything as long as the state is young.
    """
    beat = link.heartbeat
    if beat is None:
        return "no heartbeat of the autopilot yet"
    if not profile.fits(beat):
        needed = " or ".join(fitting(beat))
        return (
            f"{_enum_name('MAV_AUTOPILOT', beat.autopilot)} {_enum_name('MAV_TYPE', beat.type)} "
            f"is not what vehicle.profile {profile.name} is for: "
            + (f"this vehicle needs {needed}" if needed else "there is no profile for this vehicle")
        )
    if not link.clock.synced(now_ns):
        return "the autopilot's clock is not known: waiting for its TIMESYNC answers"
    if not engaging:
        for alternatives in (ATTITUDES, POSITIONS):
            wanted = [stream.status(now_ns) for stream in map(link.streams.get, alternatives) if stream]
            verdict = _none_usable(wanted)
            if verdict is not None:
                return verdict
        if condition.no_position is not None:
            return condition.no_position
        if parameters is not None:
            return parameters
        grounded = condition.not_flying(profile, beat)
        if grounded is not None:
            return grounded
    if isinstance(estimate, str):
        return estimate
    position = estimate.pose.position
    origin = tracker.find_origin(position, link.origin, link.home)
    if isinstance(origin, str):
        return origin
    if tracker.start_ns is None:
        error_m = tracker.start_error_m(position, origin)
        limit_m = config.supervisor.engage_max_error_m
        # an airplane's steps are flown from wherever it is, and held ones, too
        if error_m > limit_m and config.excitation.way != "flies":
            place = "the start" if tracker.paused_s is None else "where the flight was held"
            return f"{error_m:.1f} m from {place}, engage_max_error_m is {limit_m:g}: go closer"
        speed_m_s = norm(estimate.velocity_ned_m_s)
        if config.excitation.runs and config.excitation.way != "flies" and speed_m_s > STANDS_M_S:
            return f"it moves at {speed_m_s:.1f} m/s, and steps begin at rest: let it stand"
        if not engaging:
            for name, _ in profile.air[:1]:
                stream = link.streams.get(name)
                if stream is None or not stream.status(now_ns).alive:
                    return f"no {name}: an airplane is not flown without its airspeed"
            return tracker.unmet(estimate, link.origin, link.home)
    return None


def _enum_name(enum: str, value: int) -> str:
    entry = dialect.enums[enum].get(value)
    return f"{enum} {value}" if entry is None else str(entry.name)


def _none_usable(alternatives: list[StreamStatus]) -> str | None:
    """Why none of the messages, best first, can be used; None if one can."""
    names = [status.message for status in alternatives]
    listed = f"{', '.join(names[:-1])} or {names[-1]}"
    alive = [status for status in alternatives if status.alive]
    if not alive:
        return f"no {listed}: is the estimator ready?"
    valid = [status for status in alive if status.valid]
    if not valid:
        return f"no usable {listed}: is the estimator ready? The link's counters say more"
    if any(status.at_rate for status in valid):
        return None
    return f"{valid[0].message} comes at {valid[0].rate_hz:.0f} of {valid[0].wanted_hz:.0f} Hz"
