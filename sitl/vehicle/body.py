"""The seam between a firmware and what it drives: controls go in at an instant, a state comes out of one."""

from __future__ import annotations

from typing import ClassVar, NamedTuple, Protocol

from sitl.plant import Triple, Wxyz
from sitl.vehicle.controls import Control


class BodyState(NamedTuple):
    """All that an estimator could see of a body.

    `velocity_ned_m_s` is over ground, `speed_m_s` through the water or the air along the nose (of a ground
    vehicle: over ground). Where there is no airspeed sensor and no throttle, `airspeed_m_s` and `throttle`
    are 0. `wind_ned_m_s` is the velocity of the air over ground, gusts among it.
    """

    position_ned_m: Triple
    attitude_wxyz: Wxyz
    body_rates_frd_rad_s: Triple
    velocity_ned_m_s: Triple
    speed_m_s: float
    airspeed_m_s: float = 0.0
    wind_ned_m_s: Triple = (0.0, 0.0, 0.0)
    throttle: float = 0.0


class Body(Protocol):
    """A vehicle without its firmware. Instants are integer ns of one clock and never run backwards.

    How often `advance` and `ahead` are called changes nothing but, in the ideal body, roundings by `advance`.
    """

    takes: ClassVar[tuple[type, ...]]
    """Kinds of `Control`."""

    def tell(self, control: Control, at_ns: int) -> None:
        """Be told so from `at_ns` on; all its numbers are finite."""

    def advance(self, to_ns: int) -> BodyState:
        """Live until `to_ns`."""

    def ahead(self, at_ns: int) -> BodyState:
        """What it would be at `at_ns`, not before the last instant lived, if nothing else were told."""

    def carry(self, ned_m_s: Triple, at_ns: int) -> None:
        """Let the water, for an airplane the air, move with this velocity from `at_ns` on."""
