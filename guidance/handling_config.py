"""What a class of vehicles is asked for beside the law: [ground] of the configuration, and steps.

Every key of [ground] has a default that flies; one that is absent is taken from the autopilot's own
parameters. Switched off are a function's numbers that are 0.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from guidance.tune.excitation import CHANNELS, Box, Run
from guidance.tuning import NonNegative, Positive, Section


class GroundConfig(Section, frozen=True, kw_only=True):
    """Rovers and boats (`guidance.handling.ground`); not `enabled`, the law alone drives them."""

    enabled: bool = True
    turning_radius_m: NonNegative | None = None
    crawl_m_s: NonNegative | None = None
    lateral_acceleration_max_m_s2: Positive | None = None
    yaw_gain: Annotated[float, Meta(ge=0.2, le=5.0)] = 1.0
    smoothing_s: Annotated[float, Meta(ge=0.0, le=2.0)] = 0.15
    slip_max_deg: Annotated[float, Meta(ge=0.0, le=45.0)] = 8.6
    speed_kp: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.45
    speed_ki_per_s: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.4
    speed_lag_s: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.45
    waits: bool = False
    stuck_s: Annotated[float, Meta(ge=0.0, le=60.0)] = 3.0


class ExcitationConfig(Section, frozen=True, kw_only=True):
    """Steps in place of the law; `guidance tune` makes it, no file may. Without runs there are none.

    Runs start from one place, at rest, to which the law leads back at `back_m_s` with turns of
    `back_radius_m`, straight for the last `back_straight_m`; from that speed it comes to rest within
    `stop_m`. All of it stays in `box`. What `flies` is never at rest, and its first run begins
    `back_straight_m` ahead of where it is engaged; `back_m_s` is its airspeed, `fastest_m_s` its greatest,
    and the room is counted for a wind of `wind_max_m_s`. What `hovers` goes back by itself, and its box is
    along north.
    """

    runs: tuple[Run, ...] = ()
    way: Literal["drives", "flies", "hovers"] = "drives"
    box: Box = Box(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    back_m_s: float = 0.0
    back_radius_m: float = 0.0
    back_straight_m: float = 0.0
    stop_m: float = 0.0
    fastest_m_s: float = 0.0
    wind_max_m_s: float = 0.0

    def __post_init__(self) -> None:
        if not all(run.holds and run.channel in CHANNELS for run in self.runs):
            raise ValueError("a run without holds, or of no channel that can be stepped")
        needed = self.back_m_s > 0.0 and self.back_radius_m > 0.0
        if self.runs and self.way != "hovers" and not needed:
            raise ValueError("steps without a way back")
