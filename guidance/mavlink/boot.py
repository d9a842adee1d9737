"""The autopilot's time since boot: what cannot be, and when it started again."""

from __future__ import annotations

from enum import Enum
from typing import Final

from guidance.mavlink.clock import ClockFilter

#: `time_boot_ms` has 32 bits; what ODOMETRY says beyond is Unix time and no time since boot.
BOOT_MS_MAX: Final = 2**32
#: `time_boot_ms` this far back, in several messages running for a while, is a reboot and not a late message.
REBOOT_BACK_MS: Final = 1000
REBOOT_AFTER: Final = 3
REBOOT_AFTER_NS: Final = 200_000_000
#: A time may lie this far in the future, for what the clock filter does not know.
FUTURE_NS: Final = 50_000_000


class BootTime(Enum):
    """What a time since boot says."""

    GOOD = "good"
    FROM_THE_FUTURE = "from_the_future"
    BACKWARDS = "time_backwards"
    REBOOT = "reboot"


class BootClock:
    """Follows `time_boot_ms` of all messages that carry it; `newest_ms` is None before the first."""

    def __init__(self) -> None:
        self.newest_ms: int | None = None
        self._back_run = 0
        self._back_since_ns = 0

    def reset(self) -> None:
        """The autopilot started again."""
        self.newest_ms = None
        self._back_run = 0

    def take(self, boot_ms: int, clock: ClockFilter, now_ns: int) -> BootTime:
        """What `boot_ms` says; after a reboot it is the first time of the new boot."""
        if clock.synced(now_ns) and clock.to_local_ns(boot_ms * 1_000_000) > now_ns + FUTURE_NS:
            return BootTime.FROM_THE_FUTURE  # believing it would make all that follows look old
        if self.newest_ms is not None and boot_ms < self.newest_ms - REBOOT_BACK_MS:
            if self._back_run == 0:
                self._back_since_ns = now_ns
            self._back_run += 1
            if self._back_run < REBOOT_AFTER or now_ns - self._back_since_ns < REBOOT_AFTER_NS:
                return BootTime.BACKWARDS
            self.reset()
            self.newest_ms = boot_ms
            return BootTime.REBOOT
        self._back_run = 0
        self.newest_ms = max(boot_ms, self.newest_ms or 0)
        return BootTime.GOOD
