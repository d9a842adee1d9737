"""Orders that come as zenoh queries: `guidance/<vehicle>/command/<verb>`, a JSON object as payload.

Everything here runs in the sink's own thread. A query is read, handed over to the control loop without
waiting, and kept; it is answered when the loop's `Answer` comes by like any other record. Each is answered:
with {"accepted": ..., "reason": ..., "id": ..., "repeated": ...}, at the latest when its time is over. The
loop does not obey an order that it gets too late, so that "not answered" never means "obeyed later". Nor is
one obeyed that may have waited here while all of us stood still (SIGSTOP, a stuck call): who asked gave up.

`?age=2.5` says that the order was first asked for 2.5 s ago. One from before the service began may have been
obeyed by the one before it, whose memory of ids is gone: only what stops the vehicle is obeyed then.

The key must be written out: a query for `guidance/*/command/engage` orders nothing.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable
from typing import Final, NamedTuple

import msgspec
import zenoh
from msgspec.structs import replace

from guidance.commands import PAYLOAD_BYTES_MAX, VERBS, Abort, Hold, Order, OrderError, read_payload
from guidance.printable import printable
from guidance.records import Answer

#: Takes an order, and until when (ns) it may be obeyed; called in the sink's thread, returns at once.
HandOver = Callable[[Order, int], object]

#: The loop has so long to take an order. It takes one within a few ms, or something is badly wrong.
OBEY_NS: Final = 1_000_000_000
#: Then its answer has so long to come round.
ANSWER_NS: Final = 2_000_000_000
#: So many orders may wait at once.
WAITING_MAX: Final = 32
#: Who comes round so late finds queries that may be as old; so long after that, some may still come in.
HELD_UP_NS: Final = 1_000_000_000
SETTLED_NS: Final = 500_000_000
#: Parameter of the query: s since the order was asked for the first time.
AGE_PARAMETER: Final = "age"
_SOURCE_CHARACTERS: Final = 80


class Reply(msgspec.Struct, frozen=True, kw_only=True):
    """What the query is answered with."""

    accepted: bool
    reason: str
    id: str = ""
    repeated: bool = False


class _Waiting(NamedTuple):
    query: zenoh.Query
    source: str
    id: str
    until_ns: int


class OrderQueries:
    """The orders that wait for their answers. `root` is the part of the key before the verb."""

    def __init__(self, root: str, *, enabled: bool, clock_ns: Callable[[], int]) -> None:
        self.hand_over: HandOver | None = None
        self._root = root
        self._enabled = enabled
        self._clock_ns = clock_ns
        self._waiting: list[_Waiting] = []
        self._began_ns = self._round_ns = self._settled_ns = clock_ns()
        self._encode = msgspec.json.Encoder().encode
        self._decode = msgspec.json.Decoder(Answer).decode

    def opened(self) -> None:
        """A session was opened: no query is older."""
        self._round_ns = self._clock_ns()

    def come_round(self) -> None:
        """To be called before the queries that wait are taken, again and again."""
        before_ns, self._round_ns = self._round_ns, self._clock_ns()
        if self._round_ns - before_ns >= HELD_UP_NS:
            self._settled_ns = self._round_ns + SETTLED_NS

    def take(self, query: zenoh.Query) -> bool:
        """Whether the query is an order; if so it is handed over, or answered with why not."""
        key = str(query.key_expr)
        if not key.startswith(self._root):
            return False
        refused = self._take(query, key.removeprefix(self._root))
        if refused is not None:
            self._reply(query, Reply(accepted=False, reason=refused))
        return True

    def _take(self, query: zenoh.Query, verb: str) -> str | None:
        if not self._enabled or self.hand_over is None:
            return "orders by zenoh are off (zenoh.commands = false in the vehicle's configuration)"
        if "*" in verb or "$" in verb:
            return f"name one order: {', '.join(VERBS)}"
        if query.payload is not None and len(query.payload) > PAYLOAD_BYTES_MAX:  # before it is copied
            return f"{len(query.payload)} bytes: an order has at most {PAYLOAD_BYTES_MAX}"
        if len(self._waiting) >= WAITING_MAX:
            return f"{WAITING_MAX} orders wait already"
        try:
            order = read_payload(verb, b"" if query.payload is None else query.payload.to_bytes())
        except OrderError as error:
            return str(error)
        now_ns = self._clock_ns()
        if not isinstance(order, Hold | Abort):  # these are safe late
            if now_ns < self._settled_ns:
                return "the service was held up, and this may be an old order: order again"
            if _age_ns(query) > now_ns - self._began_ns:
                return "it was ordered before this service began: look at the state, then order again"
        source = f"zenoh {printable(order.source)}"[:_SOURCE_CHARACTERS].strip()
        order = replace(order, id=order.id or uuid.uuid4().hex, source=source)
        self._waiting.append(_Waiting(query, source, order.id, now_ns + ANSWER_NS))
        self.hand_over(order, now_ns + OBEY_NS)
        return None

    def answered(self, payload: bytes) -> None:
        """An `Answer` of the core came by: to an order of ours, or of somebody else."""
        answer = self._decode(payload)
        for waiting in list(self._waiting):
            if (waiting.source, waiting.id) == (answer.source, answer.id):
                self._waiting.remove(waiting)
                self._reply(
                    waiting.query,
                    Reply(
                        accepted=answer.accepted,
                        reason=answer.reason,
                        id=answer.id,
                        repeated=answer.repeated,
                    ),
                )
                return  # one answer to each

    def expire(self) -> None:
        """Answer those whose time is over."""
        now_ns = self._clock_ns()
        while self._waiting and self._waiting[0].until_ns <= now_ns:
            late = self._waiting.pop(0)
            seconds = ANSWER_NS * 1e-9
            why = f"the control loop did not answer within {seconds:g} s; look at its events"
            self._reply(late.query, Reply(accepted=False, reason=why, id=late.id))

    def finish(self) -> None:
        """The service ends."""
        while self._waiting:
            left = self._waiting.pop(0)
            self._reply(left.query, Reply(accepted=False, reason="the service ends", id=left.id))

    def forget(self) -> None:
        """The session is gone, and who asked with it."""
        self._waiting.clear()

    def _reply(self, query: zenoh.Query, reply: Reply) -> None:
        with query:
            key = str(query.key_expr)
            query.reply(key, self._encode(reply), encoding=zenoh.Encoding.APPLICATION_JSON)


def _age_ns(query: zenoh.Query) -> float:
    """As the query says; 0 if it says nothing that is a time."""
    try:
        age_s = float(query.parameters.get(AGE_PARAMETER) or 0.0)
    except ValueError:
        return 0.0
    return age_s * 1e9
