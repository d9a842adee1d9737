"""Autopilot profiles: one row says all that the service knows of a firmware on a vehicle type.

What an autopilot does with a setpoint differs by firmware and vehicle; everything else in the service is
the same for all. To add a vehicle, add a row to `PROFILES` and its golden bytes to the tests.

Sources: PX4 `src/modules/mavlink/mavlink_receiver.cpp` (main, 2025-08), ArduPilot
`Rover/GCS_MAVLink_Rover.cpp`, `ArduPlane/GCS_MAVLink_Plane.cpp`, `ArduCopter/GCS_MAVLink_Copter.cpp` and each
one's `mode_guided.cpp` (2025-10).
"""

from __future__ import annotations

from enum import StrEnum
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import all as dialect

from guidance.geodesy import Projection, azimuthal_equidistant, equirectangular
from guidance.mavlink.ardupilot_requirements import (
    COPTER_GUIDED,
    COPTER_GUIDED_RATES,
    PLANE_GUIDED,
    ROVER_GUIDED,
)
from guidance.mavlink.messages import AutopilotVersion, Heartbeat
from guidance.mavlink.modes import COPTER_MODES, PLANE_MODES, PX4_MODES, ROVER_MODES, Mode
from guidance.mavlink.px4_requirements import (
    PX4_COPTER,
    PX4_COPTER_RATES,
    PX4_PLANE,
    PX4_ROVER,
    PX4_UUV,
)
from guidance.mavlink.requirements import Requirement

_IGNORE_ROLL_RATE: Final = 1
_IGNORE_PITCH_RATE: Final = 2
_IGNORE_YAW_RATE: Final = 4
_IGNORE_ATTITUDE: Final = 128
#: Of SET_POSITION_TARGET_LOCAL_NED: position, acceleration, yaw; what is left is velocity and yaw rate.
_VELOCITY_AND_YAW_RATE: Final = 0x5C7
_VELOCITY: Final = 0xDC7
#: The first PX4 whose `uuv_att_control` has an output by body rates alone (PX4/PX4-Autopilot#25052, 2025-07):
#: 1.17.0, from its release candidates on. What was built on the way to it may be from before.
_PX4_UUV_BY_RATES: Final = 1 << 24 | 17 << 16 | dialect.FIRMWARE_VERSION_TYPE_RC


class Handling(StrEnum):
    """How a vehicle is driven along the law's field: the class of its body (`guidance.flying`)."""

    RATES = "rates"
    GROUND = "ground"
    AIRPLANE = "airplane"
    VELOCITY = "velocity"


class Asked(StrEnum):
    """What a setpoint carries, and with it its message."""

    RATES_SPEED = "body rates and thrust for a speed"
    ATTITUDE_RATES_SPEED = "attitude, body rates and thrust for a speed"
    YAW_RATE_SPEED = "yaw rate and thrust for a speed"
    ATTITUDE_THROTTLE = "roll, pitch and throttle"
    RATES_THROTTLE = "body rates and throttle"
    VELOCITY_YAW_RATE = "velocity and yaw rate"


#: What is taken over in the air.
FLIES: Final = frozenset({Handling.AIRPLANE, Handling.VELOCITY})


class Older(NamedTuple):
    """What every version takes, for one from before `first_version` or of which that is not known.

    It is a `flight_sw_version` of AUTOPILOT_VERSION: major, minor, patch, kind of release, a byte each.
    """

    first_version: int
    asked: Asked
    type_mask: int


