"""One of rotorpy's copters in steady wind, above a ground on which it can stand."""

from __future__ import annotations

from typing import ClassVar

from sitl.models import rotorpy_copter as model
from sitl.models.gusts import Wind
from sitl.models.rotorpy_copter import Asked, RotorpyCopter, State
from sitl.plant import Triple, rotation
from sitl.vehicle.bodies.grid import GridBody
from sitl.vehicle.body import BodyState
from sitl.vehicle.controls import Control, RatesThrust, Velocity


class RotorpyBody(GridBody[State]):
    """At first hovering there, or standing if that is at height 0. It acts at once on what it is told."""

    takes: ClassVar[tuple[type, ...]] = (Velocity, RatesThrust)

    def __init__(
        self,
        copter: RotorpyCopter,
        position_ned_m: Triple,
        yaw_rad: float,
        wind_ned_m_s: Triple,
        start_ns: int,
    ) -> None:
        self._copter = copter
        self._wind = Wind(*wind_ned_m_s)
        super().__init__(copter.hovering(position_ned_m, yaw_rad, self._wind), start_ns)

    def carry(self, ned_m_s: Triple, at_ns: int) -> None:
        self._live(at_ns)
        self._wind = Wind(*ned_m_s)

    def _told(self, state: State, control: Control, late_s: float) -> State:
        match control:
            case Velocity(velocity, yaw_rate):
                asked = Asked(False, *velocity, yaw_rate)
            case RatesThrust(rates, thrust):
                asked = Asked(True, *rates, thrust)
            case _:
                raise TypeError(f"a copter takes velocity and yaw rate, or rates and thrust, not {control}")
        return state._replace(asked=asked)

    def _step(self, state: State, tick: int, dt_s: float) -> State:
        return self._copter.step(state, self._wind, dt_s)

    def _seen(self, state: State) -> BodyState:
        attitude, velocity = model.attitude_wxyz(state), model.velocity_ned_m_s(state)
        return BodyState(
            model.position_ned_m(state),
            attitude,
            model.body_rates_frd_rad_s(state),
            velocity,
            sum(v * row[0] for v, row in zip(velocity, rotation(attitude), strict=True)),
            wind_ned_m_s=(self._wind.north_m_s, self._wind.east_m_s, self._wind.down_m_s),
            throttle=self._copter.throttle(state),
        )
