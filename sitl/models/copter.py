"""A multirotor behind an autopilot that is told a velocity and a yaw rate, or body rates and thrust.

World NED, body FRD. A command acts `delay_s` after it was given; what was given meanwhile queues in the
state.

**Velocity and yaw rate.** Level and vertical have loops of their own (`Loop`), in this order:

- the wanted velocity is bounded, and led to at `lead_per_s` of what is missing, within an acceleration and a
  jerk, as ArduPilot shapes it; an acceleration of 0 leads to nothing, and PX4 takes the velocity as it is;
- PID on the velocity, with the led acceleration fed forward; `position_per_s` adds a loop on the way that the
  led velocity has gone, as ArduPilot's. The integral rests while the tilt or the thrust is at its end;
- the acceleration that this asks for follows like a mass on a spring, with a natural frequency and a damping:
  those of the attitude's loops, or of the rotors.

The rotors push along -z of the body: roll and pitch are those that point the acceleration where it is, and
its length is the thrust. The yaw rate follows like an airplane's bank, with a gain, two lags and a slew:

    w' = (limit((gain u - y)/lag, +-slew) - w)/lag2        y' = w

**Body rates and thrust.** The rates follow with `rate_lag_s`, thrust over `hover_thrust` is in g and follows
as slowly as in the vertical loop; nothing holds velocity.

The air pulls with `drag_per_s` times the velocity through it: steady wind tilts a copter that stands.

The loops have the form of PX4's PositionControl (MPC_XY_VEL_*_ACC, MPC_Z_VEL_*_ACC) and of ArduPilot's
AC_PosControl (PSC_*, WPNAV_ACCEL over PSC_JERK_XY), the body that of both simulators.
"""

from __future__ import annotations

from math import exp, inf, sqrt, tan
from typing import Final, NamedTuple

from sitl.models.attitude import (
    GRAVITY_M_S2,
    Triple,
    Wxyz,
    multiplied,
    roll_pitch_heading,
    tilted,
    turned,
)
from sitl.models.copter_axis import Loop, ahead, answered, held
from sitl.models.gusts import Wind

#: So many commands can be on their way; of more, the oldest act too early. 0.64 s at 50 Hz.
IN_FLIGHT: Final = 32
#: Rotors never push less than this part of the weight, so that there is always an attitude to hold.
LEAST_THRUST: Final = 0.1


class Parameters(NamedTuple):
    """As the module says; `down_` is of the vertical loop. Speeds are bounds of what may be asked for."""

    delay_s: float
    speed_max_m_s: float
    up_max_m_s: float
    down_max_m_s: float
    lead_per_s: float
    acceleration_m_s2: float
    jerk_m_s3: float
    position_per_s: float
    velocity_p: float
    velocity_i: float
    velocity_d: float
    frequency_rad_s: float
    damping: float
    tilt_max_rad: float
    down_lead_per_s: float
    down_acceleration_m_s2: float
    down_jerk_m_s3: float
    down_position_per_s: float
    down_velocity_p: float
    down_velocity_i: float
    down_velocity_d: float
    down_frequency_rad_s: float
    down_damping: float
    drag_per_s: float
    yaw_gain: float
    yaw_slew_rad_s2: float
    yaw_lag_s: float
    yaw_lag2_s: float
    rate_lag_s: float
    hover_thrust: float


#: Parameters that divide or bound.
POSITIVE: Final = frozenset(
    {
        "speed_max_m_s",
        "up_max_m_s",
        "down_max_m_s",
        "frequency_rad_s",
        "damping",
        "tilt_max_rad",
        "down_frequency_rad_s",
        "down_damping",
        "yaw_gain",
        "yaw_slew_rad_s2",
        "yaw_lag_s",
        "yaw_lag2_s",
        "rate_lag_s",
        "hover_thrust",
    }
)
SIGNED: Final[frozenset[str]] = frozenset()