class Profile(NamedTuple):
    """One row. What is asked is clamped (`setpoints`) because PX4 acts on what it is sent.

    `type_mask` is that of the message that `asked` goes into. `thrust_min..thrust_max` is the range that the
    firmware gives a meaning. `planar` takes the law on SE(2). `needs_stream` says that the control mode is
    refused unless setpoints already arrive, and that a resumed stream takes control back. After
    `stream_timeout_s` without a setpoint the autopilot acts by itself (`on_timeout`). `holding` is the mode
    that "hold" stands for. `odometry` says that ODOMETRY can be asked for. `project` is how it makes a local
    position of latitude and longitude. `requirements` are what its parameters must be; integers among these
    come `parameters_bytewise`, or by value. `estimator` names what tells its health.

    `full_thrust_parameter` is the speed that full thrust asks for, if the firmware has one. `air` are the
    messages that tell of airspeed and wind, with their rates in Hz. `takes_rates` says that body rates and
    throttle will do instead of what is `asked` (`by_rates`), with `rates_requirements` instead, if any. What
    is asked moves no vehicle whose firmware is `older`, if there is such (`for_version`).
    """

    name: str
    firmware: str
    autopilot: int
    vehicle_types: frozenset[int]
    handling: Handling
    planar: bool
    asked: Asked
    type_mask: int
    thrust_min: float
    thrust_max: float
    control_mode: Mode
    modes: tuple[Mode, ...]
    holding: str
    needs_stream: bool
    stream_timeout_s: float
    on_timeout: str
    mode_hz: float
    odometry: bool
    project: Projection
    requirements: tuple[Requirement, ...]
    parameters_bytewise: bool
    estimator: str
    full_thrust_parameter: str = ""
    air: tuple[tuple[str, float], ...] = ()
    takes_rates: bool = False
    rates_requirements: tuple[Requirement, ...] = ()
    older: Older | None = None

    def by_rates(self) -> Profile:
        """The same row, asked by body rates and throttle; a copter's throttle is its thrust upward."""
        return self._replace(
            asked=Asked.RATES_THROTTLE,
            type_mask=_IGNORE_ATTITUDE,
            thrust_min=0.0,
            thrust_max=1.0,
            requirements=self.rates_requirements or self.requirements,
        )

    def for_version(self, version: AutopilotVersion | None) -> Profile:
        """The row that is sure to move that version, None if it is not known. One that moves any stays."""
        if self.older is None:
            return self
        first, asked, type_mask = self.older
        if version is not None and version.flight_sw_version >= first:
            return self
        return self._replace(asked=asked, type_mask=type_mask, older=None)

    def mode(self, name: str) -> Mode | None:
        """The mode of that name, None if this firmware has none; "hold" is the one that holds."""
        wanted = self.holding if name == "hold" else name
        return next((mode for mode in self.modes if mode.name == wanted), None)

    def mode_name(self, custom_mode: int) -> str:
        """The name of a HEARTBEAT's `custom_mode`, or its number if it has none here."""
        found = next((mode.name for mode in self.modes if mode.custom_mode == custom_mode), None)
        return found if found is not None else f"mode {custom_mode}"

    def fits(self, beat: Heartbeat) -> bool:
        """Whether it is for the firmware and the vehicle that a HEARTBEAT tells of."""
        return beat.autopilot == self.autopilot and beat.type in self.vehicle_types

    @property
    def condition(self) -> tuple[tuple[str, float], ...]:
        """The messages that tell of its condition (`guidance.condition`), with their rates in Hz."""
        ekf = (("EKF_STATUS_REPORT", 5.0),) if self.firmware == "ArduPilot" else ()
        landed = (("EXTENDED_SYS_STATE", 5.0),) if self.handling in FLIES else ()
        return ekf + landed

    @property
    def exits(self) -> tuple[str, ...]:
        """The names of the modes in which it can be left."""
        names = [mode.name for mode in self.modes if mode != self.control_mode]
        return tuple(names if "hold" in names else ["hold", *names])


_COPTERS: Final = frozenset(
    {
        dialect.MAV_TYPE_QUADROTOR,
        dialect.MAV_TYPE_COAXIAL,
        dialect.MAV_TYPE_HELICOPTER,
        dialect.MAV_TYPE_HEXAROTOR,
        dialect.MAV_TYPE_OCTOROTOR,
        dialect.MAV_TYPE_TRICOPTER,
        dialect.MAV_TYPE_DODECAROTOR,
        dialect.MAV_TYPE_DECAROTOR,
    }
)


