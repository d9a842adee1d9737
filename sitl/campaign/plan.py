"""What a campaign flies, checked before anything starts: names, ranges, and what goes with what."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, ClassVar, Final, NamedTuple

import msgspec

from guidance import tuning
from guidance.checking import problems
from guidance.law import Parameters
from guidance.se3 import ZERO, Quaternion, Vec3
from guidance.trajectory import Helix, Trajectory
from sitl.campaign.draw import Pair, Ranges
from sitl.campaign.flight import OUTCOMES, PARAMETERS, START_RATES, TRAJECTORIES, Common

#: Longest actuation delay, in steps: commands under way are kept in a ring of that size.
LONGEST_DELAY_STEPS: Final = 500
MOST_STEPS: Final = 10_000_000
MOST_FLIGHTS: Final = 1_000_000_000

QUADRATIC: Final = tuning.Quadratic()
#: Of section 4.
HELIX: Final = Helix()
#: How far the norm of a start's quaternion may be from 1.
UNIT_TOLERANCE: Final = 1e-9


class Start(NamedTuple):
    """A named pose to start from (NED, m)."""

    name: str
    position_ned_m: Vec3
    attitude: Quaternion


class Bound(NamedTuple):
    """What a drawn quantity may be; `above` excludes the lowest value itself."""

    low: float
    high: float
    above: bool = False


_GAIN: Final = Bound(tuning.LEAST_GAIN, tuning.MOST_GAIN)
_SPEED: Final = Bound(-tuning.MOST_SPEED_M_S, tuning.MOST_SPEED_M_S)
#: Infinite is no limit.
_ACCELERATION: Final = Bound(tuning.LEAST_ACCELERATION, math.inf)

#: Of each of `Ranges`; gains and limits as in a configuration.
BOUNDS: Final[dict[str, Bound]] = {
    "distance_m": Bound(0.0, 1e5),
    "start_s": Bound(-1e5, 1e5),
    "k": _GAIN,
    "rho2_per_s": _GAIN,
    "rho3_per_s": _GAIN,
    "beta": _GAIN,
    "speed_min_m_s": _SPEED,
    "speed_max_m_s": Bound(tuning.LEAST_SPEED_M_S, tuning.MOST_SPEED_M_S),
    "rate_max_rad_s": Bound(tuning.LEAST_RATE_RAD_S, tuning.MOST_RATE_RAD_S),
    "wind_m_s": Bound(0.0, 1e3),
    "gust_m_s": Bound(0.0, 1e3),
    "delay_s": Bound(0.0, 10.0),
    "rate_lag_s": Bound(0.0, 10.0),
    "speed_lag_s": Bound(0.0, 10.0),
    "start_speed_m_s": _SPEED,
    "start_rate_rad_s": Bound(0.0, tuning.MOST_RATE_RAD_S),
}


@dataclass(frozen=True)
class Plan:
    """A campaign. Pairs are the lowest and the highest value of what is drawn for each flight.

    Gains, speeds and rates default to those of section 4 of the paper, with reverse, and a flight starts at
    rest. Its speed and rates at the start matter to a plant with lags, and to the limits on the rates of
    change; without either, the first command is all that acts. Below `within_m` for good by `due_s` is in
    time.

    Raises:
        ValueError: a value is out of range or does not go with another; begins with the field's name.
    """

    name: str = "campaign"
    flights: int = 10_000
    seed: int = 0
    law: str = "paper"
    allocation: str = "pitch-yaw"
    error_function: tuning.ErrorFunction = QUADRATIC
    trajectory: Trajectory = HELIX
    planar: bool = False
    keep_direction: bool = True
    acceleration_m_s2: float = math.inf
    turn_acceleration_rad_s2: float = math.inf
    duration_s: float = 30.0
    step_s: float = 0.02
    within_m: float = 0.01
    due_s: float = 20.0
    gust_period_s: float = 5.0
    distance_m: Pair = (0.0, 50.0)
    start_s: Pair = (0.0, 0.0)
    k: Pair = (1.0, 1.0)
    rho2_per_s: Pair = (10.0, 10.0)
    rho3_per_s: Pair = (10.0, 10.0)
    beta: Pair = (1.0, 1.0)
    speed_min_m_s: Pair = (-5.0, -5.0)
    speed_max_m_s: Pair = (5.0, 5.0)
    rate_max_rad_s: Pair = (5.0, 5.0)
    wind_m_s: Pair = (0.0, 0.0)
    gust_m_s: Pair = (0.0, 0.0)
    delay_s: Pair = (0.0, 0.0)
    rate_lag_s: Pair = (0.0, 0.0)
    speed_lag_s: Pair = (0.0, 0.0)
    start_speed_m_s: Pair = (0.0, 0.0)
    start_rate_rad_s: Pair = (0.0, 0.0)
    starts: tuple[Start, ...] = ()

    columns: ClassVar[tuple[str, ...]] = PARAMETERS
    outcomes: ClassVar[tuple[str, ...]] = OUTCOMES

    def __post_init__(self) -> None:
        _whole("flights", self.flights, 1, MOST_FLIGHTS)
        _whole("seed", self.seed, 0, 2**64 - 1)
        _one_of("law", self.law, tuning.LAWS)
        _one_of("allocation", self.allocation, tuning.ALLOCATIONS)
        if type(self.trajectory) not in TRAJECTORIES:
            raise ValueError(f"trajectory: a campaign cannot fly {type(self.trajectory).__name__}")
        if self.trajectory.stop_at_s > 0.0:
            raise ValueError("trajectory: a campaign flies none that stops; leave out stop_at_s")
        for name in ("acceleration_m_s2", "turn_acceleration_rad_s2"):
            _number(name, getattr(self, name), _ACCELERATION)
        _number("step_s", self.step_s, Bound(1e-5, 1.0))
        _number("duration_s", self.duration_s, Bound(4.0 * self.step_s, MOST_STEPS * self.step_s))
        _number("within_m", self.within_m, Bound(0.0, 1e5, above=True))
        _number("due_s", self.due_s, Bound(0.0, 1e9, above=True))
        _number("gust_period_s", self.gust_period_s, Bound(0.0, 1e5, above=True))
        for name, bound in BOUNDS.items():
            low, high = getattr(self, name)
            _number(name, low, bound)
            _number(name, high, bound)
            if low > high:
                raise ValueError(f"{name} must be LOWEST:HIGHEST, not {low:g}:{high:g}")
        if self.speed_min_m_s[1] > self.speed_max_m_s[0]:
            raise ValueError(
                f"speed_min_m_s must not exceed speed_max_m_s: {self.speed_min_m_s[1]:g} can be drawn with "
                f"{self.speed_max_m_s[0]:g}"
            )
        if self.longest_delay > LONGEST_DELAY_STEPS:
            raise ValueError(
                f"delay_s must be at most {LONGEST_DELAY_STEPS} steps of {self.step_s:g} s, "
                f"not {self.delay_s[1]:g} s"
            )
        for start in self.starts:
            numbers = (*start.position_ned_m, *start.attitude)
            off = abs(math.hypot(*start.attitude) - 1.0)
            if not all(map(math.isfinite, numbers)) or off > UNIT_TOLERANCE:
                raise ValueError(
                    f"starts: {start.name!r} must have a finite position and a unit quaternion, not {numbers}"
                )
        if self.planar and self.allocation != "pitch-yaw":
            raise ValueError(f"allocation must be pitch-yaw in the plane, not {self.allocation}")

    @property
    def steps(self) -> int:
        """Steps of a flight."""
        return math.ceil(self.duration_s / self.step_s - 1e-9)

    @property
    def longest_delay(self) -> int:
        """In steps."""
        return math.ceil(self.delay_s[1] / self.step_s - 1e-9)

    def common(self) -> Common:
        """What all flights share, as the loop takes it."""
        return Common(
            law=tuning.LAWS[self.law],
            allocation=tuning.ALLOCATIONS[self.allocation],
            error_function=self._parameters().error_function,
            keep_direction=self.keep_direction,
            acceleration_m_s2=self.acceleration_m_s2,
            turn_acceleration_rad_s2=self.turn_acceleration_rad_s2,
            trajectory=TRAJECTORIES[type(self.trajectory)],
            shape=shape_of(self.trajectory),
            is_planar=self.planar,
            dt_s=self.step_s,
            steps=self.steps,
            within_m=self.within_m,
            longest_delay=self.longest_delay,
            is_windy=max(self.wind_m_s[1], self.gust_m_s[1]) > 0.0,
            gust_period_s=self.gust_period_s,
        )

    def _parameters(self) -> Parameters:
        """As a configuration makes them; only the error function does not differ from flight to flight."""
        config = tuning.LawConfig(k=1.0, rho2_per_s=1.0, rho3_per_s=1.0, error_function=self.error_function)
        limits = tuning.LimitsConfig(
            speed_min_m_s=0.0,
            speed_max_m_s=1.0,
            roll_rate_max_rad_s=1.0,
            pitch_rate_max_rad_s=1.0,
            yaw_rate_max_rad_s=1.0,
        )
        return tuning.parameters(config, limits, ZERO)

    def varying(self) -> tuple[str, ...]:
        """Columns of `PARAMETERS` that differ between flights."""
        found = set(PARAMETERS[:7])
        for name in DRAWN:
            low, high = getattr(self, name)
            if name in ("wind_m_s", "gust_m_s"):
                kind = name.removesuffix("_m_s")
                found |= {column for column in PARAMETERS if high > 0.0 and column.startswith(kind)}
            elif name == "start_rate_rad_s":
                found |= {column for column in START_RATES if high > 0.0}
            elif low != high:
                found.add(name)
        return tuple(column for column in PARAMETERS if column in found)

    def ranges(self) -> Ranges:
        """What is drawn."""
        pairs = {name: getattr(self, name) for name in Ranges._fields}
        return Ranges(**{name: (float(low), float(high)) for name, (low, high) in pairs.items()})

    def as_dict(self) -> dict[str, Any]:
        """Everything that determines the numbers, for the results' file and for JSON."""
        found = asdict(self)
        found["error_function"] = msgspec.to_builtins(self.error_function)
        found["trajectory"] = msgspec.to_builtins(self.trajectory)
        found["starts"] = [start.name for start in self.starts]
        for name in ("acceleration_m_s2", "turn_acceleration_rad_s2"):
            if math.isinf(found[name]):
                found[name] = None
        return found


