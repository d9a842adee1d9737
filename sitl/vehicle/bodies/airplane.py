"""The airplane of `sitl.models.airplane` in wind with gusts, above a ground on which it can roll."""

from __future__ import annotations

from math import asin, cos, exp, hypot, sin, sqrt, tan
from random import Random
from typing import ClassVar, Final, NamedTuple

from sitl.models import airplane
from sitl.models.gusts import NO_GUSTS, Gusts, Turbulence, Wind, blowing, gusts_step
from sitl.plant import Triple, attitude_from_euler
from sitl.vehicle.bodies.grid import STEP_S, GridBody
from sitl.vehicle.body import BodyState
from sitl.vehicle.controls import Attitude, Control, RatesThrottle

#: The gusts change every so many steps (20 ms), as in the flights of `sitl.airplane_flight`.
GUST_STEPS: Final = 5
#: Of gusts in low flight, after `sitl.models.gusts`: vertical sigma for one level, and scale lengths, m.
VERTICAL_PART: Final = 0.625
LEVEL_LENGTH_M: Final = 200.0
VERTICAL_LENGTH_M: Final = 50.0
#: On the ground: what rolling takes, and how quickly the wings are levelled.
ROLLING_M_S2: Final = 0.6
LEVELLING_S: Final = 0.2
#: Slower than this, in stall speeds, it does not leave the ground: it would stall.
LIFT_OFF_STALLS: Final = 1.25


class AirplaneState(NamedTuple):
    """The model's state and the gusts about the steady wind."""

    flight: airplane.State
    gusts: Gusts


class AirplaneBody(GridBody[AirplaneState]):
    """At first in steady level flight at this airspeed; with 0, standing on the ground.

    The ground is level and at height 0 of the local frame. The airplane cannot fall through it: it rolls on
    along its heading, is slowed by drag and friction, and flies again when its wings carry it. `gusts_m_s`
    is their level sigma. They are a function of `seed` and time.
    """

    takes: ClassVar[tuple[type, ...]] = (Attitude, RatesThrottle)

    def __init__(
        self,
        parameters: airplane.Parameters,
        position_ned_m: Triple,
        yaw_rad: float,
        airspeed_m_s: float,
        wind_ned_m_s: Triple,
        gusts_m_s: float,
        seed: int,
        start_ns: int,
    ) -> None:
        wind = Wind(*wind_ned_m_s)
        speed = airspeed_m_s or parameters.stall_m_s
        flight = airplane.flying(parameters, *position_ned_m, yaw_rad, speed, wind)
        if airspeed_m_s == 0.0:
            flight = flight._replace(
                velocity_north_m_s=0.0,
                velocity_east_m_s=0.0,
                velocity_down_m_s=0.0,
                pitch_rad=0.0,
                throttle=0.0,
                airspeed_m_s=hypot(*wind),
            )
            flight = airplane.told(flight, 0.0, 0.0, 0.0)
            flight = flight._replace(queue=flight.queue[-1:] * airplane.IN_FLIGHT)
        super().__init__(AirplaneState(flight, NO_GUSTS), start_ns)
        self._parameters = parameters
        self._seed = seed
        self._turbulence = Turbulence(
            wind, gusts_m_s, VERTICAL_PART * gusts_m_s, LEVEL_LENGTH_M, VERTICAL_LENGTH_M
        )

    def carry(self, ned_m_s: Triple, at_ns: int) -> None:
        self._live(at_ns)
        self._turbulence = self._turbulence._replace(wind=Wind(*ned_m_s))

    def _told(self, state: AirplaneState, control: Control, late_s: float) -> AirplaneState:
        if isinstance(control, RatesThrottle):
            return state  # its angles follow the attitude: they are given step by step
        if not isinstance(control, Attitude):
            raise TypeError(f"an airplane takes roll, pitch and throttle, or rates, not {control}")
        flight = state.flight
        given = airplane.told(flight._replace(time_s=flight.time_s + late_s), *control)
        return state._replace(flight=given._replace(time_s=flight.time_s))

    def _step(self, state: AirplaneState, tick: int, dt_s: float) -> AirplaneState:
        flight, gusts = state
        if tick % GUST_STEPS == 0 and self._turbulence.level_m_s > 0.0:
            # by the tick alone, so that looking ahead draws nothing
            gauss = Random(self._seed << 40 | tick).gauss
            normals = (gauss(0.0, 1.0), gauss(0.0, 1.0), gauss(0.0, 1.0))
            gusts = gusts_step(self._turbulence, gusts, flight.airspeed_m_s, normals, GUST_STEPS * STEP_S)
        wind = blowing(self._turbulence, gusts)
        if isinstance(self._control, RatesThrottle):
            flight = airplane.told(flight, *self._angles(flight, wind, self._control))
        after = airplane.step(self._parameters, flight, wind, dt_s)
        held = flight.down_m >= 0.0 and flight.airspeed_m_s < LIFT_OFF_STALLS * self._parameters.stall_m_s
        if held or after.down_m >= 0.0:
            after = _rolled(self._parameters, flight, after, wind, dt_s)
        return AirplaneState(after, gusts)

    def _angles(self, flight: airplane.State, wind: Wind, asked: RatesThrottle) -> Attitude:
        """The angles whose pursuit has these body rates, when they act.

        The yaw rate is that of the turn, whatever is asked: PX4's without FW_ACRO_YAW_EN.
        """
        p = self._parameters
        roll, pitch = flight.roll_rad, flight.pitch_rad
        along, across, _ = asked.body_rates_frd_rad_s
        r = _body_rates(flight, _turn_rate(p, flight, wind))[2]
        roll_rate = along + (across * sin(roll) + r * cos(roll)) * tan(pitch)
        pitch_rate = across * cos(roll) - r * sin(roll)
        # what the model's turn raises is of its pursuit of angles, not of rates
        turned = airplane.GRAVITY_M_S2 / max(flight.airspeed_m_s, airplane.STILL_M_S) * tan(roll) * sin(roll)
        raised = p.pitch_turning * turned * p.pitch_lag_s if p.pitch_lag2_s > 0.0 else 0.0
        return Attitude(
            (roll + roll_rate * (p.roll_delay_s + p.roll_lag_s) - p.roll_offset_rad) / p.roll_gain,
            (pitch + pitch_rate * (p.pitch_delay_s + p.pitch_lag_s) - raised - p.pitch_offset_rad)
            / p.pitch_gain,
            asked.throttle,
        )

    def _seen(self, state: AirplaneState) -> BodyState:
        flight = state.flight
        wind = blowing(self._turbulence, state.gusts)
        return BodyState(
            (flight.north_m, flight.east_m, flight.down_m),
            attitude_from_euler(flight.roll_rad, flight.pitch_rad, flight.heading_rad),
            _body_rates(flight, _turn_rate(self._parameters, flight, wind)),
            (flight.velocity_north_m_s, flight.velocity_east_m_s, flight.velocity_down_m_s),
            flight.airspeed_m_s,
            flight.airspeed_m_s,
            (wind.north_m_s, wind.east_m_s, wind.down_m_s),
            flight.throttle,
        )


