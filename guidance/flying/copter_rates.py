"""Copters that are told body rates and thrust: `flying.velocity`, and `handling.copter_rates` after it.

The pose goes on at the velocity that was measured, and that at the acceleration that is asked for: it is
known here, and the nose need not point where the vehicle goes. The attitude is the autopilot's own, turned on
by the rates that are under way to it.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import hypot
from typing import Annotated, Final

import msgspec
from msgspec import Meta

from guidance.config import Config
from guidance.estimate import Estimate
from guidance.flying import Flown
from guidance.flying.copter_rates_fit import rates_fitted
from guidance.flying.velocity import Velocity
from guidance.handling import copter_rates
from guidance.handling.copter_rates import (
    HOVER_LEAST,
    HOVER_MOST,
    Ends,
    Memory,
    Parameters,
    rates_step,
    standing,
)
from guidance.handling.velocity import Around, Measured, velocity_step
from guidance.mavlink.setpoints import Demand
from guidance.records import VelocityHandling
from guidance.se3 import (
    ZERO,
    Pose,
    Reference,
    Twist,
    Vec3,
    from_yaw,
    rotate,
    rotate_inverse,
    yaw_of,
)

#: What it leans by itself is averaged over this time (s), while neutral setpoints go out.
STANDS_S: Final = 2.0
#: After a longer gap it is looked at anew.
GAP_S: Final = 0.5
#: Half of the thrust, no climb: what is said before the autopilot's parameters are known. It acts on nothing.
_HALF: Final = 0.5


class Kept(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What one process leaves for the next, as JSON; the range is the one that is learned in."""

    hover_part: Annotated[float, Meta(ge=HOVER_LEAST, le=HOVER_MOST)]