def _px4(
    name: str,
    vehicle_types: frozenset[int],
    handling: Handling,
    asked: Asked,
    type_mask: int,
    requirements: tuple[Requirement, ...],
    thrust: tuple[float, float] = (-1.0, 1.0),
    *,
    planar: bool = False,
    air: tuple[tuple[str, float], ...] = (),
    takes_rates: bool = False,
    rates_requirements: tuple[Requirement, ...] = (),
    older: Older | None = None,
    modes: tuple[Mode, ...] = PX4_MODES,
    holding: str = "hold",
) -> Profile:
    """A row of PX4: the firmware's manners are those of every vehicle."""
    return Profile(
        name=name,
        firmware="PX4",
        autopilot=dialect.MAV_AUTOPILOT_PX4,
        vehicle_types=vehicle_types,
        handling=handling,
        planar=planar,
        asked=asked,
        type_mask=type_mask,
        thrust_min=thrust[0],
        thrust_max=thrust[1],
        control_mode=next(mode for mode in PX4_MODES if mode.name == "offboard"),
        modes=modes,
        holding=holding,
        needs_stream=True,
        stream_timeout_s=1.0,  # COM_OF_LOSS_T
        on_timeout="COM_OBL_RC_ACT (default: position mode); the intended mode stays offboard",
        mode_hz=10.0,  # HEARTBEAT shows a mode change up to 1 s late, and only CURRENT_MODE the intended
        odometry=True,
        project=azimuthal_equidistant,
        requirements=requirements,
        parameters_bytewise=True,
        estimator="ESTIMATOR_STATUS",
        air=air,
        takes_rates=takes_rates,
        rates_requirements=rates_requirements,
        older=older,
    )


def _ardupilot(
    name: str,
    vehicle_types: frozenset[int],
    handling: Handling,
    asked: Asked,
    type_mask: int,
    modes: tuple[Mode, ...],
    holding: str,
    on_timeout: str,
    requirements: tuple[Requirement, ...],
    thrust: tuple[float, float] = (-1.0, 1.0),
    *,
    planar: bool = False,
    full_thrust_parameter: str = "",
    air: tuple[tuple[str, float], ...] = (),
    takes_rates: bool = False,
    rates_requirements: tuple[Requirement, ...] = (),
) -> Profile:
    """A row of ArduPilot: modes and what a setpoint means differ by vehicle."""
    return Profile(
        name=name,
        firmware="ArduPilot",
        autopilot=dialect.MAV_AUTOPILOT_ARDUPILOTMEGA,
        vehicle_types=vehicle_types,
        handling=handling,
        planar=planar,
        asked=asked,
        type_mask=type_mask,
        thrust_min=thrust[0],
        thrust_max=thrust[1],
        control_mode=next(mode for mode in modes if mode.name == "guided"),
        modes=modes,
        holding=holding,
        needs_stream=False,
        stream_timeout_s=3.0,
        on_timeout=on_timeout,
        mode_hz=0.0,  # HEARTBEAT comes at once with a mode change
        odometry=False,  # not in its table of messages (`GCS_Common.cpp`): every rate is refused
        project=equirectangular,
        requirements=requirements,
        parameters_bytewise=False,
        estimator="EKF_STATUS_REPORT",
        full_thrust_parameter=full_thrust_parameter,
        air=air,
        takes_rates=takes_rates,
        rates_requirements=rates_requirements,
    )


#: "hold" of an underwater vehicle is MANUAL: PX4 before 1.17 goes on with the last attitude and thrust in all
#: its automatic modes and with the last output in the other modes by hand (`uuv_att_control.cpp`; nothing
#: starts `uuv_pos_control`), and only MANUAL, with sticks at neutral, gives the thrusters nothing in every
#: version. PX4's own Hold, which since 1.17 keeps the place, is "loiter" here.
_UUV_MODES: Final = tuple(mode._replace(name="loiter") if mode.name == "hold" else mode for mode in PX4_MODES)

