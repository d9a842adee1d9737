"""The table of checks, in the order in which one thing rests on another, and what it makes of a look."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from enum import Enum
from typing import Final, NamedTuple

from guidance.preflight import companion_checks, link_checks, vehicle_checks
from guidance.preflight.findings import Finding, skip
from guidance.preflight.seen import Seen


class Needs(Enum):
    """What a check cannot do without, and what is said if it is not there."""

    NOTHING = ""
    LINE = "the line is not open"
    AUTOPILOT = "the autopilot is not heard"


class Check(NamedTuple):
    """One row: some findings of a group; skipped as `name`."""

    group: str
    name: str
    needs: Needs
    look: Callable[[Seen], Iterable[Finding]]


CHECKS: Final = (
    Check("file", "configuration", Needs.NOTHING, link_checks.configuration),
    Check("line", "port", Needs.NOTHING, link_checks.port),
    Check("line", "bytes", Needs.LINE, link_checks.bytes_seen),
    Check("line", "others heard", Needs.LINE, link_checks.senders),
    Check("autopilot", "autopilot", Needs.LINE, link_checks.autopilot),
    Check("autopilot", "signing", Needs.AUTOPILOT, link_checks.signing),
    Check("autopilot", "profile", Needs.AUTOPILOT, link_checks.profile),
    Check("autopilot", "setpoints", Needs.AUTOPILOT, link_checks.setpoints),
    Check("autopilot", "clock", Needs.AUTOPILOT, link_checks.clock),
    Check("autopilot", "loss", Needs.AUTOPILOT, link_checks.loss),
    Check("autopilot", "throughput", Needs.AUTOPILOT, link_checks.throughput),
    Check("autopilot", "one autopilot", Needs.LINE, link_checks.one_autopilot),
    Check("streams", "streams", Needs.AUTOPILOT, link_checks.streams),
    Check("vehicle", "state", Needs.AUTOPILOT, vehicle_checks.state),
    Check("vehicle", "estimator", Needs.AUTOPILOT, vehicle_checks.estimator),
    Check("vehicle", "arming", Needs.AUTOPILOT, vehicle_checks.arming),
    Check("vehicle", "mode", Needs.AUTOPILOT, vehicle_checks.mode),
    Check("vehicle", "origin", Needs.AUTOPILOT, vehicle_checks.origin),
    Check("parameters", "parameters", Needs.AUTOPILOT, vehicle_checks.parameters),
    Check("parameters", "limits", Needs.AUTOPILOT, vehicle_checks.limits),
    Check("flight", "trajectory", Needs.AUTOPILOT, vehicle_checks.trajectory),
    Check("orders", "orders", Needs.NOTHING, companion_checks.orders),
    Check("companion", "zenoh", Needs.NOTHING, companion_checks.telemetry),
    Check("companion", "log", Needs.NOTHING, companion_checks.log),
)


def findings(seen: Seen) -> list[tuple[str, Finding]]:
    """Every group and finding, in the order of the table."""
    missing = {Needs.LINE} if seen.refused or seen.port.holders else set()
    if missing or seen.observation.absent_because:
        missing.add(Needs.AUTOPILOT)
    found: list[tuple[str, Finding]] = []
    for check in CHECKS:
        if check.needs in missing:
            found.append((check.group, skip(check.name, check.needs.value)))
        else:
            found += [(check.group, one) for one in check.look(seen)]
    return found
