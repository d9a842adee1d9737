"""What every sink is: a bounded queue, and a daemon thread that empties it in short slices.

The interpreter lock is part of the control path. A worker therefore computes for at most `SLICE_NS` and then
waits, which gives the lock away; it polls instead of being notified, because a notification would cost the
control thread more than the whole hand-over. Calls that block (a file write, a zenoh put) release the lock.
"""

from __future__ import annotations

import atexit
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, Final, Protocol

from guidance.telemetry.queue import DropOldestQueue, Sample

SLICE_NS: Final = 300_000  # a slice ends with the sample that crosses this; the rule is 0.5 ms
PAUSE_S: Final = 0.001  # between slices while there is more to do
#: Between looks at an empty queue. Each look costs the control path the caches it had warm: at 50 Hz, looks
#: every 10 ms instead made its setpoints 50 us later (median of 240 us).
IDLE_S: Final = 0.05
STALL_NS: Final = 2_000_000_000  # a worker that has not come round for so long is stuck in a call


class Sink(Protocol):
    """Where the service hands its records, seen from the control thread."""

    def offer(self, sample: Sample) -> None:
        """Take `sample`, or drop the oldest one that waits. Never blocks, never raises, O(1)."""

    def start(self) -> None:
        """Start the sink's thread and return at once; files and sessions are opened there."""

    def close(self, timeout_s: float) -> bool:
        """Write what waits and close, for at most `timeout_s` s. True if every sample offered was written."""

    @property
    def dropped(self) -> int:
        """Samples that were offered and will never be written, since the start."""

    @property
    def problem(self) -> str:
        """What is wrong and what to do about it, for an operator; empty if nothing is."""


class ThreadedSink(ABC):
    """The common part of the sinks; see `Sink` for the calls of the control thread.

    A subclass writes samples in `_take` and does everything periodic in `_turn`; both run in the worker's
    thread only. `clock_ns` and `wait` are parameters for tests: `wait(seconds)` pauses the worker.
    """

    #: How long the interpreter's exit waits for the worker, s: a service that fails without `close` still
    #: gets its last records out, and native code of a sink is not interrupted where it cannot stand it.
    LINGER_S: ClassVar[float] = 1.0

    def __init__(
        self,
        name: str,
        *,
        capacity: int,
        capacity_bytes: int,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        wait: Callable[[float], object] | None = None,
    ) -> None:
        self._name = name
        self._queue = DropOldestQueue(capacity, capacity_bytes)
        self._clock_ns = clock_ns
        self._stopping = threading.Event()
        self._wait = self._stopping.wait if wait is None else wait
        self._thread: threading.Thread | None = None
        self._turn_ns = clock_ns()
        self._trouble = ""
        self._discarded = 0  # popped, but never written; worker's thread only
        self._complete = False

    def offer(self, sample: Sample) -> None:
        """Take `sample`, or drop the oldest one that waits. Never blocks, never raises, O(1)."""
        self._queue.push(sample)

    def start(self) -> None:
        """Start the sink's thread and return at once. A second call does nothing."""
        if self._thread is None:
            self._turn_ns = self._clock_ns()
            self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
            self._thread.start()
            atexit.register(self._at_exit)

    def close(self, timeout_s: float) -> bool:
        """Write what waits and close, for at most `timeout_s` s. True if every sample offered was written.

        A worker stuck in a call is left behind; it delays the interpreter's exit by at most `LINGER_S`.
        """
        self._stopping.set()
        if self._thread is None:
            return len(self._queue) == 0
        self._thread.join(max(0.0, timeout_s))
        if self._thread.is_alive():
            return False
        atexit.unregister(self._at_exit)
        return self._complete

    def _at_exit(self) -> None:
        self.close(self.LINGER_S)

    @property
    def dropped(self) -> int:
        """Samples that were offered and will never be written, since the start."""
        return self._queue.dropped + self._discarded

    @property
    def problem(self) -> str:
        """What is wrong and what to do about it, for an operator; empty if nothing is."""
        if self._trouble:
            return self._trouble
        stuck_ns = self._clock_ns() - self._turn_ns
        if self._thread is not None and self._thread.is_alive() and stuck_ns > STALL_NS:
            return self._describe_stall(stuck_ns * 1e-9)
        return ""

    def _run(self) -> None:
        try:
            while True:
                self._turn_ns = self._clock_ns()
                stopping = self._stopping.is_set()  # before the look at the queue: nothing is left behind
                more = self._ready() and self._slice()
                self._turn()
                if stopping and not more:
                    break
                self._pause(PAUSE_S if more else IDLE_S)
            self._complete = self._finish() and self.dropped == 0 and len(self._queue) == 0
        except Exception as error:
            self._trouble = f"{self._name} stopped by an internal error, please report it: {error!r}"
            raise

    def _pause(self, seconds: float) -> None:
        # Once the sink is closing its stop event no longer waits; giving the lock away is enough then.
        if self._stopping.is_set():
            time.sleep(0)
        else:
            self._wait(seconds)

    def _slice(self) -> bool:
        """Write samples for at most a slice; True if there may be more."""
        end_ns = self._clock_ns() + SLICE_NS
        while (popped := self._queue.pop()) is not None:
            self._take(*popped)
            if self._clock_ns() >= end_ns:
                return True
        return False

    def _ready(self) -> bool:
        """False while samples should stay in the queue."""
        return True

    @abstractmethod
    def _take(self, lost: int, sample: Sample) -> None:
        """Write one sample, `lost` others having been dropped right before it."""

    @abstractmethod
    def _turn(self) -> None:
        """Whatever is periodic; called after every slice."""

    @abstractmethod
    def _finish(self) -> bool:
        """Close what is open, the queue being empty; True if all that was taken is written."""

    @abstractmethod
    def _describe_stall(self, seconds: float) -> str:
        """The problem in words when a call has not returned for `seconds` s."""
