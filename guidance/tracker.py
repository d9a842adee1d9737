"""From a state to a setpoint: the trajectory in the vehicle's frame, the handling, the profile's ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from guidance.blending import (
    NO_OFFSET,
    NO_TURN,
    Blending,
    blended,
    blending,
    offset_step,
    shifted,
    spare_speed_m_s,
    turn_step,
)
from guidance.config import Config
from guidance.estimate import Estimate
from guidance.flying import Caution, Flown
from guidance.flying.choice import handler_of
from guidance.law import Evaluation, planar
from guidance.mavlink.messages import AutopilotVersion, GpsGlobalOrigin, HomePosition
from guidance.mavlink.profiles import Profile
from guidance.mavlink.setpoints import Outgoing, outgoing
from guidance.prediction import NOTHING_SENT, History, sent
from guidance.se3 import (
    ZERO,
    Pose,
    Reference,
    Vec3,
    add,
    compose,
    conjugate,
    exp,
    multiply,
    norm,
    quaternion_exp,
    quaternion_log,
    subtract,
)
from guidance.trajectory import Trajectory, sample
from guidance.tuning import approach_m_s, cannot_allocate, rates_of


class Solution(NamedTuple):
    """One evaluation: what was flown, and what the profile makes of it.

    The reference that was tracked is the trajectory moved by `offset_ned_m`.
    """

    trajectory_s: float
    offset_ned_m: Vec3
    flown: Flown
    outgoing: Outgoing

    @property
    def reference(self) -> Reference:
        """What was tracked."""
        return self.flown.reference

    @property
    def evaluation(self) -> Evaluation:
        """The law's."""
        return self.flown.evaluation


