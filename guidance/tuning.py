"""[law] and [limits] of the configuration, and what becomes of them: the parameters of `law.guide_step`.

Gains, limits and approach speeds have no default. What has one is the paper's own choice: its law, its error
function, its allocation.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import inf
from typing import Annotated, Final, Literal

import msgspec
from msgspec import Meta

from guidance import allocation, error_function, law
from guidance.checking import Problem, shown
from guidance.law import Gains, Limits, Parameters
from guidance.se3 import Vec3

#: k, beta (without unit) and both rho (1/s). Far outside the law's sums of squares reach zero or infinity.
LEAST_GAIN: Final = 1e-6
MOST_GAIN: Final = 1e6
#: What a vehicle can do: below the least it stands, and above the most nothing flies.
LEAST_SPEED_M_S: Final = 1e-3
MOST_SPEED_M_S: Final = 1e3
LEAST_RATE_RAD_S: Final = 1e-3
MOST_RATE_RAD_S: Final = 100.0
#: In m/s^2 or rad/s^2.
LEAST_ACCELERATION: Final = 1e-3
MOST_ACCELERATION: Final = 1e6

Positive = Annotated[float, Meta(gt=0.0)]
NonNegative = Annotated[float, Meta(ge=0.0)]
Gain = Annotated[float, Meta(ge=LEAST_GAIN, le=MOST_GAIN)]
Speed = Annotated[float, Meta(ge=LEAST_SPEED_M_S, le=MOST_SPEED_M_S)]
Rate = Annotated[float, Meta(ge=LEAST_RATE_RAD_S, le=MOST_RATE_RAD_S)]
RateOrNone = Annotated[float, Meta(ge=0.0, le=MOST_RATE_RAD_S)]
Acceleration = Annotated[float, Meta(ge=LEAST_ACCELERATION, le=MOST_ACCELERATION)]
Metres = Annotated[float, Meta(ge=-1e5, le=1e5)]

#: Names in the configuration -> what the law takes.
LAWS: Final = {"paper": law.PAPER, "global": law.GLOBAL}
ALLOCATIONS: Final = {
    "pitch-yaw": allocation.PITCH_YAW,
    "roll-pitch": allocation.ROLL_PITCH,
    "roll-yaw": allocation.ROLL_YAW,
}


class Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table of the file. Unknown keys are refused: a misspelt limit must not be a missing limit."""


class _ErrorFunction(Section, frozen=True, kw_only=True, tag_field="name"):
    """[law.error_function]; `guidance.error_function` says what each is for."""


class Quadratic(_ErrorFunction, frozen=True, kw_only=True, tag="quadratic"):
    """The paper's: the approach is as fast as the error is large."""


class KOfR(_ErrorFunction, frozen=True, kw_only=True, tag="k-of-r"):
    """k (1 + gain) where the reference is at the centre (m from the trajectory's origin), k far from it."""

    gain: Annotated[float, Meta(gt=-1.0, le=1e3)]
    width_m: Annotated[float, Meta(ge=0.01, le=1e5)]
    north_m: Metres = 0.0
    east_m: Metres = 0.0
    down_m: Metres = 0.0


class Bounded(_ErrorFunction, frozen=True, kw_only=True, tag="bounded"):
    """The approach is never faster than this."""

    approach_m_s: Speed


class BoundedApart(_ErrorFunction, frozen=True, kw_only=True, tag="bounded-apart"):
    """The approach is never faster than these, in the horizontal plane and in the vertical."""

    horizontal_m_s: Speed
    vertical_m_s: Speed


ErrorFunction = Quadratic | KOfR | Bounded | BoundedApart


class LawConfig(Section, frozen=True, kw_only=True):
    """Which law, and the gains of (11) and (14); lambda = 1 / beta."""

    name: Literal["paper", "global"] = "paper"
    k: Gain
    rho2_per_s: Gain
    rho3_per_s: Gain
    beta: Gain = 1.0
    allocation: Literal["pitch-yaw", "roll-pitch", "roll-yaw"] = "pitch-yaw"
    error_function: ErrorFunction = Quadratic()

    def gains(self) -> Gains:
        """As the law takes them."""
        return Gains(k=self.k, rho2=self.rho2_per_s, rho3=self.rho3_per_s, beta=self.beta)


