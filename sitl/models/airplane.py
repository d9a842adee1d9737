"""An airplane behind an autopilot that is told roll, pitch and throttle: it turns by banking.

World NED, body FRD, angles as in MAVLink's ATTITUDE. A command acts `*_delay_s` after it was given; what was
given meanwhile queues in the state. Roll and pitch follow it as the recorded autopilots did, with one lag or
two (`*_lag2_s` > 0: the rate itself follows, which overshoots), a slew limit, a gain and an offset:

    w' = (limit((gain u + offset - y)/lag, +-slew) - w)/lag2        y' = w

An autopilot adds the pitch rate that a turn needs, g tan(phi) sin(phi)/V, and what it makes of rates is not
1: `pitch_turning` of it too much raises the nose (in a pitch with two lags), and every swing of the bank
swings the pitch, and with it the load.

The body is a point with mass in moving air. With v_a = v - wind, V = |v_a|, gamma its angle above the
horizontal and alpha = (pitch - gamma)/cos(roll), which is sin(gamma) = cos(alpha) sin(pitch) -
sin(alpha) cos(roll) cos(pitch) for small angles, per mass:

- lift g (alpha - alpha_zero) V^2/alpha_per_load, so that load factor n takes the angle of attack
  alpha_zero + alpha_per_load n/V^2; below `stall_m_s` sqrt(n) it gives no more, and drag doubles;
- without a coordinated rudder gravity slips it into the turn, and the fuselage pushes back, by
  (1 - `bank_effectiveness`) g tan(phi): of a level turn `bank_effectiveness` is left, of load beyond it all;
- thrust `thrust_m_s2` times throttle, which follows its command with a lag;
- drag `drag_per_m` V^2 + `induced_m3_s4` n^2/V^2.

The nose points into the wind that it feels: the heading is that of v_a.
"""

from __future__ import annotations

from math import asin, atan2, cos, hypot, inf, sin, sqrt, tan
from typing import Final, NamedTuple

from sitl.models.gusts import Wind

#: So many commands can be on their way; of more, the oldest act too early. 0.64 s at 50 Hz.
IN_FLIGHT: Final = 32
GRAVITY_M_S2: Final = 9.80665
#: Slower (m/s) than this the air has no direction to speak of; a body that falls gets there never.
STILL_M_S: Final = 0.1
#: Load factor at which the wing's lift ends in dives and pulls, whatever the speed.
LOAD_MAX: Final = 5.0

Rates = tuple[float, float, float, float, float, float, float, float, float, float, float]


class Parameters(NamedTuple):
    """As the module says; a lag2 of 0 is none. `thrust_m_s2` is what full throttle gives."""

    roll_delay_s: float
    roll_slew_rad_s: float
    roll_lag_s: float
    roll_lag2_s: float
    roll_gain: float
    roll_offset_rad: float
    pitch_delay_s: float
    pitch_slew_rad_s: float
    pitch_lag_s: float
    pitch_lag2_s: float
    pitch_gain: float
    pitch_offset_rad: float
    pitch_turning: float
    throttle_delay_s: float
    throttle_lag_s: float
    roll_max_rad: float
    pitch_max_rad: float
    thrust_m_s2: float
    drag_per_m: float
    induced_m3_s4: float
    bank_effectiveness: float
    alpha_zero_rad: float
    alpha_per_load_rad_m2_s2: float
    stall_m_s: float


class Command(NamedTuple):
    """What the autopilot is told, at `given_s` of the state's clock."""

    given_s: float
    roll_rad: float
    pitch_rad: float
    throttle: float


class State(NamedTuple):
    """Position, velocity over ground, attitude and its rates (of the angles), throttle; the last two of the
    numbers are what it feels of the air, and `queue` holds the last commands, oldest first."""

    time_s: float
    north_m: float
    east_m: float
    down_m: float
    velocity_north_m_s: float
    velocity_east_m_s: float
    velocity_down_m_s: float
    roll_rad: float
    roll_rate_rad_s: float
    pitch_rad: float
    pitch_rate_rad_s: float
    throttle: float
    heading_rad: float
    airspeed_m_s: float
    queue: tuple[Command, ...]


