"""The law alone: body rates and forward speed, as the paper has it.

Beside the rates it says the attitude that the autopilot will have in the middle of the setpoint's time. A PX4
that takes no rates without one (`profiles.Older`) turns by P of the angle to it and D of what the rates miss:
told the attitude that it has, it turns by the rates. Others are not sent it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from guidance.abilities import Abilities
from guidance.config import Config
from guidance.estimate import Estimate
from guidance.feasibility import abilities_of, unflyable
from guidance.flying import Caution, Flown
from guidance.flying.cautioning import about_the_way
from guidance.flying.ground_feasible import ardupilot_abilities
from guidance.law import UNSTARTED, Memory, Parameters, guide_step, planar
from guidance.mavlink.messages import Body
from guidance.mavlink.setpoints import Demand
from guidance.se3 import ZERO, Quaternion, Reference, Twist, Vec3
from guidance.tuning import ALLOCATIONS, parameters

_SPEED: Final = ("WP_SPEED",)


class Rates:
    """For underwater vehicles; `planar` for a vehicle that drives without any handling of its own."""

    waited_s = 0.0
    learned = ""

    def __init__(self, config: Config, *, planar: bool) -> None:
        self._planar = planar
        self._values: Mapping[str, float] = {}
        self._why: str | None = None  # it cannot be driven as it is configured
        self._config = config
        self._memory: Memory = UNSTARTED
        self._parameters: Parameters
        self._held_ns = round(1e9 * (0.5 / config.link.rate_hz - config.link.actuation_delay_s))
        self.configure(config, ZERO, config.law.allocation)

    def configure(self, config: Config, origin_ned_m: Vec3, allocation: str) -> str | None:
        """As `Handler` says."""
        why = self._why_not(config)
        if why is not None and (self._why is None or config.trajectory != self._config.trajectory):
            return why
        self._config, self._why = config, why
        found = parameters(config.law, config.limits, origin_ned_m, planar=self._planar)
        self._parameters = found._replace(allocation=ALLOCATIONS[allocation])
        return None

    def fit(self, values: Mapping[str, float]) -> str | None:
        """Of what drives nothing is taken but the speed of full thrust: the law alone keeps to no other."""
        self._values = {name: values[name] for name in _SPEED if name in values}
        self._why = self._why_not(self._config)
        return self._why

    def _why_not(self, config: Config) -> str | None:
        if not self._values or not self._planar:
            return None
        problems = unflyable(config.trajectory, ardupilot_abilities(config, self._values))
        return next((f"{problem.key}{problem.text}" for problem in problems), None)

    def abilities(self) -> Abilities:
        """As `Handler` says: by the configuration, and the speed of full thrust."""
        c = self._config
        if self._planar:
            return ardupilot_abilities(c, self._values)
        return abilities_of(c.limits, c.law, c.vehicle.speed_at_full_thrust_m_s, planar=False)

    def unmet(self, estimate: Estimate, origin_ned_m: Vec3, ground_down_m: float | None) -> str | None:
        """Nothing."""
        return None

    def cautions(
        self, estimate: Estimate, origin_ned_m: Vec3, ground_down_m: float | None
    ) -> tuple[Caution, ...]:
        """Of the trajectory."""
        return about_the_way(self._config.trajectory, self.abilities())

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
        return Flown(Demand(rates, u.u4, self._attitude(estimate)), reference, found, rates)

    def neutral(self, estimate: Estimate) -> Demand:
        """No turn and no speed."""
        return Demand(attitude=self._attitude(estimate))

    def _attitude(self, estimate: Estimate) -> Quaternion:
        """The autopilot's own, half-way from this setpoint to the next; it compares before actuators act."""
        return estimate.attitude_at(estimate.instant_ns + self._held_ns)
