"""Where the trajectory's origin is, when it starts, and how far the vehicle is from there."""

from __future__ import annotations

import math

import pytest

from guidance.blending import Blending, blending
from guidance.geodesy import Projection, azimuthal_equidistant, equirectangular
from guidance.law import Evaluation
from guidance.mavlink.messages import GpsGlobalOrigin, HomePosition
from guidance.mavlink.profiles import PROFILES
from guidance.records import Reference
from guidance.se3 import Vec3
from guidance.tracker import Solution, Tracker, is_usable
from guidance.trajectory import sample
from tests.helpers import ROVER, fly_until_tracking, make_config, make_flight

EKF = GpsGlobalOrigin(latitude=473977418, longitude=85455939, altitude=488000)
HERE = Vec3(3.0, -4.0, 5.0)


def tracker(origin: str, *overrides: str) -> Tracker:
    config = make_config(*overrides, f"flight.origin={origin}")
    return Tracker(config, PROFILES[config.vehicle.profile])


def home_at(latitude: int, longitude: int, altitude: int) -> HomePosition:
    return HomePosition(latitude=latitude, longitude=longitude, altitude=altitude)


def test_the_estimators_origin_and_the_place_of_engaging_need_nothing_else() -> None:
    assert tracker("ekf").find_origin(HERE, None, None) == Vec3(0.0, 0.0, 0.0)
    assert tracker("engage").find_origin(HERE, None, None) == HERE


def test_what_is_missing_is_named() -> None:
    assert "GPS_GLOBAL_ORIGIN" in str(tracker("home").find_origin(HERE, None, home_at(0, 0, 0)))
    assert "HOME_POSITION" in str(tracker("home").find_origin(HERE, EKF, None))
    assert "GPS_GLOBAL_ORIGIN" in str(tracker("[47.0, 8.0, 480.0]").find_origin(HERE, None, None))


@pytest.mark.parametrize(
    ("profile", "radius_m"), [((), 6371000.0), (ROVER[:1], 6378100.0)], ids=["PX4", "ArduPilot"]
)
def test_one_degree_is_as_long_as_on_this_autopilots_sphere(
    profile: tuple[str, ...], radius_m: float
) -> None:
    degree_m = math.radians(1.0) * radius_m
    equator = GpsGlobalOrigin(latitude=0, longitude=0, altitude=10_000)
    found = tracker("[1.0, 0.0, 10.0]", *profile).find_origin(HERE, equator, None)
    assert found == pytest.approx((degree_m, 0.0, 0.0))
    found = tracker("home", *profile).find_origin(HERE, equator, home_at(0, 10_000_000, 25_000))
    assert found == pytest.approx((0.0, degree_m, -15.0))


projections = pytest.mark.parametrize(
    ("project", "radius_m"), [(azimuthal_equidistant, 6371000.0), (equirectangular, 6378100.0)]
)


@projections
def test_distances_far_from_the_equator_and_over_the_date_line_are_right(
    project: Projection, radius_m: float
) -> None:
    point = (-47.001, -179.9995, 0.0)
    x, y, z = project(point, (-47.0, 179.9995, 100.0))
    assert x == pytest.approx(-math.radians(0.001) * radius_m, rel=1e-4)
    assert y == pytest.approx(math.radians(0.001) * radius_m * math.cos(math.radians(47.001)), rel=1e-4)
    assert z == 100.0


@projections
def test_the_origin_itself_is_at_zero(project: Projection, radius_m: float) -> None:
    at = (47.3977418, 8.5455939, 488.0)
    assert project(at, at) == Vec3(0.0, 0.0, 0.0)


def test_the_start_error_counts_depth_only_for_a_vehicle_that_can_dive() -> None:
    position, origin = (
        Vec3(3.0, 4.0, 12.0),
        Vec3(0.0, -1.0, 0.0),
    )  # r(0) is 1 m east of it
    assert tracker("ekf").start_error_m(position, origin) == pytest.approx(math.hypot(3.0, 4.0, 12.0))
    assert tracker("ekf", ROVER[0]).start_error_m(position, origin) == pytest.approx(5.0)


@pytest.mark.parametrize("delay_s", [0.0, 0.05])
def test_the_trajectory_starts_at_the_first_tracking_setpoint(delay_s: float) -> None:
    flight = make_flight(f"link.actuation_delay_s={delay_s}")
    fly_until_tracking(flight)
    flight.run(1.0, until=lambda: flight.guide.tracker.start_ns is not None)
    references = [r for r in flight.records if isinstance(r, Reference)]
    assert [r.trajectory_s for r in references] == [0.0]
    assert references[0].t_ns == flight.guide.tracker.start_ns
    assert references[0].position_ned_m == sample(flight.guide.config.trajectory, 0.0).position


def test_a_flight_that_ends_leaves_neither_start_nor_origin() -> None:
    one = tracker("ekf")
    one.start(5, HERE)
    one.stop()
    assert (one.start_ns, one.origin_ned_m) == (None, None)


@pytest.mark.parametrize(
    ("overrides", "wanted"),
    [
        ((), blending(-5.0, 5.0, 5.0)),
        (("limits.speed_max_m_s=9", "limits.yaw_rate_max_rad_s=2"), blending(-5.0, 5.0, 2.0)),
        (("limits.acceleration_max_m_s2=3",), blending(-5.0, 5.0, 5.0, 3.0)),
        (
            ("limits.pitch_acceleration_max_rad_s2=4", "limits.yaw_acceleration_max_rad_s2=6"),
            blending(-5.0, 5.0, 5.0, turn_acceleration_rad_s2=4.0),
        ),
        (("limits.roll_acceleration_max_rad_s2=0.1",), blending(-5.0, 5.0, 5.0)),
        (
            ("law.error_function.name=bounded", "law.error_function.approach_m_s=1.5"),
            blending(-5.0, 5.0, 5.0, approach_m_s=1.5),
        ),
        (
            (
                "law.error_function.name=bounded-apart",
                "law.error_function.horizontal_m_s=1.5",
                "law.error_function.vertical_m_s=0.5",
            ),
            blending(-5.0, 5.0, 5.0, approach_m_s=0.5),
        ),
        (ROVER, blending(-5.0, 5.0, 2.0)),
    ],
)
def test_after_a_reset_the_reference_comes_back_within_the_limits(
    overrides: tuple[str, ...], wanted: Blending
) -> None:
    config = make_config(*overrides)
    assert Tracker(config, PROFILES[config.vehicle.profile])._blending() == wanted


def test_a_number_that_is_not_finite_is_not_usable() -> None:
    flight = make_flight()
    fly_until_tracking(flight)
    flight.run(1.0, until=lambda: flight.guide.tracker.start_ns is not None)
    guide = flight.guide
    estimate = guide.steering.estimate(flight.now_ns)
    assert not isinstance(estimate, str)
    solution = guide.tracker.solve(estimate)
    assert is_usable(solution)
    evaluation = solution.evaluation

    def with_evaluation(found: Evaluation) -> Solution:
        return solution._replace(flown=solution.flown._replace(evaluation=found))

    for broken in (
        with_evaluation(evaluation._replace(V1=math.nan)),
        with_evaluation(evaluation._replace(e=Vec3(0.0, math.inf, 0.0))),
        solution._replace(outgoing=solution.outgoing._replace(thrust=math.nan)),
        solution._replace(outgoing=solution.outgoing._replace(body_rates_frd_rad_s=(0.0, math.nan, 0.0))),
        with_evaluation(evaluation._replace(demanded=evaluation.demanded._replace(u3=math.inf))),
    ):
        assert not is_usable(broken)