class Command(NamedTuple):
    """What the autopilot is told, and from when on (s, the state's clock) it acts on it.

    Velocity NED (m/s) and yaw rate (rad/s, `turn`); or, with `by_rates`, body rates (rad/s) and thrust (0 to
    1, `turn`).
    """

    acts_s: float
    by_rates: bool
    x: float
    y: float
    z: float
    turn: float


class State(NamedTuple):
    """Position, velocity over ground, attitude (body to world) and body rates; the loops north, east and
    down; yaw rate and its rate. `queue` holds the last commands, oldest first."""

    time_s: float
    position_ned_m: Triple
    velocity_ned_m_s: Triple
    attitude_wxyz: Wxyz
    body_rates_frd_rad_s: Triple
    north: Loop
    east: Loop
    down: Loop
    yaw_rate_rad_s: float
    yaw_rate_rad_s2: float
    queue: tuple[Command, ...]


def hovering(parameters: Parameters, position_ned_m: Triple, heading_rad: float, wind: Wind) -> State:
    """Standing there in this wind, as after a while."""
    c = parameters.drag_per_s
    north, east, down = (
        held(-c * wind.north_m_s),
        held(-c * wind.east_m_s),
        held(-c * wind.down_m_s),
    )
    attitude = tilted(north.given_m_s2, east.given_m_s2, down.given_m_s2, heading_rad)
    still = Command(-inf, False, 0.0, 0.0, 0.0, 0.0)
    return State(
        0.0,
        position_ned_m,
        (0.0, 0.0, 0.0),
        attitude,
        (0.0, 0.0, 0.0),
        north,
        east,
        down,
        0.0,
        0.0,
        (still,) * IN_FLIGHT,
    )


def told(parameters: Parameters, state: State, velocity_ned_m_s: Triple, yaw_rate_rad_s: float) -> State:
    """The state with one more velocity (m/s) and yaw rate (rad/s, to the right) under way; all finite."""
    x, y, z = velocity_ned_m_s
    return _queued(state, Command(state.time_s + parameters.delay_s, False, x, y, z, yaw_rate_rad_s))


def told_rates(parameters: Parameters, state: State, body_rates_frd_rad_s: Triple, thrust: float) -> State:
    """The state with body rates (FRD, rad/s) and collective thrust (0 to 1) under way; all finite."""
    p, q, r = body_rates_frd_rad_s
    return _queued(state, Command(state.time_s + parameters.delay_s, True, p, q, r, thrust))


def step(parameters: Parameters, state: State, wind: Wind, dt_s: float) -> State:
    """The state `dt_s` (> 0, milliseconds) later; of first order in `dt_s`."""
    command = acting(state.queue, state.time_s)
    if command.by_rates:
        return _by_rates(parameters, state, command, wind, dt_s)
    return _by_velocity(parameters, state, command, wind, dt_s)


def acting(queue: tuple[Command, ...], time_s: float) -> Command:
    """The newest command that acts at `time_s`; if all are still under way, the oldest."""
    found = queue[0]
    for command in queue:
        # times are sums of steps: a nanosecond is no delay
        if command.acts_s <= time_s + 1e-9:
            found = command
    return found


def thrust_of(parameters: Parameters, state: State) -> float:
    """The collective thrust that it flies by, 0 to 1."""
    a, b, c = state.north.given_m_s2, state.east.given_m_s2, state.down.given_m_s2 - GRAVITY_M_S2
    return _clamp(sqrt(a * a + b * b + c * c) / GRAVITY_M_S2 * parameters.hover_thrust, 0.0, 1.0)


