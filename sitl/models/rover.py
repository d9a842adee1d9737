"""A rover with Ackermann steering, or a boat, whose autopilot is told a yaw rate and a forward speed.

The plane is north-east, headings are from north to the east, yaw rates positive to the right. What acts:

- a command acts `delay_s` after it was given; what was given meanwhile queues in the state;
- the yaw rate follows `yaw_gain` times the wanted one with a lag, and changes by at most `yaw_slew_rad_s2`;
  it is no more than the wheels allow, |w| <= |v|/`turning_radius_m`: at rest nothing turns; and no more than
  the autopilot allows at speed, |v w| <= `lateral_acceleration_m_s2`;
- the autopilot leads the wanted speed at `acceleration_m_s2` to the commanded one and drives by
  `speed_feed` of it, which is more than drag takes, with a PI loop on ground speed: an answer of second
  order that overshoots. At rest with nothing wanted it lets go, and its integral is forgotten;
- the course differs from the heading: by `misalignment_rad` always, and outward by `drift_s` v w in turns;
- water carries it at `carried_*_m_s`, and wind at `wind_part` of its velocity.

The autopilot's loop has the form of ArduPilot's (ATC_SPEED_P, ATC_SPEED_I, CRUISE_SPEED over CRUISE_THROTTLE,
ATC_ACCEL_MAX, ATC_STR_ACC_MAX, ATC_TURN_MAX_G), the body that of its simulator: a drive force against a drag
that grows with speed, and a turning circle.
"""

from __future__ import annotations

from math import atan2, cos, exp, hypot, inf, pi, sin
from typing import Final, NamedTuple

#: So many commands can be on their way; of more, the oldest act too early. 0.6 s at 50 Hz.
IN_FLIGHT: Final = 32
#: Below this speed (m/s) an autopilot that is told to stand lets go, as ArduPilot's STOP_SPEED.
STANDING_M_S: Final = 0.1


class Parameters(NamedTuple):
    """As the module says. `drag_s` is the time constant in which drag alone slows it, `drive_m_s2` the
    acceleration of full throttle; `speed_p` and `speed_i` are in 1/s and 1/s^2, throttle times drive."""

    delay_s: float
    yaw_gain: float
    yaw_slew_rad_s2: float
    yaw_lag_s: float
    turning_radius_m: float
    lateral_acceleration_m_s2: float
    speed_max_m_s: float
    acceleration_m_s2: float
    speed_feed: float
    speed_p: float
    speed_i: float
    drag_s: float
    drive_m_s2: float
    misalignment_rad: float
    drift_s: float
    carried_north_m_s: float
    carried_east_m_s: float
    wind_part: float


#: Parameters that divide, and those that may be negative.
POSITIVE: Final = frozenset(
    {
        "yaw_lag_s",
        "yaw_gain",
        "yaw_slew_rad_s2",
        "turning_radius_m",
        "lateral_acceleration_m_s2",
        "speed_max_m_s",
        "acceleration_m_s2",
        "drag_s",
        "drive_m_s2",
    }
)
SIGNED: Final = frozenset({"misalignment_rad", "carried_north_m_s", "carried_east_m_s"})


class Command(NamedTuple):
    """What the autopilot is told, and from when on (s, the state's clock) it acts on it."""

    acts_s: float
    yaw_rate_rad_s: float
    speed_m_s: float


class State(NamedTuple):
    """Where it is, how it moves, and what is in its autopilot.

    `speed_m_s` is along the heading, over ground (what the autopilot measures); `wanted_m_s` the led speed;
    `integral_m_s2` that of the loop. `queue` holds the last commands, oldest first.
    """

    time_s: float
    north_m: float
    east_m: float
    heading_rad: float
    yaw_rate_rad_s: float
    speed_m_s: float
    wanted_m_s: float
    integral_m_s2: float
    velocity_north_m_s: float
    velocity_east_m_s: float
    queue: tuple[Command, ...]


def at_rest(north_m: float, east_m: float, heading_rad: float) -> State:
    """Standing there, and told to."""
    queue = (Command(-inf, 0.0, 0.0),) * IN_FLIGHT
    return State(0.0, north_m, east_m, heading_rad, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, queue)


def told(parameters: Parameters, state: State, yaw_rate_rad_s: float, speed_m_s: float) -> State:
    """The state with one more command under way; both finite."""
    s = state
    command = Command(s.time_s + parameters.delay_s, yaw_rate_rad_s, speed_m_s)
    return State(
        s.time_s,
        s.north_m,
        s.east_m,
        s.heading_rad,
        s.yaw_rate_rad_s,
        s.speed_m_s,
        s.wanted_m_s,
        s.integral_m_s2,
        s.velocity_north_m_s,
        s.velocity_east_m_s,
        (*s.queue[1:], command),
    )


