"""Steps in place of the law, for `guidance tune`: each run from one place, with a way back to it in between.

A run asks for what it says, and the vehicle's own handler drives the way back. Nothing here is privileged:
the pilot, the guards and the profile's clamps stand above it as above any other handler.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from math import hypot
from typing import Final

from guidance.abilities import Abilities
from guidance.config import Config
from guidance.estimate import Estimate
from guidance.flying import Caution, Flown, Handler
from guidance.flying.channels import asked, measured
from guidance.handling_config import ExcitationConfig
from guidance.law import Controls, Evaluation
from guidance.mavlink.messages import Body
from guidance.mavlink.setpoints import Demand
from guidance.records import Stepping
from guidance.se3 import ZERO, Reference, Vec3, yaw_of
from guidance.tune.excitation import demand_at
from guidance.tune.way_back import Path, Place, way_back

#: At rest is slower than this, for so long; a boat in a current never is, and goes on after the last.
REST_M_S: Final = 0.3
REST_S: Final = 1.0
REST_LONGEST_S: Final = 6.0


class Phase(StrEnum):
    """Of each run in this order; the last run ends done."""

    RESTING = "resting"
    STEPPING = "stepping"
    STOPPING = "stopping"
    RETURNING = "returning"
    DONE = "done"


class Excited:
    """Around the vehicle's own handler. A flight that was held goes back and does its run again."""

    waited_s = 0.0

    def __init__(self, inner: Handler, excitation: ExcitationConfig) -> None:
        self._inner = inner
        self._excitation = excitation
        self._number = 0
        self._phase: Phase | None = None
        self._since_ns = 0
        self._moving_ns = 0
        self._place: Place | None = None
        self._down_m = 0.0
        self._way: Path | None = None

    @property
    def learned(self) -> str:
        """As `Handler` says."""
        return self._inner.learned

    def recall(self, learned: str) -> str | None:
        """As `Handler` says."""
        return self._inner.recall(learned)

    def configure(self, config: Config, origin_ned_m: Vec3, allocation: str) -> str | None:
        """As `Handler` says."""
        return self._inner.configure(config, origin_ned_m, allocation)

    def fit(self, values: Mapping[str, float]) -> str | None:
        """As `Handler` says."""
        return self._inner.fit(values)

    def abilities(self) -> Abilities | None:
        """As `Handler` says."""
        return self._inner.abilities()

    def unmet(self, estimate: Estimate, origin_ned_m: Vec3, ground_down_m: float | None) -> str | None:
        """As `Handler` says."""
        return self._inner.unmet(estimate, origin_ned_m, ground_down_m)

    def cautions(
        self, estimate: Estimate, origin_ned_m: Vec3, ground_down_m: float | None
    ) -> tuple[Caution, ...]:
        """As `Handler` says."""
        return self._inner.cautions(estimate, origin_ned_m, ground_down_m)

    def heard(self, body: Body, now_ns: int) -> None:
        """As `Handler` says."""
        self._inner.heard(body, now_ns)

    def start(self) -> None:
        """As `Handler` says."""
        self._inner.start()
        self._phase = None

    def shifted(self, jump_ned_m: Vec3) -> None:
        """As `Handler` says."""
        self._inner.shifted(jump_ned_m)
        north, east, down = jump_ned_m
        if self._place is not None:
            self._place = self._moved(self._place, north, east)
            self._down_m += down
        if self._way is not None:
            self._way = Path(self._moved(self._way.start, north, east), self._way.pieces)

    def step(self, estimate: Estimate, reference: Reference, dt_s: float) -> Flown:
        """The trajectory's reference is not used."""
        now_ns = estimate.instant_ns
        at = estimate.pose.position
        here = Place(at.x, at.y, yaw_of(estimate.pose.attitude))
        speed = hypot(estimate.velocity_ned_m_s.x, estimate.velocity_ned_m_s.y)
        if speed > REST_M_S:
            self._moving_ns = now_ns
        if self._place is None:
            self._place, self._down_m = here, at.z
            self._enter(Phase.RESTING, now_ns)
        elif self._phase is None:
            self._go_back(here, now_ns)
        self._advance(here, now_ns)
        into_s = self._into_s(now_ns)
        if self._phase is Phase.RETURNING:
            return self._returning(estimate, into_s, dt_s)
        return self._stepping(estimate, into_s)

    def neutral(self, estimate: Estimate) -> Demand:
        """As `Handler` says."""
        return self._inner.neutral(estimate)

    def _advance(self, here: Place, now_ns: int) -> None:
        """To the phase that this one leads to, if it is over."""
        into_s = self._into_s(now_ns)
        rested_s = min((now_ns - self._moving_ns) * 1e-9, into_s)
        rests = rested_s >= REST_S or into_s >= REST_LONGEST_S
        match self._phase:
            case Phase.RESTING if rests:
                self._enter(Phase.STEPPING, now_ns)
            case Phase.STEPPING if into_s >= self._excitation.runs[self._number].lasts_s:
                self._enter(Phase.STOPPING, now_ns)
            case Phase.STOPPING if rests:
                if self._number + 1 == len(self._excitation.runs):
                    self._enter(Phase.DONE, now_ns)
                else:
                    self._number += 1
                    self._go_back(here, now_ns)
            case Phase.RETURNING if self._driven_s(into_s) * self._excitation.back_m_s >= self._way_m():
                self._enter(Phase.RESTING, now_ns)

    def _enter(self, phase: Phase, now_ns: int) -> None:
        self._phase, self._since_ns = phase, now_ns

    def _go_back(self, here: Place, now_ns: int) -> None:
        assert self._place is not None
        excitation = self._excitation
        self._way = way_back(here, self._place, excitation.back_radius_m, excitation.back_straight_m)
        self._inner.start()
        self._enter(Phase.RETURNING, now_ns)

    def _way_m(self) -> float:
        """How far it is driven: it rolls out to where the run begins."""
        assert self._way is not None
        return self._way.length_m - self._excitation.stop_m

    def _into_s(self, now_ns: int) -> float:
        return (now_ns - self._since_ns) * 1e-9

    def _driven_s(self, into_s: float) -> float:
        """On the clock of the way back, which may wait for the vehicle."""
        return into_s - self._inner.waited_s

    def _returning(self, estimate: Estimate, into_s: float, dt_s: float) -> Flown:
        assert self._way is not None
        along = self._way.reference(self._driven_s(into_s), self._excitation.back_m_s, self._down_m)
        flown = self._inner.step(estimate, along, dt_s)
        return flown._replace(around=self._record(estimate, into_s))

    def _stepping(self, estimate: Estimate, into_s: float) -> Flown:
        """What the run asks for, or to stand."""
        demand = self._inner.neutral(estimate)
        run = self._excitation.runs[self._number]
        if self._phase is Phase.STEPPING:
            demand = asked(demand, demand_at(run, into_s))
        rates = demand.body_rates_frd_rad_s
        controls = Controls(*rates, demand.speed_m_s)
        # nothing is tracked: the fence, not an error, bounds a run
        here = Reference(estimate.pose.position, ZERO, ZERO)
        law = Evaluation(controls, controls, ZERO, 0.0, 0.0, 0.0, 0.0, 0.0, False, False)
        return Flown(demand, here, law, rates, self._record(estimate, into_s))

    def _record(self, estimate: Estimate, into_s: float) -> Stepping:
        assert self._phase is not None
        run, t_ns = self._excitation.runs[self._number], estimate.instant_ns
        if self._phase is not Phase.STEPPING:
            return Stepping(t_ns=t_ns, run=run.name, phase=self._phase, into_s=into_s)
        seen = measured(run.channel, estimate)
        return Stepping(
            t_ns=t_ns,
            run=run.name,
            phase=self._phase,
            into_s=into_s,
            channel=run.channel,
            measured=seen.value,
            measured_ns=seen.instant_ns,
        )

    @staticmethod
    def _moved(place: Place, north_m: float, east_m: float) -> Place:
        return place._replace(north_m=place.north_m + north_m, east_m=place.east_m + east_m)
