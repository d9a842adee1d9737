"""`guidance check`: whether the flight is feasible from here, what bounds it, who signs and who may order."""

from __future__ import annotations

import pytest

from guidance.preflight.findings import Finding, Verdict
from tests.preflight_rig import Bench
from tests.test_fitting import SLOW
from tests.test_signed_flights import SIGNED
from tests.test_signing import KEY

FENCE = "guards.fence_ned_m=[[-50,-50],[50,-50],[50,50],[-50,50]]"


def found(bench: Bench, check: str) -> Finding:
    return bench.findings()[check]


def copter(*settings: str, **parameters: float) -> Bench:
    return Bench(
        "vehicle.profile=px4-copter",
        "link.rate_hz=50",
        "trajectory.name=circle",
        "trajectory.radius_m=10",
        "trajectory.speed_m_s=2",
        "limits.speed_min_m_s=0",
        "limits.acceleration_max_m_s2=1",
        "law.rho2_per_s=1.5",
        "law.rho3_per_s=1.5",
        "flight.origin=engage",
        *settings,
        vehicle={"parameters": parameters},
    )


def test_a_flight_that_is_feasible_from_here_is_said_to_be() -> None:
    bench = Bench(*SLOW, FENCE, "guards.fence_plan_s=30")
    assert found(bench, "trajectory") == Finding("trajectory", Verdict.OK, "circle: can be flown from here")
    inside = "the vehicle is inside, and so are 30 s of the way from here"
    assert found(bench, "fence") == Finding("fence", Verdict.OK, inside)
    none = found(Bench(*SLOW, "guards.fence_ned_m=[]"), "fence")
    assert none[:3] == ("fence", Verdict.WARN, "none is set")
    assert "guards.fence_deg" in none.todo


def test_a_way_that_leaves_the_fence_from_here_fails() -> None:
    """The origin is where it engages: the file alone could not say."""
    bench = Bench(*SLOW, "flight.origin=engage", "guards.fence_ned_m=[[-5,-5],[5,-5],[5,5],[-5,5]]")
    bad = bench.bad()["guards"]
    assert bad.verdict is Verdict.FAIL
    assert bad.found.startswith("fence: ")
    assert "fence" not in bench.findings()


def test_what_bounds_the_vehicle_is_listed_with_where_it_comes_from() -> None:
    listed = copter(MPC_XY_VEL_MAX=3.0, MPC_TILTMAX_AIR=10.0).findings()
    assert listed["horizontal speed"].found == "3 m/s (MPC_XY_VEL_MAX 3)"
    assert listed["sink"].found.endswith("(MPC_Z_VEL_MAX_DN 1.5)")
    assert listed["horizontal acceleration"].found == "0.9 m/s^2 (limits.acceleration_max_m_s2 less 10 %)"
    tilted = copter("limits.acceleration_max_m_s2=9", MPC_TILTMAX_AIR=5.0).findings()
    assert tilted["horizontal acceleration"].found == "0.7722 m/s^2 (g tan MPC_TILTMAX_AIR 5 less 10 %)"
    rover = Bench(*SLOW).findings()
    assert rover["yaw rate"].found.endswith(")")
    assert rover["radius"].found == "at least 0.9 m (TURN_RADIUS 0.9)"


def test_what_is_to_be_known_before_the_flight_is_a_warning() -> None:
    bad = Bench(*SLOW, vehicle={"parameters": {"WP_SPEED": 1.02}}).bad()
    assert bad["room"].verdict is Verdict.WARN
    assert "little room to catch up: speed: 1 m/s needed" in bad["room"].found


def test_an_airplane_that_stands_would_not_be_begun_with_and_that_is_no_fault() -> None:
    bench = Bench(
        "vehicle.profile=px4-plane",
        "vehicle.speed_at_full_thrust_m_s=25",
        'trajectory={name="circle", radius_m=100, speed_m_s=15}',
        "limits.speed_min_m_s=10",
        "limits.speed_max_m_s=25",
        'law.name="global"',
        "flight.origin=engage",
        "supervisor.engage_max_error_m=500",
    )
    finding = found(bench, "trajectory")
    assert finding.verdict is Verdict.WARN
    assert "airspeed" in finding.found


@pytest.mark.parametrize(
    ("settings", "by_zenoh", "by_mavlink"),
    [
        ((), "nobody (zenoh.commands = false)", "nobody (link.commands_from = [])"),
        (
            ("zenoh.commands=true", "link.commands_from=[255, 3]"),
            "whoever reaches it orders, as by guidance command",
            "system 255 or 3, unsigned",
        ),
        (
            ("zenoh.enabled=false", "zenoh.commands=true"),
            "nobody (zenoh.commands = false)",
            "nobody (link.commands_from = [])",
        ),
    ],
)
def test_who_may_order_is_said_whatever_the_line_does(
    settings: tuple[str, ...], by_zenoh: str, by_mavlink: str
) -> None:
    listed = Bench(*settings, dead=True, seconds=1.0).findings()
    assert listed["by zenoh"].found == by_zenoh
    assert listed["by MAVLink"].found == by_mavlink
    assert listed["engages"].found == "by itself, as soon as it may; arms"


def test_who_signs_is_named() -> None:
    bench = Bench(*SIGNED, vehicle={"signing_key": KEY}, signing_key=KEY)
    assert found(bench, "signers").found == "1/1; this service signs as link 0"
    assert found(bench, "signing").found.startswith("both ends sign, by one key (")
    assert "signers" not in Bench().findings()


def test_sticks_that_are_not_there_are_warned_of() -> None:
    """The built-in copter has none, as recorded."""
    finding = copter().bad()["sticks"]
    assert finding.verdict is Verdict.WARN
    assert "set COM_OBL_RC_ACT to 5 (hold)" in finding.found
    assert "sticks" not in copter(COM_OBL_RC_ACT=5).findings()