def _by_velocity(p: Parameters, state: State, command: Command, wind: Wind, dt: float) -> State:
    v_n, v_e, v_d = state.velocity_ned_m_s
    north, east, down = state.north, state.east, state.down

    part = _part(command.x, command.y, p.speed_max_m_s)
    n_m_s, e_m_s = part * command.x, part * command.y
    d_m_s = _clamp(command.z, -p.up_max_m_s, p.down_max_m_s)
    n_m_s2 = e_m_s2 = d_m_s2 = 0.0
    if p.acceleration_m_s2 > 0.0:
        a_n, a_e = p.lead_per_s * (n_m_s - north.led_m_s), p.lead_per_s * (e_m_s - east.led_m_s)
        part = _part(a_n, a_e, p.acceleration_m_s2)
        j_n, j_e = part * a_n - north.led_m_s2, part * a_e - east.led_m_s2
        part = _part(j_n, j_e, p.jerk_m_s3 * dt)
        n_m_s2, e_m_s2 = north.led_m_s2 + part * j_n, east.led_m_s2 + part * j_e
        n_m_s, e_m_s = north.led_m_s + n_m_s2 * dt, east.led_m_s + e_m_s2 * dt
    if p.down_acceleration_m_s2 > 0.0:
        most = p.down_acceleration_m_s2
        wanted = _clamp(p.down_lead_per_s * (d_m_s - down.led_m_s), -most, most)
        change = p.down_jerk_m_s3 * dt
        d_m_s2 = _clamp(wanted, down.led_m_s2 - change, down.led_m_s2 + change)
        d_m_s = down.led_m_s + d_m_s2 * dt

    # the air's pull on the way, and what the loops see of the acceleration
    r_n, r_e, r_d = (
        p.drag_per_s * (v_n - wind.north_m_s),
        p.drag_per_s * (v_e - wind.east_m_s),
        p.drag_per_s * (v_d - wind.down_m_s),
    )
    g_n, g_e, g_d = ahead(north, n_m_s, v_n, dt), ahead(east, e_m_s, v_e, dt), ahead(down, d_m_s, v_d, dt)
    miss_n = n_m_s - v_n + p.position_per_s * g_n
    miss_e = e_m_s - v_e + p.position_per_s * g_e
    miss_d = d_m_s - v_d + p.down_position_per_s * g_d
    kp, kd = p.velocity_p, p.velocity_d
    a_n = n_m_s2 + kp * miss_n + north.integral_m_s2 + kd * (n_m_s2 - north.given_m_s2 + r_n)
    a_e = e_m_s2 + kp * miss_e + east.integral_m_s2 + kd * (e_m_s2 - east.given_m_s2 + r_e)
    kp, kd = p.down_velocity_p, p.down_velocity_d
    a_d = d_m_s2 + kp * miss_d + down.integral_m_s2 + kd * (d_m_s2 - down.given_m_s2 + r_d)

    part = _part(a_n, a_e, GRAVITY_M_S2 * tan(p.tilt_max_rad))
    held_d = _clamp(a_d, GRAVITY_M_S2 * (1.0 - 1.0 / p.hover_thrust), GRAVITY_M_S2 * (1.0 - LEAST_THRUST))
    gain = p.velocity_i * dt if part == 1.0 else 0.0
    gain_d = p.down_velocity_i * dt if held_d == a_d else 0.0
    north = answered(north, n_m_s, n_m_s2, g_n, gain * miss_n, part * a_n, p.frequency_rad_s, p.damping, dt)
    east = answered(east, e_m_s, e_m_s2, g_e, gain * miss_e, part * a_e, p.frequency_rad_s, p.damping, dt)
    down = answered(
        down, d_m_s, d_m_s2, g_d, gain_d * miss_d, held_d, p.down_frequency_rad_s, p.down_damping, dt
    )

    y, w = state.yaw_rate_rad_s, state.yaw_rate_rad_s2
    wanted = _clamp((p.yaw_gain * command.turn - y) / p.yaw_lag_s, -p.yaw_slew_rad_s2, p.yaw_slew_rad_s2)
    w = wanted + (w - wanted) * exp(-dt / p.yaw_lag2_s)
    y_after = y + w * dt
    heading = roll_pitch_heading(state.attitude_wxyz)[2] + 0.5 * (y + y_after) * dt
    attitude = tilted(north.given_m_s2, east.given_m_s2, down.given_m_s2, heading)
    rates = turned(state.attitude_wxyz, attitude, dt)
    return _moved(p, state, wind, dt, north, east, down, attitude, rates, y_after, w)


