"""What a subscriber asks of services: their last minutes, and orders, over a session that it has anyway.

All of it happens in the subscriber's thread, but `Histories.want` and `Orders.give`, which only leave a wish,
and zenoh's own threads, which only append.
"""

from __future__ import annotations

import uuid
from collections import deque
from collections.abc import Mapping
from typing import Any, Final

import msgspec
import zenoh

from guidance.commands import OrderError, read_payload
from guidance.records import NOT_A_RECORD
from guidance.telemetry.arrivals import VEHICLE, VEHICLES_MAX, Answered, Heard, History, Ignored, read
from guidance.telemetry.zenoh_history import KEPT_BYTES_MAX, KEPT_NS
from guidance.telemetry.zenoh_orders import AGE_PARAMETER, ANSWER_NS, Reply

#: The vehicle answers an order within this, whatever happens there; the rest is the way.
ANSWER_S: Final = ANSWER_NS * 1e-9 + 1.0
#: So long an order is given again until somebody answers; under one id, so that it is obeyed once, and with
#: its age, so that a service that began meanwhile does not obey what the one before it may have obeyed.
ASK_NS: Final = 3_000_000_000
AGAIN_NS: Final = 100_000_000
#: So many orders may be on their way at once.
ORDERS_MAX: Final = 32
#: A history takes the service one or two seconds.
HISTORY_S: Final = 8.0
_REPLIES_MAX: Final = 8192

_decode: Final = msgspec.json.Decoder(Reply).decode


def order_payload(vehicle: str, verb: str, fields: Mapping[str, Any], source: str = "") -> tuple[str, bytes]:
    """An order's id and payload; an id is made up, and `source` filled in, unless `fields` names them.

    Raises:
        ValueError: a wrong name or order, in words.
    """
    if VEHICLE.fullmatch(vehicle) is None:
        raise ValueError(f"vehicle {vehicle!r}: a name has 1 to 64 letters, digits and _.-")
    whole = {"id": uuid.uuid4().hex, "source": source, **fields}
    try:
        payload = msgspec.json.encode(whole)
        order = read_payload(verb, payload)
    except OrderError as error:
        raise ValueError(str(error)) from None
    return order.id, payload


def order_selector(vehicle: str, verb: str, age_s: float) -> str:
    """What is asked to give an order, `age_s` after it was asked for the first time."""
    return f"guidance/{vehicle}/command/{verb}?{AGE_PARAMETER}={age_s:.3f}"


class _Get:
    """One query under way. Zenoh's threads append to `replies` and set `ended`, in that order."""

    def __init__(
        self, session: zenoh.Session, selector: str, timeout_s: float, order: bytes | None = None
    ) -> None:
        self.replies: deque[zenoh.Reply] = deque(maxlen=_REPLIES_MAX)
        self.ended = False
        # The replies travel as the query does: an order's overtakes what is published, a history gives way.
        history = order is None
        session.get(
            selector,
            zenoh.handlers.Callback(self.replies.append, self._end),
            consolidation=zenoh.ConsolidationMode.NONE,
            payload=order,
            timeout=timeout_s,
            congestion_control=zenoh.CongestionControl.DROP if history else zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.DATA if history else zenoh.Priority.INTERACTIVE_HIGH,
        )

    def _end(self) -> None:
        self.ended = True


