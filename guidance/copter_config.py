"""[copter] of the configuration: what is done around the law for vehicles that take velocities.

Every key has a default that flies; limits that are absent are the autopilot's own
(`guidance.flying.velocity_fit`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Final, Literal

from msgspec import Meta

from guidance.checking import Problem
from guidance.tuning import Acceleration, LimitsConfig, Section, Speed

#: With less (rad/s) it leans too slowly to fly by rates.
LEAST_TILT_RATE_RAD_S: Final = 0.5
#: The gain of the tilt is at most this part of the setpoints' rate.
TILT_GAIN_PART: Final = 0.15


class CopterConfig(Section, frozen=True, kw_only=True):
    """Multirotors (`guidance.handling.velocity`, and with output = "rates" `copter_rates` there)."""

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
    attitude_gain_per_s: Annotated[float, Meta(ge=0.1, le=20.0)] = 6.0
    tilt_max_deg: Annotated[float, Meta(ge=5.0, le=60.0)] | None = None
    hover_file: str = ""


def rate_conflicts(config: CopterConfig, limits: LimitsConfig, rate_hz: float) -> Iterator[Problem]:
    """What `output = "rates"` cannot be flown with: no rate to lean by, or setpoints slow for the gain."""
    for key in ("roll_rate_max_rad_s", "pitch_rate_max_rad_s"):
        if (value := getattr(limits, key)) < LEAST_TILT_RATE_RAD_S:
            must = f'must be at least {LEAST_TILT_RATE_RAD_S:g} with copter.output = "rates"'
            yield Problem(f"limits.{key}", f" = {value:g}: {must}")
    gain, most = config.attitude_gain_per_s, TILT_GAIN_PART * rate_hz
    if gain > most:
        yield Problem(
            "copter.attitude_gain_per_s",
            f" = {gain:g}: must be at most {most:g}, {TILT_GAIN_PART:g} of link.rate_hz = {rate_hz:g}",
        )
