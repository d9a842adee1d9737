"""Rovers and boats: `handling.ground` with what the configuration and the autopilot's parameters say."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from guidance.abilities import GroundAbilities
from guidance.config import Config
from guidance.estimate import Estimate
from guidance.feasibility import unflyable
from guidance.flying import Caution, Flown
from guidance.flying.cautioning import about_the_way
from guidance.flying.ground_feasible import ardupilot_abilities, px4_abilities, unbounded
from guidance.flying.ground_fit import ardupilot_allows, fitted, px4_allows, px4_rover
from guidance.handling import ground, rover_px4
from guidance.handling.ground import UNSTARTED, Measured, Memory, Parameters, ground_step
from guidance.mavlink.messages import Body
from guidance.mavlink.setpoints import Demand
from guidance.records import GroundHandling
from guidance.se3 import ZERO, Pose, Reference, Twist, Vec3, add, from_yaw, rotate_inverse, yaw_of
from guidance.tune.excitation import SPEED, YAW_RATE

_NEUTRAL: Final = Demand()


class Ground:
    """The autopilot's parameters are those of the last `fit`."""

    learned = ""

    def __init__(self, config: Config) -> None:
        self._values: Mapping[str, float] = {}
        self._memory: Memory = UNSTARTED
        self._parameters: Parameters | None = None
        self._why: str | None = None  # it cannot be driven as it is configured
        self._config = config
        self._period_s = 1.0 / config.link.rate_hz
        self.configure(config, ZERO, config.law.allocation)

    @property
    def waited_s(self) -> float:
        """As `Handler` says."""
        return self._memory.waiting.waited_s

    def configure(self, config: Config, origin_ned_m: Vec3, allocation: str) -> str | None:
        """As `Handler` says; while the vehicle is not known yet, anything is taken. It has one allocation."""
        found = self._fitted(config, origin_ned_m)
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
        found = self._fitted(self._config, self._origin_ned_m)
        self._take(found, self._why_not(self._config, found))
        return self._why

    def _why_not(self, config: Config, found: Parameters | str) -> str | None:
        if isinstance(found, str):
            return found
        able = self._abilities(config)
        assert able is not None, "what fits is known"
        problems = unflyable(config.trajectory, able)
        return next((f"{problem.key}{problem.text}" for problem in problems), None)

    def _take(self, found: Parameters | str, why: str | None) -> None:
        self._why = why
        if not isinstance(found, str):
            self._parameters = found

    def _fitted(self, config: Config, origin_ned_m: Vec3) -> Parameters | str:
        return ground_parameters(config, origin_ned_m, self._values)

    def _abilities(self, config: Config) -> GroundAbilities | None:
        return ardupilot_abilities(config, self._values)

    def abilities(self) -> GroundAbilities | None:
        """As `Handler` says."""
        return self._abilities(self._config)

    def unmet(self, estimate: Estimate, origin_ned_m: Vec3, ground_down_m: float | None) -> str | None:
        """Nothing."""
        return None

    def cautions(
        self, estimate: Estimate, origin_ned_m: Vec3, ground_down_m: float | None
    ) -> tuple[Caution, ...]:
        """Of the trajectory, and of limits that nobody sets."""
        able = self.abilities()
        if able is None:
            return ()
        return (*about_the_way(self._config.trajectory, able), *unbounded(self._parameters))

    def recall(self, learned: str) -> str | None:
        """Nothing is learned."""
        return "this vehicle learns nothing"

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
        heading = from_yaw(yaw_of(estimate.pose.attitude))
        pose = Pose(estimate.pose.position, heading)
        velocity = rotate_inverse(heading, estimate.velocity_ned_m_s)
        twist = Twist(Vec3(0.0, 0.0, estimate.twist.angular.z), velocity)
        turning = estimate.attitude.body_rates_frd_rad_s.z
        measured = Measured(pose, twist, turning, estimate.position_age_s)
        assert self._parameters is not None, "a rover that does not fit is not engaged"
        waited_s = self.waited_s
        self._memory, demand, found = ground_step(
            self._parameters, self._memory, measured, reference, dt_s or self._period_s
        )
        turns = Vec3(0.0, 0.0, found.law.controls.u3)
        around = GroundHandling(
            t_ns=estimate.instant_ns,
            slip_rad=found.slip_rad,
            clock_rate=found.clock_rate,
            waited_s=waited_s,
            speed_correction_m_s=found.speed_correction_m_s,
            crawling=found.crawling,
            slowed=found.slowed,
            stuck=found.stuck,
        )
        return Flown(self._ask(demand, estimate), found.reference, found.law, turns, around)

    def _ask(self, demand: ground.Demand, estimate: Estimate) -> Demand:
        return Demand(Vec3(0.0, 0.0, demand.yaw_rate_rad_s), demand.speed_m_s)

    def neutral(self, estimate: Estimate) -> Demand:
        """Stand."""
        return _NEUTRAL


def ground_parameters(config: Config, origin_ned_m: Vec3, values: Mapping[str, float]) -> Parameters:
    """Of the configuration's limits and ArduPilot's (`values`, in its units) the tighter hold."""
    return fitted(config, origin_ned_m, ardupilot_allows(values))


class Px4Rover(Ground):
    """PX4's rovers, which take a velocity: its bearing asks for the yaw rate (`handling.rover_px4`).

    The bearing is off the heading that PX4 has while it holds the setpoint, which is from when it comes,
    before it acts, until the next one does: that of the middle.
    """

    _autopilot: rover_px4.Autopilot | None = None

    def fit(self, values: Mapping[str, float]) -> str | None:
        """As `Handler` says."""
        autopilot = px4_rover(values)
        self._autopilot = None if isinstance(autopilot, str) else autopilot
        return super().fit(values)

    def _fitted(self, config: Config, origin_ned_m: Vec3) -> Parameters | str:
        autopilot = px4_rover(self._values)
        return (
            autopilot if isinstance(autopilot, str) else fitted(config, origin_ned_m, px4_allows(autopilot))
        )

    def _abilities(self, config: Config) -> GroundAbilities | None:
        return None if self._autopilot is None else px4_abilities(config, self._autopilot)

    def _ask(self, demand: ground.Demand, estimate: Estimate) -> Demand:
        assert self._autopilot is not None, "a rover that does not fit is not engaged"
        ahead_s = 0.5 * self._period_s - self._config.link.actuation_delay_s
        heading = yaw_of(estimate.attitude_at(estimate.instant_ns + round(1e9 * ahead_s)))
        return Demand(velocity_ned_m_s=rover_px4.velocity_of(self._autopilot, demand, heading))

    def driven(self, demand: Demand, values: Mapping[str, float], estimate: Estimate) -> Demand:
        """Yaw rate and speed of a step as PX4 takes them; the yaw rate is for the record alone."""
        wanted = ground.Demand(values[YAW_RATE], values[SPEED])
        return self._ask(wanted, estimate)._replace(yaw_rate_rad_s=wanted.yaw_rate_rad_s)

    def neutral(self, estimate: Estimate) -> Demand:
        """Stand, the nose where it is."""
        if self._autopilot is None:
            return _NEUTRAL
        return self._ask(ground.Demand(0.0, 0.0), estimate)
