"""Two autopilots that use one id on one link, found by their sequence numbers.

Each counts its frames by itself. So once both are within the other's last 128 numbers, a number comes again
with other content, and between two such conflicts the newest number has moved on. Neither loss nor frames
that come late or twice do that; a sender that starts again conflicts with itself, but nothing moves on.
"""

from __future__ import annotations

from collections import deque
from typing import Final

#: So many conflicts within this time.
_CONFLICTS: Final = 32
_WITHIN_NS: Final = 2_000_000_000


class Twins:
    """Counts conflicts."""

    def __init__(self) -> None:
        self._conflicts_ns: deque[int] = deque(maxlen=_CONFLICTS)
        self._newest: int | None = None

    def conflict(self, newest: int | None, now_ns: int) -> None:
        """A number came again with other content while the newest one was `newest`."""
        if newest != self._newest:
            self._newest = newest
            self._conflicts_ns.append(now_ns)

    def seen(self, now_ns: int) -> bool:
        """Whether two are speaking."""
        return len(self._conflicts_ns) == _CONFLICTS and now_ns - self._conflicts_ns[0] <= _WITHIN_NS
