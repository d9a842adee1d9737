"""Flying a campaign: pieces of it, on all cores, into one file."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sitl.campaign.draw import draw, uniforms
from sitl.campaign.flight import OUTCOMES, PARAMETERS, Rows, fly
from sitl.campaign.plan import Plan
from sitl.campaign.vehicle_flights import fly_range as fly_vehicles
from sitl.campaign.vehicle_flights import vehicle_of
from sitl.campaign.vehicle_plan import VehiclePlan
from sitl.compiled import compiled

#: A campaign of ideal bodies, or of vehicles.
AnyPlan = Plan | VehiclePlan

#: Flights that one thread takes at a time, at most: so few that a progress bar moves.
CHUNK: Final = 4096


@dataclass(frozen=True)
class Result:
    """What a campaign found: those of `plan.columns` that vary, and `outcomes` (n, plan.outcomes)."""

    plan: AnyPlan
    parameters: dict[str, Rows]
    outcomes: Rows

    def outcome(self, name: str) -> Rows:
        """One column of the outcomes; NaN if the plan's flights have no such."""
        if name not in self.plan.outcomes:
            return np.full(len(self.outcomes), np.nan)
        return self.outcomes[:, self.plan.outcomes.index(name)]

    def converged(self) -> NDArray[np.bool_]:
        """Which flights got below the radius and stayed there."""
        return np.isfinite(self.outcome("settled_s"))


def cores() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def memory_bytes(plan: AnyPlan) -> int:
    """What its result takes."""
    return 8 * plan.flights * (len(plan.varying()) + len(plan.outcomes))


def steps(plan: AnyPlan) -> int:
    """Of all its flights, the law's; raises ValueError if the plan cannot be flown."""
    if isinstance(plan, Plan):
        return plan.flights * plan.steps
    return plan.flights * round(plan.duration_s / vehicle_of(plan).dt_s)


def fly_range(plan: AnyPlan, first: int, count: int) -> tuple[Rows, Rows]:
    """Parameters and outcomes of flights `first` to `first + count - 1`.

    They are a function of these and the plan alone, so that a campaign can be cut anywhere, and each piece
    flown on another machine.
    """
    if isinstance(plan, VehiclePlan):
        return fly_vehicles(plan, first, count)
    parameters = np.zeros((count, len(PARAMETERS)))
    outcomes = np.zeros((count, len(OUTCOMES)))
    common = plan.common()
    compiled(draw)(common, plan.ranges(), uniforms(plan.seed, first, count), parameters)
    if plan.starts:
        poses = np.array([(*start.position_ned_m, *start.attitude) for start in plan.starts])
        parameters[:, :7] = poses[np.arange(first, first + count) % len(poses)]
    compiled(fly)(common, parameters, outcomes)
    return parameters, outcomes


def run(
    plan: AnyPlan,
    threads: int | None = None,
    chunk: int = CHUNK,
    on_progress: Callable[[int], object] = lambda flights: None,
) -> Result:
    """The whole campaign. `on_progress` is told, in this thread, how many more flights have been flown."""
    threads = threads or cores()
    # Enough pieces for all threads to end at about the same time.
    chunk = max(1, min(chunk, -(-plan.flights // (4 * threads))))
    parameters = {name: np.zeros(plan.flights) for name in plan.varying()}
    outcomes = np.zeros((plan.flights, len(plan.outcomes)))
    fly_range(plan, 0, 1)  # compiled once, not by every thread
    with ThreadPoolExecutor(threads) as executor:
        pieces = {
            executor.submit(fly_range, plan, first, min(chunk, plan.flights - first)): first
            for first in range(0, plan.flights, chunk)
        }
        try:
            for piece in as_completed(pieces):
                first = pieces.pop(piece)
                flown, found = piece.result()
                at = slice(first, first + len(flown))
                for name, column in parameters.items():
                    column[at] = flown[:, plan.columns.index(name)]
                outcomes[at] = found
                on_progress(len(flown))
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            raise
    return Result(plan, parameters, outcomes)


def save(results: list[Result], path: Path) -> None:
    """One NPZ file: for each campaign `NAME/plan` (JSON), and `NAME/...` for each column, a value per flight.

    Of the parameters only those that differ between flights; the others are in the plan.
    """
    columns: dict[str, Any] = {}
    for result in results:
        name = result.plan.name
        columns[f"{name}/plan"] = json.dumps(result.plan.as_dict())
        columns |= {f"{name}/{column}": values for column, values in result.parameters.items()}
        columns |= {f"{name}/{column}": result.outcome(column) for column in result.plan.outcomes}
    with path.open("wb") as file:
        np.savez(file, **columns)


def load(path: Path) -> dict[str, Mapping[str, NDArray[Any]]]:
    """The campaigns of a file: name -> column -> values; `plan` is the JSON text."""
    found: dict[str, dict[str, NDArray[Any]]] = {}
    with np.load(path) as file:
        for key in file.files:
            name, _, column = key.rpartition("/")
            found.setdefault(name, {})[column] = file[key]
    return dict(found)
