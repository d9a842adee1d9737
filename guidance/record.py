"""What every record is."""

from __future__ import annotations

import msgspec

Triple = tuple[float, float, float]
Wxyz = tuple[float, float, float, float]


class Record(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """A record holds for one instant of the companion's monotonic clock, `t_ns`."""

    t_ns: int