def shape_of(trajectory: Trajectory) -> tuple[float, float, float, float, float, float]:
    """Its parameters in their order, without the two of the stop, which every trajectory has first."""
    shape = [float(value) for value in msgspec.structs.astuple(trajectory)[2:]]
    a, b, c, d, e, f = shape + [0.0] * (6 - len(shape))
    return a, b, c, d, e, f


#: Fields of `Plan` that are drawn, in its order.
DRAWN: Final = tuple(field.name for field in fields(Plan) if field.name in BOUNDS)


class _Named(tuning.Section, frozen=True, kw_only=True):
    """What is given on a command line as NAME,KEY=VALUE,..."""

    trajectory: Trajectory = Helix()
    error_function: tuning.ErrorFunction = tuning.Quadratic()


def named_trajectory(text: str) -> Trajectory:
    """`helix,radius_m=2,speed_m_s=0.5`. Raises ValueError."""
    return _named("trajectory", text).trajectory


def named_error_function(text: str) -> tuning.ErrorFunction:
    """`bounded,approach_m_s=2`. Raises ValueError."""
    return _named("error_function", text).error_function


def _named(key: str, text: str) -> _Named:
    name, *settings = (part.strip() for part in text.split(","))
    table: dict[str, object] = {"name": name}
    for setting in settings:
        inner, equals, value = setting.partition("=")
        if not equals:
            raise ValueError(f"{key} must be NAME,KEY=VALUE,..., not {text!r}")
        table[inner.strip()] = _value(value.strip())
    data = {key: table}
    for problem in problems(data, _Named):
        raise ValueError(f"{problem.key}{problem.text}")
    return msgspec.convert(data, _Named)


def _value(text: str) -> object:
    if text in ("true", "false"):
        return text == "true"
    try:
        return float(text)
    except ValueError:
        return text


def pair(key: str, text: str) -> Pair:
    """`2` or `0.5:2`. Raises ValueError."""
    low, colon, high = text.partition(":")
    try:
        return float(low), float(high) if colon else float(low)
    except ValueError:
        raise ValueError(f"{key} must be a number or LOWEST:HIGHEST, not {text!r}") from None


def _number(name: str, value: float, bound: Bound) -> None:
    low_enough = value > bound.low if bound.above else value >= bound.low
    if not (low_enough and value <= bound.high):
        low = f"above {bound.low:g}" if bound.above else f"at least {bound.low:g}"
        high = f" and at most {bound.high:g}" if math.isfinite(bound.high) else ""
        raise ValueError(f"{name} must be {low}{high}, not {value:g}")


def _whole(name: str, value: int, low: int, high: int) -> None:
    if not low <= value <= high:
        raise ValueError(f"{name} must be a whole number from {low} to {high}, not {value}")


def _one_of(name: str, value: str, known: Mapping[str, int]) -> None:
    if value not in known:
        raise ValueError(f"{name} must be one of {', '.join(known)}, not {value!r}")
