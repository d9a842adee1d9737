"""What sequence numbers and `time_boot_ms` tell of a peer's messages: lost, repeated, late, or rebooted."""

from __future__ import annotations

from enum import StrEnum
from typing import Final

#: After this long without a frame a sequence number, which starts again after 256, says nothing about order.
SEQUENCE_MEMORY_NS: Final = 200_000_000
#: So many old numbers in a row are a counter that started again, and not late frames.
RESTARTED_AFTER: Final = 8

#: `time_boot_ms` may go back by this much: messages overtake each other.
BACK_MS: Final = 1000
#: It may run ahead of the local clock by this much; a late message makes the next one look ahead.
AHEAD_MS: Final = 10_000
#: Messages out of this range, so many and for so long and none within it, are a clock that started again.
REBOOTED_AFTER: Final = 3
REBOOTED_AFTER_NS: Final = 200_000_000


class Order(StrEnum):
    """How a frame stands to those before it."""

    NEXT = "next"
    DUPLICATE = "duplicate"
    LATE = "out_of_order"


class SequenceTracker:
    """Counts the frames that were lost, by the sequence numbers of one component on one link."""

    def __init__(self) -> None:
        self.lost = 0
        self._newest: int | None = None
        self._newest_ns = 0
        self._old_run = 0
        self._missed: set[int] = set()  # of the last 127 numbers, those that were counted as lost

    def place(self, sequence: int, now_ns: int) -> Order:
        """Take the number of the next frame to arrive. A late frame was counted as lost and no longer is."""
        newest = self._newest
        if newest is None or now_ns - self._newest_ns > SEQUENCE_MEMORY_NS:
            self._start(sequence, now_ns)
            return Order.NEXT
        ahead = (sequence - newest) % 256
        if 0 < ahead <= 128:
            self._missed.update((newest + n) % 256 for n in range(1, ahead))
            self._missed = {n for n in self._missed if (sequence - n) % 256 < 128}
            self.lost += ahead - 1
            self._newest, self._newest_ns, self._old_run = sequence, now_ns, 0
            return Order.NEXT
        self._old_run += 1
        if self._old_run >= RESTARTED_AFTER:
            self._start(sequence, now_ns)
            return Order.NEXT
        if sequence in self._missed:
            self._missed.discard(sequence)
            self.lost -= 1
            return Order.LATE
        return Order.DUPLICATE

    def _start(self, sequence: int, now_ns: int) -> None:
        self._newest, self._newest_ns, self._old_run = sequence, now_ns, 0
        self._missed.clear()


class BootVerdict(StrEnum):
    """What a `time_boot_ms` means."""

    GOOD = "good"
    BACKWARDS = "time_backwards"
    AHEAD = "time_ahead"
    REBOOTED = "rebooted"


class BootTimeTracker:
    """Tells a reboot from late messages and from absurd times, by `time_boot_ms` alone."""

    def __init__(self) -> None:
        self.newest_ms: int | None = None
        self._newest_ns = 0
        self._strange = 0
        self._strange_since_ns = 0

    def reset(self) -> None:
        """The clock is known to have started again."""
        self.newest_ms = None
        self._strange = 0

    def place(self, boot_ms: int, now_ns: int) -> BootVerdict:
        """Take the time of the next message; only one that is GOOD or the first after a reboot is kept."""
        verdict = self._judge(boot_ms, now_ns)
        if verdict is not BootVerdict.GOOD:
            if self._strange == 0:
                self._strange_since_ns = now_ns
            self._strange += 1
            if self._strange < REBOOTED_AFTER or now_ns - self._strange_since_ns < REBOOTED_AFTER_NS:
                return verdict
            verdict = BootVerdict.REBOOTED
            self.newest_ms = None
        self._strange = 0
        if self.newest_ms is None or boot_ms > self.newest_ms:
            self.newest_ms, self._newest_ns = boot_ms, now_ns
        return verdict

    def _judge(self, boot_ms: int, now_ns: int) -> BootVerdict:
        if self.newest_ms is None:
            return BootVerdict.GOOD
        if boot_ms < self.newest_ms - BACK_MS:
            return BootVerdict.BACKWARDS
        if boot_ms > self.newest_ms + (now_ns - self._newest_ns) // 1_000_000 + AHEAD_MS:
            return BootVerdict.AHEAD
        return BootVerdict.GOOD
