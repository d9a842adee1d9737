"""Airplanes: `handling.airplane` with what the configuration, the autopilot and earlier flights say.

The handling predicts by itself (`airplane_prediction`), by the banks that are under way and in the wind. So
it is given the pose and the velocity of the newest position, before the estimator's prediction, and how much
later the demand acts.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, inf, isfinite, radians, sin, sqrt
from typing import Annotated, Final

import msgspec
from msgspec import Meta

from guidance.abilities import FREE, AirplaneAbilities, Bound
from guidance.config import Config, profile_of
from guidance.estimate import Estimate
from guidance.flying import Caution, Flown
from guidance.flying.airplane_feasible import abilities_of, cannot_fly
from guidance.flying.airplane_fit import Fitted, assumed, fitted, thinness
from guidance.flying.cautioning import about_parameters, about_the_way
from guidance.handling import airplane, airplane_throttle, airplane_wind, smoothing
from guidance.handling.airplane import UNTRIMMED, Measured, Parameters, Trims, airplane_step
from guidance.handling.airplane_rates import body_rates, turn_rate_rad_s
from guidance.law import Controls, Evaluation
from guidance.limits import clamp
from guidance.mavlink.air import VfrHud, Wind, WindCov
from guidance.mavlink.messages import Body
from guidance.mavlink.setpoints import Demand
from guidance.records import AirplaneHandling
from guidance.se3 import (
    ZERO,
    Quaternion,
    Reference,
    Vec3,
    add,
    dot,
    from_euler,
    norm,
    pitch_of,
    roll_of,
    subtract,
    yaw_of,
)

#: An airspeed, or a wind, that is older is not used; the estimate of the wind then stays.
AIRSPEED_S: Final = 2.0
WIND_S: Final = 10.0
#: No airplane flies so fast (m/s), and nobody flies in such a wind.
ABSURD_AIRSPEED_M_S: Final = 1000.0
ABSURD_WIND_M_S: Final = 100.0
#: Slower than this part of its least airspeed, about its stall, it does not fly.
FLIES_PART: Final = 0.7
#: Above home: lower, one that dives for its airspeed meets the ground.
LEAST_HEIGHT_M: Final = 10.0
#: What is looked at anew when it changes by so much: the air's thinness, and the floor below the origin, m.
THIN_STEP: Final = 0.01
FLOOR_STEP_M: Final = 0.5
#: By which the error of the velocity is found, of PX4's estimator; ArduPilot's is taken to have none.
SMOOTHING: Final = smoothing.Parameters(0.3, 2.0, error_s=smoothing.ERROR_S, error_max_m_s=1.0)


class Kept(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What one process leaves for the next, as JSON; the ranges are those that are learned in."""

    effectiveness: Annotated[float, Meta(ge=0.6, le=1.3)]
    pitch_rad: Annotated[float, Meta(ge=-0.15, le=0.15)]
    throttle: Annotated[float, Meta(ge=-0.3, le=0.3)]