PROFILES: Final[dict[str, Profile]] = {
    profile.name: profile
    for profile in (
        _px4(
            "px4-uuv",
            frozenset({dialect.MAV_TYPE_SUBMARINE}),
            Handling.RATES,
            Asked.RATES_SPEED,  # along +x for a submarine
            _IGNORE_ATTITUDE,  # PX4 takes the rates when roll and pitch rate are both unmasked
            PX4_UUV,
            older=Older(_PX4_UUV_BY_RATES, Asked.ATTITUDE_RATES_SPEED, 0),
            modes=_UUV_MODES,
            holding="manual",
        ),
        _px4(
            "px4-plane",
            frozenset({dialect.MAV_TYPE_FIXED_WING}),
            Handling.AIRPLANE,
            Asked.ATTITUDE_THROTTLE,
            _IGNORE_ROLL_RATE | _IGNORE_PITCH_RATE | _IGNORE_YAW_RATE,
            PX4_PLANE,
            (0.0, 1.0),
            air=(("VFR_HUD", 10.0), ("WIND_COV", 2.0)),
            takes_rates=True,
        ),
        _px4(
            "px4-copter",
            _COPTERS,
            Handling.VELOCITY,
            Asked.VELOCITY_YAW_RATE,
            _VELOCITY_AND_YAW_RATE,
            PX4_COPTER,
            takes_rates=True,
            rates_requirements=PX4_COPTER_RATES,
        ),
        _px4(
            "px4-rover",
            frozenset({dialect.MAV_TYPE_GROUND_ROVER}),
            Handling.GROUND,
            Asked.VELOCITY_YAW_RATE,
            _VELOCITY,
            PX4_ROVER,
            planar=True,
        ),
        _ardupilot(
            "ardupilot-rover",
            frozenset({dialect.MAV_TYPE_GROUND_ROVER, dialect.MAV_TYPE_SURFACE_BOAT}),
            Handling.GROUND,
            Asked.YAW_RATE_SPEED,  # thrust x WP_SPEED = ground speed
            _IGNORE_ATTITUDE | _IGNORE_PITCH_RATE | _IGNORE_ROLL_RATE,
            ROVER_MODES,
            "hold",
            "stops and stays in guided",
            ROVER_GUIDED,
            planar=True,
            full_thrust_parameter="WP_SPEED",
        ),
        _ardupilot(
            "ardupilot-plane",
            frozenset({dialect.MAV_TYPE_FIXED_WING}),
            Handling.AIRPLANE,
            Asked.ATTITUDE_THROTTLE,
            _IGNORE_ATTITUDE | _IGNORE_YAW_RATE,  # takes roll and pitch of q, keeps the coordinated rudder
            PLANE_MODES,
            "loiter",
            "goes back to its own navigation and stays in guided",
            PLANE_GUIDED,
            (0.0, 1.0),
            air=(("VFR_HUD", 10.0), ("WIND", 2.0)),
        ),
        _ardupilot(
            "ardupilot-copter",
            _COPTERS,
            Handling.VELOCITY,
            Asked.VELOCITY_YAW_RATE,
            _VELOCITY_AND_YAW_RATE,
            COPTER_MODES,
            "brake",  # loiter goes by the throttle stick: with none, or a low one, it sinks (recorded)
            "levels and stops, and stays in guided (GUID_TIMEOUT)",
            COPTER_GUIDED,
            takes_rates=True,
            rates_requirements=COPTER_GUIDED_RATES,
        ),
    )
}


def fitting(beat: Heartbeat) -> list[str]:
    """The names of the profiles that are for that vehicle."""
    return [profile.name for profile in PROFILES.values() if profile.fits(beat)]


def set_mode_command(mode: Mode, system: int, component: int) -> Any:
    """COMMAND_LONG with MAV_CMD_DO_SET_MODE (176), custom mode enabled."""
    return command_long(system, component, dialect.MAV_CMD_DO_SET_MODE, 1.0, mode.main, mode.sub)


def command_long(system: int, component: int, command: int, *params: float) -> Any:
    """COMMAND_LONG (76); missing params are 0."""
    filled = (*params, *(0.0,) * (7 - len(params)))
    return dialect.MAVLink_command_long_message(system, component, command, 0, *filled)