def flying(
    parameters: Parameters,
    north_m: float,
    east_m: float,
    down_m: float,
    heading_rad: float,
    speed_m_s: float,
    wind: Wind,
) -> State:
    """In steady level flight there, at this airspeed in this wind, with the commands that hold it."""
    p = parameters
    pitch = p.alpha_zero_rad + p.alpha_per_load_rad_m2_s2 / (speed_m_s * speed_m_s)
    drag = p.drag_per_m * speed_m_s * speed_m_s + p.induced_m3_s4 / (speed_m_s * speed_m_s)
    throttle = drag / p.thrust_m_s2
    asked = Command(
        -inf, -p.roll_offset_rad / p.roll_gain, (pitch - p.pitch_offset_rad) / p.pitch_gain, throttle
    )
    return State(
        0.0,
        north_m,
        east_m,
        down_m,
        speed_m_s * cos(heading_rad) + wind.north_m_s,
        speed_m_s * sin(heading_rad) + wind.east_m_s,
        wind.down_m_s,
        0.0,
        0.0,
        pitch,
        0.0,
        throttle,
        heading_rad,
        speed_m_s,
        (asked,) * IN_FLIGHT,
    )


def told(state: State, roll_rad: float, pitch_rad: float, throttle: float) -> State:
    """The state with one more command under way; all finite."""
    command = Command(state.time_s, roll_rad, pitch_rad, throttle)
    return State(
        state.time_s,
        state.north_m,
        state.east_m,
        state.down_m,
        state.velocity_north_m_s,
        state.velocity_east_m_s,
        state.velocity_down_m_s,
        state.roll_rad,
        state.roll_rate_rad_s,
        state.pitch_rad,
        state.pitch_rate_rad_s,
        state.throttle,
        state.heading_rad,
        state.airspeed_m_s,
        (*state.queue[1:], command),
    )


def step(parameters: Parameters, state: State, wind: Wind, dt_s: float) -> State:
    """The state `dt_s` (> 0, milliseconds) later in this wind, by the classical Runge-Kutta rule."""
    p = parameters
    roll = p.roll_gain * _acting(state.queue, state.time_s - p.roll_delay_s).roll_rad + p.roll_offset_rad
    pitch = p.pitch_gain * _acting(state.queue, state.time_s - p.pitch_delay_s).pitch_rad + p.pitch_offset_rad
    throttle = _acting(state.queue, state.time_s - p.throttle_delay_s).throttle
    roll = _clamp(roll, -p.roll_max_rad, p.roll_max_rad)
    pitch = _clamp(pitch, -p.pitch_max_rad, p.pitch_max_rad)
    throttle = _clamp(throttle, 0.0, 1.0)

    y = (
        state.north_m,
        state.east_m,
        state.down_m,
        state.velocity_north_m_s,
        state.velocity_east_m_s,
        state.velocity_down_m_s,
        state.roll_rad,
        state.roll_rate_rad_s,
        state.pitch_rad,
        state.pitch_rate_rad_s,
        state.throttle,
    )
    h = 0.5 * dt_s
    k1 = _rates(p, y, roll, pitch, throttle, wind)
    k2 = _rates(p, _moved(y, k1, h), roll, pitch, throttle, wind)
    k3 = _rates(p, _moved(y, k2, h), roll, pitch, throttle, wind)
    k4 = _rates(p, _moved(y, k3, dt_s), roll, pitch, throttle, wind)
    y = _moved(_moved(_moved(_moved(y, k1, dt_s / 6.0), k2, dt_s / 3.0), k3, dt_s / 3.0), k4, dt_s / 6.0)

    north, east, down = y[3] - wind.north_m_s, y[4] - wind.east_m_s, y[5] - wind.down_m_s
    return State(
        state.time_s + dt_s,
        y[0],
        y[1],
        y[2],
        y[3],
        y[4],
        y[5],
        y[6],
        # without a second lag the rate is what the first makes it
        y[7] if p.roll_lag2_s > 0.0 else k1[6],
        y[8],
        y[9] if p.pitch_lag2_s > 0.0 else k1[8],
        y[10],
        atan2(east, north),
        sqrt(north * north + east * east + down * down),
        state.queue,
    )