class Tracker:
    """Knows the trajectory's origin and start; both are fixed at the first tracking tick.

    A flight that is held keeps its origin, and `paused_s`, the trajectory's time at which it goes on.
    `allocation` names the actuators that turn the vehicle; it outlives a flight, as a broken actuator does.
    """

    def __init__(self, config: Config, profile: Profile) -> None:
        self.start_ns: int | None = None
        self.origin_ned_m: Vec3 | None = None
        self.paused_s: float | None = None
        self._config = config
        self._trajectory = self._first = config.trajectory
        self._origin = config.flight.origin
        self.allocation: str = config.law.allocation
        self.reported_allocation: str | None = None  # what the vehicle itself said last
        self.handler = handler_of(config, profile)
        self._history = NOTHING_SENT
        self._stepped_ns = 0
        self._speed_at_full_thrust_m_s = config.vehicle.speed_at_full_thrust_m_s
        self._profile = profile
        self._row = profile
        self._forget_resets()

    def _forget_resets(self) -> None:
        self._offset = NO_OFFSET
        self._turn = NO_TURN
        self._seen: Estimate | None = None  # what the last setpoint was made of
        self._unblended = False

    @property
    def reference_offset_ned_m(self) -> Vec3:
        """How far the tracked reference is from the trajectory since resets of the autopilot's estimator; of
        a planar vehicle in the plane."""
        return ZERO if self.start_ns is None else self._offset.position

    @property
    def loaded(self) -> Trajectory | None:
        """The trajectory, if it is not the one of the start any more."""
        return None if self._trajectory == self._first else self._trajectory

    @property
    def history(self) -> History:
        """The setpoints of this flight, none before and after it."""
        return NOTHING_SENT if self.start_ns is None else self._history

    def row_for(self, version: AutopilotVersion | None) -> Profile:
        """The row by which setpoints go out from here on, of an autopilot of that version (None: not known).

        Within a flight it never goes back from what moves every version to what moves only newer ones.
        """
        self._row = self._row.for_version(version)
        return self._row

    def stop(self) -> None:
        """The flight is over; the next one starts anew."""
        self._row = self._profile
        self.start_ns = None
        self.origin_ned_m = None
        self.paused_s = None

    def pause(self, instant_ns: int) -> None:
        """The flight is held from `instant_ns` on; the next `start` continues it."""
        if self.start_ns is not None:
            self.paused_s = self._trajectory_s(instant_ns, self.start_ns)
            self.start_ns = None

    def _trajectory_s(self, instant_ns: int, start_ns: int) -> float:
        return (instant_ns - start_ns) * 1e-9 - self.handler.waited_s

    def start(self, instant_ns: int, origin_ned_m: Vec3) -> None:
        """t = 0 (after a pause, t = `paused_s`) is at `instant_ns`, and the trajectory's origin here, in the
        vehicle's local frame."""
        self.start_ns = instant_ns - round((self.paused_s or 0.0) * 1e9)
        self.paused_s = None
        self.origin_ned_m = origin_ned_m
        self.handler.start()
        self._history = NOTHING_SENT
        self._stepped_ns = instant_ns
        self._forget_resets()
        self.handler.configure(self._config, origin_ned_m, self.allocation)

    def reconfigure(self, config: Config) -> str | None:
        """Gains, limits and trajectory are these from the next setpoint on; they are checked already. Or why
        this vehicle cannot be flown with them: then nothing changes."""
        refused = self.handler.configure(config, self.origin_ned_m or ZERO, self.allocation)
        if refused is None:
            self._config = config
            self._trajectory = config.trajectory
        return refused

    def fit(self, values: Mapping[str, float]) -> str | None:
        """What the autopilot's parameters say of the vehicle holds from here on; or why it must not be flown
        with them. They are by their newest names, in their units, and each by itself plausible."""
        self.full_thrust(values)
        return self.handler.fit(values)

    def full_thrust(self, values: Mapping[str, float]) -> None:
        """Thrust 1 asks for the autopilot's own speed where it has one, whatever the configuration says."""
        self._speed_at_full_thrust_m_s = values.get(
            self._profile.full_thrust_parameter, self._config.vehicle.speed_at_full_thrust_m_s
        )

    def allocate(self, name: str) -> str | None:
        """Turn with these actuators from now on, in whatever flight; or why that is refused."""
        if name != "pitch-yaw" and self._profile.planar:
            return f"{self._profile.name} is planar and cannot roll"
        without = cannot_allocate(name, self._config.limits, self._profile.planar)
        if without is not None:
            return f"limits.{without[0]} = {without[1]:g} leaves it without that rate"
        refused = self.handler.configure(self._config, self.origin_ned_m or ZERO, name)
        if refused is None:
            self.allocation = name
        return refused

    def _blending(self) -> Blending:
        """By the limits, the law and the allocation as they now are: any may change in flight."""
        limits = self._config.limits
        keys = rates_of(self.allocation, self._profile.planar)
        accelerations = (getattr(limits, key.replace("rate", "acceleration") + "2") for key in keys)
        return blending(
            limits.speed_min_m_s,
            min(limits.speed_max_m_s, self._speed_at_full_thrust_m_s),
            min(getattr(limits, key) for key in keys),
            math.inf if limits.acceleration_max_m_s2 is None else limits.acceleration_max_m_s2,
            min((a for a in accelerations if a is not None), default=math.inf),
            approach_m_s(self._config.law.error_function),
        )

    def find_origin(
        self, position_ned_m: Vec3, ekf: GpsGlobalOrigin | None, home: HomePosition | None
    ) -> Vec3 | str:
        """The trajectory's origin in the vehicle's local frame (m), or why it is not known."""
        if self.origin_ned_m is not None:
            return self.origin_ned_m
        if self._origin == "ekf":
            return Vec3(0.0, 0.0, 0.0)
        if self._origin == "engage":
            return position_ned_m
        if ekf is None:
            return "the autopilot has not said where its local origin is (GPS_GLOBAL_ORIGIN)"
        at = (ekf.latitude * 1e-7, ekf.longitude * 1e-7, ekf.altitude * 1e-3)
        if self._origin == "home":
            if home is None:
                return "the autopilot has not said where home is (HOME_POSITION)"
            return self._profile.project(
                (home.latitude * 1e-7, home.longitude * 1e-7, home.altitude * 1e-3), at
            )
        return self._profile.project(self._origin, at)

    def unmet(self, estimate: Estimate, ekf: GpsGlobalOrigin | None, home: HomePosition | None) -> str | None:
        """Why a flight must not begin now, as what flies the vehicle sees it; the origin must be known."""
        origin = self.find_origin(estimate.pose.position, ekf, home)
        assert isinstance(origin, Vec3)
        return self.handler.unmet(estimate, origin, _ground_down_m(ekf, home))

    def cautions(
        self, estimate: Estimate, ekf: GpsGlobalOrigin | None, home: HomePosition | None
    ) -> tuple[Caution, ...]:
        """What must be known before a flight from here, and forbids none; nothing before the origin is."""
        origin = self.find_origin(estimate.pose.position, ekf, home)
        if isinstance(origin, str):
            return ()
        return self.handler.cautions(estimate, origin, _ground_down_m(ekf, home))

    def start_error_m(self, position_ned_m: Vec3, origin_ned_m: Vec3) -> float:
        """|x - r| where the flight begins or goes on, in the plane for a planar vehicle."""
        at = sample(self._trajectory, self.paused_s or 0.0).position
        error = subtract(position_ned_m, add(origin_ned_m, at))
        return math.hypot(error.x, error.y) if self._profile.planar else norm(error)

    def estimator_reset(self, estimate: Estimate | str) -> None:
        """The estimator was reset, and `estimate` is the first state after; without one the next is.

        To be called before the setpoint that is made of it: what no motion since the setpoint before explains
        is blended. All that was found in one read is one jump, however many there were and of whatever kind.
        """
        if self.start_ns is None or self._seen is None:
            return  # nothing was made of the frame before
        self._unblended = isinstance(estimate, str)
        if isinstance(estimate, str):
            return
        before, self._seen = self._seen, estimate
        since_s = (estimate.instant_ns - before.instant_ns) * 1e-9
        led = compose(before.pose, exp(before.twist, since_s))
        jump = subtract(estimate.pose.position, led.position)
        self._offset = shifted(self._offset, jump._replace(z=0.0) if self._profile.planar else jump)
        self.handler.shifted(jump)
        kept = multiply(quaternion_exp(self._turn.angle_rad), led.attitude)
        turn = quaternion_log(multiply(kept, conjugate(estimate.pose.attitude)))
        self._turn = self._turn._replace(angle_rad=turn)

    def solve(self, estimate: Estimate) -> Solution:
        """The law at the estimate's instant; `start` must have been called."""
        assert self.start_ns is not None
        assert self.origin_ned_m is not None
        trajectory_s = self._trajectory_s(estimate.instant_ns, self.start_ns)
        position, velocity, acceleration = sample(self._trajectory, trajectory_s)
        reference = Reference(add(self.origin_ned_m, position), velocity, acceleration)
        dt_s = max(estimate.instant_ns - self._stepped_ns, 0) * 1e-9
        self._stepped_ns = estimate.instant_ns
        if self._unblended:
            self.estimator_reset(estimate)
        self._seen = estimate
        if self._turn is not NO_TURN:
            self._turn = turn_step(self._turn, dt_s)
            turn = quaternion_exp(self._turn.angle_rad)
            pose, seen = (
                Pose(pose.position, multiply(turn, pose.attitude)) for pose in (estimate.pose, estimate.seen)
            )
            estimate = estimate._replace(pose=pose, seen=seen)
        if self._profile.planar:
            _, reference = planar(estimate.pose, reference)
        if self._offset is not NO_OFFSET:
            limits = self._blending()
            self._offset = offset_step(limits, self._offset, spare_speed_m_s(limits, reference), dt_s)
            reference = blended(reference, self._offset)
        flown = self.handler.step(estimate, reference, dt_s)
        self._history = sent(self._history, estimate.instant_ns, flown.acting_rates_frd_rad_s)
        out = outgoing(self._row, flown.demand, self._speed_at_full_thrust_m_s)
        return Solution(trajectory_s, self._offset.position, flown, out)

    def neutral(self, estimate: Estimate) -> Outgoing:
        """What asks the vehicle to stay as it is."""
        return outgoing(self._row, self.handler.neutral(estimate), self._speed_at_full_thrust_m_s)


def _ground_down_m(ekf: GpsGlobalOrigin | None, home: HomePosition | None) -> float | None:
    """Of home, in the vehicle's local frame; None if it is not known."""
    return None if ekf is None or home is None else (ekf.altitude - home.altitude) * 1e-3


def is_usable(solution: Solution) -> bool:
    """Whether every number that would be sent or logged is finite."""
    return solution.outgoing.is_finite() and solution.flown.is_finite()
