"""The rover and the boat of `sitl.models.rover`: level on the ground or the water."""

from __future__ import annotations

from typing import ClassVar

from sitl.models import rover
from sitl.plant import Triple, attitude_from_euler
from sitl.vehicle.bodies.grid import GridBody
from sitl.vehicle.body import BodyState
from sitl.vehicle.controls import Control, Drive


class RoverBody(GridBody[rover.State]):
    """Standing at `position_ned_m` at first, where it keeps its height. Wind pushes it as its file says."""

    takes: ClassVar[tuple[type, ...]] = (Drive,)

    def __init__(
        self,
        parameters: rover.Parameters,
        position_ned_m: Triple,
        yaw_rad: float,
        wind_ned_m_s: Triple,
        start_ns: int,
    ) -> None:
        north, east, self._down_m = position_ned_m
        super().__init__(rover.at_rest(north, east, yaw_rad), start_ns)
        self._file = self._parameters = parameters
        self._wind_ned_m_s = wind_ned_m_s

    def carry(self, ned_m_s: Triple, at_ns: int) -> None:
        self._live(at_ns)
        north, east, _ = ned_m_s
        self._parameters = self._file._replace(
            carried_north_m_s=self._file.carried_north_m_s + north,
            carried_east_m_s=self._file.carried_east_m_s + east,
        )

    def _told(self, state: rover.State, control: Control, late_s: float) -> rover.State:
        if not isinstance(control, Drive):
            raise TypeError(f"a ground vehicle takes a yaw rate and a speed, not {control}")
        # given between two grid points: the same clock, a little later
        given = rover.told(self._parameters, state._replace(time_s=state.time_s + late_s), *control)
        return given._replace(time_s=state.time_s)

    def _step(self, state: rover.State, tick: int, dt_s: float) -> rover.State:
        return rover.step(self._parameters, state, self._wind_ned_m_s[0], self._wind_ned_m_s[1], dt_s)

    def _seen(self, state: rover.State) -> BodyState:
        return BodyState(
            (state.north_m, state.east_m, self._down_m),
            attitude_from_euler(0.0, 0.0, state.heading_rad),
            (0.0, 0.0, state.yaw_rate_rad_s),
            (state.velocity_north_m_s, state.velocity_east_m_s, 0.0),
            state.speed_m_s,
            wind_ned_m_s=self._wind_ned_m_s,
        )
