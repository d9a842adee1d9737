"""An airplane flown by tracker and handler, no MAVLink between: what is seen is told to the estimator."""

from __future__ import annotations

from collections.abc import Callable
from math import atan2, cos, degrees, exp, hypot, pi, radians, sin, sqrt, tan
from typing import Final, NamedTuple

import numpy as np

from guidance.config import Config, profile_of
from guidance.estimate import Estimator
from guidance.mavlink.air import VfrHud, Wind
from guidance.mavlink.messages import Odometry
from guidance.mavlink.profiles import Asked
from guidance.records import AirplaneHandling
from guidance.se3 import ZERO, Quaternion, Vec3, add, from_euler, norm, pitch_of, roll_of, subtract
from guidance.tracker import Solution, Tracker
from guidance.trajectory import sample
from sitl.airplane_flight import (
    ATTITUDE_RAD,
    BIAS_CORRELATION_S,
    BIAS_M,
    HEADING_BIAS_RAD,
    MODEL_STEP_S,
    POSITION_M,
    VELOCITY_M_S,
)
from sitl.models import airplane as model
from sitl.models.gusts import CALM, NO_GUSTS, Turbulence, blowing, gusts_step
from sitl.models.gusts import Wind as Air

STEP_NS: Final = 20_000_000
BEGIN_NS: Final = 1_000_000_000


class Row(NamedTuple):
    """One setpoint and what was true when it was computed."""

    t_s: float
    error_m: float
    airspeed_m_s: float
    solution: Solution
    around: AirplaneHandling