def _turn_rate(p: airplane.Parameters, flight: airplane.State, wind: Wind) -> float:
    """Rate of the heading in flight, rad/s, as the model's lift turns it."""
    north = flight.velocity_north_m_s - wind.north_m_s
    east = flight.velocity_east_m_s - wind.east_m_s
    down = flight.velocity_down_m_s - wind.down_m_s
    level = hypot(north, east)
    if flight.down_m >= 0.0 or level < airplane.STILL_M_S:
        return 0.0
    speed = hypot(level, down)
    alpha = (flight.pitch_rad + asin(down / speed)) / max(cos(flight.roll_rad), 0.1)
    load, _ = airplane.load_factor(p, speed, alpha)
    slip = (1.0 - p.bank_effectiveness) / max(cos(flight.roll_rad), 0.1)
    return airplane.GRAVITY_M_S2 * (load - slip) * sin(flight.roll_rad) / level


def _body_rates(flight: airplane.State, turn_rate: float) -> Triple:
    """FRD, from the rates of roll, pitch and heading."""
    sr, cr = sin(flight.roll_rad), cos(flight.roll_rad)
    sp, cp = sin(flight.pitch_rad), cos(flight.pitch_rad)
    roll_rate, pitch_rate = flight.roll_rate_rad_s, flight.pitch_rate_rad_s
    return (
        roll_rate - turn_rate * sp,
        pitch_rate * cr + turn_rate * sr * cp,
        turn_rate * cr * cp - pitch_rate * sr,
    )


def _rolled(
    p: airplane.Parameters, before: airplane.State, after: airplane.State, wind: Wind, dt_s: float
) -> airplane.State:
    """On its wheels: straight along the heading, as thrust, drag and friction have it, never backwards."""
    c, s = cos(before.heading_rad), sin(before.heading_rad)
    speed = before.velocity_north_m_s * c + before.velocity_east_m_s * s
    through = speed - wind.north_m_s * c - wind.east_m_s * s
    drag = p.drag_per_m * through * abs(through)
    pushed = speed + (p.thrust_m_s2 * after.throttle - drag) * dt_s
    rolled = max(0.0, pushed - ROLLING_M_S2 * dt_s)
    north, east = rolled * c, rolled * s
    mean = 0.5 * (max(0.0, speed) + rolled)
    air = (north - wind.north_m_s, east - wind.east_m_s, wind.down_m_s)
    return after._replace(
        north_m=before.north_m + mean * c * dt_s,
        east_m=before.east_m + mean * s * dt_s,
        down_m=0.0,
        velocity_north_m_s=north,
        velocity_east_m_s=east,
        velocity_down_m_s=0.0,
        roll_rad=after.roll_rad * exp(-dt_s / LEVELLING_S),
        roll_rate_rad_s=0.0,
        heading_rad=before.heading_rad,
        airspeed_m_s=sqrt(air[0] ** 2 + air[1] ** 2 + air[2] ** 2),
    )
