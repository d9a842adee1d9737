"""What an ArduPilot vehicle sends: the stream groups of its first link, and what comes on request."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

from pymavlink.dialects.v20 import all as mavlink

from sitl.vehicle import telemetry
from sitl.vehicle.sample import Sample
from sitl.vehicle.telemetry import Builder

if TYPE_CHECKING:
    from sitl.vehicle.ardupilot import ArduPilot

#: MAV_DATA_STREAM -> the messages of the group that this vehicle fills. ATTITUDE_QUATERNION is in none.
STREAM_GROUPS: Final[dict[int, tuple[str, ...]]] = {
    1: ("RAW_IMU", "SCALED_PRESSURE"),
    2: ("SYS_STATUS", "POWER_STATUS", "MEMINFO", "MISSION_CURRENT", "GPS_RAW_INT", "NAV_CONTROLLER_OUTPUT"),
    3: ("SERVO_OUTPUT_RAW", "RC_CHANNELS"),
    4: ("RC_CHANNELS_SCALED",),
    6: ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"),
    10: ("ATTITUDE", "SIMSTATE", "AHRS2"),
    11: ("VFR_HUD",),
    12: ("AHRS", "SYSTEM_TIME", "EKF_STATUS_REPORT", "VIBRATION", "BATTERY_STATUS", "WIND"),
}
#: MAV_DATA_STREAM -> the MAV1_ parameter with its rate.
STREAM_PARAMETERS: Final[dict[int, str]] = {
    1: "RAW_SENS",
    2: "EXT_STAT",
    3: "RC_CHAN",
    4: "RAW_CTRL",
    6: "POSITION",
    10: "EXTRA1",
    11: "EXTRA2",
    12: "EXTRA3",
}
#: As recorded: 4.7.0-dev, 2598e9d4.
FLIGHT_SW_VERSION: Final = 0x04070000
GIT_HASH: Final = list(b"2598e9d4")
EKF_FLAGS: Final = (167, 831)


def ardupilot_builders(pilot: ArduPilot) -> dict[int, Builder]:
    """Message id -> what fills it; the mode and arming come from `pilot`."""
    messages = _ArduPilotMessages(pilot)
    ready = pilot.if_ready
    special: dict[str, Builder] = {
        "AHRS": messages.ahrs,
        "AHRS2": messages.ahrs2,
        "AUTOPILOT_VERSION": messages.autopilot_version,
        "BATTERY_STATUS": telemetry.battery_status(12600, 100),
        "EKF_STATUS_REPORT": messages.ekf_status_report,
        "EXTENDED_SYS_STATE": messages.extended_sys_state,
        "GLOBAL_POSITION_INT": messages.global_position_int,
        "GPS_RAW_INT": messages.gps_raw_int,
        "HEARTBEAT": messages.heartbeat,
        "HOME_POSITION": ready(messages.home_position),
        "MEMINFO": messages.meminfo,
        "MISSION_CURRENT": messages.mission_current,
        "NAV_CONTROLLER_OUTPUT": messages.nav_controller_output,
        "POWER_STATUS": messages.power_status,
        "RAW_IMU": messages.raw_imu,
        "RC_CHANNELS": messages.rc_channels,
        "RC_CHANNELS_SCALED": messages.rc_channels_scaled,
        "SERVO_OUTPUT_RAW": messages.servo_output_raw,
        "SIMSTATE": messages.simstate,
        "SYS_STATUS": messages.sys_status,
    }
    if pilot.finds_wind:
        special["WIND"] = ready(telemetry.wind)
    return telemetry.builders(pilot, special)


class _ArduPilotMessages:
    """Messages that show what the firmware is doing, and its own dialect's."""

    def __init__(self, pilot: ArduPilot) -> None:
        self._pilot = pilot

    def heartbeat(self, _: Sample) -> Any:
        """HEARTBEAT under ArduPilot."""
        pilot = self._pilot
        return mavlink.MAVLink_heartbeat_message(
            pilot.mav_type, 3, pilot.base_mode(), pilot.custom_mode, pilot.system_status(), 3
        )

    def global_position_int(self, s: Sample) -> Any:
        """GLOBAL_POSITION_INT: sent from the start, with zeros while there is no position."""
        if self._pilot.estimator_ready:
            return telemetry.global_position_int(s)
        return mavlink.MAVLink_global_position_int_message(s.boot_ms, 0, 0, 0, 0, 0, 0, 0, s.heading_cdeg())

    def home_position(self, s: Sample) -> Any:
        """HOME_POSITION; there is no attitude in it."""
        pilot = self._pilot
        nan = math.nan
        return telemetry.home_position(s, pilot.options.origin, pilot.home_ned_m, (nan, nan, nan, nan))

    def sys_status(self, _: Sample) -> Any:
        """SYS_STATUS."""
        present, enabled, unready, healthy = self._pilot.sensors
        health = healthy if self._pilot.estimator_ready else unready
        return mavlink.MAVLink_sys_status_message(
            present, enabled, health, 0, 12600, 0, 100, 0, 0, 0, 0, 0, 0, 0, 0, 0
        )

    def ekf_status_report(self, _: Sample) -> Any:
        """EKF_STATUS_REPORT."""
        flags = EKF_FLAGS[self._pilot.estimator_ready]
        return mavlink.MAVLink_ekf_status_report_message(flags, 0.01, 0.01, 0.01, 0.01, 0.0, 0.0)

    def extended_sys_state(self, _: Sample) -> Any:
        """EXTENDED_SYS_STATE: no VTOL; only on request."""
        return mavlink.MAVLink_extended_sys_state_message(0, self._pilot.landed_state)

    def gps_raw_int(self, s: Sample) -> Any:
        """GPS_RAW_INT: no fix before the estimator is ready, then RTK fixed as in the simulator."""
        return telemetry.gps_raw_int(s, 6 if self._pilot.estimator_ready else 1)

    def ahrs(self, _: Sample) -> Any:
        """AHRS: no gyro drift, no error."""
        return mavlink.MAVLink_ahrs_message(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def ahrs2(self, s: Sample) -> Any:
        """AHRS2: the backup estimator agrees."""
        latitude, longitude, altitude_m = s.geodetic()
        return mavlink.MAVLink_ahrs2_message(*s.euler_rad, altitude_m, latitude, longitude)

    def simstate(self, s: Sample) -> Any:
        """SIMSTATE: what the simulator would say of itself, through the same noise."""
        latitude, longitude, _ = s.geodetic()
        return mavlink.MAVLink_simstate_message(
            *s.euler_rad, *s.specific_force_frd_m_s2(), *s.body_rates_frd_rad_s, latitude, longitude
        )

    def raw_imu(self, s: Sample) -> Any:
        """RAW_IMU in mg, mrad/s and mgauss."""
        force = (_int16(part / 9.80665 * 1000.0) for part in s.specific_force_frd_m_s2())
        rates = (_int16(rate * 1000.0) for rate in s.body_rates_frd_rad_s)
        field = (_int16(part * 1000.0) for part in telemetry.magnetic_field_frd_gauss(s))
        return mavlink.MAVLink_raw_imu_message(s.boot_us, *force, *rates, *field, 0, 2500)

    def power_status(self, _: Sample) -> Any:
        """POWER_STATUS."""
        return mavlink.MAVLink_power_status_message(5000, 0, 0)

    def meminfo(self, _: Sample) -> Any:
        """MEMINFO."""
        return mavlink.MAVLink_meminfo_message(0, 65535, 524288)

    def mission_current(self, _: Sample) -> Any:
        """MISSION_CURRENT: no mission."""
        return mavlink.MAVLink_mission_current_message(0, 0, 1, 0)

    def nav_controller_output(self, _: Sample) -> Any:
        """NAV_CONTROLLER_OUTPUT: only the modes that navigate send it."""
        if not self._pilot.base_mode() & 8:
            return None
        return mavlink.MAVLink_nav_controller_output_message(0.0, 0.0, 0, 0, 0, 0.0, 0.0, 0.0)

    def rc_channels(self, s: Sample) -> Any:
        """RC_CHANNELS: the simulator's sticks in the middle."""
        pulses = [1500, 1500, 1500, 1500, 1800, 1000, 1000, 1800, *[0] * 10]
        return mavlink.MAVLink_rc_channels_message(s.boot_ms, 8, *pulses, 255)

    def rc_channels_scaled(self, s: Sample) -> Any:
        """RC_CHANNELS_SCALED: outputs are not modelled."""
        return mavlink.MAVLink_rc_channels_scaled_message(s.boot_ms, 0, *[0] * 8, 255)

    def servo_output_raw(self, s: Sample) -> Any:
        """SERVO_OUTPUT_RAW: steering and throttle in the middle, as outputs are not modelled."""
        pulses = [1500, 0, 1500, 0, 0, 0, 0, 0]
        return mavlink.MAVLink_servo_output_raw_message(s.boot_us & 0xFFFFFFFF, 0, *pulses, *[0] * 8)

    def autopilot_version(self, _: Sample) -> Any:
        """AUTOPILOT_VERSION as recorded, with an identity of its own."""
        uid2 = list(f"built-in {self._pilot.title}".encode().ljust(18, b"\0"))
        return mavlink.MAVLink_autopilot_version_message(
            self._pilot.capabilities, FLIGHT_SW_VERSION, 0, 0, 0, GIT_HASH, [0] * 8, [0] * 8, 0, 0, 0, uid2
        )


def _int16(value: float) -> int:
    return max(-32768, min(32767, round(value)))