class LimitsConfig(Section, frozen=True, kw_only=True):
    """What may be asked of the vehicle, always; rates are symmetric, an absent acceleration is free."""

    speed_min_m_s: Annotated[float, Meta(ge=-MOST_SPEED_M_S, le=MOST_SPEED_M_S)]
    speed_max_m_s: Speed
    roll_rate_max_rad_s: RateOrNone
    pitch_rate_max_rad_s: RateOrNone
    yaw_rate_max_rad_s: Rate
    keep_direction: bool = True
    acceleration_max_m_s2: Acceleration | None = None
    roll_acceleration_max_rad_s2: Acceleration | None = None
    pitch_acceleration_max_rad_s2: Acceleration | None = None
    yaw_acceleration_max_rad_s2: Acceleration | None = None

    def limits(self) -> Limits:
        """As the law takes them."""
        return Limits(
            speed_min_m_s=self.speed_min_m_s,
            speed_max_m_s=self.speed_max_m_s,
            roll_rate_rad_s=self.roll_rate_max_rad_s,
            pitch_rate_rad_s=self.pitch_rate_max_rad_s,
            yaw_rate_rad_s=self.yaw_rate_max_rad_s,
            keep_direction=self.keep_direction,
            acceleration_m_s2=_or_free(self.acceleration_max_m_s2),
            roll_acceleration_rad_s2=_or_free(self.roll_acceleration_max_rad_s2),
            pitch_acceleration_rad_s2=_or_free(self.pitch_acceleration_max_rad_s2),
            yaw_acceleration_rad_s2=_or_free(self.yaw_acceleration_max_rad_s2),
        )


def _or_free(limit: float | None) -> float:
    return inf if limit is None else limit


def parameters(
    law_config: LawConfig, limits: LimitsConfig, origin_ned_m: Vec3, *, planar: bool = False
) -> Parameters:
    """For a trajectory whose origin is here in the vehicle's local frame (m).

    A `planar` vehicle never pitches: how fast it could is nothing to its turns.
    """
    bounds = limits.limits()
    if planar:
        bounds = bounds._replace(pitch_acceleration_rad_s2=inf)
    return Parameters(
        law=LAWS[law_config.name],
        allocation=ALLOCATIONS[law_config.allocation],
        gains=law_config.gains(),
        error_function=_error_function(law_config.error_function, origin_ned_m),
        limits=bounds,
    )


def _error_function(chosen: ErrorFunction, origin: Vec3) -> error_function.ErrorFunction:
    match chosen:
        case Quadratic():
            return error_function.PAPER
        case KOfR():
            centre = Vec3(origin.x + chosen.north_m, origin.y + chosen.east_m, origin.z + chosen.down_m)
            return error_function.k_of_r(chosen.gain, chosen.width_m, centre)
        case Bounded():
            return error_function.bounded(chosen.approach_m_s)
        case BoundedApart():
            return error_function.bounded_apart(chosen.horizontal_m_s, chosen.vertical_m_s)


def approach_m_s(chosen: ErrorFunction) -> float:
    """The slowest approach (m/s) that the error function asks for from far off; inf if it has no bound."""
    match chosen:
        case Bounded():
            return chosen.approach_m_s
        case BoundedApart():
            return min(chosen.horizontal_m_s, chosen.vertical_m_s)
        case Quadratic() | KOfR():
            return inf


def rates_of(allocation: str, planar: bool) -> tuple[str, ...]:
    """The keys in [limits] of the rates that an allocation turns by; a planar vehicle has only yaw."""
    axes = ("yaw",) if planar else allocation.split("-")
    return tuple(f"{axis}_rate_max_rad_s" for axis in axes)


def cannot_allocate(name: str, limits: LimitsConfig, planar: bool) -> tuple[str, float] | None:
    """The limit (its key and value) that leaves an allocation without one of its rates, None if none does.

    Whether the rates suffice for the trajectory is not asked: where an actuator failed, too slow a turn with
    the others is the best that is left.
    """
    for key in rates_of(name, planar):
        limit: float = getattr(limits, key)
        if limit < LEAST_RATE_RAD_S:
            return key, limit
    return None


def conflicts(law_config: LawConfig, rate_hz: float) -> Iterator[Problem]:
    """Gains that setpoints at this rate cannot follow."""
    k = law_config.k / law_config.beta
    rates = {
        "rho2_per_s": ("rho2_per_s", law_config.rho2_per_s, law_config.rho2_per_s),
        "rho3_per_s": ("rho3_per_s", law_config.rho3_per_s, law_config.rho3_per_s),
        "k": ("k / beta", law_config.k, k),
    }
    chosen = law_config.error_function
    if isinstance(chosen, KOfR) and chosen.gain > 0.0:
        rates["error_function.gain"] = ("(1 + gain) k / beta", chosen.gain, (1.0 + chosen.gain) * k)
    for key, (what, value, rate) in rates.items():
        # A setpoint acts for a whole period: from 1 on it takes the error past zero, from 2 on it grows.
        if rate >= rate_hz:
            yield Problem(
                f"law.{key}",
                f" = {shown(value)}: {what} times the period of "
                f"link.rate_hz = {rate_hz:g} is {rate / rate_hz:.3g}: must be below 1 to be stable",
            )
