"""Autopilot profiles: one row says all that the service knows of a firmware on a vehicle type.

What an autopilot does with a setpoint differs by firmware and vehicle; everything else in the service is
the same for all. To add a vehicle, add a row to `PROFILES` and its golden bytes to the tests.

Sources: PX4 `src/modules/mavlink/mavlink_receiver.cpp` (main, 2025-08), ArduPilot
`Rover/GCS_MAVLink_Rover.cpp` and `Rover/mode_guided.cpp` (2025-10).
"""

from __future__ import annotations

import math
from struct import Struct
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import all as dialect

from guidance.geodesy import Projection, azimuthal_equidistant, equirectangular
from guidance.mavlink.codec import Payload
from guidance.mavlink.requirements import PX4_OFFBOARD, ROVER_GUIDED, Requirement

#: Time, attitude, body rates, thrust; target, mask. The extension, thrust_body, is zero and left out.
_ATTITUDE_TARGET: Final = Struct("<I8f3B")
_IGNORE_ROLL_RATE: Final = 1
_IGNORE_PITCH_RATE: Final = 2
_IGNORE_ATTITUDE: Final = 128

#: No vehicle is asked to turn faster than this, whatever the configuration says (4 pi, two turns a second).
BODY_RATE_MAX_RAD_S: Final = 12.566370614359172


class Mode(NamedTuple):
    """A flight mode: the operator's name, HEARTBEAT's `custom_mode`, and DO_SET_MODE's param2 and param3."""

    name: str
    custom_mode: int
    main: int
    sub: int = 0


def _px4(name: str, main: int, sub: int = 0) -> Mode:
    return Mode(name, main << 16 | sub << 24, main, sub)


def _ardupilot(name: str, number: int) -> Mode:
    return Mode(name, number, number)


class Profile(NamedTuple):
    """One row. Rates and thrust are clamped here because PX4 acts on what it is sent.

    `type_mask` is SET_ATTITUDE_TARGET's. `thrust_min..thrust_max` is the range that the firmware gives a
    meaning. `planar` takes the law on SE(2). `needs_stream` says that the control mode is refused unless
    setpoints already arrive, and that a resumed stream takes control back. After `stream_timeout_s` without
    a setpoint the autopilot acts by itself (`on_timeout`). The neutral setpoint is zero rates and
    `thrust_neutral`: it asks the vehicle to stay as it is. `odometry` says that ODOMETRY can be asked
    for. `project` is how it makes a local position of latitude and longitude. `requirements` are what its
    parameters must be; integers among these come `parameters_bytewise`, or by value. `estimator` names what
    tells its health.
    """

    name: str
    firmware: str
    autopilot: int
    vehicle_types: frozenset[int]
    planar: bool
    type_mask: int
    thrust_min: float
    thrust_max: float
    thrust_neutral: float
    control_mode: Mode
    modes: tuple[Mode, ...]
    needs_stream: bool
    stream_timeout_s: float
    on_timeout: str
    mode_hz: float
    odometry: bool
    project: Projection
    requirements: tuple[Requirement, ...]
    parameters_bytewise: bool
    estimator: str

    def mode(self, name: str) -> Mode | None:
        """The mode of that name, None if this firmware has none."""
        return next((mode for mode in self.modes if mode.name == name), None)

    def mode_name(self, custom_mode: int) -> str:
        """The name of a HEARTBEAT's `custom_mode`, or its number if it has none here."""
        found = next((mode.name for mode in self.modes if mode.custom_mode == custom_mode), None)
        return found if found is not None else f"mode {custom_mode}"


_PX4_OFFBOARD: Final = _px4("offboard", 6)
_ROVER_GUIDED: Final = _ardupilot("guided", 15)

