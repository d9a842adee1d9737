"""Airplanes: they turn by banking, and are told roll, pitch and throttle.

The rates of (11) act on the velocity, not on the nose. One step, in order: the wind, the clock of the
reference, the field with bounds of its own along and up (`error_function.BOUNDED_APART`), course and climb
with their rates (`airplane_course`), what the envelope leaves of them (`airplane_envelope`), and then what
gives the accelerations: bank (`airplane_bank`), pitch (`airplane_pitch`) and throttle (`airplane_throttle`).

Course and climb are over ground, where the reference is; what the airplane does for them it does in the air.
A steady wind changes no acceleration, so the level one that is wanted, along and across the ground's course,
is the one along and across the air's.
"""

from __future__ import annotations

from math import atan2, cos, sin, sqrt, tan
from typing import Final, NamedTuple

from guidance import error_function
from guidance.handling import (
    airplane_bank,
    airplane_clock,
    airplane_course,
    airplane_envelope,
    airplane_pitch,
    airplane_throttle,
    airplane_wind,
    waiting,
)
from guidance.handling.airplane_bank import GRAVITY_M_S2, STEEPEST_RAD
from guidance.handling.airplane_prediction import coasted
from guidance.law import field_of
from guidance.limits import clamp
from guidance.se3 import Pose, Quaternion, Reference, Vec3, dot, from_euler, roll_of, subtract, yaw_of

#: Slower (m/s) in the air, or over ground, no direction and no division is taken from it.
MOVING_M_S: Final = 3.0
#: Shortest time (s) that divides.
LEAST_S: Final = 1e-3
#: More acceleration along the path (m/s^2) than this comes from an error far off, not from a plan.
ALONG_M_S2: Final = 1.5


class Parameters(NamedTuple):
    """`k_per_s` is lambda k of the field in the plane, `k_up_per_s` that of its vertical, approached at most
    at `approach_m_s` and `approach_up_m_s`; `rho_per_s` is the turn's gain, `roll_rate_rad_s` how fast the
    bank can change."""

    k_per_s: float
    k_up_per_s: float
    approach_m_s: float
    approach_up_m_s: float
    rho_per_s: float
    roll_rate_rad_s: float
    envelope: airplane_envelope.Parameters
    bank: airplane_bank.Parameters
    pitch: airplane_pitch.Parameters
    throttle: airplane_throttle.Parameters
    wind: airplane_wind.Parameters
    waiting: waiting.Parameters


class Trims(NamedTuple):
    """What a flight learns of its airplane, and the next one starts with: eta, pitch (rad), throttle."""

    effectiveness: float
    pitch_rad: float
    throttle: float


class Memory(NamedTuple):
    """Of each function its own; `side` is the latched one of `airplane_course`, `asked_rad` the last bank,
    `obeyed_rad` that which the demands of the last `ahead_s` lead to, `slow_s` how long it has been too slow.
    """

    side: int
    wind: airplane_wind.Memory
    bank: airplane_bank.Memory
    pitch_trim_rad: float
    throttle_trim: float
    waiting: waiting.Memory
    asked_rad: float
    obeyed_rad: float
    slow_s: float
    started: bool


class Measured(NamedTuple):
    """Pose and velocity over ground, NED; true airspeed (0: not measured); the wind, if the autopilot knows.

    `ahead_s` is how much later the demand acts: position and velocity are moved there by
    `airplane_prediction`. It is 0 for a caller who did so.
    """

    pose: Pose
    velocity_ned_m_s: Vec3
    airspeed_m_s: float
    wind_given: bool
    wind_ned_m_s: Vec3
    ahead_s: float


class Demand(NamedTuple):
    """What to ask the autopilot for: `attitude` is that of roll and pitch at the measured heading."""

    attitude: Quaternion
    roll_rad: float
    pitch_rad: float
    throttle: float


class Evaluation(NamedTuple):
    """What a step found, for the record. `airspeed_m_s` is |v - w|, `asked_m_s` the one that is asked for;
    `turn_aside` the latched side. The flags say which limit changed something, and whether the
    measured airspeed is not believed."""

    reference: Reference
    e: Vec3
    wanted: airplane_course.Wanted
    course_rad: float
    course_off_rad: float
    turn_aside: int
    airspeed_m_s: float
    asked_m_s: float
    climb_m_s: float
    load: float
    clock_rate: float
    wind_ned_m_s: Vec3
    trims: Trims
    bank_saturated: bool
    pitch_saturated: bool
    throttle_saturated: bool
    climb_limited: bool
    floored: bool
    stall_guard: bool
    airspeed_doubted: bool


#: A flight of which nothing is known.
UNTRIMMED: Final = Trims(1.0, 0.0, 0.0)


