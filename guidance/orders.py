"""What the operator orders and the vehicle reports: obeyed or refused, and told as records.

Every order is answered (`Answer`) and told (`Event`); one whose id was answered before is answered the same
and does nothing, and another order by that id is refused. What is refused leaves everything as it was.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Final, NamedTuple

from msgspec.structs import asdict, replace

from guidance.changing import settings, with_setting, with_trajectory
from guidance.checking import ConfigError, shown
from guidance.commands import (
    Abort,
    Allocate,
    Engage,
    Hold,
    LoadTrajectory,
    Order,
    OrderError,
    Resume,
    Scalar,
    Set,
    Shutdown,
    read,
    verb_of,
)
from guidance.config import Config, profile_of
from guidance.engagement import Engagement
from guidance.mavlink.messages import NamedValueFloat
from guidance.records import Answer, Event, Level
from guidance.requests import DONE, ENGAGING
from guidance.requests import Order as Request
from guidance.supervisor import State
from guidance.tracker import Tracker
from guidance.tuning import ALLOCATIONS, cannot_allocate

#: So many answers are kept for ids that come again.
ANSWERS_KEPT: Final = 256


class _Outcome(NamedTuple):
    """What became of an order: the event's code and text; `reason` is the answer's."""

    accepted: bool
    code: str
    text: str
    reason: str


class Orders:
    """Carries out what is ordered. `config` is the effective one: what was set and loaded is in it."""

    def __init__(self, config: Config, engagement: Engagement, tracker: Tracker) -> None:
        self.config = config
        self._engagement = engagement
        self._tracker = tracker
        self._profile = profile_of(config)
        self._ending = False
        self._answers: dict[tuple[str, str], tuple[Order, Answer]] = {}

    def obey(self, text: str, now_ns: int) -> tuple[Event | None, Answer]:
        """An order as it entered the core."""
        try:
            order = read(text)
        except OrderError as error:
            answer = Answer(t_ns=now_ns, order="", id="", source="", accepted=False, reason=str(error))
            return _event(now_ns, Level.WARNING, "order_refused", str(error)), answer
        return self.carry_out(order, now_ns)

    def carry_out(self, order: Order, now_ns: int) -> tuple[Event | None, Answer]:
        """What became of it; no event if it was answered before."""
        who = (order.source, order.id)
        before = self._answers.get(who) if order.id else None
        if before is not None and before[0] == order:
            return None, _repeated(before[1], now_ns)
        if before is None:
            outcome = self._outcome(order, now_ns)
        else:  # to say "accepted" of the other one would be worse than to refuse
            used = f"id {order.id} was another order's ({verb_of(before[0])}): give each order its own"
            outcome = _refused(verb_of(order), used)
        answer = Answer(
            t_ns=now_ns,
            order=verb_of(order),
            id=order.id,
            source=order.source,
            accepted=outcome.accepted,
            reason=outcome.reason,
        )
        if order.id and before is None:
            self._answers[who] = order, answer
            if len(self._answers) > ANSWERS_KEPT:
                del self._answers[next(iter(self._answers))]
        level = Level.NOTICE if outcome.accepted else Level.WARNING
        by = f" (by {order.source})" if order.source else ""
        return _event(now_ns, level, outcome.code, outcome.text + by), answer

    def again(self, source: str, identity: str, now_ns: int) -> Answer | None:
        """What the order of this id was answered, whatever it was; None if there was none, or long ago."""
        known = self._answers.get((source, identity))
        return None if known is None else _repeated(known[1], now_ns)

    def _outcome(self, order: Order, now_ns: int) -> _Outcome:
        match order:
            case Shutdown():
                self._ending = True
                self._engagement.shutdown()
                return _Outcome(True, "shutdown", "shutting down", "")
            case Engage():
                return self._manoeuvre(Request.ENGAGE, self._engagement.engage, now_ns)
            case Hold():
                return self._manoeuvre(Request.HOLD, self._engagement.hold, now_ns)
            case Resume():
                return self._manoeuvre(Request.RESUME, self._engagement.resume, now_ns)
            case Abort():
                return self._manoeuvre(Request.ABORT, self._engagement.abort, now_ns)
            case Allocate(allocation=name):
                return _allocation(name, self._tracker)
            case LoadTrajectory(trajectory=trajectory):
                return self._load(trajectory)
            case Set(key=key, value=value):
                return self._set(key, value)

    def _manoeuvre(self, what: Request, ask: Callable[[int], str | None], now_ns: int) -> _Outcome:
        already = f"already {self._engagement.state}" if self._engagement.state in _ALREADY[what] else ""
        refused = ask(now_ns)
        if refused is not None and not (already and not self._ending):
            return _Outcome(False, f"{what}_refused", refused, refused.removeprefix(f"{what} refused: "))
        return _Outcome(True, what, f"{what} commanded{': ' if already else ''}{already}", already)

    def _load(self, trajectory: dict[str, Scalar]) -> _Outcome:
        state = self._engagement.state
        if state not in _LOADABLE:
            why = f"a trajectory is loaded only while the service has no control, and it is {state}"
            return _refused("load", why)
        try:
            config = with_trajectory(self.config, trajectory)
        except ConfigError as error:
            return _refused("load", str(error))
        new = config.trajectory
        name = new.__struct_config__.tag
        if config == self.config:
            return _Outcome(True, "load", f"trajectory {name}: already loaded", "already loaded")
        refused = self._tracker.reconfigure(config)
        if refused is not None:
            return _refused("load", refused)
        self.config = config
        keys = ", ".join(f"{key} = {shown(value)}" for key, value in asdict(new).items())
        return _Outcome(True, "load", f"trajectory loaded: {name}, {keys}", "")

    def _set(self, key: str, value: Scalar) -> _Outcome:
        try:
            config = with_setting(self.config, key, value)
        except ConfigError as error:
            return _refused("set", str(error))
        name, planar = self._tracker.allocation, self._profile.planar
        without = cannot_allocate(name, config.limits, planar)
        if without is not None:  # it may be another one than the configuration's
            return _refused("set", f"limits.{without[0]} = {without[1]:g} leaves {name} without that rate")
        if config == self.config:
            already = f"{key} = {_said(value)} already"
            return _Outcome(True, "set", already, already)
        change = f"{key}: {_said(settings(self.config)[key])} -> {_said(settings(config)[key])}"
        refused = self._tracker.reconfigure(config)
        if refused is not None:
            return _refused("set", refused)
        self.config = config
        return _Outcome(True, "set", change, change)


def reported(value: NamedValueFloat, tracker: Tracker, counters: Counter[str], now_ns: int) -> Event | None:
    """The vehicle reports which rates it has left: NAMED_VALUE_FLOAT "ALLOC", 0, 1 or 2."""
    if value.name.rstrip(b"\0") != b"ALLOC":
        return None
    name = next((name for name, number in ALLOCATIONS.items() if number == value.value), None)
    if name is None:
        counters["NAMED_VALUE_FLOAT:unknown_allocation"] += 1
        return None
    known, tracker.reported_allocation = tracker.reported_allocation, name
    if name in (known, tracker.allocation):
        return None
    outcome = _allocation(name, tracker)
    level = Level.NOTICE if outcome.accepted else Level.WARNING
    return _event(now_ns, level, outcome.code, outcome.text)


#: Where an order is nothing new.
_ALREADY: Final = DONE | {Request.ENGAGE: ENGAGING | {State.TRACKING}}
#: Where nobody follows a trajectory, nor has begun to: the reference never jumps under a vehicle.
_LOADABLE: Final = (
    State.DISCONNECTED,
    State.CONNECTED,
    State.WITHHELD,
    State.READY,
    State.HANDED_OVER,
    State.ABORTED,
)


def _refused(verb: str, why: str) -> _Outcome:
    return _Outcome(False, f"{verb}_refused", f"{verb} refused: {why}", why)


def _allocation(name: str, tracker: Tracker) -> _Outcome:
    """An actuator failed, or works again: turn with these from the next setpoint on."""
    refused = tracker.allocate(name)
    if refused is None:
        return _Outcome(True, "allocated", f"turning by {name}", "")
    return _Outcome(False, "allocation_refused", f"{name} refused: {refused}", refused)


def _repeated(answer: Answer, now_ns: int) -> Answer:
    return replace(answer, t_ns=now_ns, repeated=True)


def _said(value: Scalar) -> str:
    return "no limit" if value is None else shown(value)


def _event(now_ns: int, level: Level, code: str, text: str) -> Event:
    return Event(t_ns=now_ns, level=level, code=code, text=text)
