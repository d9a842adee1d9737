"""A whole tuning flight in lockstep, with the parameters that the vehicle's autopilot tells, for tests."""

from __future__ import annotations

from dataclasses import replace
from math import atan2, cos, sin
from pathlib import Path
from typing import Any, Final, NamedTuple

from guidance.commands import Engage, Shutdown
from guidance.config import Config, load
from guidance.flying.around import Phase
from guidance.mavlink.profiles import PROFILES
from guidance.mavlink.requirements import names_of, values_of
from guidance.records import Record, Stepping
from guidance.steps_log import results_of
from guidance.steps_plan import proposed
from guidance.supervisor import State
from guidance.tune.excitation import Box
from guidance.tune.identify import Identified
from guidance.tune.propose import Results
from guidance.tune.way_back import Place
from sitl.lockstep import Lockstep
from sitl.scenarios.table import Result, Row, fly_row
from sitl.vehicle import Firmware, Vehicle, VehicleOptions
from sitl.vehicle.estimator import USUAL
from tests.helpers import fly_until, make_flight, state_of

DEPLOY: Final = Path(__file__).parents[1] / "deploy"
YAW_RAD: Final = 0.7
#: How each starts in the air.
AIRBORNE: Final[dict[str, dict[str, Any]]] = {
    "px4-plane": {"model": "airplane_12", "initial_speed_m_s": 12.0, "initial_mode": "AUTO.LOITER"},
    "ardupilot-plane": {"model": "airplane_20", "initial_speed_m_s": 20.0, "initial_mode": "LOITER"},
    "px4-copter": {"model": "copter_px4", "initial_mode": "AUTO.LOITER"},
    "ardupilot-copter": {"model": "copter_ardupilot", "initial_mode": "LOITER"},
}


def fence(half_m: float) -> str:
    """A square around the local origin."""
    corners = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return "guards.fence_ned_m=" + str([[n * half_m, e * half_m] for n, e in corners]).replace(" ", "")


def shipped(profile: str, *overrides: str) -> Config:
    """The configuration that ships, in a fence."""
    return load(DEPLOY / f"{profile}.toml", (fence(2000.0), *overrides))


def told(profile: str) -> dict[str, float]:
    """What the built-in vehicle's autopilot tells of itself, as `guidance tune` reads it."""
    pilot = Vehicle(VehicleOptions(firmware=Firmware(profile)), boot_ns=1)._pilot
    table = PROFILES[profile].requirements
    known = pilot.parameter_defaults
    return values_of(table, {name: pilot.parameters[name] for name in names_of(table) if name in known})


class Flown(NamedTuple):
    """A flight from engaging to its end; `path` is ahead, right and below of where it was engaged, m."""

    flight: Lockstep
    config: Config
    results: Results
    path: list[tuple[float, float, float]]
    airspeeds_m_s: list[float]

    def found(self, channel: str) -> Identified:
        """Of a channel that must have been identified."""
        result = self.results[channel]
        assert isinstance(result, Identified), result
        return result

    @property
    def steppings(self) -> list[Stepping]:
        """The handler's records."""
        return [record for record in self.flight.records if isinstance(record, Stepping)]


def engaged(config: Config, **options: Any) -> Lockstep:
    """Told to engage as soon as it is ready."""
    profile = config.vehicle.profile
    settings = {
        "noise": USUAL,
        "initial_position_ned_m": (0.0, 0.0, -100.0 if profile in AIRBORNE else 0.0),
        "initial_yaw_rad": YAW_RAD,
        "initially_armed": True,
        **AIRBORNE.get(profile, {}),
        **options,
    }
    flight = make_flight(config=config, **settings)
    fly_until(flight, State.READY, 20.0)
    flight.guide.command(Engage(), flight.now_ns)
    fly_until(flight, State.TRACKING, 20.0)
    return flight


def flown(config: Config, **options: Any) -> Flown:
    """Until the steps are done, and the end as `guidance tune` makes it."""
    flight = engaged(config, **options)
    steps = config.excitation
    truth = flight.truth()
    north, east, down = truth.position_ned_m
    start = Place(north, east, 0.0 if steps.way == "hovers" else YAW_RAD)
    if steps.way == "flies":
        v_north, v_east, _ = truth.velocity_ned_m_s
        start = start._replace(heading_rad=atan2(v_east, v_north))
    path, airspeeds = [], []
    c, s = cos(start.heading_rad), sin(start.heading_rad)
    while (seen := newest(flight)) is None or seen.phase != Phase.DONE:
        flight.run(0.1)
        assert state_of(flight) is State.TRACKING, flight.guide.engagement.reason
        assert flight.now_ns < 320e9, seen
        truth = flight.truth()
        n, e, d = (x - x0 for x, x0 in zip(truth.position_ned_m, (north, east, down), strict=True))
        path.append((n * c + e * s, e * c - n * s, d))
        airspeeds.append(truth.airspeed_m_s)
    flight.guide.command(Shutdown(source="guidance tune"), flight.now_ns)
    fly_until(flight, State.FINISHED, 2.0)
    return Flown(flight, config, results_of(config, flight.records), path, airspeeds)


def newest(flight: Lockstep) -> Stepping | None:
    """What the handler said last."""
    recent: list[Record] = flight.records[-200:]
    return next((r for r in reversed(recent) if isinstance(r, Stepping)), None)


def inside(box: Box, path: list[tuple[float, float, float]]) -> bool:
    """Whether all of it is."""
    return all(
        -box.behind_m <= ahead <= box.ahead_m
        and -box.left_m <= right <= box.right_m
        and -box.up_m <= down <= box.down_m
        for ahead, right, down in path
    )


def on_the_circle(rows: tuple[Row, ...], done: Flown) -> Result:
    """The profile's first circle, flown with what the steps propose."""
    profile = done.config.vehicle.profile
    row = next(row for row in rows if row.task.profile == profile and "circle" in row.name)
    lines = proposed(done.config, done.results)
    settings = [f"{line.table}.{line.key}={line.value}" for line in lines]
    task = replace(row.task, settings=(*row.task.settings, *settings))
    return fly_row(replace(row, task=task), seeds=1)