def unstarted(trims: Trims) -> Memory:
    """Before the first step of a flight, with what the last one learned."""
    return Memory(
        0,
        airplane_wind.UNKNOWN,
        airplane_bank.unlearned(trims.effectiveness),
        trims.pitch_rad,
        trims.throttle,
        waiting.ON_TIME,
        0.0,
        0.0,
        0.0,
        False,
    )


def trims_of(memory: Memory) -> Trims:
    """What has been learned so far."""
    return Trims(memory.bank.effectiveness, memory.pitch_trim_rad, memory.throttle_trim)


def airplane_step(
    parameters: Parameters, memory: Memory, measured: Measured, reference: Reference, dt: float
) -> tuple[Memory, Demand, Evaluation]:
    """`dt` s (> 0) after the step before, with the reference as planned at flight time - `waited_s`.

    The reference is that of the instant at which the demand acts. The caller has checked
    that all is finite and the attitude a unit quaternion; then nothing raises and all is finite.
    """
    p = parameters
    seen = measured.velocity_ned_m_s
    bank_now = roll_of(measured.pose.attitude)
    heading = yaw_of(measured.pose.attitude)
    sensed = airplane_wind.believed_m_s(memory.wind, seen, measured.airspeed_m_s, p.wind.wind_max_m_s)
    wind = airplane_wind.wind_step(
        p.wind,
        memory.wind,
        seen,
        heading,
        sensed,
        measured.wind_given,
        measured.wind_ned_m_s,
        dt,
    )
    w_north, w_east = wind.north_m_s, wind.east_m_s
    eta = memory.bank.effectiveness
    # the demands under way, not the bank that is measured: that was their doing too, but longer ago
    obeyed, asked_rad = (memory.obeyed_rad, memory.asked_rad) if memory.started else (bank_now, bank_now)
    x, v = coasted(measured.pose.position, seen, Vec3(w_north, w_east, 0.0), obeyed, eta, measured.ahead_s)
    # directions along the ground's course and along the air's, level, and the speeds
    ground, ground_c, ground_s = _direction(v.x, v.y, heading)
    air, air_c, air_s = _direction(v.x - w_north, v.y - w_east, heading)
    carried = sqrt(air * air + v.z * v.z)
    # the wing feels the gusts that a sensor sees; the path over ground does not
    # one that is only inferred never counts as too slow: a wrong wind must not dive anybody into the ground
    inferred = max(carried, p.envelope.airspeed_min_m_s)
    airspeed = max(sensed, MOVING_M_S) if sensed > 0.0 else inferred
    course = atan2(ground_s, ground_c)

    # as steep as the wing is loaded now
    load_now = 1.0 / cos(clamp(bank_now, -STEEPEST_RAD, STEEPEST_RAD))
    slowest = airplane_envelope.slowest_m_s(p.envelope, load_now)
    fastest = airplane_throttle.fastest_m_s(p.throttle, memory.throttle_trim, load_now, -reference.velocity.z)
    fastest = min(fastest, p.envelope.airspeed_max_m_s)
    steady = airplane_envelope.most_load(p.envelope, airspeed, 1.0)
    bank_max = airplane_bank.bank_limit(p.envelope.bank_max_rad, steady)
    clock = airplane_clock.clock_step(
        p.waiting,
        memory.waiting,
        reference,
        x,
        v,
        airspeed - slowest,
        fastest - airspeed,
        GRAVITY_M_S2 * eta * tan(p.envelope.bank_max_rad),
        dt,
    )
    # s'' is left out: of a noisy position it is mostly noise, and it only pushes along the track
    r = waiting.on_clock(reference, memory.waiting.rate, 0.0)

    e = subtract(x, r.position)
    Xr, Xr_dot = _field(p, e, r, v)
    wanted = airplane_course.wanted_of(Xr, Xr_dot, course)

    turning = GRAVITY_M_S2 * eta / ground
    turn = airplane_course.turn_to(
        p.rho_per_s,
        turning * p.roll_rate_rad_s,
        turning * tan(p.envelope.bank_max_rad),
        memory.side,
        wanted,
        course,
        bank_now,
    )

    # the airspeed that makes the ground speed, and the climb
    level = Vec3(Xr.x - w_north, Xr.y - w_east, 0.0)
    asked = sqrt(dot(level, level) + wanted.climb_m_s * wanted.climb_m_s)
    # height before speed: what a climb leaves of the thrust is for the speed, down to the slowest
    best = slowest * airplane_throttle.steepest_sine(p.throttle, memory.throttle_trim, slowest, load_now)
    climb = airplane_envelope.climb_within(p.envelope, wanted.climb_m_s, airspeed, x.z, best)
    powered = airplane_throttle.fastest_m_s(p.throttle, memory.throttle_trim, load_now, climb.climb_m_s)
    missing = airplane_envelope.missing_within(
        p.envelope, min(asked, max(powered, slowest)) - carried, airspeed, load_now
    )
    path_wanted = airplane_pitch.path_angle(climb.climb_m_s, airspeed)
    path_now = airplane_pitch.path_angle(-v.z, airspeed)

    # level accelerations over ground, and the same along and across the air's direction
    to_side = ground * turn.course_rate_rad_s
    along = 0.0
    if missing == asked - carried:
        along = turn.aligned * clamp(wanted.acceleration_m_s2, -ALONG_M_S2, ALONG_M_S2)
    crab_c = ground_c * air_c + ground_s * air_s
    crab_s = ground_s * air_c - ground_c * air_s
    lateral = to_side * crab_c + along * crab_s
    forward = along * crab_c - to_side * crab_s
    if missing > asked - carried:
        # the envelope wants it faster than the path does: no turn in the wind may take thrust from it
        forward = max(forward, 0.0)
    climb_rate = 0.0 if climb.limited else wanted.climb_rate_m_s2
    upright = GRAVITY_M_S2 * cos(path_wanted) + climb_rate / cos(path_wanted)

    asked_rad = clamp(asked_rad, -bank_max, bank_max)  # what the wing carries holds at once
    wanted_bank = airplane_bank.bank_for(lateral, upright, eta, bank_max)
    bank = airplane_bank.rolled(wanted_bank, asked_rad, p.roll_rate_rad_s * dt)
    saturated = bank.saturated or turn.saturated
    slow_s = airplane_envelope.slow_step(p.envelope, memory.slow_s, airspeed, dt)
    pitch = airplane_pitch.pitch_for(
        p.pitch,
        memory.pitch_trim_rad,
        path_wanted,
        path_now,
        bank_now,
        airplane_envelope.unloaded(p.envelope, airspeed, upright / GRAVITY_M_S2),
        airspeed,
        airplane_envelope.most_load(p.envelope, airspeed, airplane_envelope.WING_PART),
        airplane_envelope.pushed_rad(slow_s),
        climb.guarded,
        dt,
    )
    throttle = airplane_throttle.throttle_for(
        p.throttle,
        memory.throttle_trim,
        missing,
        airspeed,
        path_wanted,
        bank.load,
        forward,
        climb.guarded,
        dt,
    )
    full = airplane_envelope.stalling(p.envelope, airspeed)
    learned = airplane_bank.effectiveness_step(
        p.bank,
        memory.bank,
        seen,
        Vec3(w_north, w_east, 0.0),
        bank_now,
        upright,
        saturated or climb.guarded,
        dt,
    )
    # half of what was asked for within `ahead_s` acts by then
    obeyed += clamp(2.0 * dt / max(measured.ahead_s, dt, LEAST_S), 0.0, 1.0) * (bank.bank_rad - obeyed)
    trims = (pitch.trim_rad, throttle.trim)
    after = Memory(turn.side, wind, learned, *trims, clock, bank.bank_rad, obeyed, slow_s, True)
    power = p.throttle.highest if full else throttle.throttle
    return (
        after,
        Demand(from_euler(bank.bank_rad, pitch.pitch_rad, heading), bank.bank_rad, pitch.pitch_rad, power),
        Evaluation(
            r,
            e,
            wanted,
            course,
            turn.off_rad,
            turn.side,
            airspeed,
            airspeed + missing,
            climb.climb_m_s,
            bank.load,
            memory.waiting.rate,
            Vec3(w_north, w_east, 0.0),
            trims_of(after),
            saturated,
            pitch.saturated,
            throttle.saturated,
            climb.limited,
            climb.floored,
            climb.guarded or full,
            sensed != measured.airspeed_m_s,
        ),
    )


