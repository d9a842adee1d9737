"""ODOMETRY and GLOBAL_POSITION_INT as samples: frames, units, and what is refused under which name."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from guidance.estimate.samples import from_global, from_odometry
from guidance.geodesy import azimuthal_equidistant
from guidance.mavlink.messages import GlobalPositionInt, GpsGlobalOrigin, Odometry
from guidance.mavlink.profiles import PROFILES
from guidance.se3 import Quaternion, Vec3
from sitl.vehicle import projection
from sitl.vehicle.options import Origin
from tests.oracle import matrix_of
from tests.strategies import properties, quaternions, vectors

NAN, INF = math.nan, math.inf
ODOMETRY = Odometry(
    time_usec=1_000_600, x=1.0, y=2.0, z=3.0, q1=1.0, q2=0.0, q3=0.0, q4=0.0, vx=4.0, vy=5.0, vz=6.0,
    rollspeed=0.1, pitchspeed=0.2, yawspeed=0.3, frame_id=dialect.MAV_FRAME_LOCAL_NED,
    child_frame_id=dialect.MAV_FRAME_BODY_FRD, reset_counter=0, estimator_type=8, quality=0,
)  # fmt: skip
ORIGIN = GpsGlobalOrigin(473977418, 85455939, 488000)


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"frame_id": dialect.MAV_FRAME_LOCAL_FRD}, "pose_not_in_local_ned"),
        ({"frame_id": dialect.MAV_FRAME_LOCAL_ENU}, "pose_not_in_local_ned"),
        ({"frame_id": 0}, "pose_not_in_local_ned"),
        ({"child_frame_id": dialect.MAV_FRAME_LOCAL_FRD}, "velocity_frame"),
        ({"child_frame_id": dialect.MAV_FRAME_BODY_NED}, "velocity_frame"),
        ({"child_frame_id": 0}, "velocity_frame"),
        ({"quality": -1}, "failed"),
        ({"estimator_type": dialect.MAV_ESTIMATOR_TYPE_VISION}, "not_its_own_estimate"),
        ({"q1": NAN}, "not_finite"),
        ({"q1": 0.9}, "not_a_unit_quaternion"),
        ({"q1": 0.0}, "not_a_unit_quaternion"),
        ({"x": NAN}, "not_finite"),
        ({"z": INF}, "not_finite"),
        ({"vy": NAN}, "not_finite"),
        ({"yawspeed": NAN}, "not_finite"),
        ({"y": 2e7}, "absurd"),
        ({"vz": 2000.0}, "absurd"),
        ({"rollspeed": 101.0}, "absurd"),
    ],
    ids=str,
)
def test_odometry_that_cannot_be_used_is_refused_by_name(changed: dict[str, Any], why: str) -> None:
    assert from_odometry(ODOMETRY._replace(**changed), 7) == why


@properties
@given(quaternions(), vectors(20.0))
def test_the_velocity_is_read_in_the_child_frame(q: Quaternion, v: Vec3) -> None:
    """MAV_FRAME_BODY_FRD by the standard, MAV_FRAME_LOCAL_NED as PX4 sends it today."""
    message = ODOMETRY._replace(q1=q.w, q2=q.x, q3=q.y, q4=q.z, vx=v.x, vy=v.y, vz=v.z)
    in_body = from_odometry(message, 7)
    assert not isinstance(in_body, str)
    attitude, position = in_body
    assert math.dist(position.velocity_ned_m_s, matrix_of(q) @ v) < 1e-9
    assert math.dist(attitude.attitude, q) < 1e-12
    assert attitude[:2] == position[:2] == (7, 1000)
    in_ned = from_odometry(message._replace(child_frame_id=dialect.MAV_FRAME_LOCAL_NED), 7)
    assert not isinstance(in_ned, str)
    assert in_ned[1].velocity_ned_m_s == v


@pytest.mark.parametrize(
    ("changed", "origin", "why"),
    [
        ({"lat": 0, "lon": 0}, ORIGIN, "no_position"),
        ({"lat": 900_000_001}, ORIGIN, "absurd"),
        ({"lon": -1_800_000_001}, ORIGIN, "absurd"),
        ({}, None, "no_origin"),
        ({"lat": -473977418, "lon": -1704544061}, ORIGIN, "absurd"),
    ],
    ids=str,
)
def test_a_global_position_that_cannot_be_used_is_refused_by_name(
    changed: dict[str, int], origin: GpsGlobalOrigin | None, why: str
) -> None:
    message = GlobalPositionInt(1000, 473977418, 85455939, 488000, 0, 0, 0)._replace(**changed)
    assert from_global(message, 7, origin, azimuthal_equidistant) == why


@properties
@given(
    st.floats(-70.0, 70.0),
    st.floats(-180.0, 180.0),
    st.tuples(st.floats(-2000.0, 2000.0), st.floats(-2000.0, 2000.0), st.floats(-500.0, 500.0)),
    st.sampled_from(["px4-uuv", "ardupilot-rover"]),
)
def test_a_global_position_is_the_local_one_to_its_resolution(
    latitude_deg: float, longitude_deg: float, at: tuple[float, float, float], profile: str
) -> None:
    """Through the firmware's own projection, as the built-in vehicle has it, and back through ours.

    Steps of 1e-7 deg are 11 mm, and both cut off what is less.
    """
    origin = Origin(round(latitude_deg * 1e7) * 1e-7, round(longitude_deg * 1e7) * 1e-7, 100.0)
    project = projection.azimuthal_equidistant if profile == "px4-uuv" else projection.equirectangular
    latitude, longitude, altitude_m = project(origin, at)
    sent = GlobalPositionInt(1000, latitude, longitude, round(altitude_m * 1000.0), 100, -200, 50)
    ekf = GpsGlobalOrigin(round(origin.latitude_deg * 1e7), round(origin.longitude_deg * 1e7), 100_000)
    sample = from_global(sent, 7, ekf, PROFILES[profile].project)
    if (latitude, longitude) == (0, 0):
        return
    assert not isinstance(sample, str)
    assert math.dist(sample.position_ned_m, at) < 0.017
    assert sample.velocity_ned_m_s == pytest.approx((1.0, -2.0, 0.5))