class Airplane:
    """Before `fit`, and without the airspeeds in the configuration, it cannot fly: it levels the wings."""

    def __init__(self, config: Config) -> None:
        self._values: Mapping[str, float] = {}
        self._memory = airplane.unstarted(UNTRIMMED)
        px4 = profile_of(config).firmware == "PX4"
        self._smoothing = SMOOTHING if px4 else SMOOTHING._replace(error_s=0.0)
        self._smooth, self._smooth_ns = smoothing.UNSTARTED, 0
        self._fitted: Fitted | None = None
        self._period_s = 1.0 / config.link.rate_hz
        self._airspeed_m_s, self._airspeed_ns = 0.0, 0
        self._wind_ned_m_s: Vec3 | None = None
        self._wind_ns = 0
        self._thinness = self._thin = 1.0
        self._ground_down_m: float | None = None
        self._config = config
        self.configure(config, ZERO, config.law.allocation)

    @property
    def waited_s(self) -> float:
        """As `Handler` says."""
        return self._memory.waiting.waited_s

    @property
    def trims(self) -> Trims:
        """What has been learned so far, in this flight and those before."""
        return airplane.trims_of(self._memory)

    @property
    def learned(self) -> str:
        """As `Handler` says."""
        return msgspec.json.encode(Kept(*self.trims)).decode()

    def recall(self, learned: str) -> str | None:
        """As `Handler` says."""
        try:
            kept = msgspec.json.decode(learned, type=Kept)
        except (msgspec.MsgspecError, ValueError, RecursionError) as error:
            return str(error)
        self._memory = airplane.unstarted(Trims(kept.effectiveness, kept.pitch_rad, kept.throttle))
        return None

    def configure(self, config: Config, origin_ned_m: Vec3, allocation: str) -> str | None:
        """As `Handler` says; while the airplane is not known yet, anything is taken."""
        found = fitted(config, self._values, self._thin)
        why = found if isinstance(found, str) else None
        if isinstance(found, Fitted) and config.trajectory != self._config.trajectory:
            why = cannot_fly(config.trajectory, found.parameters, self.trims)
        if why is not None and self._fitted is not None:
            return why
        self._config = config
        if isinstance(found, Fitted):
            self._take(found)
        return None

    def fit(self, values: Mapping[str, float]) -> str | None:
        """As `Handler` says."""
        self._values = dict(values)
        found = fitted(self._config, self._values, self._thin)
        if isinstance(found, str):
            return found
        self._take(found)
        return cannot_fly(self._config.trajectory, found.parameters, self.trims)

    def _take(self, found: Fitted) -> None:
        """Without a floor that is configured, the ground is it."""
        envelope = found.parameters.envelope
        if self._config.airplane.floor_down_m is None and self._ground_down_m is not None:
            envelope = envelope._replace(floor_down_m=self._ground_down_m)
        self._fitted = found._replace(parameters=found.parameters._replace(envelope=envelope))

    def abilities(self) -> AirplaneAbilities | None:
        """As `Handler` says; the floor is looked at before a flight."""
        return None if self._fitted is None else abilities_of(self._fitted.parameters, self.trims)

    def unmet(self, estimate: Estimate, origin_ned_m: Vec3, ground_down_m: float | None) -> str | None:
        """As `Handler` says: the air's density, the airspeed, the trajectory in wind and above the floor."""
        self._ground_down_m = ground_down_m
        self._thin = THIN_STEP * round(self._thinness / THIN_STEP)
        found = fitted(self._config, self._values, self._thin)
        if isinstance(found, str):
            return found
        self._take(found)
        p = found.parameters
        airspeed_m_s, wind = self._air(estimate.instant_ns)
        most_m_s = self._config.airplane.wind_max_m_s
        if wind is not None and norm(wind) > most_m_s:
            return f"the wind is {norm(wind):.1f} m/s, airplane.wind_max_m_s = {most_m_s:g}: no flight"
        slow = _too_slow(p, estimate.position.velocity_ned_m_s, airspeed_m_s, wind)
        if slow is not None:
            return slow
        low = self._too_low(estimate.pose.position.z, ground_down_m)
        if low is not None:
            return low
        floor = FREE
        if self._config.airplane.floor_down_m is not None:
            floor = Bound(self._config.airplane.floor_down_m, "airplane.floor_down_m")
        elif ground_down_m is not None:
            floor = Bound(ground_down_m, "HOME_POSITION; airplane.floor_down_m may say otherwise")
        if floor is not FREE:
            below_m = floor.value - origin_ned_m.z
            floor = floor._replace(value=FLOOR_STEP_M * round(below_m / FLOOR_STEP_M))
        return cannot_fly(self._config.trajectory, p, self.trims, wind or ZERO, floor)

    def _too_low(self, down_m: float, ground_down_m: float | None) -> str | None:
        """Why it is not engaged at this height, in words that stay; a floor that is set counts, not home."""
        floor_m = self._config.airplane.floor_down_m
        if floor_m is not None:
            return (
                f"it is below airplane.floor_down_m = {floor_m:g}: climb first" if down_m > floor_m else None
            )
        if ground_down_m is None or ground_down_m - down_m >= LEAST_HEIGHT_M:
            return None
        return (
            f"it is less than {LEAST_HEIGHT_M:g} m above HOME_POSITION: climb first, or set "
            "airplane.floor_down_m if the ground is lower here"
        )

    def cautions(
        self, estimate: Estimate, origin_ned_m: Vec3, ground_down_m: float | None
    ) -> tuple[Caution, ...]:
        """Of the trajectory in the wind, the wind, the ground, and what the autopilot does not tell."""
        able = self.abilities()
        if able is None:
            return ()
        _, wind = self._air(estimate.instant_ns)
        found = about_the_way(self._config.trajectory, able, wind or ZERO)
        if wind is None:
            text = "no wind is told: whether it can be flown was looked at in calm air"
            found += (Caution("wind", text),)
        if ground_down_m is None and self._config.airplane.floor_down_m is None:
            text = (
                "where the ground is is not known (HOME_POSITION), nor is airplane.floor_down_m set: no floor"
            )
            found += (Caution("ground", text),)
        return (*found, *about_parameters(assumed(self._config, self._values)))

    def heard(self, body: Body, now_ns: int) -> None:
        """Airspeed and wind."""
        match body:
            case VfrHud(airspeed=airspeed, alt=alt) if 0.0 <= airspeed < ABSURD_AIRSPEED_M_S:
                self._thinness = thinness(alt)
                self._airspeed_m_s, self._airspeed_ns = airspeed * self._thinness, now_ns
            case Wind(direction=from_deg, speed=speed) if isfinite(from_deg):
                north, east = -speed * cos(radians(from_deg)), -speed * sin(radians(from_deg))
                self._blows(Vec3(north, east, 0.0), now_ns)
            case WindCov(wind_x=north, wind_y=east):
                self._blows(Vec3(north, east, 0.0), now_ns)

    def _blows(self, wind_ned_m_s: Vec3, now_ns: int) -> None:
        if norm(wind_ned_m_s) < ABSURD_WIND_M_S:
            self._wind_ned_m_s, self._wind_ns = wind_ned_m_s, now_ns

    def _air(self, instant_ns: int) -> tuple[float, Vec3 | None]:
        """True airspeed (0: none) and wind (None: none), of what was heard not too long before."""
        airspeed_m_s = self._airspeed_m_s if (instant_ns - self._airspeed_ns) * 1e-9 < AIRSPEED_S else 0.0
        return airspeed_m_s, self._wind_ned_m_s if (instant_ns - self._wind_ns) * 1e-9 < WIND_S else None

    def wind_ned_m_s(self, instant_ns: int) -> Vec3 | None:
        """As the autopilot tells it, None if it does not."""
        return self._air(instant_ns)[1]

    @property
    def floor_down_m(self) -> float:
        """The least height that is flown, NED; inf if none is known."""
        return inf if self._fitted is None else self._fitted.parameters.envelope.floor_down_m

    def start(self) -> None:
        """As `Handler` says; what was learned is kept."""
        self._memory = airplane.unstarted(self.trims)
        self._smooth, self._smooth_ns = smoothing.UNSTARTED, 0

    def shifted(self, jump_ned_m: Vec3) -> None:
        """As `Handler` says."""
        self._smooth = self._smooth._replace(position=add(self._smooth.position, jump_ned_m))

    def step(self, estimate: Estimate, reference: Reference, dt_s: float) -> Flown:
        """The first step is taken to be as long as the others."""
        assert self._fitted is not None, "an airplane that does not fit is not engaged"
        p = self._fitted.parameters
        dt_s = dt_s or self._period_s
        airspeed_m_s, wind = self._air(estimate.instant_ns)
        age_s, velocity = max(estimate.position_age_s, 0.0), estimate.position.velocity_ned_m_s
        error = self._error(estimate.seen.position, velocity, estimate.instant_ns, age_s)
        velocity = subtract(velocity, error)
        measured = Measured(estimate.seen, velocity, airspeed_m_s, wind is not None, wind or ZERO, age_s)
        waited_s = self.waited_s
        self._memory, demand, found = airplane_step(p, self._memory, measured, reference, dt_s)
        turning = self._rates(
            p, estimate.pose.attitude, demand.roll_rad, demand.pitch_rad, found.airspeed_m_s
        )
        rates = estimate.attitude.body_rates_frd_rad_s
        if self._config.airplane.output == "rates":
            rates = turning
        asked = Demand(turning, attitude=demand.attitude, throttle=demand.throttle)
        evaluation = _evaluation(p, found, turning, velocity)
        around = self._record(estimate, demand, found, waited_s, measured)
        return Flown(asked, found.reference, evaluation, rates, around)

    def _error(self, position: Vec3, velocity: Vec3, instant_ns: int, age_s: float) -> Vec3:
        """By how much the velocity is too large, from what was measured and when."""
        seen_ns = instant_ns - round(age_s * 1e9)
        dt_s = (seen_ns - self._smooth_ns) * 1e-9
        if dt_s > 0.0:
            self._smooth_ns = seen_ns
            self._smooth = smoothing.smoothing_step(self._smoothing, self._smooth, position, velocity, dt_s)
        return self._smooth.error

    def neutral(self, estimate: Estimate) -> Demand:
        """Level wings at the measured heading, pitch and throttle of level flight at the cruise airspeed."""
        heading = yaw_of(estimate.pose.attitude)
        if self._fitted is None:
            return Demand(attitude=from_euler(0.0, 0.0, heading))
        p, V = self._fitted
        pitch, throttle = p.pitch, p.throttle
        alpha = pitch.alpha_zero_rad + pitch.alpha_per_load_rad_m2_s2 / (V * V)
        level = clamp(alpha + self.trims.pitch_rad, pitch.lowest_rad, pitch.highest_rad)
        drag = airplane_throttle.drag_m_s2(throttle, V, 1.0) / throttle.thrust_m_s2
        power = clamp(drag + self.trims.throttle, throttle.lowest, throttle.highest)
        levelling = self._rates(p, estimate.pose.attitude, 0.0, level, V)
        return Demand(levelling, attitude=from_euler(0.0, level, heading), throttle=power)

    def _rates(
        self, p: Parameters, attitude: Quaternion, roll_rad: float, pitch_rad: float, airspeed_m_s: float
    ) -> Vec3:
        """Body rates from the attitude to this roll and pitch, within the limits."""
        limits, gain = self._config.limits, self._config.airplane.attitude_gain_per_s
        roll, pitch = roll_of(attitude), pitch_of(attitude)
        most = limits.pitch_rate_max_rad_s
        wanted = body_rates(
            roll,
            pitch,
            clamp(gain * (roll_rad - roll), -p.roll_rate_rad_s, p.roll_rate_rad_s),
            clamp(gain * (pitch_rad - pitch), -most, most),
            turn_rate_rad_s(roll, airspeed_m_s, self.trims.effectiveness),
        )
        bounds = (limits.roll_rate_max_rad_s, most, limits.yaw_rate_max_rad_s)
        return Vec3(*(clamp(rate, -bound, bound) for rate, bound in zip(wanted, bounds, strict=True)))

    def _record(
        self,
        estimate: Estimate,
        demand: airplane.Demand,
        found: airplane.Evaluation,
        waited_s: float,
        measured: Measured,
    ) -> AirplaneHandling:
        sensed = measured.airspeed_m_s > 0.0 and not found.airspeed_doubted
        return AirplaneHandling(
            t_ns=estimate.instant_ns,
            course_rad=found.course_rad,
            course_off_rad=found.course_off_rad,
            bank_asked_rad=demand.roll_rad,
            pitch_asked_rad=demand.pitch_rad,
            load=found.load,
            climb_asked_m_s=found.climb_m_s,
            airspeed_m_s=found.airspeed_m_s,
            airspeed_asked_m_s=found.asked_m_s,
            wind_ned_m_s=found.wind_ned_m_s,
            effectiveness=found.trims.effectiveness,
            pitch_trim_rad=found.trims.pitch_rad,
            throttle_trim=found.trims.throttle,
            clock_rate=found.clock_rate,
            waited_s=waited_s,
            turning_aside=found.turn_aside != 0,
            bank_saturated=found.bank_saturated,
            pitch_saturated=found.pitch_saturated,
            throttle_saturated=found.throttle_saturated,
            climb_limited=found.climb_limited,
            floored=found.floored,
            stall_guard=found.stall_guard,
            airspeed_doubted=found.airspeed_doubted,
            blind=not (sensed or measured.wind_given),
        )