PROFILES: Final[dict[str, Profile]] = {
    profile.name: profile
    for profile in (
        Profile(
            name="px4-uuv",
            firmware="PX4",
            autopilot=dialect.MAV_AUTOPILOT_PX4,
            vehicle_types=frozenset({dialect.MAV_TYPE_SUBMARINE}),
            planar=False,
            type_mask=_IGNORE_ATTITUDE,  # PX4 takes the rates when roll and pitch rate are both unmasked
            thrust_min=-1.0,
            thrust_max=1.0,  # along +x for a submarine
            thrust_neutral=0.0,
            control_mode=_PX4_OFFBOARD,
            modes=(
                _px4("manual", 1),
                _px4("altitude", 2),
                _px4("position", 3),
                _px4("takeoff", 4, 2),
                _px4("hold", 4, 3),
                _px4("mission", 4, 4),
                _px4("return", 4, 5),
                _px4("land", 4, 6),
                _px4("acro", 5),
                _PX4_OFFBOARD,
                _px4("stabilized", 7),
            ),
            needs_stream=True,
            stream_timeout_s=1.0,  # COM_OF_LOSS_T
            on_timeout="COM_OBL_RC_ACT (default: position mode); the intended mode stays offboard",
            mode_hz=10.0,  # HEARTBEAT shows a mode change up to 1 s late, and only CURRENT_MODE the intended
            odometry=True,
            project=azimuthal_equidistant,
            requirements=PX4_OFFBOARD,
            parameters_bytewise=True,
            estimator="ESTIMATOR_STATUS",
        ),
        Profile(
            name="ardupilot-rover",
            firmware="ArduPilot",
            autopilot=dialect.MAV_AUTOPILOT_ARDUPILOTMEGA,
            vehicle_types=frozenset({dialect.MAV_TYPE_GROUND_ROVER, dialect.MAV_TYPE_SURFACE_BOAT}),
            planar=True,
            type_mask=_IGNORE_ATTITUDE | _IGNORE_PITCH_RATE | _IGNORE_ROLL_RATE,
            thrust_min=-1.0,
            thrust_max=1.0,  # x WP_SPEED = ground speed
            thrust_neutral=0.0,
            control_mode=_ROVER_GUIDED,
            modes=(
                _ardupilot("manual", 0),
                _ardupilot("acro", 1),
                _ardupilot("steering", 3),
                _ardupilot("hold", 4),
                _ardupilot("loiter", 5),
                _ardupilot("follow", 6),
                _ardupilot("simple", 7),
                _ardupilot("dock", 8),
                _ardupilot("circle", 9),
                _ardupilot("auto", 10),
                _ardupilot("rtl", 11),
                _ardupilot("smart_rtl", 12),
                _ROVER_GUIDED,
                _ardupilot("initialising", 16),
            ),
            needs_stream=False,
            stream_timeout_s=3.0,
            on_timeout="stops and stays in guided",
            mode_hz=0.0,  # HEARTBEAT comes at once with a mode change
            odometry=False,  # not in its table of messages (`GCS_Common.cpp`): every rate is refused
            project=equirectangular,
            requirements=ROVER_GUIDED,
            parameters_bytewise=False,
            estimator="EKF_STATUS_REPORT",
        ),
    )
}


class Outgoing(NamedTuple):
    """What a setpoint asks for after the profile's clamps: body rates FRD rad/s, thrust, speed in m/s."""

    body_rates_frd_rad_s: tuple[float, float, float]
    thrust: float
    speed_m_s: float


def _clamp(value: float, low: float, high: float) -> float:
    """Into [low, high]; NaN stays NaN because it is compared first."""
    return min(max(value, low), high)


def outgoing(
    profile: Profile,
    roll_rate: float,
    pitch_rate: float,
    yaw_rate: float,
    speed_m_s: float,
    speed_at_full_thrust_m_s: float,
) -> Outgoing:
    """The law's controls (rad/s, m/s) in the ranges that the autopilot gives a meaning.

    `thrust = clamp(u4 / speed_at_full_thrust_m_s)`. Inputs should be finite: a NaN comes out as NaN, which
    the caller must refuse and `set_attitude_target` will not pack.
    """
    rates = (
        _clamp(roll_rate, -BODY_RATE_MAX_RAD_S, BODY_RATE_MAX_RAD_S),
        _clamp(pitch_rate, -BODY_RATE_MAX_RAD_S, BODY_RATE_MAX_RAD_S),
        _clamp(yaw_rate, -BODY_RATE_MAX_RAD_S, BODY_RATE_MAX_RAD_S),
    )
    if profile.planar:
        rates = (0.0, 0.0, rates[2])
    thrust = _clamp(speed_m_s / speed_at_full_thrust_m_s, profile.thrust_min, profile.thrust_max)
    return Outgoing(rates, thrust, thrust * speed_at_full_thrust_m_s)


def neutral(profile: Profile, speed_at_full_thrust_m_s: float) -> Outgoing:
    """The setpoint that asks the vehicle to stay as it is."""
    return Outgoing(
        (0.0, 0.0, 0.0), profile.thrust_neutral, profile.thrust_neutral * speed_at_full_thrust_m_s
    )


def set_attitude_target(
    profile: Profile, setpoint: Outgoing, system: int, component: int, boot_ms: int
) -> Payload:
    """SET_ATTITUDE_TARGET (82) for this autopilot; the attitude is masked and its field neutral.

    Raises ValueError for a number that is not finite: to the autopilot NaN means anything but "nothing".
    """
    if not all(map(math.isfinite, (*setpoint.body_rates_frd_rad_s, setpoint.thrust))):
        raise ValueError(f"a setpoint that is not finite: {setpoint}")
    payload = _ATTITUDE_TARGET.pack(
        boot_ms & 0xFFFFFFFF,
        *(1.0, 0.0, 0.0, 0.0),
        *setpoint.body_rates_frd_rad_s,
        setpoint.thrust,
        system,
        component,
        profile.type_mask,
    )
    return Payload(dialect.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET, payload)


def set_mode_command(mode: Mode, system: int, component: int) -> Any:
    """COMMAND_LONG with MAV_CMD_DO_SET_MODE (176), custom mode enabled."""
    return command_long(system, component, dialect.MAV_CMD_DO_SET_MODE, 1.0, mode.main, mode.sub)


def command_long(system: int, component: int, command: int, *params: float) -> Any:
    """COMMAND_LONG (76); missing params are 0."""
    filled = (*params, *(0.0,) * (7 - len(params)))
    return dialect.MAVLink_command_long_message(system, component, command, 0, *filled)
