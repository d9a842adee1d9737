"""The paper's body: it does at once what it is told, in exact steps of any length."""

from __future__ import annotations

from typing import ClassVar

from sitl.plant import STOP, PlantCommand, PlantParameters, PlantState, Triple, rotation, step
from sitl.vehicle.body import BodyState
from sitl.vehicle.controls import Control, Drive

_STILL: Triple = (0.0, 0.0, 0.0)


class IdealBody:
    """The kinematic plant; as a ground vehicle it takes a yaw rate and a speed, too."""

    takes: ClassVar[tuple[type, ...]] = (PlantCommand, Drive)

    def __init__(self, parameters: PlantParameters, first: PlantState, start_ns: int) -> None:
        self._parameters = parameters
        self._state = first
        self._at_ns = start_ns
        self._command = STOP
        self._carried_ned_m_s = _STILL

    def tell(self, control: Control, at_ns: int) -> None:
        self._live(at_ns)
        if isinstance(control, Drive):
            control = PlantCommand((0.0, 0.0, control.yaw_rate_rad_s), control.speed_m_s)
        if not isinstance(control, PlantCommand):
            raise TypeError(f"the ideal body takes rates and a speed, not {control}")
        self._command = control

    def advance(self, to_ns: int) -> BodyState:
        self._state = self._at(to_ns)
        self._at_ns = to_ns
        return self._seen(self._state)

    def ahead(self, at_ns: int) -> BodyState:
        return self._seen(self._at(at_ns))

    def carry(self, ned_m_s: Triple, at_ns: int) -> None:
        self._live(at_ns)
        self._carried_ned_m_s = ned_m_s

    def refit(self, parameters: PlantParameters, at_ns: int) -> None:
        """Other bounds and lags from `at_ns` on."""
        self._live(at_ns)
        self._parameters = parameters

    def _live(self, to_ns: int) -> None:
        if to_ns > self._at_ns:
            self.advance(to_ns)

    def _at(self, at_ns: int) -> PlantState:
        dt_s = (at_ns - self._at_ns) * 1e-9
        state = step(self._parameters, self._state, self._command, dt_s)
        if self._carried_ned_m_s is _STILL:
            return state
        x, y, z = (at + by * dt_s for at, by in zip(state.position_ned_m, self._carried_ned_m_s, strict=True))
        return state._replace(position_ned_m=(x, y, z))

    def _seen(self, state: PlantState) -> BodyState:
        position, attitude, rates, speed = state
        rows = rotation(attitude)
        north, east, down = self._carried_ned_m_s
        velocity = (speed * rows[0][0] + north, speed * rows[1][0] + east, speed * rows[2][0] + down)
        return BodyState(position, attitude, rates, velocity, speed)
