"""One task, flown by the whole service against a built-in vehicle in lockstep, and what came of it.

The configuration is the one that ships for the profile, with the task's settings on top. The vehicle's
estimator has the noise of an outdoor vehicle (`sitl.vehicle.estimator.USUAL`).

The error is that against the estimate, as an operator sees it: the position with its slow bias, which nobody
on board can know, but without the white part, which is no motion. The reference is that of the same instant,
on the clock that the service set for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from math import hypot, inf, sqrt
from pathlib import Path
from typing import Any, Final

from guidance.commands import Engage
from guidance.config import Config, load
from guidance.records import AirplaneHandling, GroundHandling, Record, Reference, Setpoint
from guidance.supervisor import State
from guidance.trajectory import sample
from sitl.lockstep import SECOND, Channel, Lockstep
from sitl.vehicle import Effect, Vehicle, VehicleOptions
from sitl.vehicle.estimator import USUAL, Noise

#: Where the shipped configurations are, in a checkout.
DEPLOY: Final = Path(__file__).parents[2] / "deploy"
#: It flies when it is told to, around the autopilot's local origin.
SETTINGS: Final = ("supervisor.arm=true", 'flight.origin="ekf"')
PERIOD_S: Final = 0.02
#: Engaging takes no longer.
ENGAGED_S: Final = 20.0


@dataclass(frozen=True, kw_only=True)
class Task:
    """One flight: settings on top of the profile's configuration, the vehicle, and how it is judged.

    `vehicle` are `VehicleOptions`. Converged is below `converged_m` for good (before the first corner);
    RMS and maximum count from `settling_s` after that, but at least over the second half. `corners_s`: when
    the trajectory's corners are due, on its own clock. `speed_part` is what the vehicle makes of a speed that
    is asked for, `link_delay_s` what a datagram takes each way.
    """

    profile: str
    settings: tuple[str, ...]
    vehicle: Mapping[str, Any]
    duration_s: float
    converged_m: float
    settling_s: float
    corners_s: tuple[float, ...] = ()
    noise: Noise = USUAL
    speed_part: float = 1.0
    link_delay_s: float = 0.0


@dataclass(frozen=True)
class Figures:
    """s, m and m/s; inf where it did not happen.

    `corner_m` is the largest error after a corner, `back_s` the time from a corner until the error is below
    `converged_m` for the rest of the leg. `truth_rms_m` is the RMS of the position without its bias, which
    nobody can hold to less than that. `reverse_m_s` is the fastest asked for backwards, `airspeed_min_m_s`
    the truth's. `saturated` is the part of the setpoints at a limit, of an airplane at that of its bank,
    after convergence. `trace` has a row a step: t, error, north, east, down.
    """

    converged_s: float
    rms_m: float
    max_m: float
    truth_rms_m: float
    corner_m: float
    back_s: float
    reverse_m_s: float
    airspeed_min_m_s: float
    saturated: float
    stuck: bool
    trace: tuple[tuple[float, ...], ...] = field(repr=False)


class NotFlownError(Exception):
    """The service did not engage, or the flight ended early."""


def configuration(task: Task, directory: Path = DEPLOY) -> Config:
    """Raises ConfigError."""
    return load(directory / f"{task.profile}.toml", (*SETTINGS, *task.settings))


class _Log:
    """What is needed of the records, and only that."""

    def __init__(self) -> None:
        self.clock: list[tuple[float, float]] = []  # instants, and the trajectory's time then, s
        self.setpoints: list[Setpoint] = []
        self.saturated: list[tuple[int, bool]] = []
        self.banks: list[tuple[int, bool]] = []
        self.stuck = False

    def take(self, record: Record) -> None:
        match record:
            case Reference():
                self.clock.append((record.t_ns * 1e-9, record.trajectory_s))
            case Setpoint(neutral=False):
                self.setpoints.append(record)
                self.saturated.append((record.t_ns, record.saturated))
            case AirplaneHandling():
                self.banks.append((record.t_ns, record.bank_saturated))
            case GroundHandling(stuck=True):
                self.stuck = True


def fly(task: Task, seed: int = 0, directory: Path = DEPLOY) -> Figures:
    """The whole flight; deterministic, by its seed.

    Raises:
        ConfigError: the task's settings do not make a configuration.
        NotFlownError: the service did not engage, or control ended before the task did.
    """
    config = configuration(task, directory)
    log = _Log()
    options = VehicleOptions(**task.vehicle, noise=task.noise, seed=seed)
    vehicle = Vehicle(options, boot_ns=SECOND)
    vehicle.refit(SECOND, effect=Effect(speed=task.speed_part))
    late = Channel(delay_s=task.link_delay_s)
    flight = Lockstep(
        config, vehicle, start_ns=SECOND, to_guide=late, to_vehicle=late, seed=seed, on_record=log.take
    )
    tracker, engagement = flight.guide.tracker, flight.guide.engagement
    if flight.run(ENGAGED_S, until=lambda: engagement.state is State.READY):
        flight.guide.command(Engage(), flight.now_ns)
    if not flight.run(ENGAGED_S, until=lambda: tracker.start_ns is not None):
        raise NotFlownError(f"{task.profile} did not engage: {engagement.state}, {engagement.reason}")
    begun_s, origin = flight.now_ns * 1e-9, tracker.origin_ned_m
    assert origin is not None
    rows: list[tuple[float, ...]] = []
    airspeed_min = inf
    planar = flight.guide.profile.planar
    for _ in range(round(task.duration_s / PERIOD_S)):
        flight.run(PERIOD_S)
        if engagement.state is not State.TRACKING:
            after_s = flight.now_ns * 1e-9 - begun_s
            ended = f"{engagement.state} after {after_s:.1f} s: {engagement.reason}"
            raise NotFlownError(f"{task.profile}: {ended}")
        now_s = flight.now_ns * 1e-9
        on_s = trajectory_time(log.clock, now_s)
        truth = flight.truth()
        airspeed_min = min(airspeed_min, truth.airspeed_m_s)
        at = sample(config.trajectory, on_s).position
        off = [x - o - r for x, o, r in zip(truth.position_ned_m, origin, at, strict=True)]
        if planar:
            off[2] = 0.0
        seen = [d + b for d, b in zip(off, vehicle.position_bias_ned_m, strict=True)]
        if planar:
            seen[2] = 0.0
        rows.append((now_s - begun_s, hypot(*seen), *truth.position_ned_m, on_s, hypot(*off)))
    return _figures(task, rows, log, begun_s, airspeed_min)


def trajectory_time(clock: list[tuple[float, float]], t: float) -> float:
    """What the reference's clock, as it was set at these instants, shows at `t` (s); before them, on time."""
    for at_s, planned_s in reversed(clock):
        if at_s <= t + 1e-9:
            return planned_s + (t - at_s)
    at_s, planned_s = clock[0]
    return planned_s + (t - at_s)


