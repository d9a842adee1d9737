"""Steps in place of the law, for `guidance tune`, of what can stand: vehicles that drive, and copters.

Each run begins at rest in one place, and the vehicle's own handler leads back to it in between: on a path,
or, of a copter, which needs none, to where it hovered. A run asks for what it says.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import hypot
from typing import Final

from guidance.estimate import Estimate
from guidance.flying import Flown, Handler
from guidance.flying.around import Around, Phase
from guidance.flying.channels import asked, place_of
from guidance.handling_config import ExcitationConfig
from guidance.mavlink.setpoints import Demand
from guidance.se3 import ZERO, Reference, Vec3
from guidance.tune.excitation import demand_at
from guidance.tune.way_back import Place, way_back

#: At rest is slower than this, for so long; a boat in a current never is, and goes on after the last.
REST_M_S: Final = 0.3
REST_S: Final = 1.0
REST_LONGEST_S: Final = 6.0
#: A copter is back so near, and tries for so long.
BACK_M: Final = 0.5
BACK_LONGEST_S: Final = 15.0

#: How channels are put into a demand.
Ask = Callable[[Demand, Mapping[str, float], Estimate], Demand]


def _by_channels(demand: Demand, values: Mapping[str, float], _: Estimate) -> Demand:
    return asked(demand, values)


class Excited(Around):
    """A flight that was held goes back and does its run again."""

    def __init__(self, inner: Handler, excitation: ExcitationConfig, ask: Ask = _by_channels) -> None:
        super().__init__(inner, excitation)
        self._ask = ask
        self._moving_ns = 0

    def step(self, estimate: Estimate, reference: Reference, dt_s: float) -> Flown:
        """The trajectory's reference is not used."""
        now_ns = estimate.instant_ns
        here = place_of(estimate, self._excitation.way)
        speed = hypot(estimate.velocity_ned_m_s.x, estimate.velocity_ned_m_s.y)
        if speed > REST_M_S:
            self._moving_ns = now_ns
        if self._place is None:
            self._place, self._down_m = here, estimate.pose.position.z
            self._enter(Phase.RESTING, now_ns)
        elif self._phase is None:
            self._go_back(here, now_ns)
        self._advance(here, now_ns)
        into_s = self._into_s(now_ns)
        if self._phase is Phase.RETURNING:
            return self._returning(estimate, into_s, dt_s)
        return self._stepping(estimate, into_s)

    def _advance(self, here: Place, now_ns: int) -> None:
        """To the phase that this one leads to, if it is over."""
        into_s = self._into_s(now_ns)
        rested_s = min((now_ns - self._moving_ns) * 1e-9, into_s)
        rests = rested_s >= REST_S or into_s >= REST_LONGEST_S
        match self._phase:
            case Phase.RESTING if rests:
                self._enter(Phase.STEPPING, now_ns)
            case Phase.STEPPING if into_s >= self._run.lasts_s:
                self._enter(Phase.STOPPING, now_ns)
            case Phase.STOPPING if rests:
                if self._last:
                    self._enter(Phase.DONE, now_ns)
                else:
                    self._number += 1
                    self._go_back(here, now_ns)
            case Phase.RETURNING if self._is_back(here, into_s):
                self._enter(Phase.RESTING, now_ns)

    def _is_back(self, here: Place, into_s: float) -> bool:
        assert self._place is not None
        if self._way is None:
            off_m = hypot(here.north_m - self._place.north_m, here.east_m - self._place.east_m)
            return off_m < BACK_M or into_s >= BACK_LONGEST_S
        # it rolls out to where the run begins
        way_m = self._way.length_m - self._excitation.stop_m
        return self._driven_s(into_s) * self._excitation.back_m_s >= way_m

    def _go_back(self, here: Place, now_ns: int) -> None:
        assert self._place is not None
        excitation = self._excitation
        if excitation.way == "drives":
            self._way = way_back(here, self._place, excitation.back_radius_m, excitation.back_straight_m)
        self._inner.start()
        self._enter(Phase.RETURNING, now_ns)

    def _returning(self, estimate: Estimate, into_s: float, dt_s: float) -> Flown:
        assert self._place is not None
        if self._way is None:
            along = Reference(Vec3(self._place.north_m, self._place.east_m, self._down_m), ZERO, ZERO)
        else:
            along = self._way.reference(self._driven_s(into_s), self._excitation.back_m_s, self._down_m)
        flown = self._inner.step(estimate, along, dt_s)
        return flown._replace(around=self._record(estimate, into_s))

    def _stepping(self, estimate: Estimate, into_s: float) -> Flown:
        """What the run asks for, or to stand."""
        demand = self._inner.neutral(estimate)
        if self._phase is Phase.STEPPING:
            demand = self._ask(demand, demand_at(self._run, into_s), estimate)
        return self._asked(demand, estimate, into_s)
