"""[airplane] of the configuration: what an airplane can do, and what is done around the law for it.

Every key has a default that flies; what an airplane can do is taken from the autopilot's own parameters where
it is not given here (`guidance.flying.airplane_fit`), and the tighter of the two holds.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Literal

from msgspec import Meta

from guidance.checking import Problem
from guidance.tuning import Metres, Section, Speed

Airspeed = Annotated[float, Meta(ge=3.0, le=1000.0)]
Throttle = Annotated[float, Meta(ge=0.01, le=0.95)]
Pitch = Annotated[float, Meta(ge=-30.0, le=30.0)]
Lag = Annotated[float, Meta(ge=0.02, le=5.0)]


class AirplaneConfig(Section, frozen=True, kw_only=True):
    """Airplanes (`guidance.handling.airplane`)."""

    airspeed_min_m_s: Airspeed | None = None
    airspeed_cruise_m_s: Airspeed | None = None
    airspeed_max_m_s: Airspeed | None = None
    bank_max_deg: Annotated[float, Meta(ge=5.0, le=75.0)] | None = None
    load_max: Annotated[float, Meta(ge=1.01, le=6.0)] | None = None
    climb_max_m_s: Speed | None = None
    sink_max_m_s: Speed | None = None
    climb_full_m_s: Speed | None = None
    throttle_cruise: Throttle | None = None
    pitch_cruise_deg: Pitch | None = None
    floor_down_m: Metres | None = None
    k_up_per_s: Annotated[float, Meta(ge=0.01, le=10.0)] | None = None
    approach_up_m_s: Speed | None = None
    bank_lag_s: Lag = 0.35
    throttle_lag_s: Lag = 0.2
    learns: bool = True
    trims_file: str = ""
    waits: bool = True
    output: Literal["attitude", "rates"] = "attitude"
    attitude_gain_per_s: Annotated[float, Meta(ge=0.1, le=20.0)] = 4.0
    wind_max_m_s: Speed = 15.0


def airspeed_conflicts(config: AirplaneConfig, fastest_m_s: float) -> Iterator[Problem]:
    """Airspeeds that do not rise, of those that are given; `fastest_m_s` is `limits.speed_max_m_s`."""
    given = [
        (f"airplane.{key}", value)
        for key in ("airspeed_min_m_s", "airspeed_cruise_m_s", "airspeed_max_m_s")
        if (value := getattr(config, key)) is not None
    ]
    bound = ("limits.speed_max_m_s", fastest_m_s)
    for (low, slow), (high, fast) in pairwise([*given, bound]):
        if slow > fast or (slow == fast and low != "airplane.airspeed_max_m_s"):
            yield Problem(low, f" = {slow:g}: must be below {high} = {fast:g}")
