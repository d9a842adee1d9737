"""The hand-over from the control thread to a sink: bounded, drop-oldest, without a lock.

One thread pushes, one other thread pops. A lock would let a sink that lost the interpreter while holding it
keep the control thread waiting, and a notification would cost a system call per sample; so there is neither:
`collections.deque` appends and pops atomically, each counter has one writer, and the numbers that travel with
the samples show the consumer exactly where samples are missing and how many.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple


class Sample(NamedTuple):
    """One record on its way out.

    Attributes:
        topic: name of the record's stream, a value of `guidance.records.TOPICS`.
        t_ns: the record's own instant on the companion's monotonic clock, ns.
        payload: the record as JSON, encoded once on the control thread and never changed after.
    """

    topic: str
    t_ns: int
    payload: bytes


class DropOldestQueue:
    """At most `capacity` samples and `capacity_bytes` bytes of payload; the oldest give way to the newest.

    The bound in bytes is there for the raw traffic: a stranger who floods the port with large datagrams while
    the disk hangs must not fill the memory. A payload larger than the bound is dropped itself.

    Raises:
        ValueError: a bound that is not positive.
    """

    def __init__(self, capacity: int, capacity_bytes: int) -> None:
        if capacity < 1 or capacity_bytes < 1:
            raise ValueError(f"queue bounds must be positive: {capacity} samples, {capacity_bytes} bytes")
        self._capacity = capacity
        self._capacity_bytes = capacity_bytes
        self._items: deque[tuple[int, Sample]] = deque()
        # Written by the pushing thread only.
        self._pushed = 0
        self._bytes_pushed = 0
        self._dropped = 0
        self._bytes_dropped = 0
        # Written by the popping thread only.
        self._last_popped = 0
        self._bytes_popped = 0

    def push(self, sample: Sample) -> None:
        """Append `sample`; never blocks, never raises. Amortised O(1)."""
        self._pushed += 1
        self._bytes_pushed += len(sample.payload)
        items = self._items
        items.append((self._pushed, sample))
        if len(items) > self._capacity or self.payload_bytes > self._capacity_bytes:
            self._shed()

    def _shed(self) -> None:
        items = self._items
        while len(items) > self._capacity or self.payload_bytes > self._capacity_bytes:
            try:
                _, sample = items.popleft()
            except IndexError:  # the consumer was faster: it has the rest
                return
            self._dropped += 1
            self._bytes_dropped += len(sample.payload)

    def pop(self) -> tuple[int, Sample] | None:
        """The oldest sample and how many were dropped right before it; None if the queue is empty."""
        try:
            number, sample = self._items.popleft()
        except IndexError:
            return None
        self._bytes_popped += len(sample.payload)
        lost = number - self._last_popped - 1
        self._last_popped = number
        return lost, sample

    def lost_at_end(self) -> int:
        """How many samples after the last popped one are gone; for the consumer of an empty queue."""
        lost = 0 if self._items else self._pushed - self._last_popped
        self._last_popped += lost
        return lost

    @property
    def dropped(self) -> int:
        """Samples dropped since the start."""
        return self._dropped

    @property
    def payload_bytes(self) -> int:
        """Bytes of payload in the queue (for a moment also those that the consumer is just taking)."""
        return self._bytes_pushed - self._bytes_dropped - self._bytes_popped

    def __len__(self) -> int:
        return len(self._items)