def _by_rates(p: Parameters, state: State, command: Command, wind: Wind, dt: float) -> State:
    keep = exp(-dt / p.rate_lag_s)
    now = state.body_rates_frd_rad_s
    rates = (
        command.x + keep * (now[0] - command.x),
        command.y + keep * (now[1] - command.y),
        command.z + keep * (now[2] - command.z),
    )
    h = 0.25 * dt
    turn = (h * (now[0] + rates[0]), h * (now[1] + rates[1]), h * (now[2] + rates[2]))
    attitude = multiplied(state.attitude_wxyz, (1.0, turn[0], turn[1], turn[2]))

    wanted = _clamp(command.turn, 0.0, 1.0) / p.hover_thrust * GRAVITY_M_S2
    thrust = thrust_of(p, state) / p.hover_thrust * GRAVITY_M_S2
    thrust = wanted + (thrust - wanted) * exp(-0.5 * dt * p.down_frequency_rad_s / p.down_damping)
    w, x, y, z = attitude
    a_n = -thrust * 2.0 * (x * z + w * y)
    a_e = -thrust * 2.0 * (y * z - w * x)
    a_d = GRAVITY_M_S2 - thrust * (1.0 - 2.0 * (x * x + y * y))
    v_n, v_e, v_d = state.velocity_ned_m_s
    # a velocity that is asked for next begins where it is
    north, east, down = (
        Loop(v_n, 0.0, 0.0, 0.0, a_n, 0.0),
        Loop(v_e, 0.0, 0.0, 0.0, a_e, 0.0),
        Loop(v_d, 0.0, 0.0, 0.0, a_d, 0.0),
    )
    return _moved(p, state, wind, dt, north, east, down, attitude, rates, rates[2], 0.0)


def _moved(
    p: Parameters,
    state: State,
    wind: Wind,
    dt: float,
    north: Loop,
    east: Loop,
    down: Loop,
    attitude: Wxyz,
    rates: Triple,
    yaw_rate: float,
    yaw_rate_rate: float,
) -> State:
    """With these accelerations through moving air."""
    c = p.drag_per_s
    x, v = state.position_ned_m, state.velocity_ned_m_s
    v_n = v[0] + (north.given_m_s2 - c * (v[0] - wind.north_m_s)) * dt
    v_e = v[1] + (east.given_m_s2 - c * (v[1] - wind.east_m_s)) * dt
    v_d = v[2] + (down.given_m_s2 - c * (v[2] - wind.down_m_s)) * dt
    h = 0.5 * dt
    return State(
        state.time_s + dt,
        (x[0] + h * (v[0] + v_n), x[1] + h * (v[1] + v_e), x[2] + h * (v[2] + v_d)),
        (v_n, v_e, v_d),
        attitude,
        rates,
        north,
        east,
        down,
        yaw_rate,
        yaw_rate_rate,
        state.queue,
    )


def _queued(state: State, command: Command) -> State:
    s = state
    return State(
        s.time_s,
        s.position_ned_m,
        s.velocity_ned_m_s,
        s.attitude_wxyz,
        s.body_rates_frd_rad_s,
        s.north,
        s.east,
        s.down,
        s.yaw_rate_rad_s,
        s.yaw_rate_rad_s2,
        (*s.queue[1:], command),
    )


def _part(x: float, y: float, most: float) -> float:
    """1, or less, so that (x, y) times it is at most `most` long."""
    length = sqrt(x * x + y * y)
    return most / length if length > most else 1.0


def _clamp(value: float, lowest: float, highest: float) -> float:
    return lowest if value < lowest else highest if value > highest else value