def load_factor(parameters: Parameters, airspeed_m_s: float, alpha_rad: float) -> tuple[float, bool]:
    """n that this angle of attack gives, and whether the wing is stalled."""
    p = parameters
    v2 = airspeed_m_s * airspeed_m_s
    n = (alpha_rad - p.alpha_zero_rad) * v2 / p.alpha_per_load_rad_m2_s2
    most = min(v2 / (p.stall_m_s * p.stall_m_s), LOAD_MAX)
    return _clamp(n, -0.5 * most, most), n > most


def _rates(p: Parameters, y: Rates, roll: float, pitch: float, throttle: float, wind: Wind) -> Rates:
    """d/dt of the eleven numbers, for these wanted angles and this wanted throttle."""
    north, east, down = y[3] - wind.north_m_s, y[4] - wind.east_m_s, y[5] - wind.down_m_s
    level = max(hypot(north, east), STILL_M_S)
    speed = sqrt(level * level + down * down)
    sine, cosine = -down / speed, level / speed
    c, s = north / level, east / level

    alpha = (y[8] - asin(sine)) / max(cos(y[6]), 0.1)
    n, stalled = load_factor(p, speed, alpha)
    drag = p.drag_per_m * speed * speed + p.induced_m3_s4 * n * n / (speed * speed)
    if stalled:
        drag *= 2.0
    along = p.thrust_m_s2 * y[10] - drag
    up = GRAVITY_M_S2 * n * cos(y[6])
    slip = (1.0 - p.bank_effectiveness) / max(cos(y[6]), 0.1)
    right = GRAVITY_M_S2 * (n - slip) * sin(y[6])

    roll_rate, roll_change = _followed(roll, y[6], y[7], p.roll_lag_s, p.roll_lag2_s, p.roll_slew_rad_s)
    pitch_rate, pitch_change = _followed(pitch, y[8], y[9], p.pitch_lag_s, p.pitch_lag2_s, p.pitch_slew_rad_s)
    if p.pitch_lag2_s > 0.0:
        turned = GRAVITY_M_S2 / speed * tan(y[6]) * sin(y[6])
        pitch_change += p.pitch_turning * turned / p.pitch_lag2_s
    return (
        y[3],
        y[4],
        y[5],
        along * cosine * c - up * sine * c - right * s,
        along * cosine * s - up * sine * s + right * c,
        GRAVITY_M_S2 - along * sine - up * cosine,
        roll_rate,
        roll_change,
        pitch_rate,
        pitch_change,
        (throttle - y[10]) / p.throttle_lag_s,
    )


def _followed(
    wanted: float, angle: float, rate: float, lag: float, lag2: float, slew: float
) -> tuple[float, float]:
    """Rates of an angle and of its rate; of an angle with one lag the second is 0."""
    asked = _clamp((wanted - angle) / lag, -slew, slew)
    if lag2 > 0.0:
        return rate, (asked - rate) / lag2
    return asked, 0.0


def _moved(y: Rates, k: Rates, h: float) -> Rates:
    return (
        y[0] + h * k[0],
        y[1] + h * k[1],
        y[2] + h * k[2],
        y[3] + h * k[3],
        y[4] + h * k[4],
        y[5] + h * k[5],
        y[6] + h * k[6],
        y[7] + h * k[7],
        y[8] + h * k[8],
        y[9] + h * k[9],
        y[10] + h * k[10],
    )


def _acting(queue: tuple[Command, ...], given_s: float) -> Command:
    """The newest command that was given by then; if all are younger, the oldest."""
    found = queue[0]
    for command in queue:
        # times are sums of steps: a nanosecond is no delay
        if command.given_s <= given_s + 1e-9:
            found = command
    return found


def _clamp(value: float, lowest: float, highest: float) -> float:
    return lowest if value < lowest else highest if value > highest else value


#: Parameters that divide, and those that may be negative.
POSITIVE: Final = frozenset(
    {
        "roll_slew_rad_s",
        "roll_lag_s",
        "roll_gain",
        "pitch_slew_rad_s",
        "pitch_lag_s",
        "pitch_gain",
        "throttle_lag_s",
        "thrust_m_s2",
        "alpha_per_load_rad_m2_s2",
        "stall_m_s",
    }
)
SIGNED: Final = frozenset({"roll_offset_rad", "pitch_offset_rad", "alpha_zero_rad"})
