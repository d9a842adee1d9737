"""[copter] of the configuration: what is done around the law for vehicles that take velocities.

Every key has a default that flies; limits that are absent are the autopilot's own
(`guidance.flying.velocity_fit`).
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from guidance.tuning import Acceleration, Section, Speed


class CopterConfig(Section, frozen=True, kw_only=True):
    """Multirotors (`guidance.handling.velocity`, and with output = "rates" `guidance.handling.copter_rates`)."""

    up_max_m_s: Speed | None = None
    down_max_m_s: Speed | None = None
    vertical_acceleration_max_m_s2: Acceleration | None = None
    heading: Literal["path", "held"] = "path"
    slow_m_s: Annotated[float, Meta(ge=0.01, le=10.0)] = 0.3
    drag_per_s: Annotated[float, Meta(ge=0.0, le=2.0)] | None = None
    learns: bool = True
    short_gain: Annotated[float, Meta(ge=0.0, le=3.0)] | None = None
    smoothing_s: Annotated[float, Meta(ge=0.0, le=2.0)] = 0.3
    waits: bool = False
    stuck_s: Annotated[float, Meta(ge=0.0, le=60.0)] = 3.0
    output: Literal["velocity", "rates"] = "velocity"
    attitude_gain_per_s: Annotated[float, Meta(ge=0.1, le=20.0)] = 5.0
    tilt_max_deg: Annotated[float, Meta(ge=5.0, le=60.0)] | None = None
    hover_file: str = ""
