"""How each class of vehicle is driven: what has memory between two setpoints, around the pure functions.

A `Handler` owns the parameters and the memory of one handling (`guidance.handling`, or the law alone), turns
an estimate into what that measures with, and its answer into a demand. To add a class of vehicles, add one
here and a row's `handling`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

from msgspec.structs import astuple

from guidance.abilities import Abilities
from guidance.config import Config
from guidance.estimate import Estimate
from guidance.law import Evaluation
from guidance.mavlink.messages import Body
from guidance.mavlink.setpoints import Demand
from guidance.records import Record
from guidance.se3 import Reference, Vec3


class Flown(NamedTuple):
    """One step: the demand, the reference that was tracked, the law's evaluation of it, the body rates that
    the vehicle is taken to obey (FRD, rad/s, for the prediction), and what else is for the record."""

    demand: Demand
    reference: Reference
    evaluation: Evaluation
    acting_rates_frd_rad_s: Vec3
    around: Record | None = None

    def is_finite(self) -> bool:
        """Whether every number that would be logged is."""
        e = self.evaluation
        total = sum(e.e) + sum(e.demanded) + e.V1 + e.V2
        if self.around is not None:
            for value in astuple(self.around):
                total += (
                    sum(value) if isinstance(value, tuple) else value if isinstance(value, float) else 0.0
                )
        return total - total == 0.0


class Caution(NamedTuple):
    """What forbids no flight and must be known before it: `about` what, and the words."""

    about: str
    text: str


class Handler(Protocol):
    """`start` begins a flight, `configure` takes settings that are checked already; both at any time."""

    @property
    def waited_s(self) -> float:
        """How far the trajectory's clock is behind the flight's."""

    @property
    def learned(self) -> str:
        """What flights have taught of the vehicle, as JSON for the next process; empty if nothing can."""

    def recall(self, learned: str) -> str | None:
        """Start with what an earlier process `learned`; or why that cannot be."""

    def configure(self, config: Config, origin_ned_m: Vec3, allocation: str) -> str | None:
        """Gains and limits are these from the next step on; the trajectory's origin is here. Or why the
        vehicle cannot be flown with them: then nothing changes."""

    def fit(self, values: Mapping[str, float]) -> str | None:
        """What the autopilot's parameters say of the vehicle; or why it cannot be flown with them."""

    def abilities(self) -> Abilities | None:
        """What the vehicle can do as it is known, and of each what bounds it; None if it is not known."""

    def unmet(self, estimate: Estimate, origin_ned_m: Vec3, ground_down_m: float | None) -> str | None:
        """Why a flight must not begin now, here, with the trajectory's origin there and the ground at that
        height (None: not known). Asked over and over before a flight, never in one."""

    def cautions(
        self, estimate: Estimate, origin_ned_m: Vec3, ground_down_m: float | None
    ) -> tuple[Caution, ...]:
        """What must be known before a flight from now, here, that `unmet` lets begin; asked as that is. One
        about each thing at most."""

    def heard(self, body: Body, now_ns: int) -> None:
        """A message that is no state, which came now: airspeed and wind are among them."""

    def start(self) -> None:
        """A flight begins, or goes on after it was held."""

    def shifted(self, jump_ned_m: Vec3) -> None:
        """The autopilot's frame moved by so much."""

    def step(self, estimate: Estimate, reference: Reference, dt_s: float) -> Flown:
        """`dt_s` after the step before; the reference is that of the estimate's instant."""

    def neutral(self, estimate: Estimate) -> Demand:
        """What asks the vehicle to stay as it is."""
