"""What every record is."""

from __future__ import annotations

from typing import Annotated

import msgspec

Triple = tuple[float, float, float]
Wxyz = tuple[float, float, float, float]
#: JSON's integers have no end; whoever decodes a record refuses those that no instant and no count can be.
Int64 = Annotated[int, msgspec.Meta(ge=-(1 << 63), le=(1 << 63) - 1)]


class Record(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """A record holds for one instant of the companion's monotonic clock, `t_ns`."""

    t_ns: Int64
