"""Messages that both firmwares fill alike, from one sample of the estimator."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

from pymavlink.dialects.v20 import all as mavlink

from sitl.plant import Triple
from sitl.vehicle.frame import FrameType
from sitl.vehicle.options import Origin
from sitl.vehicle.sample import FIELD_NED_GAUSS, Sample

if TYPE_CHECKING:
    from sitl.vehicle.autopilot import Autopilot

#: Message id of each name, in the words of the dialect.
ID: Final[dict[str, int]] = {
    name.removeprefix("MAVLINK_MSG_ID_"): value
    for name, value in vars(mavlink).items()
    if name.startswith("MAVLINK_MSG_ID_") and isinstance(value, int)
}
Builder = Callable[[Sample], Any]

#: Of the recorded estimate of the wind.
WIND_VARIANCE_M2_S2: Final = 0.09

_ATTITUDE: Final = FrameType(mavlink.MAVLink_attitude_message)
_ATTITUDE_QUATERNION: Final = FrameType(mavlink.MAVLink_attitude_quaternion_message)
_LOCAL_POSITION_NED: Final = FrameType(mavlink.MAVLink_local_position_ned_message)
_GLOBAL_POSITION_INT: Final = FrameType(mavlink.MAVLink_global_position_int_message)


def builders(pilot: Autopilot, special: Mapping[str, Builder]) -> dict[int, Builder]:
    """Message id -> what fills it: the messages that every firmware fills alike, and `special` by name."""
    named: dict[str, Builder] = {
        "ATTITUDE": attitude,
        "ATTITUDE_QUATERNION": attitude_quaternion,
        "GPS_GLOBAL_ORIGIN": pilot.if_ready(pilot.gps_global_origin),
        "LOCAL_POSITION_NED": pilot.if_ready(local_position_ned),
        "SCALED_PRESSURE": scaled_pressure,
        "SYSTEM_TIME": pilot.system_time,
        "TIMESYNC": pilot.ask_timesync,
        "VFR_HUD": vfr_hud,
        "VIBRATION": vibration,
    }
    return {ID[name]: builder for name, builder in {**named, **special}.items()}


def attitude(s: Sample) -> Any:
    """ATTITUDE: Euler angles and body rates."""
    return _ATTITUDE(s.boot_ms, *s.euler_rad, *s.body_rates_frd_rad_s)


def attitude_quaternion(s: Sample) -> Any:
    """ATTITUDE_QUATERNION: body to NED, scalar first; no representation offset, as recorded."""
    return _ATTITUDE_QUATERNION(s.boot_ms, *s.attitude_wxyz, *s.body_rates_frd_rad_s, 0.0, 0.0, 0.0, 0.0)


def local_position_ned(s: Sample) -> Any:
    """LOCAL_POSITION_NED relative to the estimator's origin."""
    return _LOCAL_POSITION_NED(s.boot_ms, *s.position_ned_m, *s.velocity_ned_m_s)


def global_position_int(s: Sample) -> Any:
    """GLOBAL_POSITION_INT; the relative altitude is that above the origin."""
    latitude, longitude, altitude_m = s.geodetic()
    vx, vy, vz = s.velocity_ned_m_s
    return _GLOBAL_POSITION_INT(
        s.boot_ms,
        latitude,
        longitude,
        _int32(altitude_m * 1000.0),
        _int32(-s.position_ned_m[2] * 1000.0),
        _int16(100.0 * vx),
        _int16(100.0 * vy),
        _int16(100.0 * vz),
        s.heading_cdeg(),
    )


def vfr_hud(s: Sample) -> Any:
    """VFR_HUD; airspeed (calibrated: less than the true one in thin air) and throttle are 0 for a body that
    has none."""
    altitude_m = s.origin.altitude_m - s.position_ned_m[2]
    thin = max(0.01, 1.0 - 2.25577e-5 * altitude_m) ** -2.12794
    north, east, down = s.velocity_ned_m_s
    return mavlink.MAVLink_vfr_hud_message(
        s.estimate.airspeed_m_s / thin,
        math.hypot(north, east),
        s.heading_cdeg() // 100,
        max(0, min(100, round(100.0 * s.estimate.throttle))),
        altitude_m,
        -down,
    )


