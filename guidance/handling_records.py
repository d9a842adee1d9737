"""What was done around the law, beside each setpoint: a record for each class of vehicles."""

from __future__ import annotations

from guidance.record import Int64, Record, Triple


class GroundHandling(Record, frozen=True, kw_only=True, gc=False):
    """What was done around the law for a vehicle that drives (`guidance.handling.ground`).

    The course is `slip_rad` to the right of the heading. The trajectory's clock runs at `clock_rate` and is
    `waited_s` behind the flight's. `speed_correction_m_s` was added to the law's speed. `crawling`: the crawl
    set the speed, `slowed`: it was lowered to keep the path in a turn, `stuck`: it is asked to drive and does
    not move.
    """

    slip_rad: float
    clock_rate: float
    waited_s: float
    speed_correction_m_s: float
    crawling: bool
    slowed: bool
    stuck: bool


class AirplaneHandling(Record, frozen=True, kw_only=True, gc=False):
    """What an airplane was asked for and why (`guidance.handling.airplane`).

    The course over ground is `course_off_rad` off the wanted one (that is to the right where positive; beyond
    pi by the side that is turned to). Load factor, climb and airspeed are those of the demand;
    `airspeed_m_s` is what was measured, or |v - w|; the wind is that which is flown with. Effectiveness of
    the bank and the trims of pitch and throttle are learned. The trajectory's clock runs at `clock_rate` and
    is `waited_s` behind the flight's. `turning_aside`: it flies nearly opposite, and the side is kept;
    `climb_limited`: the climb is not what the field wants, `floored`: for the floor, `stall_guard`: for the
    airspeed, or the throttle is full for it; `airspeed_doubted`: what is measured does not fit the wind;
    `blind`: nor is a wind told, and |v - w| by an earlier one is all that is known.
    """

    course_rad: float
    course_off_rad: float
    bank_asked_rad: float
    pitch_asked_rad: float
    load: float
    climb_asked_m_s: float
    airspeed_m_s: float
    airspeed_asked_m_s: float
    wind_ned_m_s: Triple
    effectiveness: float
    pitch_trim_rad: float
    throttle_trim: float
    clock_rate: float
    waited_s: float
    turning_aside: bool
    bank_saturated: bool
    pitch_saturated: bool
    throttle_saturated: bool
    climb_limited: bool
    floored: bool
    stall_guard: bool
    airspeed_doubted: bool
    blind: bool


class Stepping(Record, frozen=True, kw_only=True, gc=False, omit_defaults=True):
    """One step of a tuning flight (`guidance.flying.excited`): `into_s` into `phase` of `run`.

    While it is "stepping", `channel` is measured: `measured` at `measured_ns`, which changes by `push` each
    second for other reasons than the command. `blind`: as of an airplane (topic `airplane`).
    """

    run: str
    phase: str
    into_s: float
    channel: str = ""
    measured: float = 0.0
    measured_ns: Int64 = 0
    push: float = 0.0
    blind: bool = False


class VelocityHandling(Record, frozen=True, kw_only=True, gc=False):
    """What a copter was asked for and why (`guidance.handling.velocity`).

    `wanted_ned_m_s` is the field within the limits; what is asked for leads it. The nose is sought at
    `heading_rad`. The air takes `drag_per_s` of the velocity through it, as learned. The trajectory's clock
    runs at `clock_rate` and is `waited_s` behind the flight's. `stuck`: it is asked to fly and does not move.

    The rest is of `copter.output = "rates"` (`guidance.handling.copter_rates`): what is held against the
    wind, the hover thrust over the one that the autopilot tells, as learned, and what is at its end.
    """

    wanted_ned_m_s: Triple
    heading_rad: float
    drag_per_s: float
    clock_rate: float
    waited_s: float
    stuck: bool
    held_ned_m_s2: Triple = (0.0, 0.0, 0.0)
    hover_part: float = 1.0
    tilt_limited: bool = False
    thrust_limited: bool = False