def _too_slow(
    p: Parameters, velocity_ned_m_s: Vec3, airspeed_m_s: float, wind_ned_m_s: Vec3 | None
) -> str | None:
    """Why nothing can be flown by this airspeed, in words that stay as long as the reason does."""
    airspeed, least = airspeed_m_s, p.envelope.airspeed_min_m_s
    if wind_ned_m_s is not None:
        through = norm(subtract(velocity_ned_m_s, wind_ned_m_s))
        wind = airplane_wind.Memory(wind_ned_m_s.x, wind_ned_m_s.y, True)
        if airspeed != airplane_wind.believed_m_s(wind, velocity_ned_m_s, airspeed, inf):
            return (
                "the airspeed (VFR_HUD) is not that of velocity and wind: is the sensor blocked? Else wait "
                "until the autopilot knows the wind"
            )
        airspeed = airspeed or through
    if airspeed == 0.0:
        return (
            "no airspeed: VFR_HUD tells none, and no wind is told either; the autopilot needs a sensor "
            "or an estimate"
        )
    if airspeed < FLIES_PART * least:
        # no number that changes: this stands in `status` as long as it stands on the ground
        slow = FLIES_PART * least
        return f"the airspeed is below {slow:.3g} m/s, the least {least:.3g}: take off, this only flies"
    return None


