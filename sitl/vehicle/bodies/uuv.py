"""The underwater vehicle of `sitl.models.uuv`, in water that may flow."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

from sitl.models import uuv
from sitl.plant import PlantCommand, Triple, Wxyz, rotation
from sitl.vehicle.bodies.grid import GridBody
from sitl.vehicle.body import BodyState
from sitl.vehicle.controls import Control


class UuvState(NamedTuple):
    """The model in its water, and where that has carried it."""

    swum: uuv.State
    carried_ned_m: Triple


class UuvBody(GridBody[UuvState]):
    """Floating at first."""

    takes: ClassVar[tuple[type, ...]] = (PlantCommand,)

    def __init__(
        self, parameters: uuv.Parameters, position_ned_m: Triple, attitude_wxyz: Wxyz, start_ns: int
    ) -> None:
        still = (0.0, 0.0, 0.0)
        super().__init__(UuvState(uuv.at_rest(position_ned_m, attitude_wxyz), still), start_ns)
        self._parameters = parameters
        self._current_ned_m_s: Triple = still

    def carry(self, ned_m_s: Triple, at_ns: int) -> None:
        self._live(at_ns)
        self._current_ned_m_s = ned_m_s

    def _told(self, state: UuvState, control: Control, late_s: float) -> UuvState:
        if not isinstance(control, PlantCommand):
            raise TypeError(f"an underwater vehicle takes rates and a speed, not {control}")
        swum = state.swum
        # given between two grid points: the same clock, a little later
        given = uuv.told(self._parameters, swum._replace(time_s=swum.time_s + late_s), *control)
        return state._replace(swum=given._replace(time_s=swum.time_s))

    def _step(self, state: UuvState, tick: int, dt_s: float) -> UuvState:
        return UuvState(
            uuv.step(self._parameters, state.swum, dt_s),
            _moved(state.carried_ned_m, self._current_ned_m_s, dt_s),
        )

    def _seen(self, state: UuvState) -> BodyState:
        swum = state.swum
        rows = rotation(swum.attitude_wxyz)
        u = swum.speed_m_s
        through = (u * rows[0][0], u * rows[1][0], u * rows[2][0])
        return BodyState(
            _moved(swum.position_ned_m, state.carried_ned_m, 1.0),
            swum.attitude_wxyz,
            swum.body_rates_frd_rad_s,
            _moved(through, self._current_ned_m_s, 1.0),
            u,
        )


def _moved(at: Triple, by: Triple, times: float) -> Triple:
    return (at[0] + times * by[0], at[1] + times * by[1], at[2] + times * by[2])
