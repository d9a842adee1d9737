"""The copter of `sitl.models.copter` in steady wind, above a ground on which it can stand."""

from __future__ import annotations

from typing import ClassVar

from sitl.models import copter
from sitl.models.gusts import CALM, Wind
from sitl.plant import Triple, euler_from_attitude, rotation
from sitl.vehicle.bodies.grid import GridBody
from sitl.vehicle.body import BodyState
from sitl.vehicle.controls import Control, RatesThrust, Velocity


class CopterBody(GridBody[copter.State]):
    """At first hovering there, or standing if that is at height 0 of the local frame: there is the ground.

    It stands level where it comes down, and leaves the ground when its rotors carry more than the weight.
    """

    takes: ClassVar[tuple[type, ...]] = (Velocity, RatesThrust)

    def __init__(
        self,
        parameters: copter.Parameters,
        position_ned_m: Triple,
        yaw_rad: float,
        wind_ned_m_s: Triple,
        start_ns: int,
    ) -> None:
        self._wind = Wind(*wind_ned_m_s)
        self._parameters = parameters
        wind = CALM if position_ned_m[2] >= 0.0 else self._wind
        super().__init__(copter.hovering(parameters, position_ned_m, yaw_rad, wind), start_ns)

    def carry(self, ned_m_s: Triple, at_ns: int) -> None:
        self._live(at_ns)
        self._wind = Wind(*ned_m_s)

    def _told(self, state: copter.State, control: Control, late_s: float) -> copter.State:
        # given between two grid points: the same clock, a little later
        late = state._replace(time_s=state.time_s + late_s)
        match control:
            case Velocity(velocity, yaw_rate):
                given = copter.told(self._parameters, late, velocity, yaw_rate)
            case RatesThrust(rates, thrust):
                given = copter.told_rates(self._parameters, late, rates, thrust)
            case _:
                raise TypeError(f"a copter takes velocity and yaw rate, or rates and thrust, not {control}")
        return given._replace(time_s=state.time_s)

    def _step(self, state: copter.State, tick: int, dt_s: float) -> copter.State:
        after = copter.step(self._parameters, state, self._wind, dt_s)
        if after.position_ned_m[2] < 0.0 or after.velocity_ned_m_s[2] < 0.0:
            return after
        north, east, _ = after.position_ned_m
        heading = euler_from_attitude(after.attitude_wxyz)[2]
        stands = copter.hovering(self._parameters, (north, east, 0.0), heading, CALM)
        return stands._replace(time_s=after.time_s, queue=after.queue)

    def _seen(self, state: copter.State) -> BodyState:
        stands = state.position_ned_m[2] >= 0.0
        rows = rotation(state.attitude_wxyz)
        forward = sum(v * row[0] for v, row in zip(state.velocity_ned_m_s, rows, strict=True))
        return BodyState(
            state.position_ned_m,
            state.attitude_wxyz,
            state.body_rates_frd_rad_s,
            state.velocity_ned_m_s,
            forward,
            wind_ned_m_s=(self._wind.north_m_s, self._wind.east_m_s, self._wind.down_m_s),
            throttle=0.0 if stands else copter.thrust_of(self._parameters, state),
        )
