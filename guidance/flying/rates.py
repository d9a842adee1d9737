"""The law alone: body rates and forward speed, as the paper has it."""

from __future__ import annotations

from collections.abc import Mapping

from guidance.config import Config
from guidance.estimate import Estimate
from guidance.flying import Flown
from guidance.law import UNSTARTED, Memory, Parameters, guide_step, planar
from guidance.mavlink.messages import Body
from guidance.mavlink.setpoints import Demand
from guidance.se3 import ZERO, Reference, Twist, Vec3
from guidance.tuning import ALLOCATIONS, parameters

_NEUTRAL = Demand()


class Rates:
    """For underwater vehicles; `planar` for a vehicle that drives without any handling of its own."""

    waited_s = 0.0
    learned = ""

    def __init__(self, config: Config, *, planar: bool) -> None:
        self._planar = planar
        self._memory: Memory = UNSTARTED
        self._parameters: Parameters
        self.configure(config, ZERO, config.law.allocation)

    def configure(self, config: Config, origin_ned_m: Vec3, allocation: str) -> None:
        """As `Handler` says."""
        found = parameters(config.law, config.limits, origin_ned_m, planar=self._planar)
        self._parameters = found._replace(allocation=ALLOCATIONS[allocation])

    def fit(self, values: Mapping[str, float]) -> str | None:
        """Nothing is taken from them."""
        return None

    def unmet(self, estimate: Estimate, origin_ned_m: Vec3, ground_down_m: float | None) -> str | None:
        """Nothing."""
        return None

    def recall(self, learned: str) -> str | None:
        """Nothing is learned."""
        return "this vehicle learns nothing"

    def heard(self, body: Body, now_ns: int) -> None:
        """Nothing."""

    def start(self) -> None:
        """As `Handler` says."""
        self._memory = UNSTARTED

    def shifted(self, jump_ned_m: Vec3) -> None:
        """Nothing is remembered of places."""

    def step(self, estimate: Estimate, reference: Reference, dt_s: float) -> Flown:
        """(11) and (14)."""
        pose, twist = estimate.pose, estimate.twist
        if self._planar:
            pose, reference = planar(pose, reference)
            twist = Twist(Vec3(0.0, 0.0, twist.angular.z), twist.linear)
        self._memory, found = guide_step(self._parameters, self._memory, pose, twist, reference, dt_s)
        u = found.controls
        rates = Vec3(u.u1, u.u2, u.u3)
        return Flown(Demand(rates, u.u4), reference, found, rates)

    def neutral(self, estimate: Estimate) -> Demand:
        """No turn and no speed."""
        return _NEUTRAL