def wind(s: Sample) -> Any:
    """WIND (ArduPilot): where it comes from, as seen from the vehicle, +-180 degrees; level, as recorded."""
    north, east, _ = s.estimate.wind_ned_m_s
    return mavlink.MAVLink_wind_message(math.degrees(math.atan2(-east, -north)), math.hypot(north, east), 0.0)


def wind_cov(s: Sample) -> Any:
    """WIND_COV (PX4): where it blows to; level, and with the variance that was recorded."""
    north, east, _ = s.estimate.wind_ned_m_s
    altitude_m = s.origin.altitude_m - s.position_ned_m[2]
    return mavlink.MAVLink_wind_cov_message(
        s.boot_us, north, east, 0.0, WIND_VARIANCE_M2_S2, 0.0, altitude_m, 0.0, 0.0
    )


def gps_raw_int(s: Sample, fix_type: int) -> Any:
    """GPS_RAW_INT with the accuracies that the recorded simulators give."""
    if fix_type < 3:
        return mavlink.MAVLink_gps_raw_int_message(s.boot_us, fix_type, 0, 0, 0, 65535, 65535, 0, 0, 0)
    latitude, longitude, altitude_m = s.geodetic()
    north, east, _ = s.velocity_ned_m_s
    course_cdeg = round(math.degrees(math.atan2(east, north)) * 100.0) % 36000
    speed = min(65534, round(100.0 * math.hypot(north, east)))
    altitude_mm = _int32(altitude_m * 1000.0)
    return mavlink.MAVLink_gps_raw_int_message(
        s.boot_us, fix_type, latitude, longitude, altitude_mm, 70, 110, speed, course_cdeg, 10,
        altitude_mm, 300, 300, 0, 0, 0,
    )  # fmt: skip


def scaled_pressure(s: Sample) -> Any:
    """SCALED_PRESSURE of the standard atmosphere at the vehicle's altitude."""
    return mavlink.MAVLink_scaled_pressure_message(s.boot_ms, pressure_hpa(s), 0.0, 2500)


def vibration(s: Sample) -> Any:
    """VIBRATION: a kinematic plant does not shake."""
    return mavlink.MAVLink_vibration_message(s.boot_us, 0.0, 0.0, 0.0, 0, 0, 0)


def battery_status(voltage_mv: int, remaining_percent: int) -> Builder:
    """BATTERY_STATUS with one voltage and no consumption."""
    voltages = [voltage_mv] + [65535] * 9

    def build(_: Sample) -> Any:
        return mavlink.MAVLink_battery_status_message(
            0, 1, 1, 32767, voltages, -1, -1, -1, remaining_percent, 0, 1
        )

    return build


def home_position(s: Sample, origin: Origin, home_ned_m: Triple, q: tuple[float, float, float, float]) -> Any:
    """HOME_POSITION: geodetic and local; PX4 fills `q`, ArduPilot sends NaN there."""
    latitude, longitude, altitude_m = s.project(origin, home_ned_m)
    return mavlink.MAVLink_home_position_message(
        latitude, longitude, _int32(altitude_m * 1000.0), *home_ned_m, list(q), 0.0, 0.0, 0.0, s.boot_us
    )


def gps_global_origin(s: Sample, origin: Origin) -> Any:
    """GPS_GLOBAL_ORIGIN: where LOCAL_POSITION_NED is zero."""
    latitude, longitude, altitude_m = s.project(origin, (0.0, 0.0, 0.0))
    return mavlink.MAVLink_gps_global_origin_message(
        latitude, longitude, _int32(altitude_m * 1000.0), s.boot_us
    )


def pressure_hpa(s: Sample) -> float:
    """Pressure of the standard atmosphere."""
    altitude_m = s.origin.altitude_m - s.position_ned_m[2]
    return 1013.25 * float(max(0.01, 1.0 - 2.25577e-5 * altitude_m) ** 5.25588)


def magnetic_field_frd_gauss(s: Sample) -> Triple:
    """The earth's field in body axes."""
    return s.to_body(*FIELD_NED_GAUSS)


def _int16(value: float) -> int:
    return max(-32768, min(32767, round(value)))


def _int32(value: float) -> int:
    return max(-(2**31), min(2**31 - 1, round(value)))
