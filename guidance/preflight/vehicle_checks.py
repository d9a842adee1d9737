"""The checks of the vehicle: its state, its parameters, whether it may arm, and where it would fly."""

from __future__ import annotations

import math
from collections.abc import Iterator
from operator import attrgetter
from typing import Final

from pymavlink.dialects.v20 import all as dialect

from guidance.config import Config
from guidance.mavlink.report import enum_name
from guidance.mavlink.requirements import Bound, Requirement
from guidance.preflight.findings import Finding, Verdict, fail, ok, skip, warn
from guidance.preflight.seen import Seen

#: An exact value may differ by this part, for the float32 that it was kept in.
SAME: Final = 1e-3

_PREARM: Final = dialect.MAV_SYS_STATUS_PREARM_CHECK
_POSITION: Final = dialect.ESTIMATOR_POS_HORIZ_REL | dialect.ESTIMATOR_POS_HORIZ_ABS
_NEEDED: Final = {
    dialect.ESTIMATOR_ATTITUDE: "attitude",
    dialect.ESTIMATOR_VELOCITY_HORIZ: "velocity",
    _POSITION: "position",
}
_BAD_STATES: Final = (
    dialect.MAV_STATE_CRITICAL,
    dialect.MAV_STATE_EMERGENCY,
    dialect.MAV_STATE_POWEROFF,
    dialect.MAV_STATE_FLIGHT_TERMINATION,
)
_TO_ESTIMATOR: Final = "wait for the estimator; has it a source of position (GPS, beacons, a camera)?"


def state(seen: Seen) -> Iterator[Finding]:
    """Attitude and position come, are valid and young."""
    estimate = seen.observation.estimate()
    if isinstance(estimate, str):
        yield fail("state", estimate, _TO_ESTIMATOR)
        return
    x, y, z = estimate.pose.position
    sources = dict.fromkeys((estimate.attitude.source, estimate.position.source))
    yield ok("state", f"({x:.1f}, {y:.1f}, {z:.1f}) m NED; {', '.join(sources)}")


def estimator(seen: Seen) -> Iterator[Finding]:
    """What the estimator says of itself."""
    flags, name = seen.observation.estimator_flags, seen.observation.profile.estimator
    if flags is None:
        yield skip("estimator", f"{name} does not come")
        return
    missing = [words for bits, words in _NEEDED.items() if not flags & bits]
    if flags & dialect.ESTIMATOR_CONST_POS_MODE:
        missing.append("anything but a constant position")
    if missing:
        yield fail("estimator", f"without {', '.join(missing)} ({name} {flags:#x})", _TO_ESTIMATOR)
    else:
        yield ok("estimator", "attitude, velocity and position are good")


def arming(seen: Seen) -> Iterator[Finding]:
    """Whether the autopilot would arm."""
    observation = seen.observation
    link, health = observation.link, observation.health
    assert link.heartbeat is not None
    status = enum_name("MAV_STATE", link.heartbeat.system_status).removeprefix("MAV_STATE_").lower()
    texts = "; ".join(observation.texts)
    why = f"the autopilot says: {texts}" if texts else "a ground station shows what it complains of"
    if link.heartbeat.system_status in _BAD_STATES:
        yield fail("arming", f"the autopilot is in state {status}", why)
    elif link.armed:
        yield ok("arming", f"armed, {status}")
    elif health is None:
        yield skip("arming", "SYS_STATUS does not come")
    elif health.onboard_control_sensors_health & _PREARM:
        yield ok("arming", f"its checks pass, {status}")
    elif not _tells_prearm(seen):
        yield skip("arming", "this firmware does not say whether it would arm")
    else:
        yield fail("arming", f"its pre-arm checks do not pass, {status}", why)


def _tells_prearm(seen: Seen) -> bool:
    """ArduPilot enables the bit where it knows it; PX4 knows it and does not enable it (recorded)."""
    health, profile = seen.observation.health, seen.observation.profile
    assert health is not None
    enabled = health.onboard_control_sensors_enabled | health.onboard_control_sensors_present
    return bool(enabled & _PREARM) or profile.autopilot == dialect.MAV_AUTOPILOT_PX4


