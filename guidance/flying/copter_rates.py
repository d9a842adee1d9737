"""Copters that are told body rates and thrust: `flying.velocity`, and `handling.copter_rates` after it.

The pose goes on at the velocity that was measured, and that at the accelerations that were asked for
meanwhile: so the delay is out of the loop on velocity, as the rates that were sent take it out of that on the
tilt (`prediction`). The attitude is the autopilot's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import hypot
from typing import Annotated, Final, NamedTuple

import msgspec
from msgspec import Meta
from pymavlink.dialects.v20 import all as dialect

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
from guidance.mavlink.messages import Body, ExtendedSysState
from guidance.mavlink.setpoints import Demand
from guidance.prediction import REMEMBERED
from guidance.records import VelocityHandling
from guidance.se3 import (
    ZERO,
    Pose,
    Reference,
    Twist,
    Vec3,
    add,
    from_yaw,
    rotate,
    rotate_inverse,
    scale,
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


class Given(NamedTuple):
    """What the velocity changes by (NED), from this instant on."""

    instant_ns: int
    acceleration_ned_m_s2: Vec3


class CopterRates(Velocity):
    """Before `fit` it cannot fly."""

    def __init__(self, config: Config) -> None:
        self._by_rates: Parameters | None = None
        self._hover_part = 1.0
        self._stands = False
        self._inner: Memory | None = None
        self._inner_ns = 0
        self._history: tuple[Given, ...] = ()
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

    def heard(self, body: Body, now_ns: int) -> None:
        """Whether it stands: the ground carries it then, and teaches nothing of its thrust."""
        if isinstance(body, ExtendedSysState):
            self._stands = body.landed_state == dialect.MAV_LANDED_STATE_ON_GROUND

    def start(self) -> None:
        """As `Handler` says; what it leans by is found anew."""
        super().start()
        self._history = ()

    def step(self, estimate: Estimate, reference: Reference, dt_s: float) -> Flown:
        """The first step is taken to be as long as the others."""
        assert self._parameters is not None, "a copter that does not fit is not engaged"
        assert self._by_rates is not None, "a copter that does not fit is not engaged"
        waited_s, dt_s = self.waited_s, dt_s or self._period_s
        seen = led(estimate, self._history)
        velocity = rotate(seen.pose.attitude, seen.twist.linear)
        self._memory, wanted, found = velocity_step(self._parameters, self._memory, seen, reference, dt_s)
        attitude = estimate.attitude_at(estimate.instant_ns)
        inner, demand, ends = rates_step(
            self._by_rates,
            self._steady(estimate, velocity),
            attitude,
            velocity,
            wanted.velocity_ned_m_s,
            wanted.yaw_rate_rad_s,
            0.0 if self._stands else dt_s,
        )
        self._inner, self._inner_ns, self._hover_part = inner, estimate.instant_ns, inner.hover_part
        self._history = (*self._history[1 - REMEMBERED :], self._given(inner, found, velocity))
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
        self._inner, self._inner_ns = before._replace(held_ned_m_s2=held), estimate.instant_ns
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

    def _given(self, inner: Memory, found: Around, velocity: Vec3) -> Given:
        """What the velocity changes by from now on: of what is given, wind and air take theirs. Wind is what
        is held, but for the air's part that `response` leaves to be held after a while."""
        assert self._by_rates is not None
        p, stood = self._by_rates, self._memory.response.stood_m_s
        given, held, c = inner.given_ned_m_s2, inner.held_ned_m_s2, found.drag_per_s
        rises = given.z + p.p_up_per_s * stood.z - c * velocity.z
        if p.climbs:
            rises = found.acceleration_ned_m_s2.z
        return Given(
            self._inner_ns,
            Vec3(
                given.x - held.x + p.p_per_s * stood.x - c * velocity.x,
                given.y - held.y + p.p_per_s * stood.y - c * velocity.y,
                rises,
            ),
        )

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


def led(estimate: Estimate, history: tuple[Given, ...]) -> Measured:
    """The vehicle at the estimate's instant, level: from the newest position on at its velocity, which
    changes as it was asked to, and with the nose where the rates under way bring it."""
    position, at = estimate.position, estimate.seen.position
    velocity, now_ns, by = position.velocity_ned_m_s, position.instant_ns, ZERO
    for instant_ns, acceleration in (*history, Given(estimate.instant_ns, ZERO)):
        if instant_ns > now_ns:
            at, velocity = _moved(at, velocity, by, (min(instant_ns, estimate.instant_ns) - now_ns) * 1e-9)
            now_ns = instant_ns
        by = acceleration
    heading = from_yaw(yaw_of(estimate.pose.attitude))
    turning = rotate(estimate.attitude.attitude, estimate.attitude.body_rates_frd_rad_s).z
    twist = Twist(Vec3(0.0, 0.0, turning), rotate_inverse(heading, velocity))
    return Measured(Pose(at, heading), twist, turning)


def _moved(at: Vec3, velocity: Vec3, acceleration: Vec3, dt_s: float) -> tuple[Vec3, Vec3]:
    later = add(velocity, scale(dt_s, acceleration))
    return add(at, scale(0.5 * dt_s, add(velocity, later))), later


def _demand(demand: copter_rates.Demand) -> Demand:
    return Demand(demand.body_rates_frd_rad_s, throttle=demand.thrust)
