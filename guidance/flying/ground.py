"""Rovers and boats: `handling.ground` with what the configuration and the autopilot's parameters say."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, radians
from typing import Final

from guidance.config import Config
from guidance.estimate import Estimate
from guidance.flying import Flown
from guidance.handling import slip, smoothing, speed_loop, stuck, waiting
from guidance.handling.ground import UNSTARTED, Measured, Memory, Parameters, ground_step
from guidance.handling.rover import ACCELERATION_PART, GRAVITY_M_S2, LATERAL_PART, WAITING
from guidance.mavlink.messages import Body
from guidance.mavlink.setpoints import Demand
from guidance.records import GroundHandling
from guidance.se3 import ZERO, Pose, Reference, Twist, Vec3, add, from_yaw, rotate_inverse, yaw_of
from guidance.tuning import parameters

_NEUTRAL: Final = Demand()


class Ground:
    """The autopilot's parameters are those of the last `fit`."""

    learned = ""

    def __init__(self, config: Config) -> None:
        self._values: Mapping[str, float] = {}
        self._memory: Memory = UNSTARTED
        self._period_s = 1.0 / config.link.rate_hz
        self.configure(config, ZERO, config.law.allocation)

    @property
    def waited_s(self) -> float:
        """As `Handler` says."""
        return self._memory.waiting.waited_s

    def configure(self, config: Config, origin_ned_m: Vec3, allocation: str) -> None:
        """As `Handler` says; a planar vehicle has one allocation."""
        self._config, self._origin_ned_m = config, origin_ned_m
        self._parameters = ground_parameters(config, origin_ned_m, self._values)

    def fit(self, values: Mapping[str, float]) -> str | None:
        """As `Handler` says."""
        self._values = dict(values)
        self._parameters = ground_parameters(self._config, self._origin_ned_m, self._values)
        return None

    def unmet(self, estimate: Estimate, origin_ned_m: Vec3, ground_down_m: float | None) -> str | None:
        """Nothing."""
        return None

    def recall(self, learned: str) -> str | None:
        """Nothing is learned."""
        return "this vehicle learns nothing"

    def heard(self, body: Body) -> None:
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
        asked = Demand(Vec3(0.0, 0.0, demand.yaw_rate_rad_s), demand.speed_m_s)
        return Flown(asked, found.reference, found.law, turns, around)

    def neutral(self, estimate: Estimate) -> Demand:
        """Stand."""
        return _NEUTRAL


def ground_parameters(config: Config, origin_ned_m: Vec3, values: Mapping[str, float]) -> Parameters:
    """Of the configuration's limits and the autopilot's (`values`, in its units) the tighter hold.

    An acceleration of 0 is no limit there.
    """
    ground = config.ground
    base = parameters(config.law, config.limits, origin_ned_m, planar=True)
    limits = base.limits
    limits = limits._replace(
        speed_max_m_s=min(limits.speed_max_m_s, values.get("WP_SPEED") or inf),
        yaw_rate_rad_s=min(limits.yaw_rate_rad_s, radians(values.get("ATC_STR_RAT_MAX") or inf)),
        acceleration_m_s2=min(
            limits.acceleration_m_s2, ACCELERATION_PART * (values.get("ATC_ACCEL_MAX") or inf)
        ),
        yaw_acceleration_rad_s2=min(
            limits.yaw_acceleration_rad_s2, radians(values.get("ATC_STR_ACC_MAX") or inf)
        ),
    )
    radius_m = ground.turning_radius_m
    if radius_m is None:
        radius_m = values.get("TURN_RADIUS", 0.0)
    crawl_m_s = radius_m * limits.yaw_rate_rad_s if ground.crawl_m_s is None else ground.crawl_m_s
    lateral = ground.lateral_acceleration_max_m_s2
    if lateral is None:
        lateral = LATERAL_PART * GRAVITY_M_S2 * (values.get("ATC_TURN_MAX_G") or inf)
    return Parameters(
        law=base._replace(limits=limits),
        crawl_m_s=min(crawl_m_s, limits.speed_max_m_s),
        lateral_acceleration_m_s2=lateral,
        yaw_gain=ground.yaw_gain,
        smoothing=smoothing.Parameters(time_constant_s=ground.smoothing_s, jump_m=0.5),
        slip=slip.Parameters(time_constant_s=2.0, speed_min_m_s=0.7, bound_rad=radians(ground.slip_max_deg)),
        speed_loop=speed_loop.Parameters(
            kp=ground.speed_kp,
            ki=ground.speed_ki_per_s,
            lag_s=ground.speed_lag_s,
            part=0.5,
        ),
        waiting=WAITING if ground.waits else waiting.OFF,
        stuck=stuck.Parameters(asked_m_s=0.3, speed_m_s=0.15, yaw_rate_rad_s=0.05, after_s=ground.stuck_s),
    )
