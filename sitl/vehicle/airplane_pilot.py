"""What flies an airplane in the modes that fly by themselves: circle, straight on, take off, land, come home.

Loops on course, climb and airspeed as every autopilot has them, in the simplest form that is stable with the
recorded answers to roll, pitch and throttle. The course turns by the bank; the pitch holds the climb, the
throttle the airspeed. Below the least airspeed the nose goes down, whatever is asked for.
"""

from __future__ import annotations

from math import acos, asin, atan, atan2, hypot, pi, remainder, sin
from typing import Final, NamedTuple

from sitl.plant import euler_from_attitude
from sitl.vehicle.body import BodyState
from sitl.vehicle.controls import Attitude

GRAVITY_M_S2: Final = 9.80665
#: Steepest bank of what flies by itself; the least that a slow airplane keeps, and the part of the airspeed
#: that the load factor may take above the least one.
ROLL_MAX_RAD: Final = 0.8
ROLL_SLOW_RAD: Final = 0.3
LOAD_MARGIN: Final = 1.1
COURSE_PER_S: Final = 0.6
HEIGHT_PER_S: Final = 0.4
#: A circle that is farther off than its radius is flown to by the shortest way.
CIRCLE_TURN: Final = 1.5
PATH_P: Final = 0.5
PATH_I_PER_S: Final = 0.6
PITCH_TRIM_MAX_RAD: Final = 0.2
THROTTLE_PER_M_S: Final = 0.08
THROTTLE_I: Final = 0.03
#: Throttle that carries the weight's part along the path.
THROTTLE_PER_SLOPE: Final = 0.75
#: In parts of the least airspeed: where it does not climb, and the width over which it climbs as asked for.
NO_CLIMB: Final = 0.9
CLIMB_WIDTH: Final = 0.25
#: Between these parts of the least airspeed the nose may be so far above the path (rad): only less angle of
#: attack, and the speed that follows, unstalls a wing.
SLOW: Final = (0.85, 1.15)
NOSE_ABOVE_PATH_RAD: Final = (-0.15, 0.3)
#: In parts of the least airspeed: where the nose is lifted on the ground.
ROTATE: Final = 1.1
#: Closer to the ground than this (m) the wings stay level.
LEVEL_BELOW_M: Final = 8.0
#: Height (m) at which it counts as standing or rolling on the ground.
GROUND_M: Final = 0.05
#: Time without a look after which the loops forget (s).
FORGET_S: Final = 0.5


class Envelope(NamedTuple):
    """What the firmware's parameters allow; throttle from 0 to 1."""

    airspeed_min_m_s: float
    airspeed_m_s: float
    roll_max_rad: float
    pitch_min_rad: float
    pitch_max_rad: float
    climb_max_m_s: float
    sink_max_m_s: float
    throttle_max: float
    takeoff_pitch_rad: float


class Circle(NamedTuple):
    """Around a point, to the right with a positive radius; heights above the origin."""

    north_m: float
    east_m: float
    radius_m: float
    height_m: float


class Straight(NamedTuple):
    """On this course over ground at this height."""

    course_rad: float
    height_m: float


class Takeoff(NamedTuple):
    """Roll, lift off and climb straight on to this height."""

    course_rad: float
    height_m: float


class Landing(NamedTuple):
    """Glide straight on down to the ground and roll out."""

    course_rad: float


Plan = Circle | Straight | Takeoff | Landing


