"""What a page may ask for, and what it is told of it."""

from __future__ import annotations

from typing import Any, Final

import msgspec

from guidance.telemetry.arrivals import Answered

#: The orders that have a button.
VERBS: Final = ("engage", "hold", "resume", "abort", "load")
#: Those that move a vehicle must be fresh; what stops it is welcome late too.
MOVING: Final = frozenset({"engage", "resume", "load"})
#: A page that heard nothing for longer sends no order; more is time that the order lay on the way.
LATE_S: Final = 4.0
OFF: Final = "orders are off here: start the dashboard with --commands"


class See(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="see"):
    """Show this vehicle."""

    vehicle: str


class Order(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="ask", tag="order"):
    """Give an order.

    `number` is the page's, and comes back with the answer; `as_of_s` is the server's clock as the page last
    heard it: what TCP delivers when a network comes back was clicked long ago.
    """

    vehicle: str
    verb: str
    number: int
    as_of_s: float
    fields: dict[str, Any] = {}


_decoder: Final[msgspec.json.Decoder[See | Order]] = msgspec.json.Decoder(See | Order)
_encode: Final = msgspec.json.Encoder().encode


def read(text: str | bytes) -> See | Order | None:
    """What a page asked, None if that is nothing a page of ours asks."""
    try:
        return _decoder.decode(text)
    except (ValueError, RecursionError):  # msgspec's own are ValueErrors
        return None


def answer(order: Order, accepted: bool | None, reason: str) -> bytes:
    """What became of it; None is that nobody knows."""
    return _encode(
        {
            "kind": "answer",
            "number": order.number,
            "vehicle": order.vehicle,
            "verb": order.verb,
            "accepted": accepted,
            "reason": reason,
        }
    )


def answered(order: Order, came: Answered) -> bytes:
    """The vehicle's answer, or that there was none."""
    return answer(order, came.accepted, came.reason)
