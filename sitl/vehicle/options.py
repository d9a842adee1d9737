"""What a built-in vehicle is made of: firmware, identity, plant, pose, clock, noise, parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, NamedTuple

from sitl.models.files import JSBSIM_PREFIX
from sitl.plant import PlantParameters, Triple, Wxyz, attitude_from_euler
from sitl.vehicle.estimator import SILENT, Noise

#: The model that does at once what it is told.
IDEAL: Final = "ideal"


class Firmware(StrEnum):
    """Whose manners the vehicle has."""

    PX4_UUV = "px4-uuv"
    PX4_PLANE = "px4-plane"
    PX4_COPTER = "px4-copter"
    PX4_ROVER = "px4-rover"
    ARDUPILOT_ROVER = "ardupilot-rover"
    ARDUPILOT_PLANE = "ardupilot-plane"
    ARDUPILOT_COPTER = "ardupilot-copter"

    @property
    def flies(self) -> bool:
        """Whether its vehicle takes off and lands."""
        return self.endswith(("-plane", "-copter"))


#: The body behind a firmware whose options name none.
DEFAULT_MODELS: Final[Mapping[Firmware, str]] = {
    Firmware.PX4_UUV: IDEAL,
    Firmware.PX4_PLANE: "airplane",
    Firmware.PX4_COPTER: "copter",
    Firmware.PX4_ROVER: "rover_px4",
    Firmware.ARDUPILOT_ROVER: IDEAL,
    Firmware.ARDUPILOT_PLANE: "airplane",
    Firmware.ARDUPILOT_COPTER: "copter",
}
#: Height at which an airborne vehicle starts, m.
AIRBORNE_M: Final = 60.0


class Origin(NamedTuple):
    """Geodetic origin of the local NED frame, and the first home: degrees and metres above mean sea level."""

    latitude_deg: float = 47.397742
    longitude_deg: float = 8.545594
    altitude_m: float = 489.0


class Truth(NamedTuple):
    """The plant itself at `t_ns`, without noise, quantisation or delay: for scoring, never for guiding."""

    t_ns: int
    boot_ms: float
    position_ned_m: Triple
    attitude_wxyz: Wxyz
    body_rates_frd_rad_s: Triple
    speed_m_s: float
    armed: bool
    mode: str
    velocity_ned_m_s: Triple
    airspeed_m_s: float
    wind_ned_m_s: Triple


@dataclass(frozen=True, kw_only=True)
class VehicleOptions:
    """Everything that can be chosen; the defaults are the paper's start and a plant without lags.

    `model` is the body behind the firmware: "ideal" (made as `plant` says), one of `sitl.models`, or a TOML
    file; without one, what fits the firmware. It starts at rest, what flies on the ground; `airborne`, it
    starts armed at 60 m in the mode that circles or stands, as JSBSim's airplanes always do, by a setup from
    their manuals. An airplane whose position is above the ground starts at `initial_speed_m_s` of the air, by
    default 1.5 times its stall speed.
    `wind_ned_m_s` is steady, `gusts_m_s` the level sigma of turbulence about it, for airplanes.

    `clock_drift_ppm` makes the vehicle's clock fast (positive) or slow against `now_ns`; the plant moves in
    the time of `now_ns`. `clock_offset_ns` is what the boot clock shows when it starts. Until
    `estimator_ready_s` after boot there is no position and arming is refused. `without_messages` names
    messages that this build of the firmware does not know. With `refuses_modes` or `refuses_arming` it
    answers every such command TEMPORARILY_REJECTED, whoever sends it. With a `signing_key` of 32 bytes it
    signs, and takes nothing that is not signed by it.

    `px4_version` is what a PX4 says it is, and its manners where they differ (`px4_uuv`).

    Raises:
        ValueError: a number is not finite or out of range, or the initial mode or a parameter is unknown
            (the last two when the vehicle is built).
    """

    firmware: Firmware = Firmware.PX4_UUV
    system_id: int = 1
    component_id: int = 1
    model: str = ""
    plant: PlantParameters = field(default_factory=PlantParameters)
    wind_ned_m_s: Triple = (0.0, 0.0, 0.0)
    gusts_m_s: float = 0.0
    initial_position_ned_m: Triple | None = None
    initial_yaw_rad: float = 0.0
    initial_speed_m_s: float | None = None
    initial_mode: str | None = None
    initially_armed: bool = False
    airborne: bool = False
    origin: Origin = field(default_factory=Origin)
    px4_version: tuple[int, int, int] = (1, 17, 0)
    speed_at_full_thrust_m_s: float = 5.0
    parameters: Mapping[str, float] = field(default_factory=dict)
    clock_offset_ns: int = 0
    clock_drift_ppm: float = 0.0
    unix_at_zero_ns: int = 1_700_000_000_000_000_000
    estimator_ready_s: float = 0.0
    noise: Noise = SILENT
    seed: int = 0
    without_messages: tuple[str, ...] = ()
    refuses_modes: bool = False
    refuses_arming: bool = False
    signing_key: bytes = field(default=b"", repr=False)

    def __post_init__(self) -> None:
        if not self.model:
            object.__setattr__(self, "model", DEFAULT_MODELS[self.firmware])
        if self.model.startswith(JSBSIM_PREFIX) and self.firmware.flies:
            object.__setattr__(self, "airborne", True)
        if self.airborne and not self.firmware.flies:
            raise ValueError(f"{self.firmware} does not fly: airborne must be false")
        if len(self.signing_key) not in (0, 32):
            raise ValueError(f"signing_key must have 32 bytes, not {len(self.signing_key)}")
        if not all(0 <= part <= 255 for part in self.px4_version):
            raise ValueError(f"px4_version must be numbers of 0 to 255, not {self.px4_version}")
        for name in ("system_id", "component_id"):
            if not 1 <= getattr(self, name) <= 255:
                raise ValueError(f"{name} must be 1 to 255, not {getattr(self, name)}")
        not_negative = {
            "plant.rate_lag_s": self.plant.rate_lag_s,
            "plant.speed_lag_s": self.plant.speed_lag_s,
            "clock_offset_ns": self.clock_offset_ns,
            "gusts_m_s": self.gusts_m_s,
            "initial_speed_m_s": self.initial_speed_m_s or 0.0,
            "estimator_ready_s": self.estimator_ready_s,
            **{f"noise.{name}": value for name, value in self.noise._asdict().items()},
        }
        positive = {
            "plant.max_rate_rad_s": self.plant.max_rate_rad_s,
            "plant.max_speed_m_s": self.plant.max_speed_m_s,
            "noise.position_bias_s": self.noise.position_bias_s,
            "speed_at_full_thrust_m_s": self.speed_at_full_thrust_m_s,
        }
        for name, number in not_negative.items():
            if not 0.0 <= number < math.inf:
                raise ValueError(f"{name} must be finite and not negative, not {number}")
        for name, number in positive.items():
            if not 0.0 < number < math.inf:
                raise ValueError(f"{name} must be finite and positive, not {number}")
        if not abs(self.clock_drift_ppm) <= 100_000.0:
            raise ValueError(f"clock_drift_ppm must be within +-100000, not {self.clock_drift_ppm}")
        if not (abs(self.origin.latitude_deg) < 90.0 and abs(self.origin.longitude_deg) <= 180.0):
            raise ValueError(f"origin must be a latitude and a longitude in degrees, not {self.origin}")
        finite = (
            *(self.initial_position_ned_m or ()),
            *self.wind_ned_m_s,
            self.initial_yaw_rad,
            self.origin.altitude_m,
        )
        if not all(map(math.isfinite, finite)):
            raise ValueError("initial position, yaw, wind and origin must be finite")

    def start_position_ned_m(self) -> Triple:
        """The chosen position; else over the paper's x(0) of section 4, which only a submarine begins at."""
        if self.initial_position_ned_m is not None:
            return self.initial_position_ned_m
        if self.airborne:
            return (-10.0, -30.0, -AIRBORNE_M)
        return (-10.0, -30.0, -5.0 if self.firmware is Firmware.PX4_UUV else 0.0)

    def start_attitude_wxyz(self) -> Wxyz:
        """Level, at the initial yaw."""
        return attitude_from_euler(0.0, 0.0, self.initial_yaw_rad)
