"""A body whose model has no exact solution: it lives in steps on a grid of time, told at any instant."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, Final, Generic, TypeVar

from sitl.plant import Triple
from sitl.vehicle.body import BodyState
from sitl.vehicle.controls import Control

STEP_NS: Final = 4_000_000
STEP_S: Final = 0.004

S = TypeVar("S")


class GridBody(ABC, Generic[S]):
    """A model's state at the newest instant of the grid, which begins at `start_ns`.

    What it is told keeps its instant to the nanosecond, its delay runs from there, and it acts from the first
    grid point after that. Between grid points the state is looked at by a shorter step, which is forgotten:
    so neither `advance` nor `ahead` changes what comes.
    """

    takes: ClassVar[tuple[type, ...]]

    def __init__(self, first: S, start_ns: int) -> None:
        self._state = first
        self._grid_ns = start_ns
        self._tick = 0
        self._control: Control | None = None

    def tell(self, control: Control, at_ns: int) -> None:
        self._live(at_ns)
        # a model remembers few commands: those that say something new (tuples of two kinds may be equal)
        if control != self._control or type(control) is not type(self._control):
            self._control = control
            self._state = self._told(self._state, control, (at_ns - self._grid_ns) * 1e-9)

    def advance(self, to_ns: int) -> BodyState:
        self._live(to_ns)
        return self.ahead(to_ns)

    def ahead(self, at_ns: int) -> BodyState:
        state, tick, rest_ns = self._state, self._tick, at_ns - self._grid_ns
        while rest_ns >= STEP_NS:
            state = self._step(state, tick, STEP_S)
            tick, rest_ns = tick + 1, rest_ns - STEP_NS
        if rest_ns > 0:
            state = self._step(state, tick, rest_ns * 1e-9)
        return self._seen(state)

    @abstractmethod
    def carry(self, ned_m_s: Triple, at_ns: int) -> None:
        """As `Body.carry`; it acts from the next grid point on."""

    @abstractmethod
    def _told(self, state: S, control: Control, late_s: float) -> S:
        """The state with this control under way, given `late_s` after the state's own instant."""

    @abstractmethod
    def _step(self, state: S, tick: int, dt_s: float) -> S:
        """The state `dt_s` after grid point `tick`, at most `STEP_S`."""

    @abstractmethod
    def _seen(self, state: S) -> BodyState:
        """What there is to see of it."""

    def _live(self, to_ns: int) -> None:
        while self._grid_ns + STEP_NS <= to_ns:
            self._state = self._step(self._state, self._tick, STEP_S)
            self._tick += 1
            self._grid_ns += STEP_NS
