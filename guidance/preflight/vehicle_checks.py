"""The checks of the vehicle: its state, its parameters, whether it may arm, and where it would fly."""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees, isfinite
from typing import Final

from pymavlink.dialects.v20 import all as dialect

from guidance.abilities import NEEDS, Bound
from guidance.cautions import about_sticks, about_stopping
from guidance.mavlink import requirements
from guidance.mavlink.report import enum_name
from guidance.mavlink.requirements import Grade, Requirement
from guidance.preflight.findings import Finding, Verdict, fail, ok, skip, warn
from guidance.preflight.seen import Seen

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
_VERDICTS: Final = {
    Grade.GOOD: Verdict.OK,
    Grade.DOUBTFUL: Verdict.WARN,
    Grade.BAD: Verdict.FAIL,
    Grade.ABSENT: Verdict.SKIP,
}
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
    if flags & dialect.ESTIMATOR_CONST_POS_MODE and not _rests(name, flags):
        missing.append("anything but a constant position")
    if missing:
        yield fail("estimator", f"without {', '.join(missing)} ({name} {flags:#x})", _TO_ESTIMATOR)
    else:
        yield ok("estimator", "attitude, velocity and position are good")


def _rests(name: str, flags: int) -> bool:
    """Whether this is PX4 that merely stands: EKF2 calls it constant in position, and has its sources."""
    return name == "ESTIMATOR_STATUS" and bool(flags & dialect.ESTIMATOR_PRED_POS_HORIZ_REL)


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
    """Each that the profile depends on, and what all of them together allow."""
    observation = seen.observation
    table, reader = observation.profile.requirements, observation.parameters
    for row in table:
        found = judged(row, seen)
        if found.verdict is not Verdict.OK or not row.quiet:
            yield found
    for caution in (
        *about_sticks(observation.profile, reader.values, observation.health),
        *about_stopping(observation.profile, reader.values, observation.link.version),
    ):
        yield warn(caution.about, caution.text, "fly all the same if that is meant")
    unfit = observation.unfit() if reader.complete else None
    if unfit is not None:
        yield fail("parameters", unfit, "fly slower and wider, or set the parameter higher")


def limits(seen: Seen) -> Iterator[Finding]:
    """What configuration and autopilot leave the vehicle together, and which of them binds."""
    observation = seen.observation
    if not observation.parameters.complete:
        yield skip("limits", "the parameters did not all come")
        return
    observation.unfit()
    able = observation.tracker.handler.abilities()
    if able is None:
        yield skip("limits", "with these parameters it is not known what the vehicle can do")
        return
    for kind, bound in zip(NEEDS[type(able)].kinds, able, strict=False):
        if isinstance(bound, Bound) and isfinite(bound.value):
            unit, value = kind.unit, bound.value
            shown = degrees(value) if unit.startswith("deg") else value
            least = "at least " if kind.is_least else ""
            yield ok(kind.what, f"{least}{shown:.4g} {unit}".rstrip() + f" ({bound.source})")


def trajectory(seen: Seen) -> Iterator[Finding]:
    """Whether it would be flown from here: by what flies, by the guards, and what else is to be known."""
    observation = seen.observation
    estimate, origin = observation.estimate(), observation.origin()
    if isinstance(estimate, str) or isinstance(origin, str):
        yield skip("trajectory", "it is not known from where")
        return
    if not observation.parameters.complete or observation.unfit() is not None:
        yield skip("trajectory", "see the parameters")
        return
    link, tracker, guards = observation.link, observation.tracker, seen.config.guards
    name = seen.config.trajectory.__struct_config__.tag
    why = tracker.unmet(estimate, link.origin, link.home)
    if why is None:
        yield ok("trajectory", f"{name}: can be flown from here")
    else:
        yield warn("trajectory", f"{name}: would not be begun now: {why}", "see to that before you engage")
    forbidden = observation.guarded(estimate)
    fenced = guards.fence_ned_m or guards.fence_deg or guards.fence_down_min_m is not None
    if forbidden is not None:
        yield fail("guards", forbidden, "see [guards]; the service would not engage")
    elif fenced or guards.fence_down_max_m is not None:
        yield ok("fence", f"the vehicle is inside, and so are {guards.fence_plan_s:g} s of the way from here")
    else:
        yield warn("fence", "none is set", "set guards.fence_deg; where there is no GPS, guards.fence_ned_m")
    for caution in tracker.cautions(estimate, link.origin, link.home):
        yield warn(caution.about, caution.text, "fly all the same if that is meant")


def judged(row: Requirement, seen: Seen) -> Finding:
    """One parameter against what is needed."""
    reader = seen.observation.parameters
    if row.value(reader.values) is None and not reader.complete:
        return skip(row.parameter, "was not answered in time")
    name, grade, found, todo = requirements.judged(row, reader.values, seen.config)
    return Finding(name, _VERDICTS[grade], found, todo)


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
