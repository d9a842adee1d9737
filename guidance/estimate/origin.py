"""The origin of the autopilot's local frame: what is done when that moves.

An autopilot may put it elsewhere in flight (a GPS that comes back, SET_GPS_GLOBAL_ORIGIN). A trajectory's
place in the local frame was found about the origin before, so that its flight would go on elsewhere.
"""

from __future__ import annotations

from typing import Final

from guidance.geodesy import Geodetic, Projection
from guidance.mavlink.messages import GpsGlobalOrigin
from guidance.se3 import norm

#: Less than this is a correction: the altitude of the origin follows the GPS for a while.
MOVED_M: Final = 1.0


class LocalOrigin:
    """What positions count from: `held` is not changed in flight; `moved` says that the autopilot did."""

    def __init__(self, project: Projection) -> None:
        self._project = project
        self.reset()

    def reset(self) -> None:
        """The autopilot rebooted: nothing is known."""
        self.held: GpsGlobalOrigin | None = None
        self.moved: str | None = None
        self._told: GpsGlobalOrigin | None = None

    def look(self, said: GpsGlobalOrigin | None, *, flying: bool) -> str | None:
        """Take what the autopilot says now; words if it has moved since that was told last."""
        if said is None:
            return None
        if not flying or self.held is None:
            self.held = said
        self.moved = self._apart(said, self.held)
        news = None if self._told is None else self._apart(said, self._told)
        if self._told is None or news is not None:
            self._told = said
        return news

    def _apart(self, said: GpsGlobalOrigin, before: GpsGlobalOrigin) -> str | None:
        if said == before:
            return None
        apart_m = norm(self._project(_geodetic(said), _geodetic(before)))
        return f"the autopilot's local origin moved by {apart_m:.1f} m" if apart_m > MOVED_M else None


def _geodetic(origin: GpsGlobalOrigin) -> Geodetic:
    return origin.latitude * 1e-7, origin.longitude * 1e-7, origin.altitude * 1e-3