class CopterRates(Velocity):
    """Before `fit` it cannot fly."""

    def __init__(self, config: Config) -> None:
        self._by_rates: Parameters | None = None
        self._hover_part = 1.0
        self._inner: Memory | None = None
        self._inner_ns = 0
        self._acceleration = ZERO
        super().__init__(config)

    @property
    def learned(self) -> str:
        """As `Handler` says: the hover thrust, over the one that the autopilot tells."""
        return msgspec.json.encode(Kept(self._hover_part)).decode()

    def recall(self, learned: str) -> str | None:
        """As `Handler` says."""
        try:
            kept = msgspec.json.decode(learned, type=Kept)
        except (msgspec.MsgspecError, ValueError, RecursionError) as error:
            return str(error)
        self._hover_part, self._inner = kept.hover_part, None
        return None

    def configure(self, config: Config, origin_ned_m: Vec3, allocation: str) -> str | None:
        """As `Handler` says."""
        why = super().configure(config, origin_ned_m, allocation)
        return why or self._adopt_rates(config, self._values, flies=self._by_rates is not None)

    def fit(self, values: Mapping[str, float]) -> str | None:
        """As `Handler` says."""
        return super().fit(values) or self._adopt_rates(self._config, values, flies=True)

    def _adopt_rates(self, config: Config, values: Mapping[str, float], *, flies: bool) -> str | None:
        if self._parameters is None:
            return None
        found = rates_fitted(config, self._parameters, values)
        if isinstance(found, str):
            return found if flies else None
        self._by_rates = found
        return None

    def start(self) -> None:
        """As `Handler` says; what it leans by is found anew."""
        super().start()
        self._acceleration = ZERO

    def step(self, estimate: Estimate, reference: Reference, dt_s: float) -> Flown:
        """The first step is taken to be as long as the others."""
        assert self._parameters is not None, "a copter that does not fit is not engaged"
        assert self._by_rates is not None, "a copter that does not fit is not engaged"
        waited_s, dt_s = self.waited_s, dt_s or self._period_s
        seen = led(estimate, self._acceleration)
        velocity = rotate(seen.pose.attitude, seen.twist.linear)
        self._memory, wanted, found = velocity_step(self._parameters, self._memory, seen, reference, dt_s)
        self._acceleration = found.acceleration_ned_m_s2
        attitude = estimate.attitude_at(estimate.instant_ns)
        inner, demand, ends = rates_step(
            self._by_rates,
            self._steady(estimate, velocity),
            attitude,
            velocity,
            wanted.velocity_ned_m_s,
            wanted.yaw_rate_rad_s,
            dt_s,
        )
        self._inner, self._inner_ns, self._hover_part = inner, estimate.instant_ns, inner.hover_part
        asked = _demand(demand)
        evaluation = found.law._replace(saturated=found.law.saturated or ends.tilt or ends.thrust)
        record = self._recorded(estimate, found, waited_s, ends)
        return Flown(asked, found.reference, evaluation, demand.body_rates_frd_rad_s, record)

    def neutral(self, estimate: Estimate) -> Demand:
        """Stand in the air: brake as the limits allow, and hold against the wind."""
        if self._parameters is None or self._by_rates is None:
            return Demand(throttle=_HALF)
        p, limits = self._by_rates, self._parameters.limits
        velocity = estimate.position.velocity_ned_m_s
        attitude = estimate.attitude_at(estimate.instant_ns)
        since_s = (estimate.instant_ns - self._inner_ns) * 1e-9
        before = self._steady(estimate, velocity)
        now = standing(p, self._hover_part, attitude, velocity).held_ned_m_s2
        part = min(max(since_s, 0.0), GAP_S) / STANDS_S
        held = before.held_ned_m_s2
        held = Vec3(held.x + part * (now.x - held.x), held.y + part * (now.y - held.y), 0.0)
        self._inner, self._inner_ns = Memory(held, self._hover_part), estimate.instant_ns
        speed, brake = hypot(velocity.x, velocity.y), limits.acceleration_m_s2 / p.p_per_s
        slower = max(1.0 - brake / speed, 0.0) if speed > 0.0 else 0.0
        asked = Vec3(slower * velocity.x, slower * velocity.y, 0.0)
        return _demand(rates_step(p, self._inner, attitude, velocity, asked, 0.0, 0.0)[1])

    def _steady(self, estimate: Estimate, velocity: Vec3) -> Memory:
        """What is held against the wind: as before, or after a gap by how much the vehicle leans."""
        assert self._by_rates is not None
        if self._inner is not None and 0.0 <= (estimate.instant_ns - self._inner_ns) * 1e-9 <= GAP_S:
            return self._inner
        attitude = estimate.attitude_at(estimate.instant_ns)
        return standing(self._by_rates, self._hover_part, attitude, velocity)

    def _recorded(self, estimate: Estimate, found: Around, waited_s: float, ends: Ends) -> VelocityHandling:
        assert self._inner is not None
        record = self._record(estimate, found, waited_s)
        return msgspec.structs.replace(
            record,
            held_ned_m_s2=self._inner.held_ned_m_s2,
            hover_part=self._inner.hover_part,
            tilt_limited=ends.tilt,
            thrust_limited=ends.thrust,
        )


def led(estimate: Estimate, acceleration_ned_m_s2: Vec3) -> Measured:
    """The vehicle at the estimate's instant, level: from the newest position on at its velocity, which
    changes by so much, and with the nose where the rates under way bring it."""
    age_s = max(estimate.position_age_s, 0.0)
    a, v, x = acceleration_ned_m_s2, estimate.position.velocity_ned_m_s, estimate.seen.position
    later = Vec3(v.x + age_s * a.x, v.y + age_s * a.y, v.z + age_s * a.z)
    half_s = 0.5 * age_s
    at = Vec3(x.x + half_s * (v.x + later.x), x.y + half_s * (v.y + later.y), x.z + half_s * (v.z + later.z))
    heading = from_yaw(yaw_of(estimate.pose.attitude))
    turning = rotate(estimate.attitude.attitude, estimate.attitude.body_rates_frd_rad_s).z
    return Measured(
        Pose(at, heading), Twist(Vec3(0.0, 0.0, turning), rotate_inverse(heading, later)), turning
    )


def _demand(demand: copter_rates.Demand) -> Demand:
    return Demand(demand.body_rates_frd_rad_s, throttle=demand.thrust)