def _direction(north: float, east: float, heading_rad: float) -> tuple[float, float, float]:
    """Speed, at least `MOVING_M_S`, and direction; that of the nose where there is no speed to speak of."""
    speed = sqrt(north * north + east * east)
    if speed < MOVING_M_S:
        return MOVING_M_S, cos(heading_rad), sin(heading_rad)
    return speed, north / speed, east / speed


def _field(p: Parameters, e: Vec3, r: Reference, v: Vec3) -> tuple[Vec3, Vec3]:
    """Xr and its derivative along the measured velocity: Xr' = r'' + H (r' - v), with either k."""
    bounded = error_function.ErrorFunction(
        error_function.BOUNDED_APART, p.approach_m_s, p.approach_up_m_s, 0.0, 1.0, r.position
    )
    level = error_function.derivatives(bounded, p.k_per_s, 1.0, e, r)
    up = error_function.derivatives(bounded, p.k_up_per_s, 1.0, e, r)
    Xr, a = field_of(1.0, level, r)
    Xr_up, a_up = field_of(1.0, up, r)
    turned = error_function.times(level.hessian, v)
    return (
        Vec3(Xr.x, Xr.y, Xr_up.z),
        Vec3(a.x - turned.x, a.y - turned.y, a_up.z - up.hessian.zz * v.z),
    )
