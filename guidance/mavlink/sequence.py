"""Sequence numbers of one sender: what was lost, what came twice, what was overtaken on the way."""

from __future__ import annotations

from enum import Enum
from typing import Final, NamedTuple

#: After this long without a frame a sequence number says nothing about order.
MEMORY_NS: Final = 200_000_000
#: So many frames running that are not new mean that the sender's counter started again.
RESTART_AFTER: Final = 64

_HALF: Final = 128
_MASK: Final = (1 << _HALF) - 1


class Order(Enum):
    """How a frame stands to those before it."""

    NEW = "new"
    LATE = "late"
    DUPLICATE = "duplicate"


class Place(NamedTuple):
    """A frame's order, and its number on a count that does not wrap."""

    order: Order
    number: int


class SequenceWatch:
    """Follows MAVLink's 8-bit sequence number. `lost` counts numbers that never came."""

    def __init__(self) -> None:
        self.lost = 0
        self._newest: int | None = None
        self._newest_ns = 0
        self._seen = 0  # bit i: number `newest - i` came
        self._missed = 0  # bit i: number `newest - i` was counted as lost
        self._not_new = 0

    @property
    def newest(self) -> int | None:
        """The newest number, on the count that does not wrap."""
        return self._newest

    def place(self, sequence: int, now_ns: int) -> Place:
        """Where the frame with this sequence number belongs."""
        if self._newest is None:
            return self._restart(sequence, now_ns)
        if now_ns - self._newest_ns > MEMORY_NS:
            return self._restart(self._newest + 1 + (sequence - self._newest - 1) % 256, now_ns)
        ahead = (sequence - self._newest) % 256
        if 0 < ahead < _HALF:
            self.lost += ahead - 1
            self._newest += ahead
            self._seen = (self._seen << ahead | 1) & _MASK
            self._missed = (self._missed << ahead | (1 << ahead) - 2) & _MASK
            self._newest_ns = now_ns
            self._not_new = 0
            return Place(Order.NEW, self._newest)
        self._not_new += 1
        if self._not_new >= RESTART_AFTER:
            return self._restart(self._newest + 256 + ahead, now_ns)
        behind = -ahead % 256
        number = self._newest - behind
        if self._seen >> behind & 1:
            return Place(Order.DUPLICATE, number)
        if behind < _HALF:
            self._seen |= 1 << behind
        if self._missed >> behind & 1:  # it was late, not lost
            self.lost -= 1
        return Place(Order.LATE, number)

    def _restart(self, number: int, now_ns: int) -> Place:
        self._newest = number
        self._newest_ns = now_ns
        self._seen = 1
        self._missed = 0
        self._not_new = 0
        return Place(Order.NEW, number)
