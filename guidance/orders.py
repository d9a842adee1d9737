"""What the operator commands and the vehicle reports: obeyed or refused, and told as an event."""

from __future__ import annotations

from collections import Counter

from guidance.engagement import Engagement
from guidance.mavlink.messages import NamedValueFloat
from guidance.records import Command, Event, Level
from guidance.tracker import Tracker
from guidance.tuning import ALLOCATIONS


def obey(command: Command, engagement: Engagement, tracker: Tracker, now_ns: int) -> Event:
    """An operator's command; the event says what became of it."""
    if command is Command.SHUTDOWN:
        engagement.shutdown()
        return Event(t_ns=now_ns, level=Level.NOTICE, code="shutdown", text="shutting down")
    if command is not Command.ENGAGE:
        return _allocate(command.removeprefix("allocate-"), tracker, now_ns)
    refused = engagement.engage(now_ns)
    if refused is None:
        return Event(t_ns=now_ns, level=Level.NOTICE, code="engage", text="engage commanded")
    return Event(t_ns=now_ns, level=Level.WARNING, code="engage_refused", text=refused)


def reported(value: NamedValueFloat, tracker: Tracker, counters: Counter[str], now_ns: int) -> Event | None:
    """The vehicle reports which rates it has left: NAMED_VALUE_FLOAT "ALLOC", 0, 1 or 2."""
    if value.name.rstrip(b"\0") != b"ALLOC":
        return None
    name = next((name for name, number in ALLOCATIONS.items() if number == value.value), None)
    if name is None:
        counters["NAMED_VALUE_FLOAT:unknown_allocation"] += 1
        return None
    known, tracker.reported_allocation = tracker.reported_allocation, name
    return None if name in (known, tracker.allocation) else _allocate(name, tracker, now_ns)


def _allocate(name: str, tracker: Tracker, now_ns: int) -> Event:
    """An actuator failed, or works again: turn with these from the next setpoint on."""
    refused = tracker.allocate(name)
    if refused is None:
        return Event(t_ns=now_ns, level=Level.NOTICE, code="allocated", text=f"turning by {name}")
    why = f"{name} refused: {refused}"
    return Event(t_ns=now_ns, level=Level.WARNING, code="allocation_refused", text=why)
