"""What the operator asks of a flight: taken, taken as done already, or refused in words.

A request that cannot be obeyed at once (a condition is not met) waits, and is given up after a time. It never
acts twice: every change of state but those before engaging ends it. To hold and to abort takes back what
waits, even where there is nothing else to do; nothing takes back an abort.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Final

from guidance.supervisor import State


class Order(StrEnum):
    """What can be asked."""

    ENGAGE = "engage"
    HOLD = "hold"
    RESUME = "resume"
    ABORT = "abort"


ENGAGING: Final = frozenset({State.STREAMING, State.SWITCHING, State.ARMING})
#: Where each has something to do.
OBEYED: Final[dict[Order, frozenset[State]]] = {
    Order.ENGAGE: frozenset({State.CONNECTED, State.WITHHELD, State.READY, State.HANDED_OVER, State.ABORTED}),
    Order.HOLD: frozenset({State.TRACKING}),
    Order.RESUME: frozenset({State.HOLDING}),
    Order.ABORT: ENGAGING | {State.CONNECTED, State.READY, State.TRACKING, State.PAUSING, State.HOLDING},
}
#: Where it is as asked already.
DONE: Final[dict[Order, frozenset[State]]] = {
    Order.ENGAGE: frozenset(),
    Order.HOLD: frozenset({State.PAUSING, State.HOLDING}),
    Order.RESUME: ENGAGING | {State.TRACKING},
    Order.ABORT: frozenset({State.CANCELLING, State.ABORTING, State.ABORTED}),
}
_REFUSED: Final = {
    Order.ENGAGE: "it has not ended: resume, or abort first",
    Order.HOLD: "not tracking",
    Order.RESUME: "nothing is held",
    Order.ABORT: "the service has no control",
}


class Requests:
    """The newest request that waits."""

    def __init__(self, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        self._order: Order | None = None
        self._until_ns = 0

    def ask(self, order: Order, state: State, reason: str, now_ns: int) -> str | None:
        """It is asked in `state`; why that is refused, None if it is not."""
        if order is Order.ENGAGE and (state in ENGAGING or state is State.TRACKING):
            return f"engage ignored: already {state}"
        waiting = self._order if now_ns < self._until_ns else None
        if waiting is Order.ABORT and order is not Order.ABORT:
            return f"{order} refused: {state}: an abort was ordered"
        takes_back = order is Order.ABORT and waiting is Order.ENGAGE
        if state not in OBEYED[order] | DONE[order] and not takes_back:
            why = reason if state is State.DISCONNECTED else _REFUSED[order]
            return f"{order} refused: {state}: {why}"
        if order in (Order.HOLD, Order.ABORT):
            self._order = None
        if state in OBEYED[order]:
            self._order, self._until_ns = order, now_ns + round(self._timeout_s * 1e9)
        return None

    def waits(self, order: Order, now_ns: int) -> bool:
        """Whether it was asked, and is young."""
        return self._order is order and now_ns < self._until_ns

    def forget(self) -> None:
        """Obeyed, or overtaken."""
        self._order = None

    def expired(self, reason: str, now_ns: int) -> str | None:
        """Says once that a request was given up, and why."""
        if self._order is None or now_ns < self._until_ns:
            return None
        given_up, self._order = self._order, None
        return f"{given_up} given up after {self._timeout_s:g} s: {reason}"
