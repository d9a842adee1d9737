"""Which message is due when: streams with intervals, sent on the grid of the firmware's loop."""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from typing import Final

#: A stream that fell this many intervals behind starts afresh instead of catching up.
MAX_BACKLOG: Final = 3


class Streams:
    """Periodic messages of one link, by message id; intervals in us, instants in ms since boot.

    A message leaves at the first loop at or after its due time, and the due time advances by the exact
    interval, so that the mean rate is kept although single gaps are whole loops.
    """

    def __init__(self, defaults: Mapping[int, int], grid_ms: int, start_ms: int) -> None:
        self.grid_ms = grid_ms
        self._defaults = dict(defaults)
        self._order = {message_id: place for place, message_id in enumerate(defaults)}
        self._interval_us: dict[int, int] = {}
        self._due_us: dict[int, int] = {}
        self._heap: list[tuple[int, int, int, int]] = []
        self._generation: dict[int, int] = {}
        for message_id, interval_us in defaults.items():
            self.set(message_id, interval_us, start_ms)

    def set(self, message_id: int, interval_us: int, now_ms: int) -> None:
        """Send `message_id` every `interval_us` from the next loop on; 0 or less stops it."""
        generation = self._generation.get(message_id, 0) + 1
        self._generation[message_id] = generation
        if interval_us <= 0:
            self._interval_us.pop(message_id, None)
            return
        self._order.setdefault(message_id, len(self._order))
        self._interval_us[message_id] = interval_us
        self._push(message_id, now_ms * 1000, generation)

    def default_us(self, message_id: int) -> int:
        """The interval after boot; 0: not sent."""
        return self._defaults.get(message_id, 0)

    def interval_us(self, message_id: int) -> int:
        """The interval now; 0: not sent."""
        return self._interval_us.get(message_id, 0)

    def next_ms(self) -> int | None:
        """The loop at which something is due, or None while no stream is on."""
        while self._heap:
            tick_ms, _, message_id, generation = self._heap[0]
            if self._generation[message_id] == generation:
                return tick_ms
            heapq.heappop(self._heap)
        return None

    def due(self, now_ms: int) -> list[int]:
        """The messages due at `now_ms` or before, in the firmware's order; each is scheduled anew."""
        heap = self._heap
        if not heap or heap[0][0] > now_ms:
            return []
        found: list[tuple[int, int]] = []
        while heap and heap[0][0] <= now_ms:
            _, place, message_id, generation = heapq.heappop(heap)
            if self._generation[message_id] == generation:
                found.append((place, message_id))
        found.sort()
        now_us = now_ms * 1000
        for _, message_id in found:
            interval_us = self._interval_us[message_id]
            due_us = self._due_us[message_id] + interval_us
            if due_us + MAX_BACKLOG * interval_us < now_us:
                due_us = now_us + interval_us
            self._push(message_id, max(due_us, now_us + 1), self._generation[message_id])
        return [message_id for _, message_id in found]

    def _push(self, message_id: int, due_us: int, generation: int) -> None:
        grid_us = self.grid_ms * 1000
        self._due_us[message_id] = due_us
        tick_ms = -(-due_us // grid_us) * self.grid_ms
        heapq.heappush(self._heap, (tick_ms, self._order[message_id], message_id, generation))
