"""What stands around a vehicle's own handler while steps are flown, whichever way it goes back.

Nothing here is privileged: the pilot, the guards and the profile's clamps stand above it as above any other
handler.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

from guidance.abilities import Abilities
from guidance.config import Config
from guidance.estimate import Estimate
from guidance.flying import Caution, Flown, Handler
from guidance.flying.channels import Measured, measured
from guidance.handling_config import ExcitationConfig
from guidance.law import Controls, Evaluation
from guidance.mavlink.messages import Body
from guidance.mavlink.setpoints import Demand
from guidance.records import Stepping
from guidance.se3 import ZERO, Reference, Vec3
from guidance.tune.excitation import Run
from guidance.tune.way_back import Path, Place


class Phase(StrEnum):
    """Of each run in this order; the last run ends done. What flies does not rest."""

    RESTING = "resting"
    STEPPING = "stepping"
    STOPPING = "stopping"
    RETURNING = "returning"
    DONE = "done"


class Around:
    """The handler that is inside, the runs, and where in them the flight is."""

    waited_s = 0.0

    def __init__(self, inner: Handler, excitation: ExcitationConfig) -> None:
        self._inner = inner
        self._excitation = excitation
        self._number = 0
        self._phase: Phase | None = None
        self._since_ns = 0
        self._place: Place | None = None
        self._down_m = 0.0
        self._way: Path | None = None
        self._wind_ned_m_s = ZERO
        self._blind = False

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

    def neutral(self, estimate: Estimate) -> Demand:
        """As `Handler` says."""
        return self._inner.neutral(estimate)

    def shifted(self, jump_ned_m: Vec3) -> None:
        """As `Handler` says."""
        self._inner.shifted(jump_ned_m)
        north, east, down = jump_ned_m
        if self._place is not None:
            self._place = self._moved(self._place, north, east)
            self._down_m += down
        if self._way is not None:
            self._way = Path(self._moved(self._way.start, north, east), self._way.pieces)

    @staticmethod
    def _moved(place: Place, north_m: float, east_m: float) -> Place:
        return place._replace(north_m=place.north_m + north_m, east_m=place.east_m + east_m)

    @property
    def _run(self) -> Run:
        return self._excitation.runs[self._number]

    @property
    def _last(self) -> bool:
        return self._number + 1 == len(self._excitation.runs)

    def _enter(self, phase: Phase, now_ns: int) -> None:
        self._phase, self._since_ns = phase, now_ns

    def _into_s(self, now_ns: int) -> float:
        return (now_ns - self._since_ns) * 1e-9

    def _driven_s(self, into_s: float) -> float:
        """On the clock of the way back, which may wait for the vehicle."""
        return into_s - self._inner.waited_s

    def _asked(self, demand: Demand, estimate: Estimate, into_s: float) -> Flown:
        """A demand that is no answer to an error: nothing is tracked, and the fence bounds it."""
        rates = demand.body_rates_frd_rad_s
        controls = Controls(*rates, demand.speed_m_s)
        here = Reference(estimate.pose.position, ZERO, ZERO)
        law = Evaluation(controls, controls, ZERO, 0.0, 0.0, 0.0, 0.0, 0.0, False, False)
        return Flown(demand, here, law, rates, self._record(estimate, into_s))

    def _record(self, estimate: Estimate, into_s: float) -> Stepping:
        assert self._phase is not None
        channel, seen = "", Measured(0, 0.0)
        if self._phase is Phase.STEPPING:
            channel = self._run.channel
            seen = measured(channel, estimate, self._wind_ned_m_s)
        return Stepping(
            t_ns=estimate.instant_ns,
            run=self._run.name,
            phase=self._phase,
            into_s=into_s,
            channel=channel,
            measured=seen.value,
            measured_ns=seen.instant_ns,
            push=seen.push,
            blind=self._blind,
        )
