"""An underwater vehicle whose autopilot is told body rates and a thrust along the nose, as PX4's UUV is.

The thrust is given as the speed that it would hold were drag linear. What acts:

- a command acts `delay_s` after it was given; what was given meanwhile queues in the state;
- each body rate follows `rate_gain` times the wanted one, at most `rate_max_rad_s`, with a lag;
- thrust T, at most that of `speed_max_m_s`, works against drag: u' = T - u/`drag_s` - `drag_per_m` u |u|.
  It is scaled so that full thrust holds `speed_max_m_s`; less of it holds more than its part of that.

The body moves along its nose: a hull with fins slides little.
"""

from __future__ import annotations

from math import exp, inf
from typing import Final, NamedTuple

from sitl import plant
from sitl.plant import PlantCommand, PlantParameters, PlantState, Triple, Wxyz

#: So many commands can be on their way; of more, the oldest act too early. 0.64 s at 50 Hz.
IN_FLIGHT: Final = 32

_UNBOUNDED: Final = PlantParameters(inf, inf)


class Parameters(NamedTuple):
    """As the module says."""

    delay_s: float
    rate_gain: float
    rate_lag_s: float
    rate_max_rad_s: float
    speed_max_m_s: float
    drag_s: float
    drag_per_m: float


#: Parameters that divide, and those that may be negative.
POSITIVE: Final = frozenset({"rate_gain", "rate_lag_s", "rate_max_rad_s", "speed_max_m_s", "drag_s"})
SIGNED: Final[frozenset[str]] = frozenset()


class Command(NamedTuple):
    """What the autopilot is told, and from when on (s, the state's clock) it acts on it."""

    acts_s: float
    body_rates_frd_rad_s: Triple
    speed_m_s: float


class State(NamedTuple):
    """Pose, body rates and the speed along the nose; `queue` holds the last commands, oldest first."""

    time_s: float
    position_ned_m: Triple
    attitude_wxyz: Wxyz
    body_rates_frd_rad_s: Triple
    speed_m_s: float
    queue: tuple[Command, ...]


def at_rest(position_ned_m: Triple, attitude_wxyz: Wxyz) -> State:
    """Floating there, and told to."""
    still = (0.0, 0.0, 0.0)
    return State(0.0, position_ned_m, attitude_wxyz, still, 0.0, (Command(-inf, still, 0.0),) * IN_FLIGHT)


def told(parameters: Parameters, state: State, body_rates_frd_rad_s: Triple, speed_m_s: float) -> State:
    """The state with one more command under way; all finite."""
    command = Command(state.time_s + parameters.delay_s, body_rates_frd_rad_s, speed_m_s)
    return state._replace(queue=(*state.queue[1:], command))


def step(parameters: Parameters, state: State, dt_s: float) -> State:
    """The state `dt_s` (> 0, milliseconds) later: of second order in `dt_s`."""
    p = parameters
    command = _acting(state.queue, state.time_s)
    most = p.rate_max_rad_s
    keep = exp(-dt_s / p.rate_lag_s)
    x, y, z = (
        wanted + (now - wanted) * keep
        for wanted, now in zip(
            (_clamp(p.rate_gain * rate, most) for rate in command.body_rates_frd_rad_s),
            state.body_rates_frd_rad_s,
            strict=True,
        )
    )
    u = state.speed_m_s
    thrust = _clamp(command.speed_m_s, p.speed_max_m_s) * (1.0 / p.drag_s + p.drag_per_m * p.speed_max_m_s)
    first = _acceleration(p, thrust, u)
    after = u + 0.5 * dt_s * (first + _acceleration(p, thrust, u + dt_s * first))

    a, b, c = state.body_rates_frd_rad_s
    twist = PlantCommand((0.5 * (a + x), 0.5 * (b + y), 0.5 * (c + z)), 0.5 * (u + after))
    moved = plant.step(_UNBOUNDED, PlantState(state.position_ned_m, state.attitude_wxyz), twist, dt_s)
    return State(
        state.time_s + dt_s, moved.position_ned_m, moved.attitude_wxyz, (x, y, z), after, state.queue
    )


def _acceleration(p: Parameters, thrust: float, u: float) -> float:
    return thrust - u / p.drag_s - p.drag_per_m * u * abs(u)


def _acting(queue: tuple[Command, ...], time_s: float) -> Command:
    """The newest command that acts at `time_s`; if all are still under way, the oldest."""
    found = queue[0]
    for command in queue:
        # times are sums of steps: a nanosecond is no delay
        if command.acts_s <= time_s + 1e-9:
            found = command
    return found


def _clamp(value: float, most: float) -> float:
    return -most if value < -most else most if value > most else value