class Histories:
    """The last minutes of one vehicle after the other."""

    def __init__(self) -> None:
        self._wanted: deque[str] = deque(maxlen=VEHICLES_MAX)
        self._vehicle = ""
        self._get: _Get | None = None
        self._records: list[Heard] = []
        self._bytes = 0

    def want(self, vehicle: str) -> None:
        """Ask for those of `vehicle` when it is its turn; raises ValueError for what is no name."""
        if VEHICLE.fullmatch(vehicle) is None:
            raise ValueError(f"vehicle {vehicle!r}: a name has 1 to 64 letters, digits and _.-")
        if vehicle not in self._wanted:
            self._wanted.append(vehicle)

    def turn(self, session: zenoh.Session, now_ns: int) -> list[History | Ignored]:
        """What has come; asks for the next if nothing is under way."""
        if self._get is None:
            if self._wanted:
                self._vehicle = self._wanted.popleft()
                selector = f"guidance/{self._vehicle}/*?history={KEPT_NS // 1_000_000_000}"
                self._get = _Get(session, selector, HISTORY_S)
            return []
        ended = self._get.ended  # before the look at the replies: none is left behind
        came: list[History | Ignored] = self._read(self._get, now_ns)
        if ended:
            self._get = None
            records = tuple(sorted((heard.record for heard in self._records), key=lambda record: record.t_ns))
            came.append(History(now_ns, self._vehicle, records))
            self._records, self._bytes = [], 0
        return came

    def _read(self, get: _Get, now_ns: int) -> list[History | Ignored]:
        ignored: list[History | Ignored] = []
        while get.replies:
            sample = get.replies.popleft().ok
            if sample is None or self._bytes > 2 * KEPT_BYTES_MAX:  # more is no service of ours
                continue
            payload = sample.payload.to_bytes()
            self._bytes += len(payload)
            arrival = read(now_ns, str(sample.key_expr), str(sample.encoding), payload, answered=True)
            if isinstance(arrival, Ignored):
                ignored.append(arrival)
            else:
                self._records.append(arrival)
        return ignored

    def forget(self) -> None:
        """The session is gone: what was under way is asked for anew."""
        if self._get is not None:
            self._get = None
            self._records, self._bytes = [], 0
            self._wanted.appendleft(self._vehicle)


class _Order:
    """One order on its way; `get` is None while nobody is being asked."""

    def __init__(self, vehicle: str, verb: str, order_id: str, payload: bytes) -> None:
        self.vehicle = vehicle
        self.verb = verb
        self.id = order_id
        self.payload = payload
        self.get: _Get | None = None
        self.until_ns: int | None = None
        self.again_ns = 0

    def answered(self, now_ns: int, accepted: bool | None, reason: str) -> Answered:
        return Answered(now_ns, self.vehicle, self.verb, self.id, accepted, reason)


class Orders:
    """Orders on their way, each by itself: none waits for another's answer."""

    def __init__(self) -> None:
        self._given: deque[_Order] = deque()
        self._open: list[_Order] = []

    def give(self, vehicle: str, verb: str, fields: Mapping[str, Any], source: str = "") -> str:
        """Leave an order to be asked, and return its id.

        Raises:
            ValueError: a wrong name or order, or too many at once, in words.
        """
        if len(self._given) + len(self._open) >= ORDERS_MAX:
            raise ValueError(f"{ORDERS_MAX} orders wait for their answers already")
        order_id, payload = order_payload(vehicle, verb, fields, source)
        self._given.append(_Order(vehicle, verb, order_id, payload))
        return order_id

    def turn(self, session: zenoh.Session | None, now_ns: int, trouble: str) -> list[Answered]:
        """Ask for those that were given, again where nobody answered; the answers that have come."""
        while self._given:
            self._open.append(self._given.popleft())
        answers, left = [], []
        for order in self._open:
            answer = self._advance(order, session, now_ns, trouble)
            if answer is None:
                left.append(order)
            else:
                answers.append(answer)
        self._open = left
        return answers

    @staticmethod
    def _advance(order: _Order, session: zenoh.Session | None, now_ns: int, trouble: str) -> Answered | None:
        if order.until_ns is None:
            order.until_ns = now_ns + ASK_NS
        if order.get is not None:
            ended = order.get.ended  # before the look at the replies: none is left behind
            while order.get.replies:
                sample = order.get.replies.popleft().ok
                if sample is None:
                    continue
                try:
                    reply = _decode(sample.payload.to_bytes())
                except NOT_A_RECORD as error:
                    return order.answered(now_ns, None, f"{order.vehicle} answers something else: {error}")
                return order.answered(now_ns, reply.accepted, reply.reason)
            if not ended:
                return None
            order.get, order.again_ns = None, now_ns + AGAIN_NS
        if now_ns >= order.until_ns:
            where = trouble or "it ended, hangs, or is out of reach"
            return order.answered(now_ns, None, f"no service of {order.vehicle} answers: {where}")
        if session is not None and now_ns >= order.again_ns:
            age_s = (now_ns - order.until_ns + ASK_NS) * 1e-9
            order.get = _Get(
                session, order_selector(order.vehicle, order.verb, age_s), ANSWER_S, order.payload
            )
        return None

    def forget(self) -> None:
        """The session is gone: what was under way is asked anew."""
        for order in self._open:
            order.get = None