def _figures(
    task: Task, rows: list[tuple[float, ...]], log: _Log, begun_s: float, airspeed_min: float
) -> Figures:
    errors = [row[1] for row in rows]
    on_s = [row[5] for row in rows]
    before_corners = sum(1 for s in on_s if not task.corners_s or s < task.corners_s[0])
    converged_s = _settled_s(errors[:before_corners], task.converged_m)
    first = round(min(converged_s + task.settling_s, 0.5 * rows[-1][0]) / PERIOD_S)
    late, truth = errors[first:], [row[6] for row in rows[first:]]
    corner = back = 0.0
    for due, until in pairwise((*task.corners_s, inf)):
        leg = [e for e, s in zip(errors, on_s, strict=True) if due <= s < until]
        if leg:
            corner = max(corner, max(leg))
            back = max(back, _settled_s(leg, task.converged_m))
    settled_ns = (begun_s + min(converged_s, first * PERIOD_S)) * 1e9
    sent = [limited for at_ns, limited in log.banks or log.saturated if at_ns >= settled_ns]
    return Figures(
        converged_s,
        sqrt(sum(e * e for e in late) / len(late)),
        max(late),
        sqrt(sum(e * e for e in truth) / len(truth)),
        corner,
        back,
        max((-s.speed_m_s for s in log.setpoints), default=0.0),
        airspeed_min,
        sum(sent) / len(sent) if sent else 0.0,
        log.stuck,
        tuple(row[:5] for row in rows),
    )


def _settled_s(errors: list[float], converged_m: float) -> float:
    """From the first of these until they stay below `converged_m`; inf if they do not."""
    outside = [n for n, e in enumerate(errors) if not e < converged_m]
    if not outside:
        return 0.0
    return inf if outside[-1] == len(errors) - 1 else (outside[-1] + 1) * PERIOD_S