def step(
    parameters: Parameters, state: State, wind_north_m_s: float, wind_east_m_s: float, dt_s: float
) -> State:
    """The state `dt_s` (> 0, milliseconds) later: of second order in `dt_s`, of first at the limits."""
    p = parameters
    command = acting(state.queue, state.time_s)
    v = state.speed_m_s

    wanted = _clamp(command.speed_m_s, -p.speed_max_m_s, p.speed_max_m_s)
    change = p.acceleration_m_s2 * dt_s
    led = _clamp(wanted, state.wanted_m_s - change, state.wanted_m_s + change)
    integral = state.integral_m_s2
    if led == 0.0 and abs(v) < STANDING_M_S:
        integral = 0.0
        after = v * exp(-dt_s / p.drag_s)
    else:
        # Heun's method on speed and integral, with the led speed of either end
        v1, i1 = _drive(p, state.wanted_m_s, v, integral)
        v2, i2 = _drive(p, led, v + v1 * dt_s, integral + i1 * dt_s)
        after = v + 0.5 * (v1 + v2) * dt_s
        integral += 0.5 * (i1 + i2) * dt_s

    w = state.yaw_rate_rad_s
    gap = p.yaw_gain * command.yaw_rate_rad_s - w
    slew = p.yaw_slew_rad_s2 * dt_s
    turn = w + _clamp(gap * (1.0 - exp(-dt_s / p.yaw_lag_s)), -slew, slew)
    most = abs(after) / p.turning_radius_m
    if abs(after) * most > p.lateral_acceleration_m_s2:
        most = p.lateral_acceleration_m_s2 / abs(after)
    turn = _clamp(turn, -most, most)

    # the midpoint's heading and speeds
    heading = state.heading_rad + 0.25 * (w + turn) * dt_s
    along = 0.5 * (v + after)
    across = along * p.misalignment_rad - p.drift_s * along * 0.5 * (w + turn)
    c, s = cos(heading), sin(heading)
    north = p.carried_north_m_s + p.wind_part * wind_north_m_s
    east = p.carried_east_m_s + p.wind_part * wind_east_m_s
    # what carries it along the heading is in the measured speed already; across it adds
    across += c * east - s * north
    north, east = along * c - across * s, along * s + across * c
    return State(
        state.time_s + dt_s,
        state.north_m + north * dt_s,
        state.east_m + east * dt_s,
        state.heading_rad + 0.5 * (w + turn) * dt_s,
        turn,
        after,
        led,
        integral,
        north,
        east,
        state.queue,
    )


def steered(
    yaw_p: float, yaw_rate_max_rad_s: float, heading_rad: float, north_m_s: float, east_m_s: float
) -> tuple[float, float]:
    """What PX4's rover makes of a velocity: the yaw rate towards its bearing, and its length as the speed.

    RO_YAW_P (1/s) and RO_YAW_RATE_LIM. Yaw and yaw rate of the setpoint are not used, it never reverses, and
    a velocity of zero has the bearing 0: north.
    """
    off = atan2(east_m_s, north_m_s) - heading_rad
    off -= 2.0 * pi * round(off / (2.0 * pi))
    return (
        _clamp(yaw_p * off, -yaw_rate_max_rad_s, yaw_rate_max_rad_s),
        hypot(north_m_s, east_m_s),
    )


def acting(queue: tuple[Command, ...], time_s: float) -> Command:
    """The newest command that acts at `time_s`; if all are still under way, the oldest."""
    found = queue[0]
    for command in queue:
        # times are sums of steps: a nanosecond is no delay
        if command.acts_s <= time_s + 1e-9:
            found = command
    return found


def _drive(p: Parameters, led: float, v: float, integral: float) -> tuple[float, float]:
    """Acceleration and the integral's rate; the integral rests while the throttle is at its end."""
    error = led - v
    throttle = p.speed_feed * led / p.drag_s + p.speed_p * error + integral
    held = _clamp(throttle, -p.drive_m_s2, p.drive_m_s2)
    growth = p.speed_i * error
    if throttle != held and growth * throttle > 0.0:
        growth = 0.0
    return held - v / p.drag_s, growth


def _clamp(value: float, lowest: float, highest: float) -> float:
    return lowest if value < lowest else highest if value > highest else value
