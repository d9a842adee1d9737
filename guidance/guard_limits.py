"""[guards] of the configuration: the limit of each guard, and what is done when it trips."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from math import inf
from typing import Annotated, Final

import msgspec
from msgspec import Meta

from guidance.checking import Problem, one_of, shown
from guidance.geofence import Corner, Fence, area_m2, crosses_itself
from guidance.mavlink.profiles import Profile
from guidance.se3 import Vec3, add
from guidance.trajectory import Trajectory, sample
from guidance.tuning import Metres, Positive, Section, Speed

#: The action that commands nothing: setpoints end, so that the autopilot's own failsafe acts.
SILENCE: Final = "silence"
#: How far apart the instants are at which a trajectory is held against the fence.
PLAN_STEP_S: Final = 0.25

Seconds = Annotated[float, Meta(ge=0.0, le=60.0)]
Corners = Annotated[tuple[tuple[float, float], ...], Meta(description="[north, east] of each corner")]
Places = Annotated[tuple[tuple[float, float], ...], Meta(description="[latitude, longitude] of each corner")]


class GuardsConfig(Section, frozen=True, kw_only=True):
    """A guard whose limit may be absent does not act then; `*_s` is how long a limit must be exceeded."""

    state_max_s: Annotated[float, Meta(ge=0.0, le=2.0)] | None = None
    state_action: str = "hold"
    rate_part: Annotated[float, Meta(ge=0.0, le=0.5)] = 0.3
    rate_s: Seconds = 2.0
    rate_action: str = "hold"
    delay_max_s: Annotated[float, Meta(ge=0.01, le=2.0)] | None = None
    delay_s: Seconds = 1.0
    delay_action: str = "hold"
    jump_max_m: Positive = 10.0
    jump_max_deg: Annotated[float, Meta(gt=0.0, le=180.0)] = 45.0
    jump_action: str = "hold"
    error_max_m: Positive | None = None
    error_s: Seconds = 3.0
    error_action: str = "hold"
    fence_ned_m: Corners = ()
    fence_deg: Places = ()
    fence_down_min_m: Metres | None = None
    fence_down_max_m: Metres | None = None
    fence_ahead_s: Seconds = 3.0
    fence_plan_s: Annotated[float, Meta(ge=0.0, le=600.0)] = 60.0
    fence_action: str = "hold"
    speed_max_m_s: Speed | None = None
    speed_action: str = "hold"
    tilt_max_deg: Annotated[float, Meta(gt=0.0, le=180.0)] | None = None
    tilt_action: str = "hold"
    number_action: str = "hold"
    effect_s: Annotated[float, Meta(ge=1.0, le=60.0)] = 5.0
    effect_action: str = "hold"
    air_action: str = "hold"
    late_max_s: Annotated[float, Meta(ge=0.005, le=1.0)] = 0.05
    late_s: Seconds = 1.0
    late_action: str = "hold"
    battery_min_percent: Annotated[float, Meta(ge=0.0, le=100.0)] = 15.0
    battery_action: str = "hold"
    failsafe_action: str = SILENCE


ACTIONS: Final = tuple(
    field.name for field in msgspec.structs.fields(GuardsConfig) if field.name.endswith("_action")
)


def fence_of(config: GuardsConfig, corners: tuple[Corner, ...]) -> Fence:
    """The fence with these corners (local NED)."""
    low, high = config.fence_down_min_m, config.fence_down_max_m
    return Fence(corners, -inf if low is None else low, inf if high is None else high)


def leaves_after_s(
    fence: Fence, trajectory: Trajectory, origin_ned_m: Vec3, from_s: float, seconds: float
) -> float | None:
    """How long after `from_s` the trajectory is outside first, at most `seconds`; None if it is not."""
    for step in range(int(seconds / PLAN_STEP_S) + 1):
        after_s = step * PLAN_STEP_S
        place = add(origin_ned_m, sample(trajectory, from_s + after_s).position)
        if fence.outside_m(place) > 0.0:
            return after_s
    return None


def guard_conflicts(
    config: GuardsConfig,
    profile: Profile,
    trajectory: Trajectory,
    origin: str | tuple[float, float, float],
    attitude_timeout_s: float,
) -> Iterator[Problem]:
    """What no single key of [guards] can tell. `origin` is `flight.origin`, the time-out is `link`'s."""
    if config.delay_max_s is not None and config.delay_max_s >= attitude_timeout_s:
        yield Problem(
            "guards.delay_max_s",
            f" = {config.delay_max_s:g}: an older attitude is not used in any case; must be below "
            f"link.attitude_timeout_s = {attitude_timeout_s:g}",
        )
    choices = [SILENCE, *profile.exits]
    for key in ACTIONS:
        name = getattr(config, key)
        if name not in choices:
            yield Problem(
                f"guards.{key}",
                f" = {shown(name)}: {profile.name} has no such mode; must be {one_of(choices, name)}",
            )
    low, high = config.fence_down_min_m, config.fence_down_max_m
    if low is not None and high is not None and low >= high:
        yield Problem("guards.fence_down_min_m", f" = {low:g}: must be below fence_down_max_m = {high:g}")
        return
    if config.fence_ned_m and config.fence_deg:
        yield Problem("guards.fence_deg", ": guards.fence_ned_m says where the fence is; set only one")
        return
    key, corners = (
        ("fence_deg", config.fence_deg) if config.fence_deg else ("fence_ned_m", config.fence_ned_m)
    )
    wrong = _wrong_with(corners, degrees=bool(config.fence_deg)) if corners else None
    if wrong is not None:
        yield Problem(f"guards.{key}", f": {wrong}")
        return
    fence: Fence | None = None
    if origin == "ekf" and not config.fence_deg:
        fence = fence_of(config, corners)
    elif not isinstance(origin, str) and config.fence_deg:  # the depth is the estimator's: not known yet
        fence = Fence(tuple(profile.project((*at, origin[2]), origin)[:2] for at in corners))
    if fence is None or fence == Fence():
        return
    after_s = _planned(fence, trajectory, config.fence_plan_s)
    if after_s is not None:
        yield Problem(
            "guards.fence_plan_s",
            f" = {config.fence_plan_s:g}: the trajectory is outside the fence after {after_s:g} s; "
            "make the fence larger, or look less far ahead",
        )


@lru_cache(maxsize=16)
def _planned(fence: Fence, trajectory: Trajectory, seconds: float) -> float | None:
    """When the flight leaves the fence. Looked for once, as this takes longer than a gain may that is set in
    flight."""
    return leaves_after_s(fence, trajectory, Vec3(0.0, 0.0, 0.0), 0.0, seconds)


@lru_cache(maxsize=16)
def _wrong_with(corners: tuple[Corner, ...], *, degrees: bool) -> str | None:
    if len(corners) < 3:
        return f"{len(corners)} corners make no fence: at least 3"
    if len(set(corners)) < len(corners):
        return "a corner comes twice: leave it out, the last one is joined to the first by itself"
    if degrees and not all(abs(lat) <= 90.0 and abs(lon) <= 180.0 for lat, lon in corners):
        return "a corner must be [latitude -90 to 90, longitude -180 to 180]"
    if crosses_itself(corners):
        return "its edges cross: nobody can say what is inside"
    return None if area_m2(corners) > 0.0 else "there is nothing inside"