def _evaluation(p: Parameters, found: airplane.Evaluation, turning: Vec3, velocity: Vec3) -> Evaluation:
    """What the law's evaluation is of a body that points where the airplane flies.

    y4, y5, y6 are the field along the velocity over ground, to its right and below; V1 is phi of the bounded
    field, its parts in the plane and in the vertical with their own k. The controls are the body rates and
    the airspeed that are asked for, all within their limits.
    """
    e, wanted = found.e, found.wanted
    level = sqrt(velocity.x * velocity.x + velocity.y * velocity.y)
    speed = max(sqrt(level * level + velocity.z * velocity.z), airplane.MOVING_M_S)
    c, s = level / speed, -velocity.z / speed
    on = wanted.speed_m_s * cos(found.course_off_rad)
    y5 = wanted.speed_m_s * sin(found.course_off_rad)
    y6 = on * s - wanted.climb_m_s * c
    across2 = dot(e, e) - e.z * e.z
    controls = Controls(turning.x, turning.y, turning.z, found.asked_m_s)
    return Evaluation(
        controls=controls,
        demanded=controls,
        e=e,
        y4=on * c + wanted.climb_m_s * s,
        y5=y5,
        y6=y6,
        V1=_bounded(p.k_per_s, p.approach_m_s, across2)
        + _bounded(p.k_up_per_s, p.approach_up_m_s, e.z * e.z),
        V2=0.5 * (y5 * y5 + y6 * y6),
        saturated=found.bank_saturated or found.pitch_saturated or found.throttle_saturated,
        singular=found.turn_aside != 0,
    )


def _bounded(k: float, approach_m_s: float, e2: float) -> float:
    """k delta (sqrt(delta^2 + |e|^2) - delta), as `error_function` has it for `BOUNDED`."""
    delta = approach_m_s / k
    return k * delta * (e2 / (sqrt(delta * delta + e2) + delta))
