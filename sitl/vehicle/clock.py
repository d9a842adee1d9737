"""The vehicle's own clock: integer nanoseconds since boot, with an offset and a constant drift."""

from __future__ import annotations

from typing import Final, NamedTuple

_BILLION: Final = 1_000_000_000


class BootClock(NamedTuple):
    """Turns the driver's monotonic `now_ns` into time since boot and back, exactly in integers."""

    boot_ns: int
    offset_ns: int = 0
    drift_ppb: int = 0

    def at(self, now_ns: int) -> int:
        """Time since boot (ns) that the vehicle's clock shows at `now_ns`."""
        return self.offset_ns + (now_ns - self.boot_ns) * (_BILLION + self.drift_ppb) // _BILLION

    def when(self, since_boot_ns: int) -> int:
        """The first `now_ns` at which the vehicle's clock shows at least `since_boot_ns`."""
        return self.boot_ns - (self.offset_ns - since_boot_ns) * _BILLION // (_BILLION + self.drift_ppb)
