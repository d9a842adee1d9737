"""Whose samples are used: the best source that comes steadily, another as soon as that one falls silent.

All instants are those of the measurements: neither a burst nor a delay of the link changes the choice.
"""

from __future__ import annotations

from typing import Final, Generic, NamedTuple, TypeVar

from guidance.estimate.samples import AttitudeSample, PositionSample

#: Best first. ODOMETRY has attitude and position of one instant; angles and degrees need conversion.
ATTITUDES: Final = ("ODOMETRY", "ATTITUDE_QUATERNION", "ATTITUDE")
POSITIONS: Final = ("ODOMETRY", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT")

#: So much younger, and a sample of a lesser source is used: five periods at 50 Hz, three at PX4's 30 Hz, and
#: half of what makes a state too old for a setpoint.
SILENT_NS: Final = 100_000_000
#: A source that fell silent is used again after it has come for so long without falling silent.
STEADY_NS: Final = 1_000_000_000
#: A sample may lie this far in the future, for what the clock filter does not know.
FUTURE_NS: Final = 50_000_000
_NEVER_NS: Final = -(2**63)

S = TypeVar("S", AttitudeSample, PositionSample)


class Switch(NamedTuple):
    """From `instant_ns` on, `quantity` ("attitude" or "position") is that of another source."""

    instant_ns: int
    quantity: str
    before: str
    after: str

    def __str__(self) -> str:
        return f"{self.quantity} from {self.after} instead of {self.before}"


class Source:
    """One message: when its newest sample was measured, and since when it comes without a gap."""

    __slots__ = ("boot_ms", "heard_ns", "instant_ns", "rank", "steady_ns")

    def __init__(self, rank: int) -> None:
        self.rank = rank
        self.reset()

    def reset(self) -> None:
        """The autopilot rebooted: nothing has come yet, and what comes first is not a return."""
        self.boot_ms = -1
        self.instant_ns = 0
        self.heard_ns = _NEVER_NS
        self.steady_ns: int | None = None

    def refuse_time(self, sample: AttitudeSample | PositionSample, now_ns: int) -> str | None:
        """Why the sample's time cannot be; None if it can."""
        if sample.boot_ms <= self.boot_ms:
            return "repeated" if sample.boot_ms == self.boot_ms else "late"
        return "from_the_future" if sample.instant_ns > now_ns + FUTURE_NS else None

    def note(self, sample: AttitudeSample | PositionSample) -> None:
        """Keep its time."""
        if self.boot_ms >= 0 and sample.instant_ns - self.instant_ns > SILENT_NS:
            self.steady_ns = sample.instant_ns
        self.boot_ms = sample.boot_ms
        self.instant_ns = self.heard_ns = sample.instant_ns

    def fail(self) -> None:
        """It came, but could not be used: nobody waits for it."""
        self.heard_ns = _NEVER_NS


class Choice(Generic[S]):
    """The sources of one quantity, best first, and the newest sample of the one in use."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self.sources = {name: Source(rank) for rank, name in enumerate(names)}
        self._in_order = tuple(self.sources.values())
        self.newest: S | None = None
        self._used: Source | None = None

    def reset(self) -> None:
        """Forget all samples."""
        self.newest = None
        self._used = None
        for source in self.sources.values():
            source.reset()

    def uses(self, source: Source) -> bool:
        """Whether its samples are those in use."""
        return self._used is source

    def needs(self, source: Source, instant_ns: int) -> bool:
        """Whether a sample of that instant could matter: not from a lesser source while the other comes."""
        used = self._used
        if used is None or source.rank <= used.rank or instant_ns - used.instant_ns > SILENT_NS:
            return True
        source.heard_ns = instant_ns
        return False

    def takes(self, source: Source, sample: S) -> bool:
        """Note that it came; whether to use it (by `use`) or to wait until its source is steady."""
        source.note(sample)
        used = self._used
        if used is None or used is source:
            return True
        ahead_ns = sample.instant_ns - used.instant_ns
        if ahead_ns > SILENT_NS:  # the best of those that come takes over
            return not any(
                other.rank < source.rank and sample.instant_ns - other.heard_ns <= SILENT_NS
                for other in self._in_order
            )
        steady = source.steady_ns is None or sample.instant_ns - source.steady_ns >= STEADY_NS
        return steady and source.rank < used.rank and ahead_ns >= -SILENT_NS

    def use(self, source: Source, sample: S) -> None:
        """It is the newest from now on, and its source the one in use."""
        self._used = source
        self.newest = sample