class Loop:
    """`body` at the trajectory's start, `right_m` beside it and `off_rad` off its course; `wind_m_s` towards
    the north-east, with gusts. A demand acts `delay_s` after it was computed, a state is `age_s` old then."""

    def __init__(
        self,
        config: Config,
        body: model.Parameters,
        *,
        speed_m_s: float,
        height_m: float = 60.0,
        right_m: float = 20.0,
        off_rad: float = radians(30.0),
        wind_m_s: float = 0.0,
        wind_told: bool = True,
        age_s: float = 0.02,
        noise: bool = True,
        seed: int = 0,
        sensed: Callable[[float], float] | None = lambda airspeed: airspeed,
        velocity_wrong_m_s: Vec3 = ZERO,
    ) -> None:
        self.config, self.body = config, body
        self.profile = profile_of(config)
        self.tracker = Tracker(config, self.profile)
        self.rows: list[Row] = []
        self.estimator = Estimator(self.profile.project)
        self._delay_ns = round(config.link.actuation_delay_s * 1e9)
        self._age_steps = round(age_s / MODEL_STEP_S)
        self._dice = np.random.default_rng(seed)
        self._noise = 1.0 if noise else 0.0
        self._heading_bias = self._noise * float(self._dice.uniform(-HEADING_BIAS_RAD, HEADING_BIAS_RAD))
        self._bias = self._noise * BIAS_M * self._dice.standard_normal(3)
        air = Air(wind_m_s * cos(pi / 4), wind_m_s * sin(pi / 4), 0.0) if wind_m_s else CALM
        self.weather = Turbulence(air, 0.16 * wind_m_s, 0.1 * wind_m_s, 200.0, 50.0)
        self._gusts = NO_GUSTS
        self._wind_told, self._sensed = wind_told, sensed
        self._wrong = velocity_wrong_m_s
        self._origin = Vec3(0.0, 0.0, -height_m)
        r = sample(config.trajectory, 0.0)
        course = atan2(r.velocity.y, r.velocity.x)
        self.state = model.flying(
            body,
            r.position.x - sin(course) * right_m,
            r.position.y + cos(course) * right_m,
            r.position.z - height_m + 5.0,
            course + off_rad,
            speed_m_s,
            air,
        )
        self._seen: list[tuple[int, model.State]] = []
        self.now_ns = BEGIN_NS

    def fly(self, seconds: float) -> list[Row]:
        """So much longer; all rows so far."""
        end_ns = self.now_ns + round(seconds * 1e9)
        while self.now_ns < end_ns:
            self._measure()
            self._steer()
            self._move()
        return self.rows

    def _measure(self) -> None:
        fade = exp(-STEP_NS * 1e-9 / BIAS_CORRELATION_S)
        self._bias = fade * self._bias + self._noise * BIAS_M * sqrt(1.0 - fade * fade) * (
            self._dice.standard_normal(3)
        )
        at_ns = self.now_ns - self._age_steps * round(MODEL_STEP_S * 1e9)
        s = next((s for t_ns, s in reversed(self._seen) if t_ns <= at_ns), None)
        if s is None:
            return
        z = (self._noise * self._dice.standard_normal(9)).tolist()
        q = from_euler(
            s.roll_rad + ATTITUDE_RAD * z[0],
            s.pitch_rad + ATTITUDE_RAD * z[1],
            s.heading_rad + self._heading_bias + ATTITUDE_RAD * z[2],
        )
        velocity = Vec3(
            s.velocity_north_m_s + self._wrong.x + VELOCITY_M_S * z[3],
            s.velocity_east_m_s + self._wrong.y + VELOCITY_M_S * z[4],
            s.velocity_down_m_s + self._wrong.z + VELOCITY_M_S * z[5],
        )
        north, east, down = (
            float(value + POSITION_M * noise + bias)
            for value, noise, bias in zip((s.north_m, s.east_m, s.down_m), z[6:], self._bias, strict=True)
        )
        p, q_rate, r = self._body_rates(at_ns)
        odometry = Odometry(
            time_usec=at_ns // 1000,
            x=north,
            y=east,
            z=down,
            q1=q.w,
            q2=q.x,
            q3=q.y,
            q4=q.z,
            vx=velocity.x,
            vy=velocity.y,
            vz=velocity.z,
            rollspeed=p,
            pitchspeed=q_rate,
            yawspeed=r,
            frame_id=1,
            child_frame_id=1,
            reset_counter=0,
            estimator_type=0,
            quality=100,
        )
        refused = self.estimator.take(odometry, at_ns, self.now_ns)
        assert refused is None, refused
        if (self.now_ns // STEP_NS) % 10 == 0:
            handler = self.tracker.handler
            if self._sensed is not None:
                handler.heard(VfrHud(self._sensed(s.airspeed_m_s + 0.3 * z[0]), 0.0), self.now_ns)
            wind = self.weather.wind
            if self._wind_told:
                from_deg = degrees(atan2(-wind.east_m_s, -wind.north_m_s))
                handler.heard(Wind(from_deg, hypot(wind.north_m_s, wind.east_m_s), 0.0), self.now_ns)

    def _body_rates(self, at_ns: int) -> Vec3:
        """By the attitude before."""
        pairs = [(t, s) for t, s in self._seen if t <= at_ns]
        if len(pairs) < 2:
            return Vec3(0.0, 0.0, 0.0)
        (t0, a), (t1, b) = pairs[-2:]
        dt = (t1 - t0) * 1e-9
        turn = (b.heading_rad - a.heading_rad + pi) % (2.0 * pi) - pi
        phi, theta = (b.roll_rad - a.roll_rad) / dt, (b.pitch_rad - a.pitch_rad) / dt
        psi, c, s = turn / dt, cos(b.roll_rad), sin(b.roll_rad)
        level = cos(b.pitch_rad)
        return Vec3(phi - psi * sin(b.pitch_rad), theta * c + psi * s * level, psi * c * level - theta * s)

    def _steer(self) -> None:
        estimate = self.estimator.at(self.now_ns + self._delay_ns, self.tracker.history)
        if estimate is None:
            return
        if self.tracker.start_ns is None:
            self.tracker.start(estimate.instant_ns, self._origin)
        solution = self.tracker.solve(estimate)
        assert isinstance(solution.flown.around, AirplaneHandling)
        self.rows.append(
            Row(
                (self.now_ns - BEGIN_NS) * 1e-9,
                self._off_m(solution),
                self.state.airspeed_m_s,
                solution,
                solution.flown.around,
            )
        )
        out = solution.outgoing
        q = Quaternion(*out.attitude_wxyz)
        roll, pitch = roll_of(q), pitch_of(q)
        if self.profile.asked is Asked.RATES_THROTTLE:
            roll, pitch = self._led_by(Vec3(*out.body_rates_frd_rad_s))
        self.state = model.told(self.state, roll, pitch, out.thrust)

    def _off_m(self, solution: Solution) -> float:
        """The airplane itself from the reference, both now: what the handler predicts is not asked."""
        around = solution.flown.around
        assert isinstance(around, AirplaneHandling)
        planned_s = solution.trajectory_s - self._delay_ns * 1e-9 * around.clock_rate
        at = add(self._origin, sample(self.config.trajectory, planned_s).position)
        return norm(subtract(Vec3(self.state.north_m, self.state.east_m, self.state.down_m), at))

    def _led_by(self, rates: Vec3) -> tuple[float, float]:
        """The roll and pitch that make the model turn at these body rates, but for its delay."""
        s, body = self.state, self.body
        carried = rates.y * sin(s.roll_rad) + rates.z * cos(s.roll_rad)
        phi = rates.x + carried * tan(s.pitch_rad)
        theta = rates.y * cos(s.roll_rad) - rates.z * sin(s.roll_rad)
        roll = s.roll_rad + phi * body.roll_lag_s - body.roll_offset_rad
        pitch = s.pitch_rad + theta * body.pitch_lag_s - body.pitch_offset_rad
        return roll / body.roll_gain, pitch / body.pitch_gain

    def _move(self) -> None:
        blows = blowing(self.weather, self._gusts)
        steps = round(STEP_NS * 1e-9 / MODEL_STEP_S)
        for n in range(steps):
            self._seen.append((self.now_ns + n * round(MODEL_STEP_S * 1e9), self.state))
            self.state = model.step(self.body, self.state, blows, MODEL_STEP_S)
        del self._seen[:-60]
        a, b, c = self._dice.standard_normal(3).tolist()
        self._gusts = gusts_step(
            self.weather, self._gusts, self.state.airspeed_m_s, (a, b, c), STEP_NS * 1e-9
        )
        self.now_ns += STEP_NS


def settled(rows: list[Row], after_s: float) -> tuple[float, float]:
    """RMS and maximum of the error from then on, m."""
    errors = np.array([row.error_m for row in rows if row.t_s >= after_s])
    return float(np.sqrt(np.mean(errors**2))), float(errors.max())
