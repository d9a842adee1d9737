"""Copters: `handling.velocity` with what the configuration and the autopilot's parameters say.

The pose is predicted here and not by the estimator: a copter's velocity does not turn with its body as it
tilts, only with its nose, and the yaw rate that was measured says more of the next tenth of a second than
those that were sent, which take longer to act.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from guidance.abilities import VelocityAbilities
from guidance.config import Config
from guidance.estimate import Estimate
from guidance.feasibility import unflyable
from guidance.flying import Caution, Flown
from guidance.flying.cautioning import about_parameters, about_the_ground, about_the_way
from guidance.flying.velocity_feasible import abilities, assumed
from guidance.flying.velocity_fit import fitted
from guidance.handling.velocity import UNSTARTED, Around, Measured, Parameters, velocity_step
from guidance.mavlink.messages import Body
from guidance.mavlink.setpoints import Demand
from guidance.records import VelocityHandling
from guidance.se3 import (
    ZERO,
    Pose,
    Reference,
    Twist,
    Vec3,
    add,
    compose,
    exp,
    from_yaw,
    rotate,
    rotate_inverse,
    yaw_of,
)

_NEUTRAL: Final = Demand()


class Velocity:
    """Before `fit` it cannot fly: it stands."""

    def __init__(self, config: Config) -> None:
        self._values: Mapping[str, float] = {}
        self._memory = UNSTARTED
        self._parameters: Parameters | None = None
        self._why: str | None = None  # it cannot be flown as it is configured
        self._config = config
        self._period_s = 1.0 / config.link.rate_hz
        self.configure(config, ZERO, config.law.allocation)

    @property
    def waited_s(self) -> float:
        """As `Handler` says."""
        return self._memory.waiting.waited_s

    @property
    def learned(self) -> str:
        """As `Handler` says: nothing that another flight could use."""
        return ""

    def recall(self, learned: str) -> str | None:
        """Nothing is learned that another flight could use."""
        return "this vehicle learns nothing"

    def configure(self, config: Config, origin_ned_m: Vec3, allocation: str) -> str | None:
        """As `Handler` says; while the vehicle is not known yet, anything is taken. It has one allocation."""
        found = fitted(config, origin_ned_m, self._values)
        why = self._why_not(config, found)
        new = self._why is None or config.trajectory != self._config.trajectory
        if why is not None and new and self._parameters is not None:
            return why
        self._config, self._origin_ned_m = config, origin_ned_m
        self._take(found, why)
        return None

    def fit(self, values: Mapping[str, float]) -> str | None:
        """As `Handler` says."""
        self._values = dict(values)
        found = fitted(self._config, self._origin_ned_m, self._values)
        self._take(found, self._why_not(self._config, found))
        return self._why

    def _why_not(self, config: Config, found: Parameters | str) -> str | None:
        if isinstance(found, str):
            return found
        problems = unflyable(config.trajectory, abilities(config, self._values, found))
        return next((f"{problem.key}{problem.text}" for problem in problems), None)

    def _take(self, found: Parameters | str, why: str | None) -> None:
        self._why = why
        if not isinstance(found, str):
            self._parameters = found

    def abilities(self) -> VelocityAbilities | None:
        """As `Handler` says."""
        p = self._parameters
        return None if p is None else abilities(self._config, self._values, p)

    def unmet(self, estimate: Estimate, origin_ned_m: Vec3, ground_down_m: float | None) -> str | None:
        """Nothing."""
        return None

    def cautions(
        self, estimate: Estimate, origin_ned_m: Vec3, ground_down_m: float | None
    ) -> tuple[Caution, ...]:
        """Of the trajectory, the ground, and of parameters that the autopilot does not tell."""
        config = self._config
        able = self.abilities()
        if able is None:
            return ()
        found = about_the_way(config.trajectory, able)
        if config.guards.fence_down_max_m is None:
            found += about_the_ground(config.trajectory, origin_ned_m, ground_down_m)
        taken = ", ".join(f"{name} {value:g}" for name, value in assumed(self._values).items())
        return (*found, *about_parameters(taken))

    def heard(self, body: Body, now_ns: int) -> None:
        """Nothing."""

    def start(self) -> None:
        """As `Handler` says."""
        self._memory = UNSTARTED

    def shifted(self, jump_ned_m: Vec3) -> None:
        """As `Handler` says."""
        smooth = self._memory.smoothing
        moved = smooth._replace(position=add(smooth.position, jump_ned_m))
        self._memory = self._memory._replace(smoothing=moved)

    def step(self, estimate: Estimate, reference: Reference, dt_s: float) -> Flown:
        """The first step is taken to be as long as the others."""
        assert self._parameters is not None, "a copter that does not fit is not engaged"
        waited_s = self.waited_s
        self._memory, demand, found = velocity_step(
            self._parameters, self._memory, measured(estimate), reference, dt_s or self._period_s
        )
        asked = Demand(velocity_ned_m_s=demand.velocity_ned_m_s, yaw_rate_rad_s=demand.yaw_rate_rad_s)
        rates = estimate.attitude.body_rates_frd_rad_s
        return Flown(asked, found.reference, found.law, rates, self._record(estimate, found, waited_s))

    def neutral(self, estimate: Estimate) -> Demand:
        """Stand in the air."""
        return _NEUTRAL

    def _record(self, estimate: Estimate, found: Around, waited_s: float) -> VelocityHandling:
        return VelocityHandling(
            t_ns=estimate.instant_ns,
            wanted_ned_m_s=found.wanted_ned_m_s,
            heading_rad=self._memory.heading_rad,
            drag_per_s=found.drag_per_s,
            clock_rate=found.clock_rate,
            waited_s=waited_s,
            stuck=found.stuck,
        )


def measured(estimate: Estimate) -> Measured:
    """The vehicle at the estimate's instant, level: its heading turns at the measured rate, and its velocity
    with it, from the newest position on."""
    turning = rotate(estimate.attitude.attitude, estimate.attitude.body_rates_frd_rad_s).z
    heading = from_yaw(yaw_of(estimate.seen.attitude))
    velocity = rotate_inverse(heading, estimate.position.velocity_ned_m_s)
    twist = Twist(Vec3(0.0, 0.0, turning), velocity)
    led = compose(Pose(estimate.seen.position, heading), exp(twist, max(estimate.position_age_s, 0.0)))
    return Measured(led, twist, turning)