class AirplanePilot:
    """Loops with two integrals: pitch and throttle for the path that is asked for."""

    def __init__(self) -> None:
        self._at_ns: int | None = None
        self._pitch_rad = 0.0
        self._throttle = 0.0

    def forget(self) -> None:
        """Somebody else flies: begin from what is when asked again."""
        self._at_ns = None

    def fly(self, plan: Plan, envelope: Envelope, state: BodyState, at_ns: int) -> Attitude:
        """Roll, pitch and throttle for the plan; to be asked some 50 times a second."""
        if on_ground(state):
            self.forget()
            if isinstance(plan, Takeoff):
                rotates = state.airspeed_m_s > ROTATE * envelope.airspeed_min_m_s
                return Attitude(0.0, envelope.takeoff_pitch_rad if rotates else 0.0, envelope.throttle_max)
            return Attitude()
        height = height_of(state)
        speed = envelope.airspeed_m_s
        match plan:
            case Circle(north, east, radius, wanted):
                roll = _circle_roll(state, north, east, radius)
                climb = HEIGHT_PER_S * (wanted - height)
            case Straight(course, wanted):
                roll = _course_roll(state, course)
                climb = HEIGHT_PER_S * (wanted - height)
            case Takeoff(course, wanted):
                roll = _course_roll(state, course) if height > LEVEL_BELOW_M else 0.0
                # there in finite time
                climb = max(1.0, HEIGHT_PER_S * (wanted - height))
            case Landing(course):
                roll = _course_roll(state, course) if height > LEVEL_BELOW_M else 0.0
                climb = -min(2.0, 0.3 + 0.15 * height)
                speed = 1.2 * envelope.airspeed_min_m_s
        return self._held(envelope, state, roll, climb, speed, at_ns)

    def _held(
        self, e: Envelope, state: BodyState, roll: float, climb: float, speed: float, at_ns: int
    ) -> Attitude:
        v = max(state.airspeed_m_s, 0.5 * e.airspeed_min_m_s)
        margin = (v / e.airspeed_min_m_s - NO_CLIMB) / CLIMB_WIDTH
        climb = _clamp(climb, -e.sink_max_m_s, e.climb_max_m_s * _clamp(margin, -1.0, 1.0))
        path, wanted = (
            asin(_clamp(-state.velocity_ned_m_s[2] / v, -1.0, 1.0)),
            asin(_clamp(climb / v, -0.5, 0.5)),
        )
        if self._at_ns is None or at_ns - self._at_ns > FORGET_S * 1e9:
            pitch = euler_from_attitude(state.attitude_wxyz)[1]
            self._pitch_rad = _clamp(pitch - path, -PITCH_TRIM_MAX_RAD, PITCH_TRIM_MAX_RAD)
            self._throttle = state.throttle - THROTTLE_PER_SLOPE * sin(path)
            self._at_ns = at_ns
        dt_s, self._at_ns = (at_ns - self._at_ns) * 1e-9, at_ns
        pitch = self._pitch_rad + wanted + PATH_P * (wanted - path)
        throttle = self._throttle + THROTTLE_PER_M_S * (speed - v) + THROTTLE_PER_SLOPE * sin(wanted)
        (slow, fast), (low, high) = SLOW, NOSE_ABOVE_PATH_RAD
        part = _clamp((state.airspeed_m_s / e.airspeed_min_m_s - slow) / (fast - slow), 0.0, 1.0)
        pitch_max = _clamp(path + low + part * (high - low), e.pitch_min_rad, e.pitch_max_rad)
        given = _clamp(pitch, e.pitch_min_rad, pitch_max)
        # at a limit the integral comes back to what is given
        missing = wanted - path if given == pitch else (given - pitch) / PATH_I_PER_S
        trim = self._pitch_rad + PATH_I_PER_S * missing * dt_s
        self._pitch_rad = _clamp(trim, -PITCH_TRIM_MAX_RAD, PITCH_TRIM_MAX_RAD)
        if 0.0 < throttle < e.throttle_max:
            self._throttle += THROTTLE_I * (speed - v) * dt_s
        load = acos(_clamp((LOAD_MARGIN * e.airspeed_min_m_s / v) ** 2, 0.0, 1.0))
        roll_max = min(e.roll_max_rad, ROLL_MAX_RAD, max(ROLL_SLOW_RAD, load))
        return Attitude(
            _clamp(roll, -roll_max, roll_max),
            given,
            _clamp(throttle, 0.0, e.throttle_max),
        )


def height_of(state: BodyState) -> float:
    """Above the origin, m."""
    return -state.position_ned_m[2]


def course_of(state: BodyState) -> float:
    """Over ground, rad; the heading if it hardly moves."""
    north, east, _ = state.velocity_ned_m_s
    return atan2(east, north) if hypot(north, east) > 1.0 else euler_from_attitude(state.attitude_wxyz)[2]


def on_ground(state: BodyState) -> bool:
    """Whether it stands or rolls."""
    return height_of(state) < GROUND_M


def standing(state: BodyState) -> bool:
    """Whether a land detector would call it landed."""
    return on_ground(state) and hypot(*state.velocity_ned_m_s) < 1.0


def _course_roll(state: BodyState, course: float, turn_rad_s: float = 0.0) -> float:
    rate = turn_rad_s + COURSE_PER_S * remainder(course - course_of(state), 2.0 * pi)
    return atan2(hypot(*state.velocity_ned_m_s[:2]) * rate, GRAVITY_M_S2)


def _circle_roll(state: BodyState, north: float, east: float, radius: float) -> float:
    side, r = (1.0 if radius >= 0.0 else -1.0), max(abs(radius), 1.0)
    x, y = state.position_ned_m[0] - north, state.position_ned_m[1] - east
    off = (hypot(x, y) - r) / r
    course = atan2(y, x) + side * (0.5 * pi + atan(CIRCLE_TURN * off))
    ahead = side * hypot(*state.velocity_ned_m_s[:2]) / r * max(0.0, 1.0 - abs(off))
    return _course_roll(state, course, ahead)


def _clamp(value: float, lowest: float, highest: float) -> float:
    return lowest if value < lowest else highest if value > highest else value
