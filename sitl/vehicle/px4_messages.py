"""What a PX4 vehicle sends: every stream of its onboard link that a plant without sensors can fill."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

from pymavlink.dialects.v20 import all as mavlink

from sitl.vehicle import telemetry
from sitl.vehicle.frame import FrameType
from sitl.vehicle.px4_modes import STANDARD_MODES
from sitl.vehicle.px4_targets import AttitudeTarget
from sitl.vehicle.sample import Sample
from sitl.vehicle.telemetry import Builder

if TYPE_CHECKING:
    from sitl.vehicle.px4 import Px4

#: Rates of MAVLINK_MODE_ONBOARD (`mavlink_main.cpp`), in its order; GPS_RAW_INT comes at the rate of the
#: receiver, as recorded. Streams that a vehicle without those devices never fills are left out.
STREAM_RATES_HZ: Final = {
    "HEARTBEAT": 1.0,
    "TIMESYNC": 10.0,
    "HIGHRES_IMU": 50.0,
    "LOCAL_POSITION_NED": 30.0,
    "ATTITUDE": 100.0,
    "ALTITUDE": 10.0,
    "ODOMETRY": 30.0,
    "ATTITUDE_QUATERNION": 50.0,
    "ATTITUDE_TARGET": 10.0,
    "BATTERY_STATUS": 0.5,
    "CURRENT_MODE": 0.5,
    "ESTIMATOR_STATUS": 1.0,
    "EXTENDED_SYS_STATE": 5.0,
    "GLOBAL_POSITION_INT": 50.0,
    "GPS_RAW_INT": 8.0,
    "HOME_POSITION": 0.5,
    "MISSION_CURRENT": 1.0,
    "PING": 1.0,
    "SCALED_PRESSURE": 1.0,
    "SERVO_OUTPUT_RAW": 10.0,
    "SYS_STATUS": 5.0,
    "SYSTEM_TIME": 1.0,
    "VFR_HUD": 10.0,
    "VIBRATION": 0.5,
    "WIND_COV": 1.0,
}
#: As recorded: those of a vehicle that takes attitude and local position targets.
CAPABILITIES: Final = 0xE8FF
ESTIMATOR_FLAGS: Final = (229, 831)
#: Pose and velocity covariance: one variance known, the rest not.
_COVARIANCES: Final = (0.01, *[math.nan] * 20) * 2
#: How often the commander publishes its status without a change.
STATUS_PERIOD_US: Final = 500_000
_LOCAL_NED: Final = 1
_AUTOPILOT_ESTIMATOR: Final = 8
_ODOMETRY: Final = FrameType(mavlink.MAVLink_odometry_message)
_HIGHRES_IMU: Final = FrameType(mavlink.MAVLink_highres_imu_message)


def px4_builders(pilot: Px4) -> dict[int, Builder]:
    """Message id -> what fills it; the mode and arming come from `pilot`."""
    messages = _Px4Messages(pilot)
    ready = pilot.if_ready
    special: dict[str, Builder] = {
        "ALTITUDE": ready(messages.altitude),
        "ATTITUDE_TARGET": messages.attitude_target,
        "AUTOPILOT_VERSION": messages.autopilot_version,
        "BATTERY_STATUS": telemetry.battery_status(16200, 99),
        "CURRENT_MODE": messages.current_mode,
        "ESTIMATOR_STATUS": messages.estimator_status,
        "EXTENDED_SYS_STATE": messages.extended_sys_state,
        "GLOBAL_POSITION_INT": ready(telemetry.global_position_int),
        "GPS_RAW_INT": messages.gps_raw_int,
        "HEARTBEAT": messages.heartbeat,
        "HIGHRES_IMU": messages.highres_imu,
        "HOME_POSITION": ready(messages.home_position),
        "MISSION_CURRENT": messages.mission_current,
        "ODOMETRY": ready(messages.odometry),
        "PING": messages.ping,
        "SERVO_OUTPUT_RAW": messages.servo_output_raw,
        "SYS_STATUS": messages.sys_status,
    }
    if pilot.finds_wind:
        special["WIND_COV"] = ready(telemetry.wind_cov)
    return telemetry.builders(pilot, special)


class _Px4Messages:
    """Messages that show what the firmware is doing."""

    def __init__(self, pilot: Px4) -> None:
        self._pilot = pilot
        self._pings = 0
        self._status_shown: tuple[int, ...] | None = None

    def heartbeat(self, _: Sample) -> Any:
        """HEARTBEAT under PX4, of the type that MAV_TYPE says."""
        pilot = self._pilot
        kind = int(pilot.parameters["MAV_TYPE"]) & 0xFF
        return mavlink.MAVLink_heartbeat_message(
            kind, 12, pilot.base_mode(), pilot.custom_mode, pilot.system_status(), 3
        )

    def current_mode(self, s: Sample) -> Any:
        """CURRENT_MODE: the mode flown and the mode intended, which differ in a failsafe.

        Asked for at any rate it comes twice a second, and at the next chance after a change: the
        commander publishes no oftener (recorded: 506 ms apart when asked for every 200 ms).
        """
        pilot = self._pilot
        status = (pilot.custom_mode, pilot.intended_mode, pilot.armed, s.boot_us // STATUS_PERIOD_US)
        if status == self._status_shown and not pilot.answering:
            return None
        self._status_shown = status
        standard = {**STANDARD_MODES, **pilot.standard_modes}.get(pilot.custom_mode, 0)
        return mavlink.MAVLink_current_mode_message(standard, pilot.custom_mode, pilot.intended_mode)

    def attitude_target(self, s: Sample) -> Any:
        """ATTITUDE_TARGET: rates as wanted; q and thrust of the last attitude setpoint, stale without one."""
        pilot = self._pilot
        target = pilot.target
        rates = target.body_rates_frd_rad_s if isinstance(target, AttitudeTarget) else (0.0, 0.0, 0.0)
        return mavlink.MAVLink_attitude_target_message(
            s.boot_ms, 0, list(pilot.stale_attitude_wxyz), *rates, pilot.stale_thrust
        )

    def altitude(self, s: Sample) -> Any:
        """ALTITUDE."""
        above_origin_m = -s.position_ned_m[2]
        altitude_m = s.origin.altitude_m + above_origin_m
        return mavlink.MAVLink_altitude_message(
            s.boot_us, altitude_m, altitude_m, above_origin_m, above_origin_m, math.nan, math.nan
        )

    def odometry(self, s: Sample) -> Any:
        """ODOMETRY with pose and velocity in local NED, as recorded (`child_frame_id` 1)."""
        return _ODOMETRY(
            s.boot_us, *s.position_ned_m, *s.attitude_wxyz, *s.velocity_ned_m_s, *s.body_rates_frd_rad_s,
            *_COVARIANCES, _LOCAL_NED, _LOCAL_NED, self._pilot.reset_counter & 0xFF, _AUTOPILOT_ESTIMATOR, 0,
        )  # fmt: skip

    def highres_imu(self, s: Sample) -> Any:
        """HIGHRES_IMU of ideal sensors."""
        return _HIGHRES_IMU(
            s.boot_us, *s.specific_force_frd_m_s2(), *s.body_rates_frd_rad_s,
            *telemetry.magnetic_field_frd_gauss(s), telemetry.pressure_hpa(s) * 100.0, 0.0,
            s.origin.altitude_m - s.position_ned_m[2], 25.0, 7167, 0,
        )  # fmt: skip

    def estimator_status(self, s: Sample) -> Any:
        """ESTIMATOR_STATUS; EKF2 counts a vehicle at rest as constant in position (`get_ekf_soln_status`)."""
        flags = ESTIMATOR_FLAGS[self._pilot.estimator_ready]
        if self._pilot.at_rest:
            flags |= mavlink.ESTIMATOR_CONST_POS_MODE
        return mavlink.MAVLink_estimator_status_message(
            s.boot_us, flags, 0.01, 0.01, 0.01, 0.01, 0.01, math.nan, 0.1, 0.1
        )

    def extended_sys_state(self, _: Sample) -> Any:
        """EXTENDED_SYS_STATE."""
        return mavlink.MAVLink_extended_sys_state_message(0, self._pilot.landed_state)

    def sys_status(self, _: Sample) -> Any:
        """SYS_STATUS."""
        present, enabled, unready, healthy = self._pilot.sensors
        health = healthy if self._pilot.estimator_ready and not self._pilot.failsafe else unready
        return mavlink.MAVLink_sys_status_message(
            present, enabled, health, 85, 16200, -1, 99, 0, 0, 0, 0, 0, 0, 0, 0, 1
        )

    def gps_raw_int(self, s: Sample) -> Any:
        """GPS_RAW_INT: a three-dimensional fix."""
        return telemetry.gps_raw_int(s, 3)

    def home_position(self, s: Sample) -> Any:
        """HOME_POSITION."""
        pilot = self._pilot
        return telemetry.home_position(s, pilot.options.origin, pilot.home_ned_m, (1.0, 0.0, 0.0, 0.0))

    def mission_current(self, _: Sample) -> Any:
        """MISSION_CURRENT: there is none."""
        return mavlink.MAVLink_mission_current_message(0, 65535)

    def ping(self, s: Sample) -> Any:
        """PING: asks everybody once a second."""
        self._pings += 1
        return mavlink.MAVLink_ping_message(s.boot_us, self._pings - 1 & 0xFFFFFFFF, 0, 0)

    def servo_output_raw(self, s: Sample) -> Any:
        """SERVO_OUTPUT_RAW: outputs are not modelled, only whether they are on."""
        pulse = 1500 if self._pilot.armed else 900
        return mavlink.MAVLink_servo_output_raw_message(s.boot_us & 0xFFFFFFFF, 0, *[pulse] * 8, *[900] * 8)

    def autopilot_version(self, _: Sample) -> Any:
        """AUTOPILOT_VERSION as recorded, with an identity of its own."""
        git = [0, 0, 0, 109, 67, 157, 154, 131]
        major, minor, patch = self._pilot.options.px4_version
        version = major << 24 | minor << 16 | patch << 8 | mavlink.FIRMWARE_VERSION_TYPE_OFFICIAL
        return mavlink.MAVLink_autopilot_version_message(
            CAPABILITIES,
            version,
            version,
            0,
            1,
            git,
            git,
            [0] * 8,
            0,
            0,
            0x5E3D,
            [0] * 18,
        )
