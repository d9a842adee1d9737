"""Steps of an airplane, for `guidance tune`: in the air, from level flight, and between them back to it.

What a run does not name stays with the airplane's own handler: height and airspeed while it banks, the
airspeed while the nose moves, the height while the throttle steps. Pitch and throttle step about what level
flight has just taken, not about what the plan took it for.

The handler's own guards come before the steps: when the stall guard acts, or the airplane is below its floor
or beyond its greatest airspeed, the run is over, the handler flies, and the run is not flown again.
"""

from __future__ import annotations

from math import atan2, cos, sin
from typing import Final

from guidance.estimate import Estimate
from guidance.flying import Flown
from guidance.flying.airplane import Airplane
from guidance.flying.around import Around, Phase
from guidance.flying.channels import asked, place_of
from guidance.handling_config import ExcitationConfig
from guidance.records import AirplaneHandling
from guidance.se3 import ZERO, Reference, Vec3, norm
from guidance.tune.excitation import PITCH, THROTTLE, demand_at
from guidance.tune.way_back import Path, Piece, Place, way_back

#: After a run it flies on level for so long, s, before it turns.
LEVEL_S: Final = 1.0
#: Pitch and throttle of level flight are those of the last so many s.
TRIM_S: Final = 1.0


class ExcitedAirplane(Around):
    """A flight that was held goes back and does its run again."""

    def __init__(self, inner: Airplane, excitation: ExcitationConfig) -> None:
        super().__init__(inner, excitation)
        self._airplane = inner
        self._learned = ""
        self._level: dict[str, float] = {}

    def unmet(self, estimate: Estimate, origin_ned_m: Vec3, ground_down_m: float | None) -> str | None:
        """As `Handler` says: the height that steps may lose, and the wind that their room is counted for."""
        why = super().unmet(estimate, origin_ned_m, ground_down_m)
        if why is not None:
            return why
        wind, most = self._airplane.wind_ned_m_s(estimate.instant_ns), self._excitation.wind_max_m_s
        if wind is not None and norm(wind) > most:
            return f"the wind is {norm(wind):.1f} m/s, and the room of the steps is counted for {most:.1f}"
        floor_down_m, sinks_m = self._airplane.floor_down_m, self._excitation.box.down_m
        above_m = floor_down_m - estimate.pose.position.z
        if above_m < sinks_m:
            return (
                f"{above_m:.0f} m above the floor (airplane.floor_down_m, or HOME_POSITION), and steps may "
                f"lose {sinks_m:.0f} m: climb"
            )
        return None

    def step(self, estimate: Estimate, reference: Reference, dt_s: float) -> Flown:
        """The trajectory's reference is not used."""
        now_ns, excitation = estimate.instant_ns, self._excitation
        here = place_of(estimate, excitation.way)
        if self._place is None:
            straight_m = excitation.back_straight_m
            self._place, self._down_m = here.ahead(straight_m), estimate.pose.position.z
            self._way = Path(here, (Piece(straight_m, 0.0),))
            self._enter(Phase.RETURNING, now_ns)
        elif self._phase is None:
            self._go_back(here, now_ns)
        self._advance(here, now_ns)
        into_s = self._into_s(now_ns)
        along = self._reference(estimate, into_s)
        flown = self._inner.step(estimate, along, dt_s)
        around = flown.around
        assert isinstance(around, AirplaneHandling)
        self._blind = around.blind
        stepping = self._phase is Phase.STEPPING
        if not stepping:
            self._wind_ned_m_s = Vec3(*around.wind_ned_m_s)
            self._trim(flown, dt_s)
        elif around.stall_guard or around.floored or around.airspeed_m_s > excitation.fastest_m_s:
            self._enter(Phase.STOPPING, now_ns)
            self._restore()
        else:
            demand = asked(flown.demand, self._values(into_s))
            return self._asked(demand, estimate, into_s)._replace(
                acting_rates_frd_rad_s=flown.acting_rates_frd_rad_s
            )
        return flown._replace(around=self._record(estimate, self._into_s(now_ns)))

    def _advance(self, here: Place, now_ns: int) -> None:
        """To the phase that this one leads to, if it is over."""
        into_s = self._into_s(now_ns)
        match self._phase:
            case Phase.STEPPING if into_s >= self._run.lasts_s:
                self._enter(Phase.STOPPING, now_ns)
                self._restore()
            case Phase.STOPPING if into_s >= LEVEL_S:
                if self._last:
                    self._enter(Phase.DONE, now_ns)
                else:
                    self._number += 1
                    self._go_back(here, now_ns)
            case Phase.RETURNING if self._flown_m(into_s) >= self._way_m():
                self._learned = self._inner.learned
                self._enter(Phase.STEPPING, now_ns)

    def _go_back(self, here: Place, now_ns: int) -> None:
        assert self._place is not None
        excitation = self._excitation
        self._way = way_back(here, self._place, excitation.back_radius_m, excitation.back_straight_m)
        self._inner.start()
        self._level = {}
        self._enter(Phase.RETURNING, now_ns)

    def _way_m(self) -> float:
        assert self._way is not None
        return self._way.length_m

    def _flown_m(self, into_s: float) -> float:
        return self._driven_s(into_s) * self._excitation.back_m_s

    def _restore(self) -> None:
        """What was learned from a step that the handler knows nothing of is forgotten."""
        if self._run.channel in (PITCH, THROTTLE):
            self._inner.recall(self._learned)

    def _trim(self, flown: Flown, dt_s: float) -> None:
        """Pitch and throttle that level flight takes, as a running mean."""
        handling = flown.around
        assert isinstance(handling, AirplaneHandling)
        part = min(dt_s / TRIM_S, 1.0)
        for channel, now in ((PITCH, handling.pitch_asked_rad), (THROTTLE, flown.demand.throttle)):
            before = self._level.get(channel, now)
            self._level[channel] = before + part * (now - before)

    def _values(self, into_s: float) -> dict[str, float]:
        """Of the run, about the level flight of now."""
        run = self._run
        values = demand_at(run, into_s)
        if run.channel in self._level:
            values[run.channel] += self._level[run.channel] - run.holds[0].value
        return values

    def _reference(self, estimate: Estimate, into_s: float) -> Reference:
        """Along the way; in a run and after it level and straight ahead, at the airspeed of the steps."""
        V = self._excitation.back_m_s
        if self._phase is Phase.RETURNING:
            assert self._way is not None
            return self._way.reference(self._driven_s(into_s), V, self._down_m)
        at, v, w = estimate.pose.position, estimate.velocity_ned_m_s, self._wind_ned_m_s
        air = atan2(v.y - w.y, v.x - w.x)
        velocity = Vec3(V * cos(air) + w.x, V * sin(air) + w.y, 0.0)
        return Reference(Vec3(at.x, at.y, self._down_m), velocity, ZERO)
