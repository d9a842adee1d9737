"""What a campaign of real vehicles flies: a shipped configuration, a model, and what is drawn around it.

A plan is a TOML file of these keys, or a preset. Pairs are the lowest and the highest value of what is drawn,
uniformly and independently, for each flight; directions are uniform.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal

import msgspec
from msgspec import Meta

from guidance.checking import Places, problems
from guidance.tuning import Section

#: What is drawn for a flight: where it starts beside the reference's start, and what is wrong.
PARAMETERS: Final = (
    "right_m",
    "ahead_m",
    "up_m",
    "off_rad",
    "gain",
    "power",
    "slew",
    "delay_s",
    "wind_north_m_s",
    "wind_east_m_s",
    "gusts_m_s",
    "noise",
    "heading_bias_rad",
)
#: What came of it; times are from the start of the flight, NaN where it did not happen.
#: `entered_s`, `settled_s` and `excursion_m` are as an ideal flight's (`sitl.campaign.flight`). RMS, maximum
#: and the part of setpoints at a limit count from `settling_s` after it settled, but at least over the second
#: half. `reverse_m_s` is the fastest asked for backwards; airspeed and height are an airplane's.
OUTCOMES: Final = (
    "start_error_m",
    "start_heading_error_rad",
    "entered_s",
    "settled_s",
    "final_error_m",
    "excursion_m",
    "rms_m",
    "max_m",
    "saturated",
    "reverse_m_s",
    "airspeed_min_m_s",
    "height_min_m",
    "stuck",
    "finite",
)

Part = Annotated[float, Meta(ge=0.05, le=20.0)]
NotNegative = Annotated[float, Meta(ge=0.0, le=1e4)]
Metres = Annotated[float, Meta(ge=-1e4, le=1e4)]
Seconds = Annotated[float, Meta(ge=-10.0, le=10.0)]
Degrees = Annotated[float, Meta(ge=0.0, le=180.0)]
Positive = Annotated[float, Meta(gt=0.0, le=1e5)]

#: The model that a profile flies if the plan names none.
MODELS: Final = {"ardupilot-rover": "rover", "px4-plane": "airplane_12", "ardupilot-plane": "airplane_20"}


class VehiclePlan(Section, frozen=True, kw_only=True):
    """A campaign of one vehicle.

    `configuration` is a file, by default the one that ships for the profile, with `settings` (KEY=VALUE) on
    top; its trajectory is flown. `model` is one of `sitl.models` or a file.

    `gain`, `slew` and `power` are factors: on the answer in yaw rate, or in roll and pitch, on how fast that
    may change, and on speed or thrust. `delay_s` is added to the model's delay, and no sum is below 0.
    `wind_m_s` blows to anywhere, with gusts of sigma `gusts` times as much; a rover feels what its file
    says. `noise` is a part of the usual estimator's. A flight starts `distance_m` from the reference's start
    (uniform in area), `up_m` above it, its nose `off_deg` off the reference's course to either side; a rover
    at rest, an airplane with the reference's speed through the air.
    """

    profile: Literal["ardupilot-rover", "px4-plane", "ardupilot-plane"]
    name: Annotated[str, Meta(min_length=1, max_length=80)] = "campaign"
    configuration: str = ""
    settings: tuple[str, ...] = ()
    model: str = ""
    flights: Annotated[int, Meta(ge=1, le=10_000_000)] = 400
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    duration_s: Annotated[float, Meta(ge=1.0, le=1e4)] = 60.0
    within_m: Positive = 0.3
    due_s: Positive = 20.0
    settling_s: NotNegative = 6.0
    gain: tuple[Part, Part] = (1.0, 1.0)
    power: tuple[Part, Part] = (1.0, 1.0)
    slew: tuple[Part, Part] = (1.0, 1.0)
    delay_s: tuple[Seconds, Seconds] = (0.0, 0.0)
    wind_m_s: tuple[NotNegative, NotNegative] = (0.0, 0.0)
    gusts: tuple[NotNegative, NotNegative] = (0.16, 0.16)
    distance_m: tuple[NotNegative, NotNegative] = (0.0, 0.0)
    up_m: tuple[Metres, Metres] = (0.0, 0.0)
    off_deg: tuple[Degrees, Degrees] = (0.0, 0.0)
    noise: tuple[NotNegative, NotNegative] = (1.0, 1.0)

    starts: ClassVar[tuple[()]] = ()
    columns: ClassVar[tuple[str, ...]] = PARAMETERS
    outcomes: ClassVar[tuple[str, ...]] = OUTCOMES

    def __post_init__(self) -> None:
        for name in DRAWN:
            low, high = getattr(self, name)
            if not low <= high:
                raise ValueError(f"{name} must be [LOWEST, HIGHEST], not [{low:g}, {high:g}]")
            if not math.isfinite(high - low):
                raise ValueError(f"{name} must be finite, not [{low:g}, {high:g}]")

    @property
    def is_airplane(self) -> bool:
        """Whether it flies."""
        return self.profile != "ardupilot-rover"

    @property
    def model_name(self) -> str:
        """Of `sitl.models`, or a file."""
        return self.model or MODELS[self.profile]

    def varying(self) -> tuple[str, ...]:
        """All columns of `PARAMETERS`: flights are few."""
        return PARAMETERS

    def as_dict(self) -> dict[str, Any]:
        """Everything that determines the numbers but for the files it names."""
        found: dict[str, Any] = msgspec.to_builtins(self)
        return {**found, "model": self.model_name}


#: What is drawn.
DRAWN: Final = (
    "gain",
    "power",
    "slew",
    "delay_s",
    "wind_m_s",
    "gusts",
    "distance_m",
    "up_m",
    "off_deg",
    "noise",
)


def changed(plan: VehiclePlan, given: Mapping[str, Any]) -> VehiclePlan:
    """With these keys, checked like a file's; raises ValueError."""
    data = {**msgspec.to_builtins(plan), **given}
    for problem in problems(data, VehiclePlan):
        raise ValueError(f"{problem.key}{problem.text}")
    return msgspec.convert(data, VehiclePlan)


def read_plan(path: Path) -> VehiclePlan:
    """Raises ValueError, with file, line, key and what is allowed."""
    try:
        text = path.read_text(encoding="utf-8")
        data = tomllib.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: cannot be read: {error}") from None
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path}: not valid TOML: {error}") from None
    places = Places(str(path), text)
    found = [f"{places.of(each.key)}: {each.key}{each.text}" for each in problems(data, VehiclePlan)]
    if found:
        raise ValueError("\n".join(found))
    try:
        return msgspec.convert(data, VehiclePlan)
    except msgspec.ValidationError as error:
        raise ValueError(f"{path}: {error}") from None
