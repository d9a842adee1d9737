"""One of JSBSim's airplanes in wind with gusts, in the air from the start."""

from __future__ import annotations

from random import Random
from typing import ClassVar, Final

from sitl.models.gusts import NO_GUSTS, Turbulence, Wind, blowing, gusts_step
from sitl.models.jsbsim_airplane import JsbsimAirplane
from sitl.plant import Triple, attitude_from_euler
from sitl.vehicle.bodies.airplane import LEVEL_LENGTH_M, VERTICAL_LENGTH_M, VERTICAL_PART
from sitl.vehicle.body import BodyState
from sitl.vehicle.controls import Attitude, Control, RatesThrottle

#: The gusts change every so many steps of JSBSim, 20 ms at 200 a second.
GUST_STEPS: Final = 4


class JsbsimBody:
    """It lives in JSBSim's own steps from `start_ns`; what it is told acts from the next one on.

    JSBSim cannot be asked what would be and then go back: from its last step on the airplane is seen to fly
    straight. `gusts_m_s` is the level sigma; gusts are a function of `seed` and time.
    """

    takes: ClassVar[tuple[type, ...]] = (Attitude, RatesThrottle)

    def __init__(
        self, airplane: JsbsimAirplane, wind_ned_m_s: Triple, gusts_m_s: float, seed: int, start_ns: int
    ) -> None:
        self._airplane = airplane
        self._step_ns = round(1e9 / airplane.rate_hz)
        self._start_ns = start_ns
        self._tick = 0
        self._seed = seed
        self._gusts = NO_GUSTS
        self._turbulence = Turbulence(
            Wind(*wind_ned_m_s), gusts_m_s, VERTICAL_PART * gusts_m_s, LEVEL_LENGTH_M, VERTICAL_LENGTH_M
        )

    def tell(self, control: Control, at_ns: int) -> None:
        self._live(at_ns)
        if isinstance(control, Attitude):
            self._airplane.tell(*control)
        elif isinstance(control, RatesThrottle):
            roll_rate, pitch_rate, _ = control.body_rates_frd_rad_s
            self._airplane.tell_rates(roll_rate, pitch_rate, control.throttle)
        else:
            raise TypeError(f"an airplane takes roll, pitch and throttle, or rates, not {control}")

    def advance(self, to_ns: int) -> BodyState:
        self._live(to_ns)
        return self.ahead(to_ns)

    def ahead(self, at_ns: int) -> BodyState:
        state = self._airplane.state()
        late_s = (at_ns - self._start_ns - self._tick * self._step_ns) * 1e-9
        velocity = (state.velocity_north_m_s, state.velocity_east_m_s, state.velocity_down_m_s)
        wind = blowing(self._turbulence, self._gusts)
        return BodyState(
            (
                state.north_m + late_s * velocity[0],
                state.east_m + late_s * velocity[1],
                state.down_m + late_s * velocity[2],
            ),
            attitude_from_euler(state.roll_rad, state.pitch_rad, state.heading_rad),
            state.body_rates_frd_rad_s,
            velocity,
            state.airspeed_m_s,
            state.airspeed_m_s,
            (wind.north_m_s, wind.east_m_s, wind.down_m_s),
            state.throttle,
        )

    def carry(self, ned_m_s: Triple, at_ns: int) -> None:
        self._live(at_ns)
        self._turbulence = self._turbulence._replace(wind=Wind(*ned_m_s))
        self._airplane.blow(blowing(self._turbulence, self._gusts))

    def _live(self, to_ns: int) -> None:
        while self._start_ns + (self._tick + 1) * self._step_ns <= to_ns:
            if self._tick % GUST_STEPS == 0 and self._turbulence.level_m_s > 0.0:
                self._blow()
            self._airplane.step()
            self._tick += 1

    def _blow(self) -> None:
        gauss = Random(self._seed << 40 | self._tick).gauss
        normals = (gauss(0.0, 1.0), gauss(0.0, 1.0), gauss(0.0, 1.0))
        airspeed, period_s = self._airplane.state().airspeed_m_s, GUST_STEPS * self._step_ns * 1e-9
        self._gusts = gusts_step(self._turbulence, self._gusts, airspeed, normals, period_s)
        self._airplane.blow(blowing(self._turbulence, self._gusts))
