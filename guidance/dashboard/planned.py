"""The path that is planned, sampled from the trajectory, before and while it is flown."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Any, Final

import msgspec
from msgspec.structs import replace

from guidance.geodesy import Geodetic
from guidance.mavlink.profiles import PROFILES
from guidance.records import NOT_A_RECORD
from guidance.se3 import Vec3, norm, subtract
from guidance.trajectory import Trajectory, sample

POINTS: Final = 400
#: What never comes back to where it was is drawn in pieces of a cycle, of so long at least, two at a time.
_PIECE_S: Final = 30.0
#: Later than this nothing is drawn.
_LATEST_S: Final = 1e7
_PLANS_MAX: Final = 200

_TRAJECTORY: Final[msgspec.json.Decoder[Trajectory]] = msgspec.json.Decoder(Trajectory)
_encode: Final = msgspec.json.Encoder().encode


class Planner:
    """The plan of each vehicle as a page is told it: the same object until it is another plan."""

    def __init__(self) -> None:
        self._plans: dict[str, tuple[tuple[Trajectory | None, float, float], bytes]] = {}

    def told(self, vehicle: str, keys: Mapping[str, Any], trajectory_s: float) -> bytes:
        """For the trajectory of these keys, at that time of its own; without points if it is none of ours."""
        trajectory = read(keys)
        whole, from_s, to_s = (True, 0.0, 0.0) if trajectory is None else stretch(trajectory, trajectory_s)
        held = self._plans.get(vehicle)
        if held is None or held[0] != (trajectory, from_s, to_s):
            if len(self._plans) >= _PLANS_MAX:
                self._plans.clear()
            points = [] if trajectory is None else path(trajectory, from_s, to_s)
            said = _encode({"kind": "plan", "vehicle": vehicle, "points": points, "whole": whole})
            held = self._plans[vehicle] = (trajectory, from_s, to_s), said
        return held[1]


def read(keys: Mapping[str, Any]) -> Trajectory | None:
    """The trajectory of a table of a configuration; None if it is none that this version knows."""
    try:
        return _TRAJECTORY.decode(msgspec.json.encode(keys))
    except NOT_A_RECORD:
        return None


def stretch(trajectory: Trajectory, trajectory_s: float) -> tuple[bool, float, float]:
    """What is drawn at a time of the trajectory: from when to when, s, and whether that is all of it.

    All is one round of what is flown in rounds, and what comes to rest.
    """
    cycle_s, rest_s = trajectory.cycle_s, trajectory.stop_at_s
    start, end = (sample(replace(trajectory, stop_at_s=0.0), t_s) for t_s in (0.0, cycle_s))
    round_m = norm(subtract(end.position, start.position))
    if round_m < 1e-6 * (1.0 + norm(start.position)) and norm(start.velocity) > 0.0:
        return True, 0.0, min(cycle_s, rest_s or cycle_s)
    piece_s = max(cycle_s, _PIECE_S)
    if 0.0 < rest_s <= 2.0 * piece_s:
        return True, 0.0, rest_s
    known = isfinite(trajectory_s) and 0.0 <= trajectory_s < _LATEST_S
    from_s = trajectory_s // piece_s * piece_s if known else 0.0
    to_s = from_s + 2.0 * piece_s
    return False, from_s, min(to_s, rest_s) if rest_s > from_s else to_s


def path(trajectory: Trajectory, from_s: float, to_s: float) -> list[float]:
    """North, east and down of point after point, m from the trajectory's origin, to the millimetre."""
    step_s = (to_s - from_s) / (POINTS - 1)
    places = (sample(trajectory, from_s + k * step_s).position for k in range(POINTS))
    return [round(metres, 3) for place in places for metres in place]


def local(profile: str, point: Geodetic, ekf: Geodetic) -> Vec3 | None:
    """A place in local NED, m, as an autopilot of this profile projects it; None if that is not known."""
    known = PROFILES.get(profile)
    if known is None or not all(map(isfinite, (*point, *ekf))):
        return None
    return known.project(point, ekf)