def mode(seen: Seen) -> Iterator[Finding]:
    """The mode; armed in the control mode, the service would leave the vehicle alone."""
    link, profile = seen.observation.link, seen.observation.profile
    assert link.custom_mode is not None
    control = profile.control_mode
    name = profile.mode_name(link.custom_mode)
    if link.armed and control.custom_mode in (link.custom_mode, link.intended_mode):
        found = f"{name}, armed, and {control.name} is on or intended: the service would leave it alone"
        yield warn("mode", found, "switch to another mode first, or disarm")
    else:
        yield ok("mode", f"{name}, {'armed' if link.armed else 'disarmed'}")


def parameters(seen: Seen) -> Iterator[Finding]:
    """Each that the profile depends on."""
    for requirement in seen.observation.profile.requirements:
        yield judged(requirement, seen)


def judged(requirement: Requirement, seen: Seen) -> Finding:
    """One parameter against what is needed."""
    reader = seen.observation.parameters
    name = requirement.parameter
    if name not in reader.values and requirement.older in reader.values:
        name = requirement.older
    value = reader.values.get(name)
    if value is None:
        if not reader.complete:
            return skip(name, "was not answered in time")
        older = f", and no {requirement.older}" if requirement.older else ""
        return skip(name, f"the autopilot has no such parameter{older}")
    if not math.isfinite(value):
        return fail(name, f"{value:g} is no value", f"set {name} anew: the memory of it is damaged")
    shown = f"{value:g} {requirement.unit}".rstrip()
    if requirement.meanings:
        meaning = requirement.meanings.get(round(value))
        if meaning is None:
            todo = f"look it up in the firmware's own list: {requirement.why}"
            return warn(name, f"{shown}: a meaning that is not known here", todo)
        shown = f"{shown}: {meaning}"
        doubtful = round(value) in requirement.doubtful
        return warn(name, shown, requirement.why) if doubtful else ok(name, shown)
    if value == 0.0 and requirement.zero_is_no_limit:
        return ok(name, "no limit")
    problem = _out_of_bounds(requirement, value, seen.config)
    if problem is None:
        return ok(name, shown)
    verdict = Verdict.FAIL if requirement.serious else Verdict.WARN
    return Finding(name, verdict, f"{shown}, needs {problem[0]}", f"{problem[1]}: {requirement.why}")


def _out_of_bounds(requirement: Requirement, value: float, config: Config) -> tuple[str, str] | None:
    """What it should be, and how to get there; None if it is."""
    low, high = _number(requirement.low, config), _number(requirement.high, config)
    scaled = value * requirement.scale
    too_low = low is not None and scaled < low * (1.0 - SAME)
    too_high = high is not None and scaled > high * (1.0 + SAME)
    if not too_low and not too_high:
        return None
    bound, key = (low, requirement.low) if too_low else (high, requirement.high)
    assert bound is not None
    wanted = f"{bound / requirement.scale:g}"
    least = "" if low == high else "at least " if too_low else "at most "
    todo = f"set {requirement.parameter} to {least}{wanted}"
    if isinstance(key, str):
        return f"{least}{wanted} for {key} = {bound:g}", f"{todo}, or {key} = {scaled:g}"
    return f"{least}{wanted}", todo


def _number(bound: Bound | None, config: Config) -> float | None:
    """A key that is not set sets no bound."""
    return attrgetter(bound)(config) if isinstance(bound, str) else bound


def origin(seen: Seen) -> Iterator[Finding]:
    """The trajectory's place is known, and the vehicle is near its start."""
    observation = seen.observation
    estimate, found = observation.estimate(), observation.origin()
    if isinstance(estimate, str):
        yield skip("origin", estimate)
        return
    if isinstance(found, str):
        todo = 'wait for the estimator, set it in a ground station, or fly from flight.origin = "engage"'
        yield fail("origin", found, todo)
        return
    yield ok("origin", f"({found.x:.1f}, {found.y:.1f}, {found.z:.1f}) m NED: {seen.config.flight.origin}")
    error_m = observation.tracker.start_error_m(estimate.pose.position, found)
    limit_m = seen.config.supervisor.engage_max_error_m
    distance = f"{error_m:.1f} m away, engages within {limit_m:g} m"
    if error_m > limit_m:
        yield warn("start", distance, "go closer before you engage, or raise supervisor.engage_max_error_m")
    else:
        yield ok("start", distance)
